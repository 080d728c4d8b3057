# SPDX-License-Identifier: Apache-2.0
"""Files from the network: fetched over https alone, within limits, gone on with after any end, checked.

A fetch that is interrupted, by kill -9 too, leaves a `Partial` beside its place; the next one goes on from
there. Two at once fetch once. Bytes that are wrong can't be seen before the end, unless the checksums of the
file's pieces are known: then a wrong piece alone is fetched again.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from slamhive.data.files.https import (
    PAGE_BYTES,
    STALL_BYTES,
    STALL_SECONDS,
    HttpsResponse,
    Interrupted,
    OfflineError,
    WrongPartError,
    open_url,
    require_no_page,
)
from slamhive.data.files.partial import DiskFault, Partial, disk_words
from slamhive.model.canonical import digest
from slamhive.model.errors import DataError, SlamHiveError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from concurrent.futures import Future
    from pathlib import Path

    from slamhive.data.files.partial import Span

MOST_BYTES = 1 << 38
"""Bytes of the largest file that is fetched, 256 GiB."""
MEBIBYTE = 1 << 20
LEFT_BYTES = 1 << 30
"""Bytes that stay free on the disk."""
PATIENCE_SECONDS = 600.0
"""Seconds that a fetch may take beside those in which its bytes must come."""
PAUSES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Seconds before further tries after an interruption; bytes that come start the count again."""
BLOCK = 1 << 18
"""Bytes that are written at a time; an end by kill -9 loses those that are on their way."""
_BLOCKS = 8
"""Blocks that wait for the checksum at most."""
_READ = 1 << 14
"""Bytes of a record of TLS: no read gives more."""


@dataclass(frozen=True)
class WantedFile:
    """A file elsewhere.

    Attributes:
        urls: Where it is: https addresses, the preferred first.
        what: What it is, for messages.
        sha256: Its checksum, if it is known.
        size: Its size, bytes, if it is known.
        piece_bytes: Size of the pieces whose checksums are known.
        pieces: Their checksums.
    """

    urls: Sequence[str]
    what: str
    sha256: str | None = None
    size: int | None = None
    piece_bytes: int = 0
    pieces: Sequence[str] = ()


@dataclass
class FetchProgress:
    """Callbacks that a fetch reports to: its progress in bytes, and sentences on anything unusual.

    Attributes:
        count: Called with the bytes that are there and how many they are to be, if that is known.
        notify: Called with a sentence where something isn't as usual.
    """

    count: Callable[[int, int | None], None] = lambda _held, _total: None
    notify: Callable[[str], None] = lambda _sentence: None


def fetch(url: str, place: Path, sha256: str, what: str) -> None:
    """Fetch a file whose checksum is known to a place.

    Args:
        url: where it is; the models allow https alone.
        place: the file to make.
        sha256: its checksum, 64 hexadecimal digits.
        what: what it is, for messages.

    Raises:
        DataError: what came is another file, more than `MOST_BYTES`, or comes by a way that isn't https.
        SystemFault: it can't be had right now, or there is no room for it.
    """
    fetch_file(WantedFile([url], what, sha256), place)


def fetch_file(wanted: WantedFile, place: Path, progress: FetchProgress | None = None) -> str:
    """Fetch a file to a place, and return its sha256; one that another process fetches is waited for.

    Raises:
        DataError: What came is another file, more than `MOST_BYTES`, or comes by a way that isn't https.
        SystemFault: It can't be had right now, or there is no room for it; what came stays for the next time.
    """
    progress = progress or FetchProgress()
    place.parent.mkdir(parents=True, exist_ok=True)
    path = partial_path(wanted.urls[0], place.parent)
    with one_at_a_time(path, wanted.what, progress) as waited:
        if waited and place.is_file():
            found = sha256_of(place)
            if wanted.sha256 in {None, found}:
                return found
        partial = Partial(path)
        try:
            found = _whole(wanted, partial, progress)
            with disk_words(wanted.what, place):
                partial.move(place)
        except SlamHiveError as error:
            # Without a size nothing can be gone on with.
            if isinstance(error, DataError) or partial.total is None:
                partial.forget()
            raise
        finally:
            partial.close()
        return found


def partial_path(url: str, folder: Path) -> Path:
    """Return the path of a file's bytes until it is whole."""
    return folder / f".fetching-{digest(url)[:24]}.part"


