# SPDX-License-Identifier: Apache-2.0
"""Judgement of IMUs: units, halves in two topics, noise at rest, and samples between frames."""

from __future__ import annotations

from array import array
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic.alias_generators import to_camel

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.doctor.matching import is_mirrored
from slamhive.data.doctor.noise import noise_at_rest
from slamhive.data.doctor.ratescales import DEGREE, IntegratedTurns
from slamhive.data.doctor.turning import gyro_turning, turning_of
from slamhive.data.doctor.watching import MessageWatcher
from slamhive.data.recordings.checks import stamp_fault
from slamhive.data.recordings.kinds import IMU
from slamhive.data.recordings.repairing import FORCES, IMU_FORCE, IMU_NUMBERS, IMU_RATE
from slamhive.model.dataset import modes_with, sensor_for
from slamhive.model.errors import DataError
from slamhive.model.repair import MOST_DROPPED
from slamhive.model.sensors import ROLES, Role, SensorMode

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    import numpy.typing as npt

    from slamhive.data.doctor.examined import Examined
    from slamhive.data.doctor.watching import PassingMessage, WatchedSensor
    from slamhive.data.recordings.reading import Recording
    from slamhive_eval import Trajectory

    Array = npt.NDArray[np.float64]
    Numbers = npt.NDArray[np.floating[Any]]

_RATE, _FORCE = (slice(8 * one.start, 8 * one.stop) for one in (IMU_RATE, IMU_FORCE))
"""Bytes of turning rates and specific forces in those at the end of a sensor_msgs/Imu."""
_GRAVITY = 9.80665
_AROUND = (0.8, 1.25)
"""Share of gravity that specific forces have typically, however a platform moves: no Earth's is beyond."""
_UNITS = {"g": _GRAVITY, "mg": _GRAVITY / 1000.0}
_NOTHING = 1e-12
_PIECE = 2**20
"""Bytes of numbers that are gathered before they are put away."""
_ABSURD = 10.0
"""Turning rate, rad/s, that no platform has for a twentieth of the time: racing drones peak there."""
_FIRST = 500
"""Samples that tell of an IMU at a glance."""
_OTHER_NOISE = 3.0
"""Factor by which a noise that was measured is another than stated: temperature and mounting make up two."""
_OFTEN = 0.01
"""Share of frames without a sample that isn't chance: the rate is too low for them."""
_FRAMES = (Role.CAMERA, Role.LEFT, Role.COLOR, Role.LIDAR, Role.SCAN)


class Samples(MessageWatcher):
    """Watcher of the samples of an IMU: stamps, turning rates and specific forces of all of them."""

    def __init__(self, of: WatchedSensor) -> None:
        super().__init__(of)
        self._stamps = array("q")
        self._numbers = bytearray()
        self._pieces: list[npt.NDArray[np.float32]] = []
        self._order = "<"
        self._scale: tuple[float, str] | None = None

    def take(self, message: PassingMessage) -> None:
        """Take in a sample."""
        raw = message.raw
        tail = raw[len(raw) - 8 * IMU_NUMBERS :]
        if len(tail) < 8 * IMU_NUMBERS:
            raise DataError(f"{len(raw)} bytes are no {IMU}")
        if not self._stamps:
            force = message.decoded.linear_acceleration
            given = [force.x, force.y, force.z]
            if not np.array_equal(np.frombuffer(tail[_FORCE], "<f8"), given, equal_nan=True):
                self._order = ">"
        self._stamps.append(message.stamp)
        self._numbers += tail[_RATE]
        self._numbers += tail[_FORCE]
        if len(self._numbers) >= _PIECE:
            self._put_away()

    def _put_away(self) -> None:
        # Half the memory, and digits enough for what is judged.
        numbers = np.frombuffer(bytes(self._numbers), f"{self._order}f8").reshape(-1, 6)
        self._pieces.append(numbers.astype(np.float32))
        self._numbers.clear()

    @property
    def stamps(self) -> npt.NDArray[np.int64]:
        """Return the header stamps, ns, shape (n,)."""
        return np.array(self._stamps, dtype=np.int64)

    def rates_and_forces(self) -> tuple[Numbers, Numbers]:
        """Return the turning rates and the specific forces as stated, each of shape (n, 3)."""
        if self._numbers or not self._pieces:
            self._put_away()
            self._pieces = [np.concatenate(self._pieces)]
        return self._pieces[0][:, :3], self._pieces[0][:, 3:]

    def sound(self) -> tuple[Array, Numbers, Numbers]:
        """Return sensor times, s, rates and forces of the samples whose numbers are finite."""
        times, (rates, forces) = self.stamps / 1e9 + self.of.sensor.time_offset, self.rates_and_forces()
        sound = _are_finite(rates, forces)
        return (times, rates, forces) if sound.all() else (times[sound], rates[sound], forces[sound])

    def scale_of_rates(self, truth: Trajectory | None) -> tuple[float, str]:
        """Return the factor that the turning rates need, and what tells of it; 1 where nothing does.

        Negative is that of rates of the wrong sign.
        """
        if self._scale is None:
            self._scale = self._told_scale(truth)
        return self._scale

    def _told_scale(self, truth: Trajectory | None) -> tuple[float, str]:
        times, rates, forces = self.sound()
        is_whole = has_halves(rates, forces) == (True, True) and len(times) > 1
        if not is_whole or stamp_fault(self.stamps) is not None:
            return 1.0, ""
        turns = IntegratedTurns(times, rates, forces)
        scale, by = turns.scale_by_gravity(), "the way that gravity turns in its axes"
        if scale is None and truth is not None:
            scale, by = turns.scale_by_truth(truth), "how far the ground truth turns"
            offset, true = self.of.sensor.time_offset, turning_of(truth)
            turned = gyro_turning(self.stamps, self.rates_and_forces()[0], offset)
            if turned is not None and true is not None and is_mirrored(turned, true.turns()):
                scale, by = -(scale or 1.0), "how the ground truth turns"
        if scale is None and np.percentile(np.linalg.norm(rates, axis=1), 95) > _ABSURD:
            scale, by = DEGREE, "their size, as nothing that maps turns so fast for so long"
        return (1.0 if scale is None else scale), by


