# SPDX-License-Identifier: Apache-2.0
"""Judgement of the times of a LiDAR's points: their unit, and scans whose times say nothing.

The first and the last time of each scan tell; a scan lasts about as long as the next one takes to come.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.doctor.findings import Severity
from slamhive.data.doctor.points import ScanWatcher
from slamhive.data.recordings.clouds import PER_SECOND, TIME_FIELDS, cloud_points, time_reading
from slamhive.model.errors import DataError
from slamhive.model.repair import MOST_DROPPED
from slamhive.model.sensors import TimesSince

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy.typing as npt

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.doctor.watching import PassingMessage, WatchedSensor

    Array = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

SAME_INSTANT = 0.3
"""Share of a scan by which its points' times may lie elsewhere than they are said to."""
LEAST_SCAN_SECONDS = 1e-3
"""Seconds below which points are all of one instant."""
_PERIODS = (0.02, 2.0)
"""Lengths in periods that are believed: of recordings with one scan of fifty, to scans that overlap."""
_FITS = (0.1, 1.5)
"""Lengths in periods that speak for another unit; a sensor that turns takes one."""
_LENGTHS = (5e-3, 2.0)
"""Lengths of scans of sensors that are built, s."""
_ODD = 1.5
"""Times the typical length from which on a scan is unlike the rest: a turn hardly varies."""
_LEAST_STEPS = 100
"""Steps of its number within a scan below which a time tells too little of its point."""
_CLOCKS_APART = 60.0
"""Seconds by which absolute times may differ from stamps: TAI and UTC do by 37."""
_FEW = 0.01
_UNITS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}


