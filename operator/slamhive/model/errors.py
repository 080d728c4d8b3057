# SPDX-License-Identifier: Apache-2.0
"""The error tree of slamhive.

::

    SlamHiveError                 a sentence for the user, a reason for machines
    ├── InputError                what the user wrote is wrong (exit code 2, HTTP 4xx, refused manifest)
    │   ├── ManifestError         a manifest does not follow the language
    │   ├── UnknownNameError      a name that nothing is known by
    │   ├── SettingsError         a settings file that its template doesn't give with these parameters
    │   └── DataError             a recording or trajectory that cannot be used
    └── SystemFault               the machine could not do it; worth another try

Every message says what was wrong, where, and what is allowed.
"""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


class SlamHiveError(Exception):
    """The root of all errors raised on purpose."""

    reason = "Error"
    retryable = False


class InputError(SlamHiveError):
    """Error in what the user wrote or gave: it cannot be used as it is.

    Args:
        sentence: what is wrong with it.
        argument: argument of a function that gave it, put in front of the sentence; the command line has an
            option of that name. Empty for what no argument gave.
    """

    reason = "InvalidInput"

    def __init__(self, sentence: str, argument: str = "") -> None:
        super().__init__(f"{argument}: {sentence}" if argument else sentence)
        self.argument = argument


class ManifestError(InputError):
    """A manifest does not follow the language."""

    reason = "InvalidManifest"


class UnknownNameError(InputError):
    """A name that nothing is known by.

    Args:
        kind: what the name should have named, such as ``algorithm``.
        name: the name as it was written.
        known: the names that exist.
        where: where it was written, put in front of the sentence.
        argument: as of InputError.
    """

    reason = "UnknownName"

    def __init__(
        self, kind: str, name: str, known: Iterable[str], where: str = "", argument: str = ""
    ) -> None:
        known = sorted(known)
        prefix = f"{where}: " if where else ""
        super().__init__(f"{prefix}unknown {kind} {name!r}{suggestion(name, known)}", argument)


class DataError(InputError):
    """A recording, ground truth or trajectory cannot be used."""

    reason = "InvalidData"


class SettingsError(InputError):
    """A settings file of an algorithm can't be rendered."""

    reason = "InvalidParameters"


class SystemFault(SlamHiveError):  # noqa: N818 - a fault of the machine, not an error of the user
    """The machine could not do what was asked; another try may succeed."""

    reason = "SystemFault"
    retryable = True


def sentence(error: Exception) -> str:
    """Return the sentence of an error, an operating system's without its number."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


_MEANT = {"mode": ("sensors",), "exclusiveNodes": ("resources", "template")}
"""Fields of manifests that commands and programs know by another name, or that are below one of these."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """End a sentence about an unknown name with the nearest known one, or with all of a short list."""
    names = sorted(set(known))
    meant = [field for field in _MEANT.get(name, ()) if field in names]
    close = meant or difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if close:
        return f"; did you mean {close[0]!r}?"
    if not names:
        return "; none is known"
    shown = ", ".join(names[:12]) + (", …" if len(names) > 12 else "")
    return f"; known: {shown}"
