# SPDX-License-Identifier: Apache-2.0
"""Judgement of LiDAR scans: their layout, and points that are no returns.

The layout of all scans is looked at, the positions of some thirty scans.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.doctor.repeats import is_same
from slamhive.data.doctor.watching import MessageWatcher
from slamhive.data.recordings.clouds import cloud_points
from slamhive.model.errors import DataError
from slamhive.model.repair import MOST_DROPPED

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy.typing as npt

    from slamhive.data.doctor.watching import PassingMessage, WatchedSensor

LOOKED_AT = 30
_PROBED = 64
"""Points of a scan that are looked at before all are."""
_AT_ORIGIN = 0.01
"""Share of points at the origin, and of scans without a return, that is worth a warning: 40 % of the points
made the error an eighth larger."""


class ScanWatcher(MessageWatcher):
    """Watcher of the scans of a LiDAR."""

    def found(  # noqa: PLR0917 - as a finding has them
        self, code: str, severity: Severity, sentence: str, stamps: Sequence[int] = (),
        value: float | None = None, unit: str | None = None, **repair: Any,
    ) -> Finding:  # fmt: skip
        """Return a finding of this sensor on the scans of some stamps (ns), with the repair that helps."""
        first = self.of.seconds(int(stamps[0])) if len(stamps) else None
        return Finding(
            code, severity, f"{self.of.where}{sentence}", self.of.name, len(stamps) or 1, first, value, unit,
            sensor_repair(self.of.name, **repair) if repair else {},
        )  # fmt: skip


def _has_return(points: npt.NDArray[Any]) -> bool:
    """Tell whether any point of a scan has a place other than the origin; some points mostly do."""
    for some in (points[:: max(1, len(points) // _PROBED)], points):
        axes = [np.ascontiguousarray(some[axis]) for axis in "xyz"]
        placed = np.logical_and.reduce([np.isfinite(axis) for axis in axes])
        if (placed & np.logical_or.reduce([axis != 0 for axis in axes])).any():
            return True
    return False


class ScanPoints(ScanWatcher):
    """Watcher of the layout of scans, and of points that are no returns."""

    def __init__(self, of: WatchedSensor) -> None:
        super().__init__(of)
        self._every = max(1, of.messages // LOOKED_AT)
        self._taken = self._looked = self._counted = self._at_origin = self._unplaced = 0
        self._is_dense = False
        self._last = b""
        self._unread: list[tuple[int, int, str]] = []
        self._blank: list[tuple[int, int]] = []
        self._stepless: list[int] = []
        self._swapped: list[int] = []

    def take(self, message: PassingMessage) -> None:
        """Take in a scan."""
        self._taken += 1
        before, self._last = self._last, message.raw
        try:
            scan = message.decoded
            points = cloud_points(scan, self.of.sensor.topic, copy=False)
        except DataError as error:
            self._unread.append((message.index, message.stamp, str(error)))
            return
        has_places = {"x", "y", "z"} <= {*(points.dtype.names or ())}
        if not len(points) or (has_places and not _has_return(points)):
            self._blank.append((message.index, message.stamp))
        elif is_same(before, message.raw):
            self.repeated.append(message.index)
        if len(points) and not scan.row_step:
            self._stepless.append(message.stamp)
        if scan.is_bigendian:
            self._swapped.append(message.stamp)
        if message.index % self._every == 0 and has_places:
            self._looked += 1
            axes = [np.ascontiguousarray(points[axis]) for axis in "xyz"]
            unplaced = ~np.logical_and.reduce([np.isfinite(axis) for axis in axes])
            self._counted += len(points)
            self._unplaced += int(np.count_nonzero(unplaced))
            self._at_origin += int(np.count_nonzero(np.logical_and.reduce([axis == 0 for axis in axes])))
            self._is_dense |= bool(scan.is_dense and unplaced.any())

    def findings(self) -> Iterator[Finding]:
        """Yield the findings of the scans."""
        yield from self._layout()
        yield from self._no_returns()

    def _layout(self) -> Iterator[Finding]:
        code, topic = "points.layout", self.of.sensor.topic
        if self._unread:
            drop = [index for index, _, _ in self._unread]
            few = len(drop) < self._taken and len(drop) <= MOST_DROPPED
            yield self.found(
                code, Severity.ERROR,
                f": {len(drop)} of {self._taken} scans can't be read, the first is message "
                f"{drop[0] + 1}: {self._unread[0][2]}; runs end there"
                + ("; leave these scans out" if few else ""),
                [stamp for _, stamp, _ in self._unread], len(drop), "scans",
                **({"drop": drop} if few else {}),
            )  # fmt: skip
        if self._stepless:
            yield self.found(
                code, Severity.NOTE,
                f": scans on {topic} state rows of 0 bytes (row_step), and are read as rows without padding; "
                "programs that go by rows themselves may see the first row only", self._stepless,
            )  # fmt: skip
        if self._swapped:
            yield self.found(
                code, Severity.NOTE,
                f": scans on {topic} are big-endian; adapters read them so, nodes that use PCL don't",
                self._swapped,
            )  # fmt: skip

    def _no_returns(self) -> Iterator[Finding]:
        if self._blank:
            drop = [index for index, _ in self._blank]
            few, share = len(drop) < self._taken and len(drop) <= MOST_DROPPED, len(drop) / self._taken
            yield self.found(
                "points.no-return", Severity.WARNING if share > _AT_ORIGIN else Severity.NOTE,
                f": {len(drop)} of {self._taken} scans have no point but at the origin or of NaN: to "
                "odometry they are missing, and programs that expect points fail there"
                + ("; leave them out" if few else ""),
                [stamp for _, stamp in self._blank], len(drop), "scans", **({"drop": drop} if few else {}),
            )  # fmt: skip
        if not self._counted:
            return
        code, looked = "points.no-return", f"in {self._looked} scans looked at"
        if self._at_origin:
            share = self._at_origin / self._counted
            grave = share > _AT_ORIGIN
            yield self.found(
                code, Severity.WARNING if grave else Severity.NOTE,
                f": {share:.1%} of the points are at the origin ({looked}), as drivers write what didn't "
                "return: an obstacle in the sensor to programs that keep near points; leave them out",
                [], 100 * share, "%", noReturns=True,
            )  # fmt: skip
        if self._unplaced:
            share = self._unplaced / self._counted
            dense = "; is_dense says that there are none, which programs believe" if self._is_dense else ""
            yield self.found(
                code, Severity.NOTE,
                f": {share:.1%} of the points have no position (NaN, {looked}){dense}; adapters leave them "
                "out, some ROS nodes refuse such scans", [], 100 * share, "%", noReturns=True,
            )  # fmt: skip