def force_findings(name: str, forces: Numbers) -> Iterator[Finding]:
    """Yield the finding of forces in another unit than m/s².

    Args:
        name: The sensor.
        forces: Specific forces, shape (n, 3).
    """
    lengths = np.linalg.norm(forces[_are_finite(forces)], axis=1)
    typical = float(np.median(lengths)) if lengths.size else 0.0
    if typical <= _NOTHING or _AROUND[0] < typical / _GRAVITY < _AROUND[1]:
        return
    unit = next(
        (one for one, scale in _UNITS.items() if _AROUND[0] < typical * scale / _GRAVITY < _AROUND[1]), None
    )
    if unit is not None:
        hint = f"; it looks like units of {unit}: with inertial algorithms gravity and speeds come out wrong"
    elif typical < _AROUND[0] * _GRAVITY:
        hint = (
            "; gravity may have been taken out, by which inertial algorithms tell what is up: record the "
            "driver's raw forces"
        )
    else:
        hint = ", and inertial algorithms take the rest for motion"
    yield Finding(
        "imu.units", Severity.WARNING,
        f"sensors.{name}: the specific force is {typical:.3g} m/s² typically, about 9.8 is expected{hint}",
        name, count=len(forces), value=typical, unit="m/s²",
        repair=sensor_repair(name, forceScale=_UNITS[unit]) if unit else {},
    )  # fmt: skip


def has_halves(rates: Numbers, forces: Numbers) -> tuple[bool, bool]:
    """Tell whether samples have rates, and whether they have forces, other than 0 and NaN."""
    return _says(rates), _says(forces)


def _are_finite(*tables: Numbers) -> npt.NDArray[np.bool_]:
    """Tell which rows of some tables hold finite numbers alone."""
    return np.asarray(np.logical_and.reduce([np.isfinite(table).all(axis=1) for table in tables]))


def _says(table: Numbers) -> bool:
    return bool((np.isfinite(table) & (np.abs(table) > _NOTHING)).any())


def first_samples(recording: Recording, topic: str) -> tuple[Array, Array]:
    """Return the turning rates and forces of a topic's first samples, each of shape (n, 3).

    Messages other than Imu hold forces alone; their rates are 0.

    Raises:
        DataError: The recording is damaged.
    """
    rows: list[tuple[float, ...]] = []
    for connection, _, raw in recording.messages({topic}):
        message = recording.decode(raw, connection.msgtype)
        force, rate = FORCES[connection.msgtype](message), getattr(message, "angular_velocity", None)
        turn = (rate.x, rate.y, rate.z) if rate is not None else (0.0, 0.0, 0.0)
        rows.append((*turn, force.x, force.y, force.z))
        if len(rows) == _FIRST:
            break
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return table[:, :3], table[:, 3:]


