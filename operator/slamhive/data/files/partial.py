# SPDX-License-Identifier: Apache-2.0
"""A file that is being fetched, and which bytes of it are there: kill -9 loses a few blocks on their way.

Beside ``NAME.part`` stands ``NAME.state`` with what the file is and which spans of it are there, and
``NAME.at`` with the span that grows, written in place after each block: a rename for each would wait for
the disk. Within one boot of the machine both are true whatever happens to the process. What the kernel has
not brought to disk when the power fails is told by the second list of spans, which is written after an
fsync.
"""

from __future__ import annotations

import errno
import json
import os
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.data.files.https import Validators
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterator

FLUSH_BYTES = 64 << 20
"""Bytes after which what was written is brought to disk."""

_SLICE = 1 << 17
"""Bytes that the kernel is given at a time: of 1 MiB at once it makes large folios, which on Linux 6.18 takes
five times the CPU seconds (ext4, 0.55 s instead of 0.10 s for 384 MiB)."""
_AT_BYTES = 48
Span = tuple[int, int]
"""First byte, byte after the last."""


class DiskFault(SystemFault):
    """A disk that is full or refuses: another server would be of no use."""

    reason = "DiskFault"


class Partial:
    """The bytes of a file that are there.

    Args:
        path: Where it lies; its state lies beside it.

    Attributes:
        url: Where the bytes came from.
        validators: What the server knew the file by.
        total: Size of the whole file, bytes; None where nobody has said.
        spans: What is there, ascending and apart.
        begun_here: Whether this process asked for all of it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._state, self._at = path.with_suffix(".state"), path.with_suffix(".at")
        self.url: str | None = None
        self.validators = Validators()
        self.total: int | None = None
        self.spans: list[Span] = []
        self.begun_here = True
        self._flushed: list[Span] = []
        self._since = 0
        self._descriptor: int | None = None
        self._place: int | None = None
        self._grows: Span | None = None
        self._flusher: threading.Thread | None = None
        self._refused: OSError | None = None
        self._load()

    def _load(self) -> None:
        try:
            known = json.loads(self._state.read_text(encoding="utf-8"))
            size = self.path.stat().st_size
            spans = known["flushed"]
            if known["boot"] == _boot():
                spans = _with([(int(first), int(end)) for first, end in known["spans"]], self._growing())
            self.spans = [(int(first), int(end)) for first, end in spans if int(end) <= size]
            self.url, self.total = known["url"], known["total"]
            self.validators = Validators(*known["validators"])
            self.begun_here = not self.spans
        except (OSError, ValueError, KeyError, TypeError):
            self.forget()
        self._flushed = list(self.spans)

    @property
    def held(self) -> int:
        """Return the number of bytes that are there."""
        return sum(end - first for first, end in self.spans)

    def held_from(self, start: int) -> int:
        """Return up to where the bytes from one on are there without a hole."""
        return next((end for first, end in self.spans if first <= start < end), start)

    def begin(self, url: str, validators: Validators, total: int | None) -> None:
        """Note what is fetched from now on; marks of answers before stay, where this one has none."""
        before = self.validators if url == self.url else Validators()
        marks = validators.etag or before.etag, validators.modified or before.modified
        self.url, self.validators, self.total = url, Validators(*marks), total

    def write(self, at: int, data: bytes | memoryview) -> None:
        """Write bytes at their place and note that they are there.

        Raises:
            OSError: The disk refuses; what was there before stays noted.
        """
        if self._descriptor is None:
            self._descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        view, place = memoryview(data), at
        while view:
            written = os.pwrite(self._descriptor, view[:_SLICE], place)
            view, place = view[written:], place + written
        self._note(at, place)
        self._since += place - at
        if self._since >= FLUSH_BYTES and not (self._flusher and self._flusher.is_alive()):
            self._wait()
            self._since = 0
            # Aside: neither network nor disk waits for the other.
            self._flusher = threading.Thread(target=self._flush_aside, args=(list(self.spans),), daemon=True)
            self._flusher.start()

    def _note(self, at: int, end: int) -> None:
        """Note that bytes are there."""
        if self._grows is None or self._grows[1] != at:
            self._save()  # what grew until now is part of the state from here on
            self._grows = (at, at)
        if self._place is None:
            self._place = os.open(self._at, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._grows = (self._grows[0], end)
        if at < end:
            self.spans = _with(self.spans, (at, end))
        os.pwrite(self._place, f"{self._grows[0]} {end}".ljust(_AT_BYTES).encode("ascii"), 0)

    def _growing(self) -> Span:
        try:
            first, end = self._at.read_text(encoding="ascii").split()
            return int(first), int(end)
        except (OSError, ValueError):
            return 0, 0

    def flush(self) -> None:
        """Bring what is there to disk.

        Raises:
            OSError: The disk refuses.
        """
        self._wait()
        if self._descriptor is not None:
            os.fdatasync(self._descriptor)
        self._flushed, self._since = list(self.spans), 0
        self._save()

    def _flush_aside(self, spans: list[Span]) -> None:
        try:
            os.fdatasync(self._descriptor or 0)
        except OSError as error:
            self._refused = error
        else:
            self._flushed = spans

    def _wait(self) -> None:
        """Wait for what is being brought to disk.

        Raises:
            OSError: The disk refused.
        """
        if self._flusher is not None:
            self._flusher.join()
            self._flusher = None
        if self._refused is not None:
            error, self._refused = self._refused, None
            raise error

    def close(self) -> None:
        """Let go of the file; it stays."""
        if self._flusher is not None:
            self._flusher.join()
            self._flusher = None
        for descriptor in (self._descriptor, self._place):
            if descriptor is not None:
                os.close(descriptor)
        self._descriptor = self._place = self._grows = None

    def drop(self, span: Span) -> None:
        """Note that bytes are not there after all."""
        kept = []
        for first, end in self.spans:
            kept += [(first, min(end, span[0])), (max(first, span[1]), end)]
        self.spans = [(first, end) for first, end in kept if first < end]
        self._flushed = list(self.spans)
        self.close()
        self._at.unlink(missing_ok=True)
        if self.path.exists():
            self._save()

    def forget(self) -> None:
        """Remove all of it."""
        self.close()
        self.spans, self._flushed = [], []
        self.url = self.total = None
        self.validators, self.begun_here = Validators(), True
        with suppress(OSError):
            self._at.unlink(missing_ok=True)
            self._state.unlink(missing_ok=True)
            self.path.unlink(missing_ok=True)

    def move(self, place: Path) -> None:
        """Give the whole file its name.

        Raises:
            OSError: The disk refuses.
        """
        self.write(0, b"")  # an empty file is one, too
        self.flush()
        self.close()
        self.path.replace(place)
        self._at.unlink(missing_ok=True)
        self._state.unlink(missing_ok=True)

    def _save(self) -> None:
        state: dict[str, Any] = {
            "url": self.url,
            "validators": [self.validators.etag, self.validators.modified],
            "total": self.total,
            "boot": _boot(),
            "spans": self.spans,
            "flushed": self._flushed,
        }
        aside = self._state.with_suffix(".state~")
        aside.write_text(json.dumps(state), encoding="utf-8")
        aside.replace(self._state)


def _with(spans: list[Span], new: Span) -> list[Span]:
    merged: list[Span] = []
    for first, end in sorted(span for span in (*spans, new) if span[0] < span[1]):
        if merged and first <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((first, end))
    return merged


def _boot() -> str:
    """Return the identity of this start of the machine."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""


@contextmanager
def disk_words(what: str, path: Path) -> Iterator[None]:
    """Turn a disk's refusal into a sentence that says what stays.

    Raises:
        DiskFault: The disk refused.
    """
    try:
        yield
    except OSError as error:
        if error.errno in {errno.ENOSPC, errno.EDQUOT}:
            raise DiskFault(
                f"{what}: the disk of {path.parent} is full; what was fetched stays: make room, and the same "
                "command goes on"
            ) from None
        raise DiskFault(f"{what}: {path}: {error.strerror or error}") from None
