# SPDX-License-Identifier: Apache-2.0
"""Files that an algorithm wrote, opened and looked at so that nothing in them can harm the reader."""

from __future__ import annotations

import errno
import os
import resource
import stat
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_COMPRESSED = (b"\x1f\x8b", b"BZh")
_PAGE = os.sysconf("SC_PAGE_SIZE")


class NotRegularError(OSError):
    """Error for a path at which there is no regular file, but a link, a directory or a pipe."""


@contextmanager
def open_regular(path: str, folder: int | None = None) -> Iterator[int]:
    """Open a file an algorithm wrote: no link to elsewhere, no pipe to wait on.

    Args:
        path: The file; only its last part is kept from being a link.
        folder: Descriptor of the folder that a relative path begins at.

    Yields:
        Its descriptor.

    Raises:
        FileNotFoundError: There is nothing.
        NotRegularError: It is something else than a file.
        OSError: It can't be opened.
    """
    try:
        # O_NOFOLLOW: a link could lead to ground truth or a secret. O_NONBLOCK: opening a pipe would wait for
        # someone who writes into it.
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        descriptor = os.open(path, flags, dir_fd=folder)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO, errno.ENODEV, errno.ENOTDIR):
            raise NotRegularError(error.errno, error.strerror, path) from None
        raise
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise NotRegularError(errno.EINVAL, "not a regular file", path)
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def open_below(root: str | os.PathLike[str], relative: str, *, follow: bool = False) -> Iterator[int]:
    """Open a file an algorithm wrote somewhere below a folder; no part of the way may be a link.

    Args:
        root: The folder.
        relative: The file's path in it.
        follow: Whether the folder itself may be a link, as where an algorithm can't replace it.

    Yields:
        Its descriptor.

    Raises:
        FileNotFoundError: There is nothing.
        NotRegularError: It is something else than a file, or a part of the way is no folder.
        OSError: It can't be opened.
    """
    *folders, last = relative.split("/")
    folder = open_folder(root, follow=follow)
    try:
        for part in folders:
            below = open_folder(part, folder)
            os.close(folder)
            folder = below
        with open_regular(last, folder) as descriptor:
            yield descriptor
    finally:
        os.close(folder)


def open_folder(path: str | os.PathLike[str], folder: int | None = None, *, follow: bool = False) -> int:
    """Return the descriptor of a folder, to be closed.

    Args:
        path: The folder.
        folder: Descriptor of the folder that a relative path begins at.
        follow: Whether it may be a link.

    Raises:
        NotRegularError: It is no folder.
        OSError: It can't be opened.
    """
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
    try:
        return os.open(path, flags, dir_fd=folder)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENOTDIR):
            raise NotRegularError(error.errno, error.strerror, path) from None
        raise


def read_regular(path: str, limit: int) -> bytes:
    """Return the bytes of a file an algorithm wrote, cut at a limit; errors as of `open_regular`."""
    with open_regular(path) as descriptor, open(descriptor, "rb", closefd=False) as file:
        return file.read(limit)


def compression_problem(descriptor: int, name: str) -> str | None:
    """Return the complaint about an algorithm's text file that is compressed, None where it is not.

    A megabyte can unpack to gigabytes, so none is unpacked: not in a pod, not on a workstation.

    Args:
        descriptor: The file, open for reading.
        name: What the sentence calls it.
    """
    if os.pread(descriptor, 3, 0).startswith(_COMPRESSED):
        return f"{name} is compressed; it must be plain text"
    return None


@contextmanager
def memory_bounded(extra: int) -> Iterator[None]:
    """Let us take so many bytes more and no others, so that a file of nothing but brackets can't end us."""
    with open("/proc/self/statm", "rb") as file:  # noqa: PTH123
        now = int(file.read().split()[0]) * _PAGE
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = now + extra if hard == resource.RLIM_INFINITY else min(now + extra, hard)
    resource.setrlimit(resource.RLIMIT_AS, (bound, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
