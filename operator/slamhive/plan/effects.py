# SPDX-License-Identifier: Apache-2.0
"""Effects of input options: which of them change nothing of a recording, and what it has instead.

A frame rate above the recording's own, a length beyond its end or a resolution for a LiDAR would otherwise
be archived and tabulated as if it had been tried. What is known of a recording comes from its Dataset before
it is read, and from its preparation afterwards; what isn't known counts as having an effect.

An option is called as it is written below ``input``: ``frameRate``, ``lidar.rings``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pydantic.alias_generators import to_camel

from slamhive.model.algorithm import Pace
from slamhive.model.base import seconds
from slamhive.model.canonical import normalize
from slamhive.model.dataset import sensor_for
from slamhive.model.errors import InputError
from slamhive.model.run import OF_ROLES, is_random, neutral
from slamhive.model.sensors import FOLLOWS, ROLE_TYPES, SAME_RATE, Role, SensorType
from slamhive.model.synthetic import FIXED_RATES, SyntheticSensor
from slamhive.plan.resolution import sensors_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from slamhive.model.algorithm import Mode
    from slamhive.model.dataset import Dataset
    from slamhive.model.results import Prepared

Options = dict[str, Any]

_LIDAR = ("lidar.minRange", "lidar.maxRange", "lidar.rings")
_CAMERAS = frozenset({SensorType.CAMERA, SensorType.DEPTH_CAMERA})
_PERTURBED = {
    "lidar": (SensorType.LIDAR, "LiDAR"),
    "images": (SensorType.CAMERA, "camera"),
    "imu": (SensorType.IMU, "IMU"),
}
_BY_ROLE = {to_camel(field) for field in OF_ROLES}


@dataclass(frozen=True)
class Recorded:
    """Properties of a recording as one mode reads it, as far as they are known.

    Attributes:
        dataset: name of the Dataset.
        mode: name of the mode.
        types: kinds of sensors that the mode takes.
        source: whose frame rate it is, such as ``hall's lidar``.
        frame_rate: of the fastest sensor that a frame rate thins, Hz; None: not known.
        rings: of the LiDAR; None: not known.
        imu_rate: of the IMU, Hz; None: not known.
        roles: those that the mode takes.
        seconds: its length; None: not known.
    """

    dataset: str
    mode: str
    types: frozenset[SensorType]
    source: str
    frame_rate: float | None = None
    rings: int | None = None
    seconds: float | None = None
    imu_rate: float | None = None
    roles: frozenset[Role] = frozenset()


@dataclass(frozen=True)
class Effect:
    """An option that changes nothing.

    Attributes:
        option: which one.
        asked: its value.
        effective: the value that takes effect; None: as if nothing were asked.
        sentence: what is asked and what the recording has.
    """

    option: str
    asked: Any
    effective: Any
    sentence: str

    @property
    def path(self) -> tuple[str, ...]:
        """Return the option's path in a MappingRun's spec."""
        return ("input", *self.option.split("."))


@dataclass(frozen=True)
class Reading:
    """A recording as a run reads it.

    Attributes:
        options: the run's options.
        seen: what is known of the recording.
    """

    options: Options
    seen: Recorded

    @cached_property
    def idle(self) -> tuple[Effect, ...]:
        """Return the options that change nothing."""
        return tuple(without_effect(self.options, self.seen))


def options_of(given: Mapping[str, Any]) -> Options:
    """Return the ``input`` of a spec by option, those that aren't set left out."""
    result: Options = {}
    for name, value in given.items():
        if isinstance(value, dict):
            result |= {f"{name}.{key}": item for key, item in options_of(value).items()}
        elif value is not None:
            result[name] = value
    return result


def recorded(
    dataset: Dataset, mode: Mode, options: Mapping[str, Any], prepared: Prepared | None = None
) -> Recorded:
    """Return the known facts about a dataset's recording.

    Args:
        dataset: the Dataset.
        mode: the mode that reads it.
        options: the run's options; ``remap.ROLE`` chooses sensors.
        prepared: what its preparation found, once it was read.
    """
    sensors = _sensors(dataset, mode, options)
    rates = {role: _rate(dataset, name) for role, name in sensors.items() if _leads(role, mode)}
    known = [rate for rate in rates.values() if rate is not None]
    rate = max(known) if known and len(known) == len(rates) else None
    declared = dataset.spec.recording
    length = declared.synthetic.total_seconds if declared.synthetic else declared.duration_seconds
    if prepared is not None:
        rate, length = prepared.recorded_frame_rate or rate, prepared.recorded_seconds or length
    fastest = max(rates, key=lambda role: rates[role] or 0.0, default=None)
    return Recorded(
        dataset=dataset.name,
        mode=str(mode.name),
        types=frozenset(ROLE_TYPES[role] for role in mode.needs),
        source=f"{dataset.name}'s {sensors[fastest]}" if fastest else dataset.name,
        frame_rate=rate,
        rings=_rings(dataset, sensors.get(Role.LIDAR)),
        seconds=length,
        imu_rate=_rate(dataset, sensors[Role.IMU]) if Role.IMU in sensors else None,
        roles=frozenset(mode.needs),
    )


