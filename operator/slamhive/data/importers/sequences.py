# SPDX-License-Identifier: Apache-2.0
"""Folders that hold several sequences of a dataset, as its archives unpack."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def sequence_folder(source: Path, wanted: str | None, is_sequence: Callable[[Path], bool]) -> Path:
    """Return the folder of a sequence: the source itself, or the wanted one of those in it.

    Args:
        source: What is imported.
        wanted: Name of the sequence, if one was named.
        is_sequence: Tells whether a folder is one.

    Raises:
        InputError: There are several and none is named, or there is none of that name.
    """
    if is_sequence(source):
        return source
    names = sorted(path.name for path in source.iterdir() if path.is_dir() and is_sequence(path))
    if wanted is None and len(names) == 1:
        return source / names[0]
    if wanted not in names:
        begin = "several sequences" if wanted is None else f"no sequence {wanted!r}"
        raise InputError(f"{source}: {begin} in it; choose one of them by --sequence: {', '.join(names)}")
    return source / str(wanted)
