# SPDX-License-Identifier: Apache-2.0
"""The outcome of a run: summary.json, the truth about how it ended, and the reader's part of its CPU."""

from __future__ import annotations

import json
import math
import os
import stat
import time
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from slamhive.monitor.accounting import Usage  # noqa: TC001 - the type of a public field

_METRICS_BYTES = 64 << 20


class Reason(StrEnum):
    """Why a run did not succeed."""

    DEADLINE_EXCEEDED = "DeadlineExceeded"
    OUT_OF_MEMORY = "OutOfMemory"
    ALGORITHM_FAILED = "AlgorithmFailed"
    CANCELLED = "Cancelled"
    OUTPUT_TOO_LARGE = "OutputTooLarge"


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """How a run ended.

    Attributes:
        exit_code: The algorithm's exit code, None if a signal ended it or it never ended.
        signal: The signal that ended it.
        reason: None for a run that succeeded.
        message: One sentence, empty for a run that succeeded.
        started_at: Wall clock, seconds since 1970.
        finished_at: The same.
        usage: What it used.
        log_tail: The last lines it printed.
        left_processes: Processes that outlived the algorithm's first one and were ended.
        notes: What was wrong but didn't end the run.
    """

    exit_code: int | None
    signal: int | None
    reason: Reason | None
    message: str
    started_at: float
    finished_at: float
    usage: Usage
    log_tail: str
    left_processes: int = 0
    notes: tuple[str, ...] = ()

    def to_json(self) -> str:
        """Return the summary as a JSON object with camelCase keys and ISO 8601 times."""
        values = asdict(self)
        values["reason"] = None if self.reason is None else self.reason.value
        for name in ("started_at", "finished_at"):
            values[name] = iso_time(values[name])
        return json.dumps(_camel_keys(values), indent=2, allow_nan=False) + "\n"


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


def read_reader_report(output_directory: str | None) -> ReaderReport:
    """Read what an algorithm says about its reader; anything odd there is noted, never an error."""
    if output_directory is None:
        return ReaderReport()
    try:
        metrics = json.loads(_read_regular(f"{output_directory}/metrics.json"))
    except FileNotFoundError:
        return ReaderReport()
    except (OSError, ValueError, RecursionError):
        metrics = None
    if not isinstance(metrics, dict):
        return ReaderReport(note="output/metrics.json is no JSON object and was ignored")
    seconds, includes = metrics.get("readerCpuSeconds"), metrics.get("includesReader")
    included = includes if isinstance(includes, bool) else None
    if seconds is None:
        return ReaderReport(includes_reader=included)
    number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    if not number or not math.isfinite(seconds) or seconds < 0:
        note = f"output/metrics.json: readerCpuSeconds must be a number, 0 or more, not {str(seconds)[:40]}"
        return ReaderReport(includes_reader=included, note=note)
    return ReaderReport(float(seconds), included)


def _read_regular(path: str) -> bytes:
    """Read a file an algorithm wrote: no link to elsewhere, no pipe to wait on, no endless size."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    with open(descriptor, "rb") as file:  # noqa: PTH123
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_size > _METRICS_BYTES:
            raise ValueError(path)
        return file.read(_METRICS_BYTES)


def iso_time(seconds: float) -> str:
    """Return a time in UTC as ISO 8601 with milliseconds."""
    whole, milliseconds = divmod(round(seconds * 1000), 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(whole))}.{milliseconds:03d}Z"


def _camel_keys(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {_camel(key): _camel_keys(item) for key, item in value.items()}


def _camel(name: str) -> str:
    first, *rest = name.split("_")
    return first + "".join(part.capitalize() for part in rest)
