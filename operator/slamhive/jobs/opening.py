# SPDX-License-Identifier: Apache-2.0
"""Files that algorithms and others' evaluators left, opened so that no link leads elsewhere."""

from __future__ import annotations

import errno
import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

from slamhive.contract.files import NotRegularError, open_below
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def opened(root: Path, relative: str, limit: int) -> Iterator[int]:
    """Open a regular file below a folder for reading; no part of the way may be a symbolic link.

    Args:
        root: the folder, trusted.
        relative: the file's path in it.
        limit: largest size allowed.

    Yields:
        The descriptor.

    Raises:
        DataError: it is missing, too large, or something else than a file.
    """
    for part in relative.split("/"):
        _require_name(part, relative)
    try:
        with open_below(root, relative, follow=True) as file:
            size = os.fstat(file).st_size
            if size > limit:
                raise DataError(f"{relative} has {size} bytes, at most {limit} are read")
            yield file
    except OSError as error:
        raise DataError(f"{relative}: {_meaning(error)}") from error


def read_bytes(root: Path, relative: str, limit: int) -> bytes:
    """Return the bytes of a file; errors as of `opened`."""
    with opened(root, relative, limit) as descriptor, open(descriptor, "rb", closefd=False) as file:
        return file.read(limit)


def _require_name(part: str, relative: str) -> None:
    if part in {"", ".", ".."}:
        raise DataError(f"{relative!r} is not a path below the volume's folder")


def _meaning(error: OSError) -> str:
    match error.errno:
        case errno.ENOENT:
            return "does not exist"
        case errno.EINVAL if isinstance(error, NotRegularError):
            return "is not a regular file"
        case errno.ELOOP | errno.ENOTDIR:
            return "is not reached through plain folders alone: symbolic links are not followed"
        case _:
            return error.strerror or str(error)