def without_effect(options: Mapping[str, Any], seen: Recorded) -> list[Effect]:
    """Return the options that change nothing of a recording.

    A rate within 2 % of the recording's own, or a length that ends with it, is the recording itself: it is no
    mistake, and stays as it is.

    Args:
        options: the run's options.
        seen: what is known of the recording.
    """
    return [
        Effect(option, options[option], effective, f"input.{option}: {text}")
        for option, effective, text in _idle(options, seen)
    ]


def recording_fields(
    given: Mapping[str, Any],
    asked: Mapping[str, Any],
    dataset: Dataset,
    mode: Mode,
    prepared: Prepared | None,
) -> dict[str, Any]:
    """Return the fields of a run's provenance that say what it was given of its recording.

    Args:
        given: ``input`` of its resolved spec.
        asked: options that were asked for in the place of some of these.
        dataset: its Dataset.
        mode: its mode.
        prepared: what its preparation found; None where it never got so far.
    """
    options = options_of(given)
    found = without_effect(options, recorded(dataset, mode, options, prepared))
    effective = {option: options.get(option) for option in asked}
    effective |= {item.option: item.effective for item in found}
    effective = {option: value for option, value in effective.items() if value is not None}
    wanted = {item.option: item.asked for item in found} | dict(asked)
    return {"asked": wanted or None, "effective": effective or None, "prepared": prepared}


def option_problems(given: Mapping[str, Any], dataset: Dataset, mode: Mode) -> list[str]:
    """Return a sentence for each input option of a single run that its recording can't give.

    Args:
        given: ``input`` of its resolved spec.
        dataset: its Dataset.
        mode: its mode.
    """
    options = options_of(given)
    seen = recorded(dataset, mode, options)
    start = start_problem(options, seen)
    return [*([start] if start else []), *(effect.sentence for effect in without_effect(options, seen))]


def start_problem(options: Mapping[str, Any], seen: Recorded) -> str | None:
    """Say that a run would start beyond the recording's end, or return None."""
    start = options.get("start")
    if start is None or seen.seconds is None or seconds(start) < seen.seconds:
        return None
    return f"input.start: {start} is asked, {seen.dataset} lasts {seen.seconds:g} s"


def nominal(rate: float) -> float:
    """Return the whole number of Hz that a measured rate stands for, or the rate itself.

    >>> nominal(29.97), nominal(12.5)
    (30.0, 12.5)
    """
    whole = float(round(rate))
    return whole if rate <= whole * SAME_RATE and whole <= rate * SAME_RATE else rate


def _idle(options: Mapping[str, Any], seen: Recorded) -> Iterator[tuple[str, Any, str]]:
    yield from _frame_rate(options, seen)
    yield from _duration(options, seen)
    if options.get("resolution", 1) != 1 and not seen.types & _CAMERAS:
        yield "resolution", 1, f"{options['resolution']:g} is asked, the mode {seen.mode} has no camera"
    for option in _LIDAR:
        if option in options and SensorType.LIDAR not in seen.types:
            yield option, None, f"{options[option]:g} is asked, the mode {seen.mode} has no LiDAR"
    rings = options.get("lidar.rings")
    if rings is not None and seen.rings is not None and rings > seen.rings:
        yield "lidar.rings", seen.rings, f"{rings} is asked, {seen.dataset}'s LiDAR has {seen.rings}"
    if options.get("rate", 1) != 1 and options.get("pace") == Pace.LOCKSTEP:
        yield "rate", None, f"{options['rate']:g} is asked, the pace Lockstep has no speed of playback"
    yield from _perturbed(options, seen)