def forces_alone(recording: Recording, known: Collection[str]) -> Iterator[str]:
    """Yield the topics of specific forces alone: of Imu, and of vectors that are as long as gravity.

    Args:
        recording: The recording.
        known: Topics that are left out.
    """
    for topic in recording.topics.values():
        if topic.message_type not in FORCES or not topic.count or topic.name in known:
            continue
        rates, forces = first_samples(recording, topic.name)
        if has_halves(rates, forces) != (False, True):
            continue
        lengths = np.linalg.norm(forces[_are_finite(forces)], axis=1)
        typical = float(np.median(lengths)) / _GRAVITY if lengths.size else 0.0
        if topic.message_type == IMU or _AROUND[0] < typical < _AROUND[1]:
            yield topic.name


def other_half(topic: str, others: Iterable[str]) -> str | None:
    """Return the topic of the forces that belong to a topic of rates: the one with the most of its name."""

    def shared(other: str) -> int:
        return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(topic, other, strict=False)))

    return max(others, key=lambda other: (shared(other), other), default=None)


def judge_imus(examined: Examined) -> Iterable[Finding]:
    """Yield the findings of the samples of each IMU."""
    samples = {
        name: one
        for name, watchers in examined.watched.watchers.items()
        for one in watchers
        if isinstance(one, Samples) and len(one.stamps)
    }
    for name in samples:
        yield from _ImuJudge(examined, name, samples).findings()


