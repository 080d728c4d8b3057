# SPDX-License-Identifier: Apache-2.0
"""Judgement of header stamps: that they go back, are equal, leave gaps, or wander about a steady rate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.recordings.checks import stamp_fault
from slamhive.data.recordings.repairing import longest_run
from slamhive.data.recordings.thinning import rate_of
from slamhive.model.repair import MOST_DROPPED, BackwardStamps
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy.typing as npt

    from slamhive.data.doctor.examined import Examined
    from slamhive.data.recordings.checks import StampFault
    from slamhive.data.recordings.reading import Scan

    Times = npt.NDArray[np.int64]

GAP_PERIODS = 3.0
"""Periods of a sensor's mean rate without a message that are called a gap."""
_STEADY = 0.1
"""Share of a period by which record times may wander against the stamps to be as good as stamps."""
_FEW = 0.01
"""Share of equal stamps below which they change no figure: a driver that repeats a message now and then."""
_IRREGULAR, _WILD = 0.2, 0.5
"""Shares of a period by which the stamps of a sensor's own clock don't wander, and by which the steps between
samples are so wrong that what is integrated over them is."""
_CODES = {"none": "stamps.none", "zero": "stamps.zero", "back": "stamps.back", "far": "stamps.gap"}
_FEWEST = 20
"""Messages below which nothing is said of how regular they are."""


def gaps_of(stamps: Times) -> tuple[npt.NDArray[np.intp], float | None]:
    """Return the places of the gaps in a stream, and what they are longer than.

    Args:
        stamps: ns, never decreasing, shape (n,).

    Returns:
        The message before each gap, from 0, and the limit in s; None where there is no rate.
    """
    steps = np.diff(stamps)
    # Those of bursts would make each step between them a gap.
    rate = rate_of(stamps[np.hstack([True, steps > 0])]) if len(stamps) else None
    if rate is None:
        return np.array([], dtype=np.intp), None
    return np.flatnonzero(steps > GAP_PERIODS * 1e9 / rate), GAP_PERIODS / rate


def judge_stamps(examined: Examined) -> Iterable[Finding]:
    """Yield the findings of the header stamps of each sensor."""
    for name, sensor in examined.entry.dataset.spec.sensors.items():
        scan = examined.watched.scans.get(sensor.topic)
        if scan is None:
            continue
        judge = _StampJudge(
            name, sensor.topic, scan, sensor.time_offset, is_imu=sensor.type is SensorType.IMU
        )
        fault = stamp_fault(scan.stamps)
        if fault is not None:
            yield judge.fault(fault, examined.recording.label)
            continue  # Gaps come of it.
        yield from judge.gaps()
        if scan.has_header:
            yield from judge.equal()
            yield from judge.jitter()


