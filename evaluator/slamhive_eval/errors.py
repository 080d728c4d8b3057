# SPDX-License-Identifier: Apache-2.0
"""Errors that the evaluator raises, as sentences a user can act on.

::

    EvaluationError (a ValueError)
    ├── TrajectoryError      poses that are no trajectory: NaN, unsorted, a zero quaternion, none at all
    │   └── FileError        the same found in a file: names the path and, where there is one, the line
    │       └── NoPosesError nothing but empty lines and comments
    ├── AssociationError     no pose of one trajectory has a partner in the other
    └── OptionError          a method, unit or number that isn't allowed

``evaluate`` raises none of them for what an algorithm did badly: lost and diverged are results.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


class EvaluationError(ValueError):
    """Root of every error of this package; its text is one sentence for the user."""


class TrajectoryError(EvaluationError):
    """Arrays that don't form a trajectory."""


class FileError(TrajectoryError):
    """A file that can't be read as what it should be.

    Attributes:
        path: The file.
        line: Line number counted from 1, or None when the fault has no line.
    """

    def __init__(self, path: str | Path, message: str, line: int | None = None) -> None:
        place = f"{path}, line {line}" if line is not None else str(path)
        super().__init__(f"{place}: {message}")
        self.path = path
        self.line = line


class NoPosesError(FileError):
    """A file of poses without one: every line is empty or a comment."""

    def __init__(self, path: str | Path) -> None:
        super().__init__(path, "holds no poses: every line is empty or a comment")


class AssociationError(EvaluationError):
    """Two trajectories without a common pose."""


class OptionError(EvaluationError):
    """An option outside of what is allowed."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean …?`` with the name most like the one given, empty when none is."""
    import difflib  # noqa: PLC0415 - needed for errors only

    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""
