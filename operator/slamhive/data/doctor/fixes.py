# SPDX-License-Identifier: Apache-2.0
"""Watcher of GNSS fixes: their states, and leaps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.doctor.truths import excursions, local_speed, longest_around
from slamhive.data.doctor.watching import MessageWatcher
from slamhive_eval.formats.posemessages import east_north_up

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from slamhive.data.doctor.watching import PassingMessage, WatchedSensor

    Array = npt.NDArray[np.float64]

_STATES = {0: "of satellites alone", 1: "with SBAS", 2: "with a ground station (GBAS, RTK)"}
_LEAST_METRES = 1.0
_ACCELERATION = 10.0
"""m/s², which tyres don't bring a vehicle to."""
_NOISES, _SIGMAS = 6.0, 5.0
"""Times the typical bend of the path, and the stated standard deviation: a step of noise has neither."""
_AROUND = 2
_FEWEST = 6


class Fixes(MessageWatcher):
    """Fixes of a receiver."""

    def __init__(self, of: WatchedSensor) -> None:
        super().__init__(of)
        self._rows: list[tuple[float, ...]] = []

    def take(self, message: PassingMessage) -> None:
        """Take in a fix."""
        fix = message.decoded
        variances = np.reshape(fix.position_covariance, (3, 3)).diagonal()
        known = fix.position_covariance_type > 0 and (variances >= 0).all()
        spread = float(np.sqrt(variances[:2].sum())) if known else 0.0
        place = (fix.latitude, fix.longitude, fix.altitude)
        self._rows.append((message.index, self.of.seconds(message.stamp), *place, fix.status.status, spread))

    def findings(self) -> Iterator[Finding]:
        """Yield the findings of states and leaps."""
        table = np.array(self._rows).reshape(-1, 7)
        lost = (table[:, 5] < 0) | ~np.isfinite(table[:, 2:5]).all(axis=1)
        yield from self._states(table, lost)
        found = table[~lost]
        found = found[np.diff(found[:, 1], prepend=-np.inf) > 0]
        # Places off the Earth are refused where the content is looked at.
        if len(found) >= _FEWEST and (np.abs(found[:, 2:4]) <= (90.0, 180.0)).all():
            yield from self._leaps(found)

    def _states(self, table: Array, lost: npt.NDArray[np.bool_]) -> Iterator[Finding]:
        topic, known = self.of.sensor.topic, table[~lost, 5].astype(int).tolist()
        kinds = [f"{known.count(state)} {_STATES.get(state, '')} ({state})" for state in sorted({*known})]
        if not lost.any() and len(kinds) < 2:
            return
        said = f"none of the {len(table)} messages on {topic} has a fix"
        if known:
            said = (
                f"{lost.sum()} of {len(table)} messages on {topic} have no fix; the others are "
                f"{', '.join(kinds)}, by their status: programs that take those of one status alone have "
                "none in between, others weigh all alike unless the covariance tells"
            )
        yield Finding(
            "gnss.status",
            Severity.WARNING if lost.any() else Severity.NOTE,
            f"{self.of.where}: {said}",
            self.of.name,
            int(lost.sum()) or len(table),
            float(table[np.argmax(lost), 1]),
            float(100 * lost.mean()),
            "%",
        )

    def _leaps(self, found: Array) -> Iterator[Finding]:
        """Yield steps that are longer than the vehicle, the noise and the stated accuracy make them."""
        stamps, places = found[:, 1], east_north_up(found[:, 2:5])[:, :2]
        times = np.diff(stamps)
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        speed = local_speed(steps / times, _AROUND)
        bend = float(np.median(np.linalg.norm(np.diff(places, n=2, axis=0), axis=1)))
        spread = np.maximum(found[1:, 6], found[:-1, 6])
        limits = np.maximum.reduce(
            (
                np.full_like(steps, max(_LEAST_METRES, _NOISES * bend)),
                _ACCELERATION * longest_around(times, _AROUND) * times,
                _SIGMAS * spread,
            )
        )
        leaps = np.flatnonzero(steps - speed * times > limits)
        if not leaps.size:
            return
        k = int(leaps[np.argmax(steps[leaps])])
        stated = f"; the stated standard deviation is {spread[k]:.2g} m" if spread[k] else ""
        away = [k for first, last in excursions(leaps, stamps, places) for k in range(first, last + 1)]
        count = leaps.size
        yield Finding(
            "gnss.leap",
            Severity.WARNING,
            f"{self.of.where}: fixes leap {count} time{'s' if count > 1 else ''}, first at "
            f"{stamps[leaps[0]]:.3f} s, farthest by {steps[k]:.3g} m in {times[k]:.3g} s at "
            f"{stamps[k]:.3f} s, where those around move at {speed[k]:.2g} m/s{stated}: programs that join "
            "fixes with other sensors bend their path by as much, unless they reject outliers"
            + (f"; leave {len(away)} of them out" if away else ""),
            self.of.name,
            count,
            float(stamps[leaps[0]]),
            float(steps[k]),
            "m",
            repair=sensor_repair(self.of.name, drop=found[away, 0].astype(int).tolist()) if away else {},
        )