@contextmanager
def one_at_a_time(path: Path, what: str, progress: FetchProgress) -> Iterator[bool]:
    """Hold the right to fetch to a path, and tell whether another process had it first."""
    with disk_words(what, path):
        descriptor = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        waited = False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            progress.notify(f"{what}: another process is fetching it; waiting for that")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            waited = True
        yield waited
    finally:
        os.close(descriptor)


def is_busy(path: Path) -> bool:
    """Tell whether a process fetches to a path, or works with what it fetched."""
    try:
        descriptor = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _whole(wanted: WantedFile, partial: Partial, progress: FetchProgress) -> str:
    """Fetch all of a file until its checksum is right, at most twice."""
    urls = list(wanted.urls)
    for last in (False, True):
        running = _Running(partial)
        fetch_span(wanted, urls, partial, (0, None), progress, running)
        if partial.path.exists():
            with partial.path.open("rb") as file:
                require_no_page(partial.url or urls[0], file.read(PAGE_BYTES))
        found = running.digest()
        wrong = _wrong_pieces(wanted, partial)
        if wanted.sha256 in {None, found} and not wrong:
            return found
        problem = f"has sha256 {found}, expected {wanted.sha256}"
        if wrong:
            problem = f"{len(wrong)} of {len(wanted.pieces)} pieces are wrong"
        sentence = f"{wanted.what}: {partial.url}: {problem}"
        if last:
            raise DataError(sentence)
        progress.notify(f"{sentence}: fetched again")
        for span in wrong:
            partial.drop(span)
        if not wrong:
            partial.forget()
        urls.append(urls.pop(0))
    raise AssertionError


def _wrong_pieces(wanted: WantedFile, partial: Partial) -> list[Span]:
    """Return the spans of the pieces that aren't what their checksums say, and of what follows them."""
    wrong = []
    if wanted.pieces:
        partial.write(0, b"")  # an empty file is one, too
        with partial.path.open("rb") as file:
            for number, expected in enumerate([*wanted.pieces, hashlib.sha256().hexdigest()]):
                data = file.read(wanted.piece_bytes)
                if hashlib.sha256(data).hexdigest() != expected:
                    first = number * wanted.piece_bytes
                    wrong.append((first, first + wanted.piece_bytes))
    return wrong


def fetch_span(  # noqa: PLR0917 - what, from where, to where, which part
    wanted: WantedFile,
    urls: Sequence[str],
    partial: Partial,
    span: tuple[int, int | None],
    progress: FetchProgress,
    running: _Running | None = None,
) -> None:
    """Have a span of a file in its partial; addresses are tried in turn, each several times.

    Args:
        wanted: The file.
        urls: Its addresses, in the order in which they are tried.
        partial: Where its bytes go.
        span: First byte, byte after the last; None for the end of the file.
        progress: Who is told.
        running: The checksum of the whole file, computed on the way.

    Raises:
        DataError: The file isn't what was said.
        OfflineError: None of its addresses is reached.
        SystemFault: No address sends it.
    """
    problems: list[str] = []
    began, most = time.monotonic(), partial.held
    began_with, offline = most, 0
    anew: set[str] = set()
    for url in urls:
        tries = list(PAUSES)
        while True:
            try:
                _attempt(_FetchOrder(wanted, url, partial, progress, running), span)
            except DiskFault:
                raise
            except SystemFault as error:
                # Bytes are progress, answers are none: a file that changes each time never comes to its end.
                if partial.held >= most + STALL_BYTES:
                    tries, most = list(PAUSES), partial.held
                if isinstance(error, WrongPartError) and span[1] is None and url not in anew and not tries:
                    # Parts may never come right from there; the file from its start does, as to anybody.
                    progress.notify(f"{wanted.what}: {url}: {error}: comes from its start again")
                    partial.forget()
                    anew.add(url)
                    tries, most = list(PAUSES), 0
                    continue
                if span[1] is None and not partial.spans:
                    partial.forget()  # a size that was told is of a file of which nothing came
                # Without a network at the begin none comes; one that goes meanwhile may come back.
                is_away = isinstance(error, OfflineError) and partial.held > began_with
                if not (is_away or isinstance(error, Interrupted)) or not tries:
                    problems.append(f"{url}: {error}")
                    offline += isinstance(error, OfflineError)
                    break
                _require_patience(f"{wanted.what}: {url}: {error}", time.monotonic() - began, most)
                time.sleep(tries.pop(0))
            else:
                return
    kind = OfflineError if offline == len(problems) else SystemFault
    raise kind(f"{wanted.what}: {'; '.join(problems)}")