class ScanTimes(ScanWatcher):
    """Watcher of the times of points."""

    def __init__(self, of: WatchedSensor) -> None:
        super().__init__(of)
        self._field: str | None = None
        self._type: np.dtype[Any] = np.dtype(float)
        # Of each scan: its number, stamp (ns), and the first and the last time as they are written.
        self._scans: list[tuple[int, int, float, float]] = []
        # Of scans with points without a time: stamp (ns), number of these, and of all.
        self._untimed: list[tuple[int, int, int]] = []
        self._stamps: list[int] = []

    def take(self, message: PassingMessage) -> None:
        """Take in a scan."""
        self._stamps.append(message.stamp)
        try:
            points = cloud_points(message.decoded, self.of.sensor.topic, copy=False)
        except DataError:  # `ScanPoints` tells of it.
            return
        lidar, names = self.of.sensor.lidar, points.dtype.names or ()
        # As adapters find it: the declared field, or one of the usual names.
        wanted = (lidar.time_field,) if lidar is not None and lidar.time_field else TIME_FIELDS
        field = next((name for name in wanted if name in names), None)
        if field is None or not len(points):
            return
        self._field, self._type = field, points.dtype[field]
        times = np.ascontiguousarray(points[field])
        low, high = float(times.min()), float(times.max())
        if not np.isfinite([low, high]).all():
            timed = np.isfinite(times)
            placed = np.isfinite(points["x"]) if "x" in names else np.ones_like(timed)
            if missing := int((placed & ~timed).sum()):
                self._untimed.append((message.stamp, missing, len(times)))
            times = times[timed]
            if not len(times):
                return
            low, high = float(times.min()), float(times.max())
        if len(times) > 1:
            self._scans.append((message.index, message.stamp, low, high))

    @property
    def period(self) -> float | None:
        """Return the typical time between scans, s; None where there is one scan only."""
        steps = np.diff(np.sort(np.array(self._stamps)))
        return float(np.median(steps[steps > 0])) / 1e9 if (steps > 0).any() else None

    def found(  # noqa: PLR0917 - as a finding has them
        self, code: str, severity: Severity, sentence: str, stamps: Sequence[int] | Whole = (),
        value: float | None = None, unit: str | None = None, **repair: Any,
    ) -> Finding:  # fmt: skip
        """Return a finding on the scans of some stamps (ns)."""
        lidar = self.of.sensor.lidar
        if "pointTimes" in repair and (lidar is None or lidar.time_field is None):
            # The repair is of a field that has a name.
            sentence += f"; state lidar.timeField: {self._field}, and pointTimes: {repair.pop('pointTimes')}"
        return super().found(code, severity, sentence, stamps, value, unit, **repair)  # type: ignore[arg-type]

    def findings(self) -> Iterator[Finding]:
        """Yield the findings of the times."""
        where = f".lidar.timeField: the times of points in {self._field}"
        if self._untimed:
            yield self._some_without(where)
        if not self._scans:
            return
        index, stamps = (np.array([scan[k] for scan in self._scans]) for k in (0, 1))
        low, high = (np.array([scan[k] for scan in self._scans]) for k in (2, 3))
        varies = high > low
        if not varies.all():
            held = self._absolute(low, stamps)
            if held is None or not self._is_coarse(low, held):
                yield self._constant(where, index, stamps, varies)
                if not varies.any():
                    return
                index, stamps, low, high = (one[varies] for one in (index, stamps, low, high))
        unit, is_absolute, wrong = self._reading(where, stamps, low, high)
        if wrong is not None:
            yield wrong
        if unit == "None":
            return
        headers = stamps / 1e9 if is_absolute else np.zeros(len(stamps))
        after = np.column_stack([low, high]) / PER_SECOND[unit] - headers[:, None]
        yield from self._odd(where, index, stamps, after[:, 1] - after[:, 0])
        if wrong is None:
            # Not of each scan is there a point of its begin and of its end.
            ends = np.percentile(after[:, 0], 5), np.percentile(after[:, 1], 95)
            yield from self._beside(*map(float, ends), is_absolute=is_absolute)

    def _some_without(self, where: str) -> Finding:
        missing = sum(one[1] for one in self._untimed)
        share = missing / sum(one[2] for one in self._untimed)
        return self.found(
            "points.times.none", Severity.WARNING if share > _FEW else Severity.NOTE,
            f"{where} are no numbers (NaN) for {missing} points ({share:.2%}) of {len(self._untimed)} scans "
            f"of {len(self._stamps)}: adapters leave these points out, other programs may fail on them",
            [one[0] for one in self._untimed], 100 * share, "%", noReturns=True,
        )  # fmt: skip

    def _constant(self, where: str, index: Whole, stamps: Whole, varies: npt.NDArray[np.bool_]) -> Finding:
        same = np.flatnonzero(~varies)
        number, of = len(same), len(index)
        if number == of:
            return self.found(
                "points.times.constant", Severity.WARNING,
                f"{where} are the same within each of {of} scans: nothing tells where the sensor was at each "
                "point, so scans stay skewed by its motion, and programs that divide by their length fail. "
                "Leave these times out, and run with deskew: false", stamps[same], number, "scans",
                pointTimes="None",
            )  # fmt: skip
        few = number < 0.05 * of and number <= MOST_DROPPED
        return self.found(
            "points.times.constant", Severity.WARNING,
            f"{where} are the same within each of {number} of {of} scans, the first at "
            f"{self.of.seconds(int(stamps[same[0]])):.3f} s: these scans stay skewed by the motion, and "
            "programs that divide by their length fail; "
            + ("leave these scans out" if few else "leave these times out, and run with deskew: false"),
            stamps[same], number, "scans",
            **({"drop": index[same].tolist()} if few else {"pointTimes": "None"}),
        )  # fmt: skip

    def _absolute(self, low: Array, stamps: Whole) -> str | None:
        """Return the unit in which times are absolute ones, by the stamps; None where they aren't."""
        headers = stamps / 1e9
        for unit, per_second in PER_SECOND.items():
            apart = float(np.median(np.abs(low / per_second - headers)))
            if apart < min(_CLOCKS_APART + self._step(low) / per_second, float(np.median(headers)) / 2):
                return unit
        return None

    def _step(self, times: Array) -> float:
        """Return the distance of a time, as it is written, to the next one."""
        largest = np.abs(times).max()
        return float(np.spacing(largest.astype(self._type))) if self._type.kind == "f" else 1.0

    def _is_coarse(self, low: Array, unit: str) -> bool:
        """Tell whether the numbers are too coarse for the times of points."""
        return self._step(low) / PER_SECOND[unit] > (self.period or 0.1) / _LEAST_STEPS

    def _reading(
        self, where: str, stamps: Whole, low: Array, high: Array
    ) -> tuple[str, bool, Finding | None]:
        """Return the unit of the times, whether they are absolute, and the finding where runs misread them.

        Times that say nothing have the unit None, as in a repair.
        """
        code, period, where = "points.times.unit", self.period, f"{where} ({self._type.name})"
        taken, is_absolute = time_reading(self._type, float(np.median(np.maximum(-low, high))))
        span = float(np.median(high - low))
        seconds = span / PER_SECOND[taken]
        unit = self._absolute(low, stamps)
        if unit is not None and self._is_coarse(low, unit):
            step = self._step(low) / PER_SECOND[unit]
            return "None", True, self.found(
                code, Severity.ERROR,
                f"{where} are absolute ones, which such numbers hold in steps of {step:.3g} s only, so they "
                "can't tell the points of a scan apart: runs that deskew come out wrong. Leave these times "
                "out, and run with deskew: false", stamps, step, "s", pointTimes="None",
            )  # fmt: skip
        if unit is not None:
            wrong = None if (taken, is_absolute) == (unit, True) else self.found(
                code, Severity.ERROR,
                f"{where} are absolute ones in {_UNITS[unit]}, which are taken for {_UNITS[taken]}"
                f"{'' if is_absolute else ' since the stamp'}: runs get times of no scan, and are Lost",
                stamps, seconds, "s", pointTimes=unit,
            )  # fmt: skip
            return unit, True, wrong
        unit = taken
        if period and not _PERIODS[0] < seconds / period < _PERIODS[1]:
            lengths = {one: span / per_second for one, per_second in PER_SECOND.items()}
            fitting = [
                one
                for one, length in lengths.items()
                if _FITS[0] < length / period < _FITS[1] and _LENGTHS[0] < length < _LENGTHS[1]
            ]
            unit = fitting[0] if fitting else taken
        headers = stamps / 1e9 if is_absolute and unit == taken else 0.0
        after = float(np.median(low / PER_SECOND[unit] - headers))
        if abs(after) > max(1.0, 3 * (period or 0.0)):
            return "None", False, self.found(
                code, Severity.ERROR,
                f"{where} begin {abs(after):.10g} s {'after' if after > 0 else 'before'} the stamp of their "
                "scan: they are of another clock, and runs get stamps that are as far off. Leave these times "
                "out, and run with deskew: false, or correct the clock where it is recorded",
                stamps, after, "s", pointTimes="None",
            )  # fmt: skip
        if unit == taken:
            return taken, is_absolute, None
        long = seconds > span / PER_SECOND[unit]
        does = (
            "runs get stamps that are as far off, and are Lost"
            if long
            else "runs that deskew leave scans skewed by the motion, with a larger error"
        )
        return unit, False, self.found(
            code, Severity.ERROR if long else Severity.WARNING,
            f"{where} are taken for {_UNITS[taken]}, so that a scan lasts {seconds:.3g} s, but one comes "
            f"every {period:.3g} s: they are {_UNITS[unit]}; {does}", stamps, seconds, "s", pointTimes=unit,
        )  # fmt: skip

    def _odd(self, where: str, index: Whole, stamps: Whole, spans: Array) -> Iterator[Finding]:
        """Yield the scans whose times span more than those of the others."""
        typical = float(np.median(spans))
        odd = np.flatnonzero(spans > _ODD * max(typical, LEAST_SCAN_SECONDS))
        if not len(odd) or len(spans) < 3:
            return
        k, drop = odd[0], index[odd].tolist()
        # What is odd in every tenth scan is how the sensor is.
        few = len(odd) <= 0.1 * len(spans) and len(drop) <= MOST_DROPPED
        leading = drop == list(range(len(drop)))
        yield self.found(
            "points.times.span", Severity.WARNING if few else Severity.NOTE,
            f"{where} span {spans[k]:.3g} s in the scan at {self.of.seconds(int(stamps[k])):.3f} s, and "
            f"{typical:.3g} s typically; {len(odd)} of {len(spans)} scans span more than {_ODD:g} times "
            "that. Algorithms that deskew bend such a scan, and all that is built on it"
            + ("; leave out what is odd" if few else ""),
            stamps[odd], float(spans[k]), "s",
            **(({"dropLeading": len(drop)} if leading else {"drop": drop}) if few else {}),
        )  # fmt: skip

    def _beside(self, low: float, high: float, *, is_absolute: bool) -> Iterator[Finding]:
        """Yield times that lie elsewhere than the stamp, as declared, lets them."""
        sensor, share = self.of.sensor, self.of.sensor.stamp.share
        if sensor.lidar is None or sensor.lidar.time_field is None or share is None:
            return
        since = TimesSince.HEADER if is_absolute else sensor.lidar.times_since or TimesSince.HEADER
        zero = share if since is TimesSince.HEADER else float(since is TimesSince.SCAN_END)
        if high - low > LEAST_SCAN_SECONDS and abs(-low / (high - low) - zero) > SAME_INSTANT:
            yield self.found(
                "points.times.stamp", Severity.WARNING,
                f": the times of points run from {low:.3g} to {high:.3g} s"
                f"{' after the header stamp' if since is TimesSince.HEADER else ''}, but stamp is "
                f"{sensor.stamp} and lidar.timesSince is {since}: poses come out as much too early or late; "
                "correct the one that is wrong",
            )  # fmt: skip
