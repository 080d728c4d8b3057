# SPDX-License-Identifier: Apache-2.0
"""Judgement of clocks by turning: every sensor and the ground truth against the gyro.

Without a gyro they are held against the ground truth.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.doctor.clocks import KNOWN, cause_of
from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.doctor.imus import Samples
from slamhive.data.doctor.matching import SEARCH, match
from slamhive.data.doctor.mountings import judge_mountings, pose_in_body
from slamhive.data.doctor.sighting import turns_of
from slamhive.data.doctor.turning import Turns, gyro_turning, turning_of
from slamhive.data.doctor.voting import SEEING, TurningSensor, most
from slamhive.model.sensors import SensorType
from slamhive.model.variant import TRUTH

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.data.doctor.examined import Examined
    from slamhive.data.doctor.matching import Match
    from slamhive.data.doctor.turning import Turning
    from slamhive.model.dataset import DatasetSpec

LEAST_SECONDS = 0.01
"""Offsets below are those of exposures and drivers, and a body of 1 m/s moves by less than a centimetre."""
_LEAST_DRIFT = 1e-4
_NEAR_SHARE = 0.1
_SHORT_SECONDS = 9.0
"""Recordings that are shorter tell little of clocks, and that they don't isn't worth a note."""
_UPRIGHT = 0.87
"""Cosine of the angle to z of the body up to which a force points up it."""
_TIME_ZONES = 14.5
"""Hours by which a clock may be in another time zone."""
_HARM = {
    SensorType.IMU: "inertial algorithms combine what isn't of one time, and drift or diverge",
    SensorType.CAMERA: "algorithms that take both combine what isn't of one time, and drift or diverge",
    SensorType.LIDAR: "algorithms that take both combine what isn't of one time, and drift or diverge",
    TRUTH: "an estimate is held against poses of another time, and the errors of every algorithm grow",
}


def judge_turning(examined: Examined) -> Iterator[Finding]:
    """Yield the clocks that contradict how the body turned, and what can't be told of them."""
    streams, turnings = _streams(examined)
    if len(streams) < 2:
        return
    scans = [scan.stamps for scan in examined.watched.scans.values() if len(scan.stamps)]
    is_long = any(np.ptp(stamps) >= _SHORT_SECONDS * 1e9 for stamps in scans)
    reference = next((one for one in streams if one.name in turnings), None)
    if reference is None:
        names = " and ".join(one.name for one in streams)
        if is_long:
            yield Finding(
                "clock.offset",
                Severity.NOTE,
                f"the clocks of {names} can't be held against each other: that takes a gyro, or ground truth "
                "with orientations, that turns",
            )
        return
    fitted, untold = [reference], []
    for stream in streams:
        if stream is reference:
            continue
        fit = _fit(examined, stream, reference, turnings)
        if fit is None:
            untold.append(stream.name)
        else:
            fitted.append(replace(stream, fit=fit))
    spec = examined.entry.dataset.spec
    yield from _clocks(fitted, spec)
    found = judge_mountings(fitted, spec)
    yield from (one for one in found if is_long or one.severity is not Severity.NOTE)
    if untold and is_long:
        yield Finding(
            "clock.offset",
            Severity.NOTE,
            f"from this motion the clock of {' and '.join(untold)} can't be told against {reference.name}: "
            "it turns too little, too evenly or too often alike, or they don't turn together, as where "
            "another finding says that times are wrong",
        )


def _streams(examined: Examined) -> tuple[list[TurningSensor], dict[str, Turning]]:
    """Return the streams, the reference first, and the turning of those that tell of it all the time."""
    spec = examined.entry.dataset.spec
    streams: list[TurningSensor] = []
    turnings: dict[str, Turning] = {}
    gyros = {
        name: (turning, watcher)
        for name, watchers in examined.watched.watchers.items()
        for watcher in watchers
        if isinstance(watcher, Samples)
        for rates in (watcher.rates_and_forces()[0] * watcher.scale_of_rates(examined.truth)[0],)
        for turning in (gyro_turning(watcher.stamps, rates, watcher.of.sensor.time_offset),)
        if turning is not None
    }
    truth = turning_of(examined.truth)
    for name, (turning, watcher) in gyros.items():
        turnings[name], body = turning, pose_in_body(spec, name)[:3, :3]
        force = body @ watcher.sound()[2].sum(axis=0, dtype=np.float64)
        up = bool(force[2] > _UPRIGHT * np.linalg.norm(force))
        first = float(turning.stamps[0])
        streams.append(TurningSensor(name, SensorType.IMU, first, body, is_upright=up))
    if truth is not None:
        turnings[TRUTH] = truth
        streams.append(TurningSensor(TRUTH, TRUTH, float(truth.stamps[0]), pose_in_body(spec, TRUTH)[:3, :3]))
    for name in examined.watched.watchers:
        sensor = spec.sensors[name]
        scan = examined.watched.scans.get(sensor.topic)
        if sensor.type in SEEING and scan is not None and len(scan.stamps):
            first = float(scan.stamps[0]) / 1e9 + sensor.time_offset
            streams.append(TurningSensor(name, sensor.type, first, pose_in_body(spec, name)[:3, :3]))
    return streams, turnings


