# SPDX-License-Identifier: Apache-2.0
"""Preparation of two trajectories, as they were read, for a comparison pose by pose.

In this order: the estimate's clock, the poses that belong together, the frame of the body, the world.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.alignment import METHODS, Alignment, Method, align
from slamhive_eval.association import DEFAULT_GAP_SECONDS, MATCHINGS, Matching, match, pair_up
from slamhive_eval.errors import OptionError
from slamhive_eval.trajectory import Trajectory, check_rigid

if TYPE_CHECKING:
    from slamhive_eval.association import Association
    from slamhive_eval.handeye import HandEye
    from slamhive_eval.robust import Loss
    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.timing import TimeOffset

Clock = Literal["given", "offset", "drift"]
CLOCKS: tuple[Clock, ...] = get_args(Clock)
_LEVER_METRES = 1e-9
_MOST_ROUNDS = 100
_SETTLED = 1e-13


@dataclass(frozen=True, eq=False)
class Preparation:
    """Settings for matching two trajectories and laying one onto the other.

    Attributes:
        matching: ``nearest``, ``unique``, ``forward`` or ``interpolate``; see `slamhive_eval.match`.
        max_difference_seconds: Largest time difference in s of the first three.
        max_gap_seconds: Largest gap in s of the ground truth for the last.
        clock: ``given``, or find the ``offset`` of the estimate's clock, with its ``drift``; see
            `slamhive_eval.find_offset`.
        offset_seconds: Added to the estimate's stamps for matching, where given.
        extrinsic: T_body_sensor, shape (4, 4): the ground truth is moved to the estimate's sensor. None
            leaves it.
        hand_eye: Find that pose instead; see `slamhive_eval.hand_eye`.
        alignment: Method of `slamhive_eval.align`.
        first_poses: Align by so many poses from the start only; None for all.
        robust: ``huber`` or ``trimmed``; see `slamhive_eval.align_robustly`. None for least squares.
        keep: Share of the poses that ``trimmed`` fits.
    """

    matching: Matching = "nearest"
    max_difference_seconds: float = 0.01
    max_gap_seconds: float = DEFAULT_GAP_SECONDS
    clock: Clock = "given"
    offset_seconds: float = 0.0
    extrinsic: FloatArray | None = None
    hand_eye: bool = False
    alignment: Method = "none"
    first_poses: int | None = None
    robust: Loss | None = None
    keep: float = 0.75

    def __post_init__(self) -> None:
        for what, value, known in (
            ("matching", self.matching, MATCHINGS),
            ("clock", self.clock, CLOCKS),
            ("alignment", self.alignment, METHODS),
        ):
            if value not in known:
                raise OptionError(f"unknown {what} {value!r}; known are {', '.join(known)}")
        if self.hand_eye and self.extrinsic is not None:
            raise OptionError("the extrinsic is either given or found, not both")
        if self.clock != "given" and self.offset_seconds:
            raise OptionError("the time offset is either given or found, not both")
        if self.robust is not None and self.first_poses is not None:
            raise OptionError("a robust alignment is by all poses, not by the first ones")

    def pair_up(
        self, reference: Trajectory, estimate: Trajectory
    ) -> tuple[Association, Trajectory, Trajectory]:
        """Return the pairs of a match and the poses of both, as `slamhive_eval.association.pair_up` does."""
        return pair_up(
            reference,
            estimate,
            self.matching,
            max_difference_seconds=self.max_difference_seconds,
            offset_seconds=self.offset_seconds,
            max_gap_seconds=self.max_gap_seconds,
        )


@dataclass(frozen=True, eq=False)
class Prepared:
    """Result of `prepare`: matched and aligned trajectories, with the alignment, clock and extrinsic found.

    Attributes:
        reference: m poses of the ground truth, in the estimate's frame where that was asked.
        estimate: m poses of the estimate, aligned.
        matched: The same poses of the estimate before they were aligned.
        alignment: What laid it there.
        clock: The offset found, None where it was given.
        hand_eye: The extrinsic found, None where it wasn't asked for.
    """

    reference: Trajectory
    estimate: Trajectory
    matched: Trajectory
    alignment: Alignment
    clock: TimeOffset | None = None
    hand_eye: HandEye | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: poses, alignment, notes; clock and handEye where they were found."""
        found: dict[str, Any] = {
            "poses": len(self.reference),
            "alignment": {
                "method": self.alignment.method,
                "transform": self.alignment.transform.tolist(),
                "scale": self.alignment.scale,
            },
            "notes": [*self.estimate.notes, *self.alignment.notes],
        }
        if self.clock is not None:
            found["clock"] = self.clock.as_dict()
        if self.hand_eye is not None:
            found["handEye"] = {
                "extrinsic": self.hand_eye.extrinsic.tolist(),
                "motions": self.hand_eye.motions,
                "rotationRmsDeg": self.hand_eye.rotation_rms_deg,
                "translationRms": self.hand_eye.translation_rms,
            }
        return found


