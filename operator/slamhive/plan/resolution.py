# SPDX-License-Identifier: Apache-2.0
"""Resolution of a run against its Algorithm and Dataset: fills in defaults and finds what doesn't fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from slamhive.model.base import explain
from slamhive.model.canonical import normalize
from slamhive.model.catalogue import find_sequence
from slamhive.model.errors import InputError, UnknownNameError, suggestion
from slamhive.model.run import NO_PROGRAM, MappingRunSpec
from slamhive.model.sensors import ROLE_TYPES, STAND_INS, SensorType
from slamhive.model.synthetic import SyntheticSensor
from slamhive.plan.perturbable import chosen_form, perturbation_problems

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from slamhive.model.algorithm import Algorithm, Mode
    from slamhive.model.dataset import Dataset

_SYNTHETIC_SENSORS: dict[SyntheticSensor, dict[str, SensorType]] = {
    SyntheticSensor.LIDAR: {"lidar": SensorType.LIDAR},
    SyntheticSensor.IMU: {"imu": SensorType.IMU},
    SyntheticSensor.STEREO: {"left": SensorType.CAMERA, "right": SensorType.CAMERA},
    SyntheticSensor.RGBD: {"color": SensorType.CAMERA, "depth": SensorType.DEPTH_CAMERA},
    SyntheticSensor.LASER_SCAN: {"scan": SensorType.LASER_SCAN},
    SyntheticSensor.ODOMETRY: {"odometry": SensorType.ODOMETRY},
    SyntheticSensor.GNSS: {"gnss": SensorType.GNSS},
    SyntheticSensor.MAGNETOMETER: {"magnetometer": SensorType.MAGNETOMETER},
    SyntheticSensor.BAROMETER: {"barometer": SensorType.BAROMETER},
}
_FIELDS = [field.alias or name for name, field in MappingRunSpec.model_fields.items()]


def resolve(
    spec: Mapping[str, Any], algorithm: Algorithm | None, dataset: Dataset | None, *, where: str = "spec"
) -> dict[str, Any]:
    """Return a MappingRun's spec with the defaults of the CRD and of the Algorithm filled in.

    Args:
        spec: as it stands in a manifest or came from a server.
        algorithm: the one it names; None leaves the Algorithm's defaults out.
        dataset: the one it names; None leaves the check of its sensors out.
        where: the field that holds it, for sentences about mistakes.

    Returns:
        Plain JSON values with normalised numbers, fields in the order of the model.

    Raises:
        InputError: one sentence a line for each mistake.
    """
    try:
        body = MappingRunSpec.model_validate(dict(spec)).as_json()
    except ValidationError as error:
        lines = [
            f"{where}.{'.'.join(map(str, item['loc']))}: {explain(item)}, found {item['input']!r}"
            for item in error.errors()
        ]
        raise InputError("\n".join(lines)) from None
    complete(body, algorithm)
    problems = list(run_problems(body, algorithm, dataset))
    if problems:
        raise InputError("\n".join(f"{where}.{problem}" for problem in problems))
    return order(normalize(body))


def complete(spec: dict[str, Any], algorithm: Algorithm | None) -> None:
    """Fill an Algorithm's defaults into a spec in place; what doesn't fit is left as it is."""
    if not spec["input"].get("lidar"):
        spec["input"].pop("lidar", None)
    perturb = {key: item for key, item in (spec["input"].pop("perturb", None) or {}).items() if item != {}}
    if perturb:
        spec["input"]["perturb"] = perturb
    if algorithm is None:
        return
    modes = algorithm.spec.modes
    if spec.get("sensors") is None and len(modes) == 1:
        spec["sensors"] = str(modes[0].name)
    spec["input"].setdefault("pace", str(algorithm.spec.paces[0]))
    defaults = {name: item.default for name, item in sorted(algorithm.spec.parameters.items())}
    spec["parameters"] = defaults | spec["parameters"]


def order(spec: dict[str, Any]) -> dict[str, Any]:
    """Return a spec with its fields in the order of the model."""
    return {key: spec[key] for key in _FIELDS if key in spec}


def run_problems(
    spec: Mapping[str, Any], algorithm: Algorithm | None, dataset: Dataset | None
) -> Iterator[str]:
    """Yield a sentence for each thing in a spec that its Algorithm or Dataset doesn't allow.

    Each begins with the field below the spec, such as ``parameters.maxRange``.
    """
    options = spec["input"]
    if algorithm is not None:
        for name, value in spec["parameters"].items():
            yield from parameter_problem(algorithm, name, value)
        yield from pace_problem(algorithm, options.get("pace"))
    mode, problem = mode_of(algorithm, spec.get("sensors"))
    if problem:
        yield problem
    if mode is not None and dataset is not None:
        yield from role_problems(mode, dataset, options.get("remap", {}), options.get("preparedBy"))
        if algorithm is not None and options.get("perturb"):
            form = chosen_form(dataset, algorithm.spec.formats(mode))
            yield from perturbation_problems(options, dataset, mode.needs, form)
    if dataset is not None:
        yield from program_problem(dataset, options.get("preparedBy"))
    lidar = options.get("lidar") or {}
    if lidar.get("minRange", 0) >= lidar.get("maxRange", float("inf")):
        yield "input.lidar: minRange must be below maxRange"


def parameter_problem(algorithm: Algorithm, name: str, value: Any) -> Iterator[str]:
    """Yield the faults of a parameter's value."""
    declared = algorithm.spec.parameters.get(name)
    if declared is None:
        hint = suggestion(name, algorithm.spec.parameters)
        yield f"parameters.{name}: {algorithm.name} has no parameter {name!r}{hint}"
        return
    problem = declared.problem(value)
    if problem:
        yield f"parameters.{name}: {problem}"


