# SPDX-License-Identifier: Apache-2.0
"""Accounting: from samples to a run's usage (means, peaks, windows, contention).

Supervisor and sidecar use it.

Memory of this process stays the same however long a run takes: all figures are kept up as samples come.
"""

from __future__ import annotations

import os
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.monitor.measuring.processes import read_file

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.monitor.measuring.sources import Sample, UsageSource

WINDOW_SECONDS = 1.0
RESIDENT = "Resident"
_SUSPECT_LETTERS = 400
# Below this share of a window's capacity, work of others is noise of the tick that counts it.
_CONTENTION_NOISE = 0.05
_WORTH_A_WORD_SECONDS = 10.0
"""Waiting for others below this is none of the reasons that a run came late."""
_TICK = os.sysconf("SC_CLK_TCK")
# A short run shall have samples too: these come before the regular ones, s.
_EARLY_SAMPLES = (0.005, 0.02, 0.05)


class SampleTimes:
    """Times at which usage is sampled: on a grid from the start, and a few before it begins."""

    def __init__(self, start: float, interval: float) -> None:
        """Begin at `start` (monotonic clock, s)."""
        self._start = start
        self._interval = interval
        self._early = [start + seconds for seconds in _EARLY_SAMPLES if seconds < interval]
        self.due = start
        self.advance(start)

    def advance(self, now: float) -> None:
        """Go on to the next; samples that are too late are left out, not made up for."""
        while self._early and self._early[0] <= now:
            self._early.pop(0)
        steps = int((now - self._start) / self._interval) + 1
        self.due = self._early[0] if self._early else self._start + steps * self._interval


@dataclass(frozen=True, slots=True)
class MeasuredCpu:
    """Processor use.

    Attributes:
        mean_cores: CPU seconds over wall seconds, the reader's left out.
        max_cores: The most in any window of 1 s, the reader's included.
        seconds: CPU seconds, the reader's left out.
        seconds_per_data_second: The same by second of recording.
        total_seconds: CPU seconds, the reader's included.
    """

    mean_cores: float
    max_cores: float
    seconds: float
    seconds_per_data_second: float | None
    total_seconds: float


@dataclass(frozen=True, slots=True)
class MeasuredMemory:
    """Memory use; None where no sample saw the algorithm alive, as nothing that ran had no memory.

    Attributes:
        peak_bytes: The headline: peak of the resident memory of all processes.
        mean_bytes: Its mean over time.
        anonymous_peak_bytes: Peak of anonymous memory, of the samples.
        working_set_peak_bytes: Peak of the working set, of the samples; by /proc, where no page cache is
            seen, that of resident memory, shared pages repeated.
        kernel_peak_bytes: The kernel's own peak, between samples too. Of a cgroup: page cache included. Of
            /proc: of the largest single process.
        kind: What `peak_bytes` and `mean_bytes` are.
    """

    peak_bytes: int | None
    mean_bytes: float | None
    anonymous_peak_bytes: int | None
    working_set_peak_bytes: int | None
    kernel_peak_bytes: int | None
    kind: str = RESIDENT


@dataclass(frozen=True, slots=True)
class MeasuredUsage:
    """CPU, memory and time that a run took.

    Attributes:
        cpu: Processor use.
        memory: Memory use.
        wall_seconds: From the start of the algorithm's first process to its end.
        throttled_seconds: Time in which a quota held it back, None if nothing counts that.
        contended_seconds: Processor time it waited for while others used its processors.
        reader_cpu_seconds: What was subtracted for reading the recording, None if nothing was.
        reader_share: The part of all CPU seconds that this is.
        samples: Number of samples, the rows of usage.csv.
        source: Whose account this is.
        includes_reader: Reading the recording is part of the figures and can't be told apart, None if that
            isn't known.
        max_includes_reader: The reader is part of `max_cores` although subtracted elsewhere.
        suspect: Why these figures are to be doubted, None if nothing speaks against them.
    """

    cpu: MeasuredCpu
    memory: MeasuredMemory
    wall_seconds: float
    throttled_seconds: float | None
    contended_seconds: float
    reader_cpu_seconds: float | None
    reader_share: float | None
    samples: int
    source: str
    includes_reader: bool | None
    max_includes_reader: bool | None
    suspect: str | None = None