def _fit(
    examined: Examined, stream: TurningSensor, reference: TurningSensor, turnings: dict[str, Turning]
) -> Match | None:
    turning = turnings[reference.name]
    apart = reference.first - stream.first
    if stream.name in turnings:
        turns = turnings[stream.name].turns()
    else:
        sensors = examined.entry.dataset.spec.sensors
        sensor = sensors[stream.name]
        scan = examined.watched.scans[sensor.topic]
        alike = sum(one.type is sensor.type for one in sensors.values())
        # Of another epoch it is looked at where it turns most if both begin together.
        is_near = turning.knows(scan.stamps / 1e9 + sensor.time_offset)
        chosen = turning if is_near else replace(turning, stamps=turning.stamps - apart)
        tell = partial(examined.progress, stream.name)
        seen = turns_of(examined.recording, sensor, scan, chosen, alike, tell)
        if seen is None:
            return None
        turns = seen
    expected = stream.body.T @ reference.body
    found = match(turning, turns, expected)
    if found is not None or TRUTH not in {stream.kind, reference.kind}:
        return found
    if stream.kind != TRUTH and turning.knows(turns.middle):
        return None
    # Ground truth has no times of recording that tell of its epoch.
    zone = round(apart / 1800.0) * 1800.0
    away = [sign * seconds for seconds in KNOWN for sign in (1.0, -1.0)] + [apart]
    if 0 < abs(zone) < _TIME_ZONES * 3600.0:
        away.append(zone)
    for far in away:
        found = match(turning, Turns(turns.begin + far, turns.end + far, turns.rates), expected)
        if found is not None:
            return replace(found, offset=found.offset + far, origin=found.origin - far)
    return None


def _clocks(streams: Sequence[TurningSensor], spec: DatasetSpec) -> Iterator[Finding]:
    """Yield the streams whose clock isn't that of most."""

    def agree(one: TurningSensor, other: TurningSensor) -> bool:
        time = next((stream.fit.origin for stream in (one, other) if stream.fit is not None), 0.0)
        apart, (c, ec), (d, ed) = abs(one.offset(time) - other.offset(time)), one.drift, other.drift
        return apart <= max(LEAST_SECONDS, one.error + other.error) and abs(c - d) <= max(
            _LEAST_DRIFT, ec + ed
        )

    members, sure = most(streams, agree)
    for stream in streams:
        if stream in members or agree(stream, sure):
            continue
        time = next(one.fit.origin for one in (stream, sure) if one.fit is not None)
        offset, growth = stream.offset(time) - sure.offset(time), stream.drift[0] - sure.drift[0]
        if abs(offset) > SEARCH:
            yield _epoch(stream, sure, offset)
        elif growth:
            yield _drift(stream, sure, offset + growth * (stream.first - time), growth)
        else:
            yield _offset(stream, sure, offset, spec)


def _epoch(stream: TurningSensor, sure: TurningSensor, offset: float) -> Finding:
    exact, cause = cause_of(-offset, stream.first, sure.first)
    side = "ahead of" if exact > 0 else "behind"
    # Known to 0.1 ms by turning, however far the epochs are apart.
    shift = round(offset, 4)
    return _found(
        stream, "clock.epoch", Severity.ERROR,
        f"its times are {abs(exact):.10g} s {side} those of {sure.name}, by turning rates"
        f"{cause}; {_HARM[stream.kind]}; shift its stamps by {shift:.10g} s",
        -offset, "s", shift=shift,
    )  # fmt: skip


def _offset(stream: TurningSensor, sure: TurningSensor, offset: float, spec: DatasetSpec) -> Finding:
    side, error = "late" if offset < 0 else "early", stream.error + sure.error
    halves = stream.fit or sure.fit
    found = "" if halves is None else (
        f" (each half by itself: {abs(halves.halves[0]):.3f} and {abs(halves.halves[1]):.3f} s)"
    )  # fmt: skip
    shift = round(offset, 4)
    return _found(
        stream, "clock.offset", Severity.WARNING,
        f"its times are {abs(offset):.4f} ± {error:.4f} s {side} by turning rates against "
        f"{sure.name}{found}{_cause(stream, offset, spec)}; {_HARM[stream.kind]}; shift its stamps by "
        f"{shift:g} s",
        -offset, "s", shift=shift,
    )  # fmt: skip


def _drift(stream: TurningSensor, sure: TurningSensor, shift: float, growth: float) -> Finding:
    return _found(
        stream, "clock.drift", Severity.WARNING,
        f"its clock is {abs(growth) * 1e6:.0f} parts in a million "
        f"{'slow' if growth > 0 else 'fast'} by turning rates against {sure.name}, from {-shift:.4f} s at "
        f"its begin on; {_HARM[stream.kind]}; shift its stamps by {shift:.4f} s, and by {growth:.6f} s "
        "more for each second",
        -growth, "s/s", shift=round(shift, 4), drift=round(growth, 8),
    )  # fmt: skip


def _cause(stream: TurningSensor, offset: float, spec: DatasetSpec) -> str:
    """Return the likely cause of an offset in words."""
    sensor = spec.sensors.get(stream.name)
    if sensor is None or sensor.type is not SensorType.LIDAR or not sensor.rate:
        return ""
    for share, words in ((0.5, "half a scan"), (1.0, "a scan")):
        if abs(abs(offset) * sensor.rate - share) < _NEAR_SHARE * share:
            return f", {words}: its stamps may mean another instant of it than stamp: {sensor.stamp} states"
    return ""


def _found(  # noqa: PLR0917 - as a finding has them
    stream: TurningSensor, code: str, severity: Severity, text: str, value: float, unit: str, **repair: float
) -> Finding:
    """Return a finding of a clock, with the repair of its stamps."""
    is_truth = stream.kind == TRUTH
    return Finding(
        code,
        severity,
        f"{stream.where}: {text}",
        sensor=stream.name,
        first=stream.first,
        value=value,
        unit=unit,
        repair={"repair": {TRUTH: repair}} if is_truth else sensor_repair(stream.name, **repair),
    )