def pace_problem(algorithm: Algorithm, pace: str | None) -> Iterator[str]:
    """Yield the faults of a pace."""
    paces = [str(item) for item in algorithm.spec.paces]
    if pace is not None and pace not in paces:
        yield f"input.pace: {algorithm.name} does not run in {pace}, allowed: {', '.join(paces)}"


def mode_of(algorithm: Algorithm | None, name: str | None) -> tuple[Mode | None, str | None]:
    """Return the mode of an algorithm by name, or the only one, and what is wrong if there is none."""
    if algorithm is None:
        return None, None
    modes = {str(mode.name): mode for mode in algorithm.spec.modes}
    if name is None:
        if len(modes) == 1:
            return next(iter(modes.values())), None
        return None, f"sensors: {algorithm.name} has several modes, name one of {', '.join(modes)}"
    if name in modes:
        return modes[name], None
    return None, f"sensors: {algorithm.name} does not support {name}, allowed: {', '.join(modes)}"


def program_problem(dataset: Dataset, name: str | None) -> Iterator[str]:
    """Yield a sentence on a program that a dataset doesn't have."""
    if name is None or name == NO_PROGRAM or name in (dataset.spec.preparations or {}):
        return
    known = [*(dataset.spec.preparations or ()), NO_PROGRAM]
    yield f"input.preparedBy: {dataset.name} has no preparation {name!r}{suggestion(name, known)}"


def role_problems(
    mode: Mode, dataset: Dataset, remap: Mapping[str, str], program: str | None = None
) -> Iterator[str]:
    """Yield the roles of a mode that a dataset has no sensor for.

    Args:
        mode: the mode.
        dataset: the dataset.
        remap: the run's choice of sensors for roles.
        program: the program that prepares its recording, which may give some of them.
    """
    try:
        sensors = sensors_of(dataset)
    except InputError as error:
        yield str(error)
        return
    if not sensors and dataset.spec.recording.synthetic is not None:
        return
    has = ", ".join(sorted(sensors)) or "no sensor"
    for role in dataset.spec.recorded_roles(mode.needs, program):
        asked = remap.get(role)
        if asked is not None and asked not in sensors:
            yield f"input.remap.{role}: {UnknownNameError('sensor', asked, sensors)}"
            continue
        candidates = [asked] if asked else [str(name) for name in STAND_INS.get(role, (role,))]
        name = next((name for name in candidates if name in sensors), None)
        if name is None:
            yield (
                f"sensors: {mode.name} needs a sensor for the role {str(role)!r}, and {dataset.name} has "
                f"none; it has: {has} (input.remap.{role} may name another)"
            )
        elif sensors[name] is not ROLE_TYPES[role]:
            field = f"input.remap.{role}" if asked else "sensors"
            yield (
                f"{field}: the role {str(role)!r} takes a {ROLE_TYPES[role]}, and {name!r} of "
                f"{dataset.name} is a {sensors[name]}"
            )


def sensors_of(dataset: Dataset) -> dict[str, SensorType]:
    """Return the kinds of a dataset's sensors by name; none where its generator isn't known.

    Raises:
        InputError: The catalogue has no such sequence.
    """
    declared = {name: sensor.type for name, sensor in dataset.spec.sensors.items()}
    if dataset.spec.is_to_fetch:
        return find_sequence(str(dataset.spec.catalogue)).family.sensors | declared
    if declared:
        return declared
    synthetic = dataset.spec.recording.synthetic
    result: dict[str, SensorType] = {}
    for sensor in synthetic.sensors if synthetic else ():
        result |= _SYNTHETIC_SENSORS[sensor]
    return result