class Accounting:
    """Takes samples as they come and keeps the figures."""

    def __init__(self, start: float) -> None:
        """Begin at `start` (monotonic clock, s), with no CPU used."""
        self.samples = 0
        self.cpu_seconds = 0.0
        self._start = self._last = start
        self._memory = 0
        self._byte_seconds = 0.0
        self._memory_seconds = 0.0
        self._peak = self._anonymous_peak = self._working_set_peak = 0
        self._max_cores: float | None = None
        self._recent = deque([(start, 0.0)])

    def add(self, sample: Sample, *, final: bool = False) -> float:
        """Take a sample.

        Args:
            sample: The sample.
            final: The algorithm has ended: its CPU counts, memory is no longer its own.

        Returns:
            The cores used since the sample before.
        """
        elapsed = sample.time - self._last
        # Samples may come late: each one's memory counts for as long as it was the last that was known.
        if self.samples:
            self._byte_seconds += self._memory * elapsed
            self._memory_seconds += elapsed
        cores = (sample.cpu - self.cpu_seconds) / elapsed if elapsed > 0 else 0.0
        self.samples += 1
        self._last, self.cpu_seconds, self._memory = sample.time, sample.cpu, sample.resident
        if not final:
            self._peak = max(self._peak, sample.resident)
            self._working_set_peak = max(self._working_set_peak, sample.working_set)
            self._anonymous_peak = max(self._anonymous_peak, sample.anonymous)
        self._slide(sample.time, sample.cpu)
        return cores

    def _slide(self, now: float, cpu: float) -> None:
        """Close the window that ends at this sample; its start is interpolated between two samples."""
        recent = self._recent
        recent.append((now, cpu))
        begin = now - WINDOW_SECONDS
        if begin < self._start:
            return
        while recent[1][0] <= begin:
            recent.popleft()
        (time0, cpu0), (time1, cpu1) = recent[0], recent[1]
        cpu_at_begin = cpu0 + (cpu1 - cpu0) * (begin - time0) / (time1 - time0)
        self._max_cores = max(self._max_cores or 0.0, (cpu - cpu_at_begin) / WINDOW_SECONDS)

    def usage(
        self,
        source: str,
        *,
        data_seconds: float | None = None,
        reader_cpu_seconds: float | None = None,
        includes_reader: bool | None = None,
        throttled_seconds: float | None = None,
        contended_seconds: float = 0.0,
        kernel_peak: int | None = None,
        largest_process: int | None = None,
        suspicions: Iterable[str] = (),
    ) -> MeasuredUsage:
        """Return the figures of all samples so far; a run below 1 s is one window by itself.

        Args:
            source: Name of the samples' source.
            data_seconds: Length of the recording.
            reader_cpu_seconds: CPU seconds to subtract for reading the recording.
            includes_reader: Passed through.
            throttled_seconds: Passed through.
            contended_seconds: Passed through.
            kernel_peak: Passed through.
            largest_process: Resident peak of the largest single process; lifts a peak behind the last sample.
            suspicions: Sentences about what speaks against the figures.
        """
        wall = self._last - self._start
        total = self.cpu_seconds
        reader = min(reader_cpu_seconds or 0.0, total)
        whole = total / wall if wall > 0 else 0.0
        seconds = total - reader
        # What a process took between the last sample and its end is in the kernel's record of it alone.
        peak = max(self._peak, largest_process or 0) or None
        # A single sample has no time to be averaged over: its own figure stands for the mean below.
        mean = self._byte_seconds / self._memory_seconds if self._memory_seconds > 0 else 0.0
        return MeasuredUsage(
            cpu=MeasuredCpu(
                mean_cores=seconds / wall if wall > 0 else 0.0,
                max_cores=whole if self._max_cores is None else self._max_cores,
                seconds=seconds,
                seconds_per_data_second=seconds / data_seconds if data_seconds else None,
                total_seconds=total,
            ),
            memory=MeasuredMemory(
                peak_bytes=peak,
                mean_bytes=mean or peak,
                anonymous_peak_bytes=self._anonymous_peak or None,
                working_set_peak_bytes=self._working_set_peak or None,
                kernel_peak_bytes=kernel_peak,
            ),
            wall_seconds=wall,
            throttled_seconds=throttled_seconds,
            contended_seconds=contended_seconds,
            reader_cpu_seconds=reader_cpu_seconds,
            reader_share=None if reader_cpu_seconds is None or total <= 0 else reader / total,
            samples=self.samples,
            source=source,
            includes_reader=includes_reader,
            max_includes_reader=reader > 0 or includes_reader,
            suspect="; ".join(suspicions)[:_SUSPECT_LETTERS] or None,
        )


