# SPDX-License-Identifier: Apache-2.0
"""The reader's part of a run, as output/metrics.json tells it, for the sidecar and the supervisor.

Anything odd there becomes a note, never an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from slamhive.contract.metrics import is_number

if TYPE_CHECKING:
    from slamhive.contract.metrics import AlgorithmMetrics

# A reader takes a part of a run's CPU seconds, hardly more than the algorithm itself.
_PLAUSIBLE_SHARE = 0.5
# By how much a reader's own clock and ours may differ, which is read once a second.
_CLOCK_TOLERANCE, _CLOCK_SECONDS = 0.1, 1.2


class ReaderShare(NamedTuple):
    """The reader's part of a run.

    Attributes:
        cpu_seconds: What to subtract, None if nothing is known.
        included: It is in the figures and can't be told apart, None if nothing says so or otherwise.
        note: What was wrong with what the algorithm said.
        suspicion: Why what it said is to be doubted.
    """

    cpu_seconds: float | None
    included: bool | None
    note: str | None
    suspicion: str | None = None


@dataclass(frozen=True, slots=True)
class ReaderReport:
    """Report of the algorithm in metrics.json on the CPU time of reading the recording.

    Attributes:
        cpu_seconds: CPU seconds of the reader, None if it doesn't say.
        includes_reader: Whether they can't be told apart, None if it doesn't say.
        note: What was wrong with the file, None if nothing was.
    """

    cpu_seconds: float | None = None
    includes_reader: bool | None = None
    note: str | None = None

    def share(self, total: float, *, included: bool, measured: float | None = None) -> ReaderShare:
        """Judge the report.

        Args:
            total: CPU seconds of the entire run.
            included: The Algorithm says that reading can't be told apart.
            measured: CPU seconds of threads that call themselves the reader, None where none does.
        """
        if self.cpu_seconds is not None and self.cpu_seconds > total:
            said = f"output/metrics.json: readerCpuSeconds {self.cpu_seconds:g}"
            wrong = f"{said} is more than all CPU seconds and was ignored"
            return ReaderShare(None, True, wrong, wrong)
        if self.note is not None:
            # What was to be subtracted is not known then.
            return ReaderShare(None, True, self.note)
        told = included or None if self.includes_reader is None else self.includes_reader
        if self.cpu_seconds is None:
            return ReaderShare(0.0 if told is False else None, told, None)
        return ReaderShare(self.cpu_seconds, bool(told), None, self._suspicion(total, measured))

    def _suspicion(self, total: float, measured: float | None) -> str | None:
        said = self.cpu_seconds
        if said is None:
            return None
        if measured is not None and said > (1 + _CLOCK_TOLERANCE) * measured + _CLOCK_SECONDS:
            return f"its reader claims {said:.2f} CPU seconds, the clock of its thread has {measured:.2f}"
        if said > _PLAUSIBLE_SHARE * total:
            return f"its reader claims {said / total:.0%} of its CPU seconds"
        return None


def reader_report(metrics: AlgorithmMetrics) -> ReaderReport:
    """Return the algorithm's own report about its reader."""
    seconds, includes = metrics.values.get("readerCpuSeconds"), metrics.values.get("includesReader")
    included = includes if isinstance(includes, bool) else None
    if seconds is None:
        return ReaderReport(includes_reader=included, note=metrics.note)
    if not is_number(seconds) or seconds < 0:
        note = f"output/metrics.json: readerCpuSeconds must be a number, 0 or more, not {str(seconds)[:40]!r}"
        return ReaderReport(includes_reader=included, note=note)
    return ReaderReport(float(seconds), included)
