# SPDX-License-Identifier: Apache-2.0
"""Ground truth without orientations (a laser tracker, GNSS): what is measured and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import (
    OptionError,
    Options,
    Trajectory,
    ape_errors,
    evaluate,
    find_pairs,
    rotation,
    rpe_errors,
)
from slamhive_eval.measures.relative import sub_trajectory_errors
from slamhive_eval.reports.report import report_data

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive_eval.alignment import Method


@pytest.fixture(name="bare")
def bare_fixture(wander: Callable[..., Trajectory]) -> Trajectory:
    truth = wander()
    return Trajectory(truth.stamps, truth.positions, np.tile((0.0, 0, 0, 1), (200, 1)), oriented=False)


def test_positions_are_compared_and_the_rest_left_out(
    wander: Callable[..., Trajectory], bare: Trajectory
) -> None:
    found = evaluate(bare, wander())
    assert found.ate.rmse == pytest.approx(0.0, abs=1e-9)
    assert (found.ate_rotation_deg, found.rpe, found.outcome) == (None, (), "Tracked")
    assert found.as_dict()["notes"] == [
        "there are no orientations: rotation errors and relative errors were left out"
    ]
    data = report_data(bare, {"a": found}, title="", reference_name="")
    assert list(data["kinds"]) == list(data["estimates"][0]["errors"]) == ["position"]


@pytest.mark.parametrize("relation", ["rot_part", "full", "angle_deg", "angle_rad"])
def test_errors_that_need_orientations_are_refused(
    wander: Callable[..., Trajectory], bare: Trajectory, relation: str
) -> None:
    pairs = find_pairs(bare, 1, "frames", all_pairs=True)
    with pytest.raises(
        OptionError, match=f"ground truth has no orientations, which this error of {relation}"
    ):
        ape_errors(bare, wander(), relation)
    for asked in (relation, "trans_part"):
        with pytest.raises(OptionError, match="estimate has no orientations"):
            rpe_errors(wander(), bare, pairs, asked)
    assert rpe_errors(bare, wander(), pairs, "point_distance").max() < 1e-9


def test_lever_arms_and_sub_trajectories_need_them(
    wander: Callable[..., Trajectory], bare: Trajectory
) -> None:
    lever = np.eye(4)
    lever[0, 3] = 0.1
    with pytest.raises(OptionError, match="no lever arm can be applied"):
        evaluate(bare, bare, Options(extrinsic=lever))
    assert evaluate(bare, wander(), Options(extrinsic=np.eye(4))).ate.rmse < 1e-9
    with pytest.raises(OptionError, match="need orientations"):
        sub_trajectory_errors(bare, wander(), (1.0,))


@pytest.mark.parametrize(("alignment", "scale"), [("se3", 1.0), ("sim3", 1.0), ("sim3", 7.5), ("none", 1.0)])
def test_a_prism_is_reached_by_the_orientations_of_the_estimate(
    wander: Callable[..., Trajectory], alignment: Method, scale: float
) -> None:
    """A tracker sees a prism on the body; the estimate is that of a camera, perhaps without scale."""
    body, prism, camera = wander(), np.eye(4), np.eye(4)
    prism[:3, 3] = -0.294, -0.012, -0.273
    camera[:3, :3], camera[:3, 3] = rotation.to_matrix(np.array([0.5, -0.5, 0.5, -0.5])), (0.1, 0.3, -0.2)
    seen = body.moved(prism)
    truth = Trajectory(seen.stamps, seen.positions, np.tile((0.0, 0, 0, 1), (200, 1)), oriented=False)
    estimate = body.moved(camera)
    estimate = Trajectory(estimate.stamps, estimate.positions / scale, estimate.quaternions)
    options = Options(alignment=alignment, extrinsic=np.linalg.inv(prism) @ camera, has_scale=scale == 1)
    found = evaluate(truth, estimate, options)
    assert found.ate.rmse < 1e-9
    assert found.alignment.scale == pytest.approx(scale, rel=1e-9)
    assert any("moved there by its own orientations" in note for note in found.notes)
    without = evaluate(truth, estimate, replace(options, extrinsic=None))
    assert without.ate.rmse > 0.01