class Contention:
    """Meter of the processor time that others took from a run on the processors meant for it alone.

    In each window the smaller of two times counts: what others (and the hypervisor: steal) used on the run's
    processors, and what the run's threads waited in the queue for a processor. The first alone would blame a
    busy neighbour that took nothing away, the second alone a run with more threads than processors.
    Where the kernel keeps no pressure of the group, waiting is that of processes alive as a window ends.
    """

    def __init__(self, cpus: Iterable[int], source: UsageSource, now: float) -> None:
        """Watch a run.

        Args:
            cpus: The run's processors, empty for all.
            source: Its account.
            now: Monotonic clock, s.
        """
        self.seconds = 0.0
        names = [f"cpu{number}".encode() for number in sorted(set(cpus))]
        self._names = frozenset(names or (f"cpu{number}".encode() for number in os.sched_getaffinity(0)))
        self._source = source
        self._time = now
        self._cpu = 0.0
        self._busy = _busy_seconds(self._names)
        self._waited: dict[str, int] = {}
        self._pressure = source.pressure()

    def due(self, now: float) -> bool:
        """Tell whether a window is full."""
        return now - self._time >= WINDOW_SECONDS

    def add(self, now: float, cpu: float) -> None:
        """Close a window.

        Args:
            now: Monotonic clock, s.
            cpu: CPU seconds of the run so far.
        """
        busy = _busy_seconds(self._names)
        others = (busy - self._busy) - (cpu - self._cpu)
        capacity = (now - self._time) * len(self._names)
        waited = self._waiting()
        if capacity > 0 and others > _CONTENTION_NOISE * capacity:
            self.seconds += max(min(others, waited), 0.0)
        self._time, self._cpu, self._busy = now, cpu, busy

    def overrun(self, allowed: float) -> str:
        """Sentence on a run that took longer than allowed, s, and whether that was for others' programs."""
        late = f"it took more than {allowed:g} s"
        # Equal words for equal ends: how long it waited is a figure of the run.
        if self.seconds <= max(allowed / 2, _WORTH_A_WORD_SECONDS):
            return late
        return f"{late}, most of them waiting for processors that others used"

    def _waiting(self) -> float:
        """Return the seconds the run's threads waited in this window."""
        pressure = self._source.pressure()
        if pressure is not None and self._pressure is not None:
            waited = pressure - self._pressure
            self._pressure = pressure
            return waited
        before, self._waited = self._waited, {}
        with suppress(OSError):
            for pid in self._source.processes():
                self._waited.update(_run_delays(pid))
        return sum(value - before.get(key, 0) for key, value in self._waited.items()) / 1e9


def _run_delays(pid: int) -> dict[str, int]:
    """Return for each thread of a process the ns it waited for a processor (schedstat, field 2)."""
    delays = {}
    with suppress(OSError):
        for task in os.listdir(f"/proc/{pid}/task"):  # noqa: PTH208
            path = f"/proc/{pid}/task/{task}/schedstat"
            with suppress(OSError, IndexError):
                delays[path] = int(read_file(path).split()[1])
    return delays


def _busy_seconds(names: frozenset[bytes]) -> float:
    """Return the seconds in which these processors were not idle, steal included, guests not twice."""
    ticks = 0
    with suppress(OSError):
        for line in read_file("/proc/stat").splitlines():
            if not line.startswith(b"cpu"):
                break
            parts = line.split()
            if parts[0] in names:
                user, nice, system, _idle, _iowait, *interrupts = map(int, parts[1:9])
                ticks += user + nice + system + sum(interrupts)
    return ticks / _TICK
