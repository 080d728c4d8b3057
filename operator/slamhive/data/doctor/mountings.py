# SPDX-License-Identifier: Apache-2.0
"""Judgement of mountings by turning: rotations of T_body_sensor that contradict how sensors turned."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.doctor.turning import exp_of, log_of
from slamhive.data.doctor.voting import SEEING, TurningSensor, most
from slamhive.model.variant import TRUTH

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.data.doctor.turning import Array, Mask
    from slamhive.model.dataset import DatasetSpec

LEAST_DEGREES = 1.5
"""A good calibration is within a degree, and intrinsics that are a little off look like more."""
_SEEN_DEGREES = 0.3
"""Error of sights of cameras and LiDARs, beyond their noise, where mountings are right."""
_TOLD_DEGREES = 1.0
"""A turn about an axis that is known less well isn't told by the motion."""
_FAR = 3.0
"""Times its error that a turn is told all the same."""
_SIGMAS = 3.0
_NEAR_AXIS = 0.97
_HALF_TURN, _ACROSS = 5.0, 0.5
"""Degrees that half a turn may be off, and the share of its axis along z up to which it turns a body over."""


class _Turn(NamedTuple):
    """Turn of a frame against another: axes of the body by rows, (3, 3), degrees about each, errors, (3,)."""

    axes: Array
    degrees: Array
    errors: Array

    @property
    def told(self) -> Mask:
        """Return a mask of the axes about which the motion tells the turn, shape (3,)."""
        known = (self.errors < _TOLD_DEGREES) | (np.abs(self.degrees) > _FAR * self.errors)
        return np.asarray(known, dtype=np.bool_)

    @property
    def vector(self) -> Array:
        """Return the turn that is told, as a rotation vector in the body, degrees, shape (3,)."""
        return np.asarray((self.degrees * self.told) @ self.axes)

    @property
    def size(self) -> tuple[float, float]:
        """Return the angle of the turn that is told, and its error, degrees."""
        return float(np.linalg.norm(self.vector)), float(np.max(self.errors * self.told))


def pose_in_body(spec: DatasetSpec, name: str) -> Array:
    """Return the stated pose in the body, shape (4, 4), of a sensor, or of the frame of ``groundTruth``."""
    truth, stated = spec.ground_truth, None
    if name == TRUTH and truth is not None:
        stated, name = truth.T_body_frame, truth.frame
    if stated is None and name in spec.sensors:
        stated = spec.sensors[name].T_body_sensor
    return np.eye(4) if stated is None else np.array(stated, dtype=np.float64)


def judge_mountings(streams: Sequence[TurningSensor], spec: DatasetSpec) -> Iterator[Finding]:
    """Yield the streams whose frame is turned against what the manifest states, by how most turned.

    Args:
        streams: The reference, then others with how they fit it.
        spec: Of the dataset.
    """
    reference = streams[0]

    def turn(one: TurningSensor, other: TurningSensor) -> _Turn:
        off = [
            np.eye(3) if stream.fit is None else reference.body @ stream.fit.rotation.T @ stream.body.T
            for stream in (one, other)
        ]
        values, vectors = np.linalg.eigh(
            sum((_covariance(stream) for stream in (one, other)), np.zeros((3, 3)))
        )
        seen = _SEEN_DEGREES * any(stream.kind in SEEING for stream in (one, other))
        errors = np.degrees(_SIGMAS * np.sqrt(np.maximum(values, 0.0))) + seen
        return _Turn(vectors.T, vectors.T @ np.degrees(log_of(off[0] @ off[1].T)), errors)

    def agree(one: TurningSensor, other: TurningSensor) -> bool:
        angle, error = turn(one, other).size
        return angle < max(LEAST_DEGREES, error)

    members, sure = most(streams, agree)
    for stream in streams:
        if stream not in members and not agree(stream, sure):
            yield _finding(stream, sure, turn(stream, sure), spec)
    untold: dict[str, list[str]] = {}
    for stream in streams[1:]:
        found = turn(stream, reference)
        if not found.told.all():
            untold.setdefault(_named(found.axes[~found.told]), []).append(stream.name)
    if untold:
        about = ", and ".join(f"of {' and '.join(names)} {axes}" for axes, names in untold.items())
        yield Finding(
            "frames.rotation",
            Severity.NOTE,
            f"the turn {about} can't be told from this motion, by turning rates against {reference.name}: "
            "the mounting that is stated is taken on trust",
        )


def _covariance(stream: TurningSensor) -> Array:
    if stream.fit is None:
        return np.zeros((3, 3))
    return np.asarray(stream.body @ stream.fit.covariance @ stream.body.T)


def _named(axes: Array) -> str:
    """Return axes of the body in words."""
    if len(axes) == 3:
        return "about any axis"
    across = axes[0] if len(axes) == 1 else np.cross(axes[0], axes[1])
    main = int(np.argmax(np.abs(across)))
    name = "xyz"[main] if abs(across[main]) > _NEAR_AXIS else f"({', '.join(f'{k:.2f}' for k in across)})"
    return f"about {'' if len(axes) == 1 else 'axes across '}{name} of the body"


def _finding(stream: TurningSensor, sure: TurningSensor, turn: _Turn, spec: DatasetSpec) -> Finding:
    angle, error = turn.size
    along = turn.vector / max(angle, 1e-9)
    axis = ", ".join(f"{k:.2f}" for k in along)
    turned = (
        f"{stream.where}: by turning rates against {sure.name} it is turned by {angle:.1f} ± {error:.1f}° "
        f"about ({axis}) of the body from what is stated"
    )
    # Turned over, it would feel gravity from the other side.
    if stream.is_upright and angle > 180.0 - max(_HALF_TURN, error) and abs(along[2]) < _ACROSS:
        return Finding(
            "imu.sign",
            Severity.WARNING,
            f"{turned}, but its forces point up as stated: the turning rates are of the wrong sign, and "
            "inertial algorithms turn the other way than the sensor did",
            sensor=stream.name,
            first=stream.first,
            value=angle,
            unit="deg",
            repair=sensor_repair(stream.name, rateScale=-1.0),
        )
    field, harm = "T_body_sensor", (
        "algorithms that are told it combine what doesn't fit, and drift or diverge, and figures of the "
        "body's pose are off"
    )  # fmt: skip
    if stream.kind == TRUTH:
        field, harm = "T_body_frame", (
            "the ground truth is of another frame than is stated: lever arms and rotation errors of all "
            "algorithms are wrong"
        )  # fmt: skip
    open_axes = turn.axes[~turn.told]
    rest = f" (what it is {_named(open_axes)} can't be told from this motion)" if len(open_axes) else ""
    return Finding(
        "frames.rotation",
        Severity.WARNING,
        f"{turned}{rest}; {harm}; correct {field}",
        sensor=stream.name,
        first=stream.first,
        value=angle,
        unit="deg",
        repair=_repair(stream, field, np.radians(turn.vector), spec),
    )


def _repair(stream: TurningSensor, field: str, vector: Array, spec: DatasetSpec) -> dict[str, Any]:
    """Return the corrected pose of a frame in the body, for the manifest."""
    pose = pose_in_body(spec, TRUTH if stream.kind == TRUTH else stream.name)
    pose[:3, :3] = exp_of(vector) @ pose[:3, :3]
    stated = {field: [[round(float(number), 9) for number in row] for row in pose]}
    return {TRUTH: stated} if stream.kind == TRUTH else {"sensors": {stream.name: stated}}
