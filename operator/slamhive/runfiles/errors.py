# SPDX-License-Identifier: Apache-2.0
"""Errors of reading a run's files, for pages, figures and bridges alike.

::

    RunFileError             a sentence, and the field of the question that is wrong
    ├── RunPathError         the path leads out of the run's folder, or is none
    ├── FileMissingError     nothing that can be read is there
    ├── FileTooLargeError    it is more than is read at a time
    └── FileAwayError        object storage does not give it at present
"""

from __future__ import annotations

from slamhive.model.errors import InputError, SlamHiveError, SystemFault


class RunFileError(SlamHiveError):
    """A file of a run that can't be read.

    Attributes:
        field: name of what was asked for and is wrong, such as ``path``.
    """

    def __init__(self, sentence: str, field: str | None = None) -> None:
        super().__init__(sentence)
        self.field = field


class RunPathError(RunFileError, InputError):
    """A path that leads elsewhere than below the run's folder."""


class FileMissingError(RunFileError):
    """Nothing is there by the name that was asked for, or nothing that can be read."""


class FileTooLargeError(RunFileError):
    """More is asked for than is read at a time."""


class FileAwayError(RunFileError, SystemFault):
    """A file that object storage doesn't give at present; another try may."""
