# SPDX-License-Identifier: Apache-2.0
"""Parts of zip archives elsewhere: one sequence of an archive that holds many, without the rest.

What is fetched of an archive stands in a file of its size with holes, at the places that it has there:
zipfile reads it as if the whole were there, and its members have checksums (CRC-32) of their own.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from typing import TYPE_CHECKING

from slamhive.contract.lines import printable
from slamhive.data.files.fetching import (
    FetchProgress,
    WantedFile,
    fetch_span,
    forget_another,
    one_at_a_time,
    partial_path,
)
from slamhive.data.files.https import open_url
from slamhive.data.files.partial import Partial
from slamhive.data.files.unpacking import DIRECTORY_BYTES, MeteredFile
from slamhive.model.errors import DataError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from slamhive.data.files.partial import Span

_TAIL = 1 << 16
"""Bytes read at a time of the table of contents, which is at the end."""
_HEAD = 30 + (1 << 16)
"""Bytes that a member's own header takes at most, nearly always."""
_NEAR = 1 << 20
"""Bytes between members that are fetched with them, to ask less often."""


def fetch_members(
    wanted: WantedFile, names: Sequence[str], folder: Path, progress: FetchProgress
) -> Path | None:
    """Fetch members of a zip archive, and return the file with holes in which they stand.

    Args:
        wanted: The archive.
        names: Members: files, or folders with all in them.
        folder: Where the file is, and what was fetched of the archive before.
        progress: Who is told; bytes counted are those of the members.

    Returns:
        The file; None where the server sends no parts, or it is no zip archive: then all of it is needed.

    Raises:
        DataError: A member isn't in it, or it is damaged.
        SystemFault: It can't be had right now, or there is no room for it.
    """
    url = _sending_parts(wanted)
    if url is None:
        return None
    wanted = replace(wanted, sha256=None)  # the whole never comes: nothing would tell in the end
    path = partial_path(wanted.urls[0], folder)
    folder.mkdir(parents=True, exist_ok=True)
    with one_at_a_time(path, wanted.what, progress):
        partial = Partial(path)
        try:
            remote = _Remote(wanted, url, partial)
            if not zipfile.is_zipfile(remote):
                return None
            remote.seek(0)
            with zipfile.ZipFile(MeteredFile(remote, DIRECTORY_BYTES)) as archive:  # type: ignore[arg-type]
                spans = _spans(archive, names, wanted.what)
            needed = sum(end - first for first, end in spans)
            before = 0
            for span in spans:
                base, held = before, partial.held

                def count(now: int, _: int | None, base: int = base, held: int = held) -> None:
                    progress.count(base + now - held, needed)

                fetch_span(wanted, [url], partial, span, FetchProgress(count, progress.notify))
                before += span[1] - span[0]
            partial.flush()
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            partial.forget()
            raise DataError(f"{wanted.what}: {url}: is a damaged zip archive: {error}") from None
        finally:
            partial.close()
    return path


def _sending_parts(wanted: WantedFile) -> str | None:
    """Return the first address that sends parts of the file."""
    for url in wanted.urls:
        try:
            with open_url(url, 0, 1) as answer:
                if answer.by_ranges and answer.total is not None:
                    return url
        except SystemFault:
            continue
    return None


def _spans(archive: zipfile.ZipFile, names: Sequence[str], what: str) -> list[Span]:
    """Return the spans of members in an archive, near ones together."""
    infos = sorted(archive.infolist(), key=lambda info: info.header_offset)
    ends = [*(info.header_offset for info in infos[1:]), archive.start_dir]
    spans: list[Span] = []
    missing = set(names)
    for info, end in zip(infos, ends, strict=False):  # an empty archive has an end as well
        matching = next(
            (name for name in names if not name or (info.filename + "/").startswith(f"{name}/")), None
        )
        if matching is None:
            continue
        missing.discard(matching)
        if spans and info.header_offset - spans[-1][1] <= _NEAR:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((info.header_offset, end))
    if missing:
        some = printable(", ".join(info.filename for info in infos[:5]))
        raise DataError(f"{what}: has no {', '.join(sorted(missing))} in it; it has: {some}, …")
    return spans


class _Remote(io.RawIOBase):
    """A file elsewhere, read by parts, which stay in the partial."""

    def __init__(self, wanted: WantedFile, url: str, partial: Partial) -> None:
        super().__init__()
        self._wanted, self._url, self._partial = wanted, url, partial
        self._at = 0
        with open_url(url, 0, 1) as answer:
            forget_another(partial, url, answer)
            partial.begin(url, answer.validators, answer.total)
        self._size = partial.total or 0

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        if base + offset < 0:
            raise OSError("before the first byte")
        self._at = base + offset
        return self._at

    def read(self, size: int = -1) -> bytes:
        end = self._size if size < 0 else min(self._at + size, self._size)
        if end <= self._at:
            return b""
        first = max(0, min(self._at, end - _TAIL))
        fetch_span(self._wanted, [self._url], self._partial, (first, end), FetchProgress())
        with self._partial.path.open("rb") as file:
            file.seek(self._at)
            data = file.read(end - self._at)
        self._at = end
        return data
