# SPDX-License-Identifier: Apache-2.0
"""The outcome of a run: summary.json, the truth about how it ended."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

from slamhive.contract.output import OutputContents  # noqa: TC001 - the type of a public field
from slamhive.monitor.measuring.accounting import MeasuredUsage  # noqa: TC001 - the type of a public field
from slamhive.monitor.spec import camel


class Reason(StrEnum):
    """Reasons for which a run did not succeed."""

    DEADLINE_EXCEEDED = "DeadlineExceeded"
    OUT_OF_MEMORY = "OutOfMemory"
    ALGORITHM_FAILED = "AlgorithmFailed"
    CANCELLED = "Cancelled"
    OUTPUT_TOO_LARGE = "OutputTooLarge"
    SYSTEM_FAULT = "SystemFault"


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """Summary of a finished run, written to summary.json: how it ended, what it used and left.

    Attributes:
        exit_code: The algorithm's exit code, None if a signal ended it or it never ended.
        signal: The signal that ended it.
        reason: None for a run that succeeded.
        message: One sentence, empty for a run that succeeded.
        started_at: Wall clock, seconds since 1970; None if it was never seen.
        finished_at: The same.
        usage: What it used; None if it was never seen.
        log_tail: The last lines it printed.
        left_processes: Processes that outlived the algorithm's first one and were ended.
        metrics_problem: What was wrong with metrics.json, None if nothing was.
        notes: What else was wrong but didn't end the run.
        output: What the algorithm left; None where it has no output folder.
    """

    exit_code: int | None
    signal: int | None
    reason: Reason | None
    message: str
    started_at: float | None
    finished_at: float | None
    usage: MeasuredUsage | None
    log_tail: str
    left_processes: int = 0
    metrics_problem: str | None = None
    notes: tuple[str, ...] = ()
    output: OutputContents | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the summary as plain values with camelCase keys and ISO 8601 times."""
        values = asdict(replace(self, output=None))
        del values["output"]
        values["reason"] = None if self.reason is None else self.reason.value
        for name in ("started_at", "finished_at"):
            values[name] = None if values[name] is None else iso_time(values[name])
        told = {camel(name): _camel_keys(value) for name, value in values.items()}
        return told if self.output is None else {**told, **self.output.as_json()}

    def to_json(self) -> str:
        """Return the same as text."""
        return json.dumps(self.as_json(), indent=2, allow_nan=False) + "\n"


def iso_time(seconds: float) -> str:
    """Return a time in UTC as ISO 8601 with milliseconds."""
    whole, milliseconds = divmod(round(seconds * 1000), 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(whole))}.{milliseconds:03d}Z"


def _camel_keys(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {camel(key): _camel_keys(item) for key, item in value.items()}