def _require_patience(problem: str, seconds: float, held: int) -> None:
    # A minute for each MiB, and ten more, are enough for any line.
    if seconds > PATIENCE_SECONDS + held / STALL_BYTES * STALL_SECONDS:
        raise SystemFault(
            f"{problem}; given up after {seconds / 60:.0f} min; what came stays, and the same command goes on"
        ) from None


class _Running:
    """The checksum of a file that is being fetched, computed from what comes in the order of the file."""

    def __init__(self, partial: Partial) -> None:
        self._partial = partial
        self._sum = hashlib.sha256()
        self._at = 0

    def update(self, at: int, block: bytes | memoryview) -> None:
        """Take in what is written at a place."""
        if at == 0:
            self._sum, self._at = hashlib.sha256(), 0
        if at == self._at:
            self._sum.update(block)
            self._at += len(block)

    def catch_up(self, until: int) -> None:
        """Take in what was fetched before, from the disk."""
        if self._at > until:  # what it was of is forgotten
            self._sum, self._at = hashlib.sha256(), 0
        if self._at == until:
            return
        with self._partial.path.open("rb") as file:
            file.seek(self._at)
            while self._at < until and (block := file.read(min(BLOCK, until - self._at))):
                self._sum.update(block)
                self._at += len(block)

    def digest(self) -> str:
        """Return the checksum of the whole file."""
        self.catch_up(self._partial.held_from(0))
        return self._sum.hexdigest()


@dataclass(frozen=True)
class _FetchOrder:
    """Arguments of one attempt to fetch a file: its URL, the partial file that it goes to, callbacks."""

    wanted: WantedFile
    url: str
    partial: Partial
    progress: FetchProgress
    running: _Running | None

    @property
    def where(self) -> str:
        return f"{self.wanted.what}: {self.url}"

    @property
    def room(self) -> int:
        """Return the number of bytes that the disk still takes."""
        return shutil.disk_usage(self.partial.path.parent).free - LEFT_BYTES


def _attempt(order: _FetchOrder, span: tuple[int, int | None]) -> None:
    """Fetch what is missing of a span, in one answer for each hole in it."""
    partial = order.partial
    if partial.url not in {None, order.url} and order.wanted.sha256 is None:
        partial.forget()  # nobody could tell that the two halves are of one file
    while True:
        end = partial.total if span[1] is None else span[1]
        start = partial.held_from(span[0])
        if end is not None and start >= end:
            return
        ahead = [first for first, _ in partial.spans if first > start]
        until = min(ahead + ([] if end is None else [end]), default=None)
        if order.running is not None:
            order.running.catch_up(start)
        condition = partial.validators.condition if partial.url == order.url else None
        asked_end = until if ahead or span[1] is not None else None
        with open_url(order.url, start, asked_end, condition) as answer:
            if forget_another(partial, order.url, answer, has_sum=order.wanted.sha256 is not None):
                if span[1] is not None:
                    raise SystemFault("the file changed on the server meanwhile")
                if answer.start:
                    order.progress.notify(
                        f"{order.where}: is another file now: it comes from its start again"
                    )
                    raise Interrupted("the file changed on the server")
                until = None
            if not _is_same(order, answer, start):
                if span[1] is not None:
                    raise SystemFault("the server sends no parts of files")
                until = None
            _copy(order, answer, until)


def forget_another(partial: Partial, url: str, answer: HttpsResponse, *, has_sum: bool = False) -> bool:
    """Forget what is there if an answer is of another file, or nobody can tell; tell whether that was so.

    Without a mark in both answers a file is gone on with in one process alone, unless its checksum is known.
    Another address may have other marks: it is asked only where a checksum tells in the end.
    """
    differ = partial.validators.differ(answer.validators) if partial.url == url else False
    is_doubtful = differ is None and not partial.begun_here and not has_sum
    is_another = bool(partial.spans) and (
        bool(differ)
        or is_doubtful
        or (answer.total is not None and partial.total not in {None, answer.total})
    )
    if is_another:
        partial.forget()
    return is_another


