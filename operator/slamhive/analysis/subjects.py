# SPDX-License-Identifier: Apache-2.0
"""The evaluator's inputs for one run: sensor mode, extrinsics, keyframes, time window.

They come from its Algorithm and its prepared recording.

The workstation and the operator derive it here, so that a trajectory has the same errors on both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

import numpy as np

from slamhive.analysis.measuring import Subject
from slamhive.model.algorithm import Poses
from slamhive.model.base import Model
from slamhive.model.dataset import sensor_for
from slamhive.model.errors import InputError
from slamhive.model.sensors import Extrinsics, Role, SensorMode

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.model.sensors import Matrix4


@dataclass(frozen=True)
class Surroundings:
    """Sensor poses, ground truth frame and time window of a run, on which its evaluation depends.

    Attributes:
        truth_frame: T_body_frame, pose in the body of the frame whose poses the ground truth has, (4, 4).
        by_role: T_body_sensor of the sensors of the prepared recording, (4, 4) each.
        by_name: T_body_sensor of all sensors of the dataset, (4, 4) each.
        remap: the run's choice of sensors for roles.
        gravity_aligned: whether the z axis of the ground truth points up.
        window: first and last sensor time of the prepared recording, s.
    """

    truth_frame: npt.ArrayLike
    by_role: Mapping[Role, Matrix4]
    by_name: Mapping[str, Matrix4] = field(default_factory=dict)
    remap: Mapping[str, str] | None = None
    gravity_aligned: bool = False
    window: tuple[float, float] | None = None


def subject_of(algorithm: AlgorithmSpec, mode: SensorMode, given: Surroundings) -> Subject:
    """Build the evaluator's inputs for a run: sensor mode, extrinsics, keyframes, time window.

    Args:
        algorithm: the run's Algorithm.
        mode: its sensor mode.
        given: what it was given.

    Raises:
        InputError: the algorithm has no such mode, or no sensor fills the role whose poses it writes.
    """
    output = algorithm.output_of(algorithm.mode(mode))
    frame = np.eye(4) if output.frame == "body" else np.array(pose_of_role(Role(output.frame), given))
    return Subject(
        mode=mode,
        extrinsic=np.linalg.inv(np.asarray(given.truth_frame, dtype=np.float64)) @ frame,
        gravity_aligned=output.gravity_aligned and given.gravity_aligned,
        keyframes=output.poses is Poses.KEYFRAMES,
        window=given.window,
    )


def pose_of_role(role: Role, given: Surroundings) -> Matrix4:
    """Return T_body_sensor of the sensor that fills a role.

    Raises:
        InputError: none does.
    """
    if role in given.by_role:
        return given.by_role[role]
    return given.by_name[sensor_for(role, given.by_name, given.remap)]


class SubjectItem(Model):
    """A subject as plain JSON values, as the request of an evaluation Job has it."""

    mode: SensorMode
    extrinsic: Extrinsics | None = None
    gravity_aligned: bool = False
    keyframes: bool | None = None
    window: tuple[float, float] | None = None

    @classmethod
    def of(cls, subject: Subject, **more: object) -> Self:
        """Return the item of a subject; ``more`` are the fields of a subclass.

        Raises:
            InputError: a number in it is not finite.
        """
        extrinsic = None if subject.extrinsic is None else np.asarray(subject.extrinsic).tolist()
        if not np.isfinite(np.array([*(subject.window or ()), *np.ravel(extrinsic or 0.0)])).all():
            raise InputError("the window or the extrinsics of the run hold a number that is not finite")
        return cls.model_validate(
            {
                "mode": subject.mode,
                "extrinsic": extrinsic,
                "gravity_aligned": subject.gravity_aligned,
                "keyframes": subject.keyframes,
                "window": subject.window,
                **more,
            }
        )

    def subject(self) -> Subject:
        """Return the subject."""
        return Subject(
            mode=self.mode,
            extrinsic=None if self.extrinsic is None else np.array(self.extrinsic, dtype=np.float64),
            gravity_aligned=self.gravity_aligned,
            keyframes=self.keyframes,
            window=self.window,
        )
