# SPDX-License-Identifier: Apache-2.0
"""Rows of an archive that can't be read: they are left out of what is told of it, and named.

An archive may be another one's, written by any program or damaged: one odd row must not cost the others.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

_NAMED = 5


class LeftOut(NamedTuple):
    """A row that can't be read.

    Attributes:
        what: what it is of, such as ``run 'u1'``.
        why: what is wrong with it.
        number: the id of a run; None of others.
        uid, folder, dataset: of a run, as far as they are texts.
    """

    what: str
    why: str
    number: int | None = None
    uid: str | None = None
    folder: str | None = None
    dataset: str | None = None


class LeftOutWarning(UserWarning):
    """Warning that rows of an archive can't be read, and are left out."""


def sentences(left_out: Sequence[LeftOut]) -> list[str]:
    """Return a sentence on each of the first rows that were left out, and one on all others."""
    told = [
        f"{one.what} can't be read, and is left out: {one.why}; `slamhive archive check` says more"
        for one in left_out[:_NAMED]
    ]
    more = len(left_out) - _NAMED
    return [*told, f"{more:,} more can't be read, and are left out"] if more > 0 else told


def warn_of(left_out: Sequence[LeftOut], archive: str) -> None:
    """Warn of rows of an archive that were left out; a command prints it, a library's user sees it."""
    for sentence in sentences(left_out):
        warnings.warn(f"archive {archive}: {sentence}", LeftOutWarning, stacklevel=3)