class _StampJudge:
    """Judge of the stamps of one sensor."""

    def __init__(self, name: str, topic: str, scan: Scan, offset: float, *, is_imu: bool) -> None:
        self.name, self.topic, self.scan, self.offset, self.is_imu = name, topic, scan, offset, is_imu
        self.where = f"sensors.{name}"
        self.sorted = np.sort(scan.stamps)
        self.rate = rate_of(self.sorted)

    def found(self, code: str, severity: Severity, text: str, first: int | None, **more: Any) -> Finding:
        at = None if first is None else float(first / 1e9) + self.offset
        return Finding(code, severity, f"{self.where}: {text}", self.name, first=at, **more)

    def fault(self, fault: StampFault, label: str) -> Finding:
        """Return the finding of stamps that no run can be prepared with."""
        stamps, numbers = self.scan.stamps, fault.numbers
        repair: dict[str, Any] = {}
        helps = "; runs with it come out PreparationFailed"
        if fault.kind == "zero":
            if numbers.size < min(len(stamps), MOST_DROPPED + 1):
                repair = {"drop": numbers.tolist()}
                helps += f"; leave out the {numbers.size} without a stamp"
        elif numbers.size and self.scan.has_header:
            way, what = _way_on(self.scan, fault.seconds, self.rate)
            repair, helps = {"stamps": str(way)}, f"{helps}; {what}"
        return self.found(
            _CODES[fault.kind], Severity.ERROR, f"{self.topic} in {label}: {fault.text}{helps}",
            int(stamps[max(0, numbers[0] - 1)]) if numbers.size else None,
            count=max(1, int(numbers.size)),
            value=fault.seconds or None,
            unit="s" if fault.seconds else None,
            repair=sensor_repair(self.name, **repair) if repair else {},
        )  # fmt: skip

    def gaps(self) -> Iterator[Finding]:
        wide, limit = gaps_of(self.sorted)
        if not wide.size or limit is None:
            return
        steps = np.diff(self.sorted)[wide]
        longest = int(wide[np.argmax(steps)])
        yield self.found(
            "stamps.gap", Severity.WARNING,
            f"{wide.size} gap{'s' if wide.size > 1 else ''} in {self.topic}, the longest "
            f"{steps.max() / 1e9:.3f} s at {self.sorted[longest] / 1e9 + self.offset:.3f} s; a gap is more "
            f"than {limit:.3g} s, {GAP_PERIODS:g} periods",
            int(self.sorted[wide[0]]), count=int(wide.size), value=float(steps.max() / 1e9), unit="s",
        )  # fmt: skip

    def equal(self) -> Iterator[Finding]:
        equal = np.flatnonzero(np.diff(self.scan.stamps) == 0)
        if not equal.size:
            return
        share = equal.size / len(self.scan.stamps)
        # Stamped by a computer as bursts came in; the recorder may have had them one by one.
        spread, burst = _wander(self.scan), _longest_burst(equal)
        steady = self.rate is not None and spread < (burst + GAP_PERIODS) / self.rate
        steady = steady and _is_regular(self.scan.times)
        repair: dict[str, Any] = {"stamps": str(BackwardStamps.RECORDED)} if steady else {}
        helps = "; the times of recording are regular: stamps: Recorded takes those" if steady else ""
        if not steady and not self.is_imu and equal.size <= MOST_DROPPED:
            repair, helps = {"drop": (equal + 1).tolist()}, "; leave out the later ones"
        yield self.found(
            "stamps.equal", Severity.NOTE if share < _FEW else Severity.WARNING,
            f"{equal.size} of {len(self.scan.stamps)} messages of {self.topic} ({share:.2g} of them) have "
            "the stamp of the one before: "
            + ("algorithms that integrate from stamp to stamp leave every such sample out, or divide by 0"
               if self.is_imu else "programs that pair or order by stamp take one of them") + helps,
            int(self.scan.stamps[equal[0]]), count=int(equal.size), value=round(share, 6),
            repair=sensor_repair(self.name, **repair) if repair else {},
        )  # fmt: skip

    def jitter(self) -> Iterator[Finding]:
        steps = np.diff(self.sorted).astype(np.float64)
        steps = steps[steps > 0]
        if len(steps) < _FEWEST:
            return
        usual = float(np.median(steps))
        steps = steps[steps <= GAP_PERIODS * usual]
        low, high = np.percentile(steps, (5, 95))
        wander = float(high - low) / 2
        if wander <= _IRREGULAR * usual:
            return
        # A stamp that is late makes the step before it longer and the next one shorter; where the rate
        # itself varies, which is no fault, neighbours are alike.
        around = steps - steps.mean()
        is_late = float((around[1:] * around[:-1]).mean()) < -0.2 * float((around**2).mean())
        is_late &= self.rate is not None and abs(1e9 / self.rate - usual) < _WILD * usual
        is_grave = self.is_imu and is_late and wander > _WILD * usual
        if is_late:
            does = (
                "they look like times of arrival, so poses are off by the motion in "
                f"{wander / 1e6:.2g} ms; have the driver stamp by the sensor's clock"
            )
        else:
            does = "a rate that varies is no fault, but programs that count on a steady one misjudge it"
        yield self.found(
            "stamps.jitter", Severity.WARNING if is_grave else Severity.NOTE,
            f"the steps between the stamps of {self.topic} are irregular, {usual / 1e6:.3g} ms typically, "
            f"{low / 1e6:.3g} to {high / 1e6:.3g} ms nine times in ten: {does}",
            None, value=round(wander / 1e9, 9), unit="s",
        )  # fmt: skip


def _way_on(scan: Scan, back: float, rate: float | None) -> tuple[BackwardStamps, str]:
    """Choose how stamps that go back are repaired, and say why."""
    period = 1.0 / rate if rate else 0.0
    wander = _wander(scan, back / 2)
    within = (
        f"the times of recording, which keep to the stamps within {1e3 * wander:.2g} ms, stand in for all"
    )
    if wander <= _STEADY * period:
        return BackwardStamps.RECORDED, f"{within} with stamps: Recorded"
    kept = longest_run(scan.stamps)
    low, high = np.percentile((scan.stamps - scan.times)[kept] / 1e9, (5, 95))
    if high - low < max(back / 2, period):
        lost = len(scan.stamps) - len(kept)
        return BackwardStamps.DROP, f"leave out the {lost} that do with stamps: Drop"
    # What is left without those that go back is of one clock and of another one later.
    return BackwardStamps.RECORDED, f"{within} with stamps: Recorded, as the stamps leap for good"


def _wander(scan: Scan, leap: float = np.inf) -> float:
    """Return by how much record times wander against stamps, leaps of the stamps left out, s."""
    steps = np.diff((scan.stamps - scan.times) / 1e9)
    return float(np.ptp(np.cumsum(steps[np.abs(steps) < leap]))) if steps.size else 0.0


def _longest_burst(equal: npt.NDArray[np.intp]) -> int:
    """Return the number of messages of the longest run with one stamp, by those before an equal one."""
    ends = np.flatnonzero(np.diff(equal) > 1)
    edges = np.concatenate(([-1], ends, [len(equal) - 1]))
    return int(np.diff(edges).max()) + 1


def _is_regular(times: Times) -> bool:
    steps = np.diff(times)
    low, high = np.percentile(steps, (5, 95))
    return bool(high - low < _STEADY * np.median(steps))