def _is_same(order: _FetchOrder, answer: HttpsResponse, start: int) -> bool:
    """Tell whether an answer goes on with what is there; where it doesn't, that is forgotten."""
    partial = order.partial
    if answer.total is not None:
        _require_size(order, answer.total)
    is_same = answer.start == start
    if not is_same:
        order.progress.notify(
            f"{order.where}: comes from its start again: the server sends no parts, or another file now"
        )
        partial.forget()
    if answer.packing is not None:
        order.progress.notify(
            f"{order.where}: comes packed ({answer.packing}), which nobody asked for: it may be another file"
        )
    _require_room((answer.total or 0) - partial.held, order.room, order)
    known = (answer.total, partial.total, order.wanted.size)
    partial.begin(order.url, answer.validators, next((size for size in known if size is not None), None))
    return is_same


def _require_size(order: _FetchOrder, found: int) -> None:
    expected = order.wanted.size
    if expected is not None and found != expected:
        raise DataError(f"{order.where}: has {found:,} bytes, expected {expected:,}")


def _copy(order: _FetchOrder, answer: HttpsResponse, until: int | None) -> None:
    """Write an answer within the limits of size and room."""
    partial = order.partial
    expected = answer.total if until is None else until
    room = order.room
    at, counted = answer.start, 0
    with _BlockWriter(order, at) as writer:
        while expected is None or at < expected:
            block = answer.read(_READ)
            if not block:
                break
            data = memoryview(block)
            if expected is not None:
                data = data[: expected - at]
            at += len(data)
            counted += len(data)
            if answer.total is None:
                _require_room(at - answer.start, room, order)
            writer.put(data)
            if counted >= STALL_BYTES:
                counted = 0
                order.progress.count(partial.held, answer.total)
    order.progress.count(partial.held, answer.total)
    if expected is None:
        expected = _end_of(order, answer, at)
    if at < expected:
        raise Interrupted(f"ended after {at:,} of {expected:,} bytes")


def _end_of(order: _FetchOrder, answer: HttpsResponse, at: int) -> int:
    """Return the size of a file whose answer didn't tell it and has ended at a byte."""
    size = order.wanted.size
    if size is None:
        if not answer.tells_end:
            order.progress.notify(f"{order.where}: no end was told: it may have been cut")
        order.partial.total = at
        return at
    if at > size:
        _require_size(order, at)
    return size


class _BlockWriter:
    """Writes what comes, a block at a time, while the last ones are added to the checksum on another core."""

    def __init__(self, order: _FetchOrder, at: int) -> None:
        self._order, self._at = order, at
        self._block = bytearray()
        self._summing = ThreadPoolExecutor(1, "fetched bytes")
        self._sums: deque[Future[None]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._write()
            for added in self._sums:
                added.result()
        finally:
            self._summing.shutdown()

    def put(self, data: memoryview) -> None:
        """Have bytes written behind the last ones.

        Raises:
            SystemFault: The disk refuses them.
        """
        self._block += data
        if len(self._block) >= BLOCK:
            self._write()

    def _write(self) -> None:
        block, self._block = self._block, bytearray()
        if not block:
            return
        order = self._order
        with disk_words(order.wanted.what, order.partial.path):
            order.partial.write(self._at, memoryview(block))
        if order.running is not None:
            self._sums.append(self._summing.submit(order.running.update, self._at, memoryview(block)))
            if len(self._sums) > _BLOCKS:
                self._sums.popleft().result()
        self._at += len(block)


def _require_room(size: int, room: int, order: _FetchOrder) -> None:
    if size > MOST_BYTES:
        raise DataError(f"{order.where}: has more than {MOST_BYTES >> 30} GiB, the most that is fetched")
    if size > room:
        raise DiskFault(
            f"{order.wanted.what}: needs {size / MEBIBYTE:,.0f} MiB more, but the disk of "
            f"{order.partial.path.parent} has room for {max(room, 0) / MEBIBYTE:,.0f} MiB, as "
            f"{LEFT_BYTES / MEBIBYTE:,.0f} MiB stay free"
        )


def sha256_of(path: Path) -> str:
    """Return the checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def require_sha256(path: Path, sha256: str, what: str) -> None:
    """Check a file against its checksum.

    Raises:
        DataError: it is another file.
    """
    found = sha256_of(path)
    if found != sha256:
        raise DataError(f"{what}: has sha256 {found}, expected {sha256}")