def prepare(reference: Trajectory, estimate: Trajectory, asked: Preparation) -> Prepared:
    """Lay an estimate onto its ground truth.

    Args:
        reference: Ground truth.
        estimate: What is measured.
        asked: How.

    Returns:
        Both, pose k belonging to pose k.

    Raises:
        AssociationError: No poses belong together, or the clock's offset can't be found.
        OptionError: A number out of bounds.
        TrajectoryError: The poses don't determine what was to be found from them.
    """
    estimate, clock = set_clock(reference, estimate, asked)
    reference, estimate = match(
        reference,
        estimate,
        asked.matching,
        max_difference_seconds=asked.max_difference_seconds,
        offset_seconds=asked.offset_seconds,
        max_gap_seconds=asked.max_gap_seconds,
    )
    return lay(reference, estimate, asked, clock)


def set_clock(
    reference: Trajectory, estimate: Trajectory, asked: Preparation
) -> tuple[Trajectory, TimeOffset | None]:
    """The estimate with stamps of the reference's clock, and the offset where it had to be found.

    Raises:
        AssociationError: It can't be found.
    """
    if asked.clock == "given":
        return estimate, None
    from slamhive_eval.timing import find_offset  # noqa: PLC0415 - few ask for it

    clock = find_offset(reference, estimate, drift=asked.clock == "drift")
    return clock.apply(estimate), clock


def lay(
    reference: Trajectory, estimate: Trajectory, asked: Preparation, clock: TimeOffset | None = None
) -> Prepared:
    """Lay poses that belong together, pose k to pose k, into one frame of the body and one world.

    Ground truth is moved by the extrinsic, never the estimate, unless it is of positions alone: a lever arm
    needs an orientation, and the estimate's is the only one there is. Its alignment's notes say so.

    Raises:
        OptionError: A number out of bounds, or a lever arm where neither has orientations.
        TrajectoryError: The poses don't determine what was to be found from them.
    """
    found = None
    if asked.hand_eye:
        from slamhive_eval.handeye import hand_eye  # noqa: PLC0415 - few ask for it

        found = hand_eye(reference, estimate, with_scale=asked.alignment in ("sim3", "scale"))
        reference = reference.moved(found.extrinsic)
    elif asked.extrinsic is not None and not reference.oriented:
        lever = _lever(asked.extrinsic)
        if lever is not None:
            return _laid_by_lever(reference, estimate, lever, asked, clock)
    elif asked.extrinsic is not None:
        reference = reference.moved(asked.extrinsic)
    alignment = _aligned(reference, estimate, asked)
    return Prepared(reference, alignment.apply(estimate), estimate, alignment, clock, found)


def _aligned(reference: Trajectory, estimate: Trajectory, asked: Preparation) -> Alignment:
    if asked.robust is None:
        return align(reference, estimate, asked.alignment, asked.first_poses)
    from slamhive_eval.robust import align_robustly  # noqa: PLC0415 - few ask for it

    return align_robustly(reference, estimate, asked.alignment, asked.robust, asked.keep)


def _lever(extrinsic: FloatArray) -> FloatArray | None:
    """Return the ground truth's origin in the estimate's frame, in m, shape (3,); None where it is 0."""
    matrix = check_rigid(extrinsic)
    lever: FloatArray = -matrix[:3, :3].T @ matrix[:3, 3]
    return lever if np.abs(lever).max() > _LEVER_METRES else None


def _laid_by_lever(
    reference: Trajectory,
    estimate: Trajectory,
    lever: FloatArray,
    asked: Preparation,
    clock: TimeOffset | None,
) -> Prepared:
    """Positions beside an estimate that was moved to their frame by its own orientations.

    A lever arm is in m, an unscaled estimate isn't: the arm is divided by the scale of the alignment, round
    after round until that stays.
    """
    if not estimate.oriented:
        raise OptionError("neither ground truth nor estimate has orientations: no lever arm can be applied")
    turned = rotation.rotate(estimate.quaternions, np.broadcast_to(lever, estimate.positions.shape))
    scale = 1.0
    for _ in range(_MOST_ROUNDS):
        moved = Trajectory(estimate.stamps, estimate.positions + turned / scale, estimate.quaternions)
        alignment = _aligned(reference, moved, asked)
        if not alignment.scale > 0 or abs(alignment.scale - scale) <= _SETTLED * scale:
            break
        scale = alignment.scale
    note = (
        f"the ground truth has positions alone, of a frame {np.linalg.norm(lever):.3g} m away from the "
        "estimate's: the estimate was moved there by its own orientations, whose errors are part of these"
    )
    alignment = replace(alignment, notes=(*alignment.notes, note))
    return Prepared(reference, alignment.apply(moved), moved, alignment, clock)
