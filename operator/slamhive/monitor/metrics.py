# SPDX-License-Identifier: Apache-2.0
"""What an algorithm says of itself in output/metrics.json; anything odd there is noted, never an error."""

from __future__ import annotations

import errno
import json
import math
import os
import resource
import stat
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_METRICS_BYTES = 4 << 20
_VALUE_BYTES = 4096
_KEPT_BYTES = 64 << 10
_LARGEST_COUNT = 1 << 53
_FRAMES = {"offered": "framesOffered", "processed": "framesProcessed", "dropped": "framesDropped"}
_PAGE = os.sysconf("SC_PAGE_SIZE")


class NotRegularError(OSError):
    """What was to be read is no file: a link, a directory, a pipe, or it isn't there."""


class Metrics(NamedTuple):
    """What metrics.json holds.

    Attributes:
        values: Its object, empty if there is none.
        note: What was wrong with the file, None if nothing was.
    """

    values: Mapping[str, Any]
    note: str | None = None


class ReaderShare(NamedTuple):
    """The reader's part of a run.

    Attributes:
        cpu_seconds: What to subtract, None if nothing is known.
        included: It can't be told apart.
        note: What was wrong with what the algorithm said.
    """

    cpu_seconds: float | None
    included: bool
    note: str | None


@dataclass(frozen=True, slots=True)
class ReaderReport:
    """What metrics.json says about reading the recording.

    Attributes:
        cpu_seconds: CPU seconds of the reader, None if it doesn't say.
        includes_reader: Whether they can't be told apart, None if it doesn't say.
        note: What was wrong with the file, None if nothing was.
    """

    cpu_seconds: float | None = None
    includes_reader: bool | None = None
    note: str | None = None

    def share(self, total: float, *, included: bool) -> ReaderShare:
        """Judge the report.

        Args:
            total: CPU seconds of the entire run.
            included: What the Algorithm says where the report says nothing.
        """
        included = included if self.includes_reader is None else self.includes_reader
        if self.cpu_seconds is not None and self.cpu_seconds > total:
            said = f"output/metrics.json: readerCpuSeconds {self.cpu_seconds:g}"
            return ReaderShare(None, True, f"{said} is more than all CPU seconds and was ignored")
        # What was to be subtracted is not known then.
        return ReaderShare(self.cpu_seconds, included or self.note is not None, self.note)


def read_metrics(
    output_directory: str | None, limit: int = _METRICS_BYTES, memory: int | None = None
) -> Metrics:
    """Read metrics.json.

    Args:
        output_directory: Where it is.
        limit: Bytes it may have.
        memory: Bytes that reading it may take from us; None for any.
    """
    if output_directory is None:
        return Metrics({})
    try:
        with open_regular(f"{output_directory}/metrics.json") as descriptor, memory_bounded(memory):
            with open(descriptor, "rb", closefd=False) as file:
                data = file.read(limit + 1)
            values = json.loads(data) if len(data) <= limit else None
    except FileNotFoundError:
        return Metrics({})
    except (OSError, ValueError, RecursionError, MemoryError):
        values = None
    if not isinstance(values, dict):
        most = f"at most {limit >> 20} MiB"
        return Metrics({}, f"output/metrics.json is no JSON object of {most} and was ignored")
    return Metrics(values)


def reader_report(metrics: Metrics) -> ReaderReport:
    """Return what an algorithm says about its reader."""
    seconds, includes = metrics.values.get("readerCpuSeconds"), metrics.values.get("includesReader")
    included = includes if isinstance(includes, bool) else None
    if seconds is None:
        return ReaderReport(includes_reader=included, note=metrics.note)
    if not _is_number(seconds) or seconds < 0:
        note = f"output/metrics.json: readerCpuSeconds must be a number, 0 or more, not {str(seconds)[:40]!r}"
        return ReaderReport(includes_reader=included, note=note)
    return ReaderReport(float(seconds), included)


def frame_counts(metrics: Metrics) -> dict[str, int | None]:
    """Return how many frames were offered, processed and dropped, as the algorithm counted."""
    counts = {name: metrics.values.get(key) for name, key in _FRAMES.items()}
    return {name: count if _is_count(count) else None for name, count in counts.items()}


def plain_values(metrics: Metrics) -> dict[str, Any]:
    """Return the numbers and short texts, also those in objects of such, 64 KiB at most."""
    kept: dict[str, Any] = {}
    room = _KEPT_BYTES
    for key, value in metrics.values.items():
        if isinstance(value, dict):
            plain = all(_is_plain(item) for item in value.values())
        else:
            plain = _is_plain(value)
        size = len(json.dumps({key: value})) if plain else 0
        if plain and size <= min(room, _VALUE_BYTES):
            kept[key] = value
            room -= size
    return kept


def _is_plain(value: Any) -> bool:
    return isinstance(value, str | bool) or _is_number(value)


def _is_number(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= _LARGEST_COUNT if isinstance(value, int) else math.isfinite(value)


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and _is_number(value) and value >= 0


@contextmanager
def open_regular(path: str) -> Iterator[int]:
    """Open a file an algorithm wrote: no link to elsewhere, no pipe to wait on.

    Raises:
        FileNotFoundError: There is nothing.
        NotRegularError: It is something else than a file.
        OSError: It can't be opened.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
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
def memory_bounded(extra: int | None) -> Iterator[None]:
    """Let us take so many bytes more and no others, so that a file of nothing but brackets can't end us."""
    if extra is None:
        yield
        return
    with open("/proc/self/statm", "rb") as file:  # noqa: PTH123
        now = int(file.read().split()[0]) * _PAGE
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = now + extra if hard == resource.RLIM_INFINITY else min(now + extra, hard)
    resource.setrlimit(resource.RLIMIT_AS, (bound, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
