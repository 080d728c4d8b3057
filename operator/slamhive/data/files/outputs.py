# SPDX-License-Identifier: Apache-2.0
"""Files that a user asked a command for: they are there whole, or as they were before it."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def output_whole(path: Path, argument: str = "output") -> Iterator[Path]:
    """Have a file written aside, and give it its name when all of it is written.

    What is no plain file, as a pipe, is written itself, and so is a file in a folder that takes no others.

    Args:
        path: the file.
        argument: what named it.

    Yields:
        What is to be written.

    Raises:
        InputError: it can't be written.
    """
    target = Path(os.path.realpath(path))
    plain = target.is_file() or not target.exists()
    if not plain or not os.access(target.parent, os.W_OK, effective_ids=True):
        with _told(path, argument):
            yield target
        return
    aside = target.with_name(f".{target.name.lstrip('.')[:200]}.{os.urandom(4).hex()}.making")
    with _told(path, argument):
        try:
            yield aside
            if target.exists():
                shutil.copymode(target, aside)
            aside.replace(target)
        finally:
            aside.unlink(missing_ok=True)


@contextmanager
def _told(path: Path, argument: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}", argument) from None