def _perturbed(options: Mapping[str, Any], seen: Recorded) -> Iterator[tuple[str, Any, str]]:
    asked = {name.removeprefix("perturb."): name for name in options if name.startswith("perturb.")}
    for short, option in asked.items():
        value, (block, _, field) = options[option], short.partition(".")
        if not field or value == neutral(short):
            continue
        kind, word = _PERTURBED.get(block, (None, ""))
        if kind is not None and kind not in seen.types:
            instead = None if _has_no_neutral(short) else neutral(short)
            yield option, instead, f"{value:g} is asked, the mode {seen.mode} has no {word}"
        elif block in _BY_ROLE and field not in seen.roles:
            yield option, 0, f"{value:g} is asked, the mode {seen.mode} has no {field}"
        elif short == "imu.rate" and seen.imu_rate is not None and value > seen.imu_rate * SAME_RATE:
            text = f"{value:g} Hz is asked, {seen.dataset}'s IMU has {seen.imu_rate:g} Hz"
            yield option, normalize(nominal(seen.imu_rate)), text
    if "seed" in asked and not any(map(is_random, asked)):
        yield (
            "perturb.seed",
            None,
            f"{options['perturb.seed']} is asked, and nothing that is perturbed is random",
        )


def _has_no_neutral(short: str) -> bool:
    """Tell whether only the absence of a perturbation changes nothing."""
    return short in {"images.jpegQuality", "imu.accelerometerRange", "imu.gyroscopeRange", "imu.rate"}


def _frame_rate(options: Mapping[str, Any], seen: Recorded) -> Iterator[tuple[str, Any, str]]:
    asked = options.get("frameRate")
    if asked is not None and not any(kind.has_frames for kind in seen.types):
        text = f"{asked:g} Hz is asked, the mode {seen.mode} has no frames; samples are never thinned"
        yield "frameRate", None, text
    elif asked is not None and seen.frame_rate is not None and asked > seen.frame_rate * SAME_RATE:
        text = f"{asked:g} Hz is asked, {seen.source} has {seen.frame_rate:g} Hz"
        yield "frameRate", normalize(nominal(seen.frame_rate)), text


def _duration(options: Mapping[str, Any], seen: Recorded) -> Iterator[tuple[str, Any, str]]:
    asked, start = options.get("duration"), seconds(options.get("start") or "0s")
    if asked is None or seen.seconds is None or seen.seconds <= start:
        return
    rest = seen.seconds - start
    period = 1.0 / seen.frame_rate if seen.frame_rate else 0.0  # after the last frame, its scan goes on
    if seconds(asked) > rest * SAME_RATE + period:
        after = f", {rest:g} s after input.start" if start else ""
        yield "duration", _written(rest), f"{asked} is asked, {seen.dataset} lasts {seen.seconds:g} s{after}"


def _written(length: float) -> str:
    """Return a duration as manifests have it, rounded up to whole ms."""
    whole, rest = divmod(math.ceil(length * 1000 - 1e-6), 1000)
    return f"{whole}s" + (f"{rest}ms" if rest else "") if whole else f"{rest}ms"


def _sensors(dataset: Dataset, mode: Mode, options: Mapping[str, Any]) -> dict[Role, str]:
    """Return the names of the sensors that fill a mode's roles; none for roles that can't be filled."""
    remap = {key.removeprefix("remap."): options[key] for key in options if key.startswith("remap.")}
    names = sensors_of(dataset)
    result = {}
    for role in mode.needs:
        try:
            result[role] = sensor_for(role, names, remap)
        except InputError:
            continue  # the check of roles says so
    return result


def _leads(role: Role, mode: Mode) -> bool:
    """Tell whether a frame rate thins a role's frames by itself."""
    return ROLE_TYPES[role].has_frames and FOLLOWS.get(role) not in mode.needs


def _rate(dataset: Dataset, name: str) -> float | None:
    declared, synthetic = dataset.spec.sensors.get(name), dataset.spec.recording.synthetic
    if declared is not None and declared.rate is not None:
        return declared.rate
    if synthetic is None:
        return None
    match sensors_of(dataset)[name]:
        case SensorType.LIDAR:
            return synthetic.lidar.rate
        case SensorType.IMU:
            return synthetic.imu.rate
        case SensorType.LASER_SCAN:
            return FIXED_RATES[SyntheticSensor.LASER_SCAN]
        case _:
            return synthetic.camera.rate


def _rings(dataset: Dataset, name: str | None) -> int | None:
    if name is None:
        return None
    declared, synthetic = dataset.spec.sensors.get(name), dataset.spec.recording.synthetic
    if declared is not None:
        return declared.lidar.rings if declared.lidar else None
    return synthetic.lidar.rings if synthetic else None