class _ImuJudge:
    """Judge of one IMU among all of a recording."""

    def __init__(self, examined: Examined, name: str, samples: Mapping[str, Samples]) -> None:
        self.examined, self.name, self.samples = examined, name, samples
        self.spec = examined.entry.dataset.spec
        self.sensor = self.spec.sensors[name]
        self.where = f"sensors.{name}"
        self.mine = samples[name]
        self.stamps, (self.rates, self.forces) = self.mine.stamps, self.mine.rates_and_forces()
        self.modes = [
            mode for mode in modes_with(name, self.spec.sensors) if Role.IMU in ROLES[SensorMode(mode)]
        ]

    def found(
        self, code: str, severity: Severity, text: str, first: int | None = None, **more: Any
    ) -> Finding:
        at = None if first is None else float(first / 1e9) + self.sensor.time_offset
        return Finding(code, severity, f"{self.where}: {text}", self.name, first=at, **more)

    def findings(self) -> Iterator[Finding]:
        turns, pushes = has_halves(self.rates, self.forces)
        is_ordered = stamp_fault(self.stamps) is None
        units = [*force_findings(self.name, self.forces)]
        if not (turns and pushes):
            yield from self._half(turns=turns, pushes=pushes)
        else:
            yield from self._unreal()
            units += self._rate_scale()
            if is_ordered and not units and len(self.mine.sound()[0]) > 1:
                yield from self._noise()
        yield from units
        if is_ordered:
            yield from self._sparse()

    def _unreal(self) -> Iterator[Finding]:
        wrong = np.flatnonzero(~_are_finite(self.rates, self.forces))
        if not wrong.size:
            return
        is_few = wrong.size < min(len(self.stamps), MOST_DROPPED)
        yield self.found(
            "imu.finite", Severity.ERROR,
            f"message {wrong[0] + 1} of {len(self.stamps)} on {self.sensor.topic} has a rate or force that "
            f"is not a finite number ({wrong.size} in all), and inertial algorithms are lost from there on",
            int(self.stamps[wrong[0]]), count=int(wrong.size),
            repair=sensor_repair(self.name, drop=wrong.tolist()) if is_few else {},
        )  # fmt: skip

    def _half(self, *, turns: bool, pushes: bool) -> Iterator[Finding]:
        topic, repairs = self.sensor.topic, self.spec.repair.sensors if self.spec.repair else {}
        if pushes and any(repair.forces == topic for repair in repairs.values()):
            return  # Another sensor has these forces by its repair.
        rates = [
            name for name, one in self.samples.items() if has_halves(*one.rates_and_forces()) == (True, False)
        ]
        if pushes and rates:
            return  # The finding is that of the rates.
        forces = other_half(topic, self._forces()) if turns else None
        if forces is not None:
            yield self.found(
                "imu.halves", Severity.ERROR if self.modes else Severity.WARNING,
                f"{topic} has turning rates alone, and {forces} forces alone: no inertial algorithm can use "
                "one without the other; joined, the forces are interpolated at the stamps of the rates",
                count=len(self.stamps), repair=sensor_repair(self.name, forces=forces),
            )  # fmt: skip
            return
        what = "turning rate" if pushes else "specific force" if turns else "turning rate and specific force"
        # A device has noise. Samples all alike come of a program that had to fill them in.
        made_up = pushes and not np.ptp(self.forces, axis=0).any()
        is_error = bool(self.modes) and not made_up
        modes = f" ({', '.join(self.modes)})" if self.modes else ""
        yield self.found(
            "imu.zero", Severity.ERROR if is_error else Severity.WARNING,
            f"each {what} of {len(self.stamps)} messages on {topic} is 0 or not a finite number: runs with "
            f"it{modes} fail or come out wrong; choose modes without an IMU, or record the driver's other "
            "topic",
            int(self.stamps[0]), count=len(self.stamps),
        )  # fmt: skip

    def _forces(self) -> Iterator[str]:
        """Yield the topics of forces alone, of other sensors and of none."""
        recording, known = self.examined.recording, {self.spec.sensors[name].topic for name in self.samples}
        for one in self.samples.values():
            if has_halves(*one.rates_and_forces()) == (False, True):
                yield one.of.sensor.topic
        yield from forces_alone(recording, known)

    def _rate_scale(self) -> Iterator[Finding]:
        scale, by = self.mine.scale_of_rates(self.examined.truth)
        if scale == 1.0:
            return
        fast = float(np.percentile(np.linalg.norm(self.mine.sound()[1], axis=1), 95))
        code, looks, harm = "imu.sign", "are of the wrong sign", "turn the other way than"
        if abs(scale) != 1.0:
            code = "imu.units"
            looks = f"look like {'deg/s' if abs(scale) == DEGREE else 'radians taken for degrees'}"
            looks += " of the wrong sign" if scale < 0 else ""
            harm = f"turn {1 / scale:.3g} times as far as"
        yield self.found(
            code, Severity.WARNING,
            f"the turning rates, {fast:.3g} rad/s in one of twenty samples, {looks} by {by}: "
            f"inertial algorithms {harm} the sensor did",
            count=len(self.stamps), value=fast, unit="rad/s",
            repair=sensor_repair(self.name, rateScale=round(scale, 7)),
        )  # fmt: skip

    def _noise(self) -> Iterator[Finding]:
        """Yield the finding of a noise at rest that is far from the stated one."""
        imu = self.sensor.imu
        rest = noise_at_rest(*self.mine.sound(), self.examined.truth) if imu else None
        if rest is None or imu is None:
            return
        for field, what, unit, found in (
            ("gyroscope_noise", "rates", "rad/s/√Hz", rest.rates),
            ("accelerometer_noise", "forces", "m/s²/√Hz", rest.forces),
        ):
            stated = float(getattr(imu, field))
            # Less than a thousandth is none: samples that were made up.
            if not 1e-3 * stated < found or 1 / _OTHER_NOISE <= found / stated <= _OTHER_NOISE:
                continue
            is_more, is_stated = found > stated, field in imu.model_fields_set
            yield self.found(
                "imu.noise", Severity.WARNING if is_more and is_stated else Severity.NOTE,
                f"at rest, {rest.seconds:g} s from {rest.first:.3f} s on, the noise of the {what} is "
                f"{found:.2g} {unit}, {found / stated:.2g} times imu.{to_camel(field)} ({stated:.2g}"
                f"{'' if is_stated else ', the default'}): algorithms with an IMU trust it "
                + ("more than they should" if is_more else "less than they could, which is often wanted"),
                round((rest.first - self.sensor.time_offset) * 1e9), value=found, unit=unit,
            )  # fmt: skip

    def _sparse(self) -> Iterator[Finding]:
        """Yield the finding of frames with no sample since the one before, for modes that need one."""
        frames: dict[str, list[str]] = {}
        for mode in self.modes:
            leader = next((role for role in ROLES[SensorMode(mode)] if role in _FRAMES), None)
            if leader is not None:
                frames.setdefault(sensor_for(leader, self.spec.sensors), []).append(mode)
        mine = np.sort(self.stamps) / 1e9 + self.sensor.time_offset
        for name, modes in frames.items():
            sensor = self.spec.sensors[name]
            scan = self.examined.watched.scans.get(sensor.topic)
            if scan is None:
                continue
            times = np.sort(scan.stamps) / 1e9 + sensor.time_offset
            times = np.unique(times[(times >= mine[0]) & (times <= mine[-1])])
            empty = np.flatnonzero(np.diff(np.searchsorted(mine, times, side="right")) == 0)
            if not empty.size:
                continue
            share = empty.size / (len(times) - 1)
            yield self.found(
                "imu.rate", Severity.WARNING,
                f"{empty.size} of {len(times) - 1} frames of {name} ({share:.2g} of them) have no sample of "
                f"{self.sensor.topic} between them and the frame before: algorithms with an IMU "
                f"({', '.join(modes)}) reset there or fail; "
                + ("use modes without it, or a lower input.frameRate" if share > _OFTEN
                   else "messages were lost in the recording"),
                round((times[empty[0]] - self.sensor.time_offset) * 1e9), count=int(empty.size),
                value=round(share, 6),
            )  # fmt: skip
