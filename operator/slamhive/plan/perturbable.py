# SPDX-License-Identifier: Apache-2.0
"""Needs of perturbations, of a dataset and of the form an algorithm reads; unmet ones are refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.model.dataset import TruthFormat, sensor_for
from slamhive.model.errors import InputError
from slamhive.model.formats import DataFormat
from slamhive.model.run import DELIVERY
from slamhive.model.sensors import ROLE_TYPES, SensorType

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from slamhive.model.dataset import Dataset
    from slamhive.model.sensors import Role

_UNTURNED = (TruthFormat.RELATIONS, TruthFormat.CONTROL_POINTS)
"""Ground truth that says nothing of how the platform turns all the time."""


def chosen_form(dataset: Dataset, formats: Sequence[DataFormat]) -> DataFormat:
    """Return the form in which an algorithm is given a dataset: as it is recorded, or else the preferred.

    Args:
        dataset: The dataset.
        formats: What the algorithm reads, the preferred first.
    """
    recorded = DataFormat(dataset.spec.recording.format)
    return DataFormat(recorded if recorded in formats else formats[0])


def perturbation_problems(
    options: Mapping[str, Any], dataset: Dataset, roles: Collection[Role], form: DataFormat
) -> Iterator[str]:
    """Yield a sentence for each perturbation that can't be had.

    Args:
        options: ``input`` of a run's spec.
        dataset: The dataset.
        roles: The sensors that the algorithm takes.
        form: In which it is given them.
    """
    perturb = options.get("perturb") or {}
    for block in DELIVERY:
        late = [role for role, value in (perturb.get(block) or {}).items() if value]
        if late and form.is_folder:
            yield (
                f"input.perturb.{block}.{late[0]}: a folder in {form}'s form has no order of delivery; "
                "only bags have, which are played or read message by message"
            )
    if not (perturb.get("images") or {}).get("motionBlur"):
        return
    cameras = [role for role in roles if ROLE_TYPES[role] is SensorType.CAMERA]
    # A generated or fetched recording brings sensors with intrinsics, and ground truth.
    if not cameras or not dataset.spec.recording.files:
        return
    if not turning_sources(dataset):
        yield (
            f"input.perturb.images.motionBlur: nothing says how {dataset.name} turns: it has no IMU, and no "
            "ground truth with orientations; images.blur in pixels needs neither"
        )
    for role in cameras:
        try:
            name = sensor_for(role, dataset.spec.sensors, options.get("remap"))
        except InputError:
            continue  # the check of roles says so
        if dataset.spec.sensors[name].camera is None:
            yield (
                f"input.perturb.images.motionBlur: sensors.{name}.camera isn't stated, whose focal length "
                "makes pixels of a turn; images.blur in pixels needs none"
            )


def turning_sources(dataset: Dataset) -> list[str]:
    """Return the sources that say how a dataset's platform turns: names of IMUs, then ``groundTruth``."""
    spec = dataset.spec
    found = [name for name, sensor in spec.sensors.items() if sensor.type is SensorType.IMU]
    truth = spec.ground_truth
    turns = truth is not None and truth.format not in _UNTURNED
    return [*found, "groundTruth"] if turns else found
