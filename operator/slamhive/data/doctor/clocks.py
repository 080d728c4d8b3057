# SPDX-License-Identifier: Apache-2.0
"""Clocks of a recording's sensors: one that counts from another epoch than the others."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.data.doctor.examined import Examined

_EPOCH_SECONDS = 5.0
"""Record times lag behind headers by queues and buffers, seldom by more than a second or two."""
_STEADY_SECONDS = 1.0
"""Record times that wander more against the headers are those of a conversion, and tell of no clock."""
_CAUSE_SECONDS = 0.6
_BOOT_SECONDS = 1e8
_UNIX_SECONDS = 1e9
KNOWN = {
    37.0: "TAI − UTC",
    18.0: "GPS − UTC",
    19.0: "TAI − GPS",
    315_964_782.0: "the epoch of GPS, 1980, instead of 1970",
}
"""Seconds between clocks that are in use, and what they are."""


class _Clock(NamedTuple):
    """Sensor times of a stream against its times of recording, s."""

    name: str
    lead: float
    first: float
    last: float
    recorded: float


def epochs(examined: Examined) -> Iterable[Finding]:
    """Yield the sensors whose headers are of another epoch than the other sensors', by the record times."""
    clocks = _clocks(examined)
    if len(clocks) < 2:
        return
    # Most agree on the right one; of as many, the one nearest to the recorder's clock is.
    right = min(
        clocks, key=lambda one: (-sum(abs(one.lead - k.lead) < _EPOCH_SECONDS for k in clocks), abs(one.lead))
    )
    for clock in clocks:
        ahead = clock.lead - right.lead
        # Headers that agree where record times don't are of one clock, as in recordings that were merged.
        apart = abs(clock.first - right.first) > abs(clock.recorded - right.recorded)
        if abs(ahead) < _EPOCH_SECONDS or not apart:
            continue
        exact, cause = cause_of(ahead, clock.first, right.first)
        side = "ahead of" if ahead > 0 else "behind"
        both = max(0.0, min(clock.last, right.last) - max(clock.first, right.first))
        yield Finding(
            "clock.epoch",
            Severity.ERROR,
            f"sensors.{clock.name}: its header stamps are {abs(exact):.10g} s {side} those of {right.name}, "
            f"by the times of recording{cause}; algorithms that take both share {both:.1f} s of them, "
            f"and those with it alone miss the ground truth; shift its stamps by {-exact:.10g} s",
            sensor=clock.name,
            first=clock.first,
            value=exact,
            unit="s",
            repair=sensor_repair(clock.name, shift=-exact),
        )


def _clocks(examined: Examined) -> list[_Clock]:
    clocks = []
    for name, sensor in examined.entry.dataset.spec.sensors.items():
        scan = examined.watched.scans.get(sensor.topic)
        if scan is None or not scan.has_header or not len(scan.stamps):
            continue
        leads = (scan.stamps - scan.times) / 1e9 + sensor.time_offset
        low, lead, high = np.percentile(leads, (10, 50, 90))
        if high - low < _STEADY_SECONDS:
            first, last = (float(k) / 1e9 + sensor.time_offset for k in (scan.stamps[0], scan.stamps[-1]))
            clocks.append(_Clock(name, float(lead), first, last, float(scan.times[0]) / 1e9))
    return clocks


def cause_of(ahead: float, first: float, right: float) -> tuple[float, str]:
    """Return the difference of two clocks, exact where its cause is known, s, and the cause in words.

    Args:
        ahead: The difference as found, s.
        first: The first time of the one that is wrong, s.
        right: That of the other, s.
    """
    for seconds, cause in KNOWN.items():
        if abs(abs(ahead) - seconds) < _CAUSE_SECONDS:
            return float(np.copysign(seconds, ahead)), f", which is {cause}"
    hours = round(ahead / 1800.0) / 2.0
    if 0 < abs(hours) <= 14 and abs(ahead - 3600.0 * hours) < _CAUSE_SECONDS:
        return 3600.0 * hours, f", which is {abs(hours):g} h, a time zone"
    if abs(first) < _BOOT_SECONDS and right > _UNIX_SECONDS:
        return round(ahead, 3), ": they count from the sensor's start"
    if abs(right) < _BOOT_SECONDS and first > _UNIX_SECONDS:
        return round(ahead, 3), ": the others count from a sensor's start"
    return round(ahead, 3), ""
