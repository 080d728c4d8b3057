# SPDX-License-Identifier: Apache-2.0
"""Tests of support: gaps, common support, segments."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import AssociationError, OptionError, Options, RpeOptions, Trajectory, evaluate
from slamhive_eval.measures.support import (
    common_support,
    evaluate_segments,
    find_support,
    segment_numbers,
    within,
)

if TYPE_CHECKING:
    from collections.abc import Callable


def test_planted_gaps_are_found(wander: Callable[..., Trajectory]) -> None:
    truth = wander(start=0.0)
    found = find_support(truth, truth.select(np.r_[20:60, 90:120, 125:180]))
    assert found.seconds_to_first_pose == pytest.approx(2.0)
    assert found.seconds_after_last_pose == pytest.approx(2.0)
    (gap,) = found.gaps  # 0.6 s between 119 and 125 is none
    assert (gap.begin, gap.end, gap.seconds) == pytest.approx((5.9, 9.0, 3.1))
    assert gap.metres == pytest.approx(truth.distances[90] - truth.distances[59])
    assert json.loads(json.dumps(found.as_dict()))["gaps"][0]["metres"] == gap.metres
    assert len(find_support(truth, truth.select(np.r_[0:60, 90:200]), longest_step_seconds=5).gaps) == 0
    early = find_support(truth.select(slice(50, 100)), truth, window=(6.0, 7.0))
    assert (early.seconds_to_first_pose, early.seconds_after_last_pose) == (0, 0)
    with pytest.raises(OptionError, match="positive number of seconds, not 0"):
        find_support(truth, truth, longest_step_seconds=0)


def test_common_support(wander: Callable[..., Trajectory]) -> None:
    truth = wander(start=0.0)
    shifted = Trajectory(truth.stamps + 0.04, truth.positions, truth.quaternions)
    one, two = truth.select(np.r_[10:60, 90:200]), shifted.select(np.r_[0:120, 150:180])
    spans = common_support((one, two))
    np.testing.assert_allclose(spans, ((1.0, 5.9), (9.0, 11.94), (15.04, 17.94)))
    np.testing.assert_array_equal(within(one, spans).stamps, truth.stamps[np.r_[10:60, 90:120, 151:180]])
    assert evaluate(truth, within(one, spans)).matched == 109
    with pytest.raises(AssociationError, match="no time at which all 2"):
        common_support((truth.select(slice(0, 10)), truth.select(slice(20, 30))))
    with pytest.raises(AssociationError, match="no pose inside"):
        within(truth.select(slice(0, 5)), spans)
    with pytest.raises(OptionError, match="at least one"):
        common_support(())


@pytest.mark.parametrize("extrinsic", [None, np.eye(4)])
def test_the_longest_segment_is_aligned_and_the_others_reported(
    wander: Callable[..., Trajectory], extrinsic: np.ndarray | None
) -> None:
    truth = wander(300, seed=4)
    restart = truth.stamps[100]
    # After the restart the world begins anew, 5 m aside.
    positions = truth.positions + np.where(truth.stamps >= restart, 5.0, 0.0)[:, np.newaxis]
    estimate = Trajectory(truth.stamps, positions, truth.quaternions)
    numbers = segment_numbers(estimate, [restart])
    np.testing.assert_array_equal(np.bincount(numbers), (100, 200))
    found = evaluate_segments(truth, estimate, numbers, Options(extrinsic=extrinsic))
    assert evaluate(truth, estimate).ate.rmse > 0.5
    assert found.main.name == 1
    assert found.main.alone.ate.rmse == pytest.approx(0.0, abs=1e-9)
    (other,) = found.others
    assert other.alone.ate.rmse == pytest.approx(0.0, abs=1e-9)
    assert other.in_main_frame.rmse == pytest.approx(5.0 * np.sqrt(3.0))
    told = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert told["outcome"] == found.main.alone.outcome
    assert told["mainSegment"] == 1
    assert [segment["poses"] for segment in told["segments"]] == [100, 200]
    assert told["coverage"] == pytest.approx(
        (truth.path_length - truth.distances[100]) / truth.path_length, abs=1e-6
    )


def test_segments_without_ground_truth(wander: Callable[..., Trajectory]) -> None:
    truth = wander(start=0.0)
    later = wander(start=100.0)
    both = Trajectory(
        np.r_[truth.stamps, later.stamps],
        np.vstack((truth.positions, later.positions)),
        np.vstack((truth.quaternions, later.quaternions)),
    )
    found = evaluate_segments(truth, both, np.repeat((0, 1), 200))
    assert found.main.name == 0
    assert (found.others[0].metres, found.others[0].in_main_frame) == (0.0, None)
    assert found.others[0].as_dict()["ate"] is None
    with pytest.raises(OptionError, match="400 poses need as many segment numbers"):
        evaluate_segments(truth, both, np.zeros(3, dtype=int))


def test_few_pairs_are_not_ranked(wander: Callable[..., Trajectory]) -> None:
    truth = wander()
    for poses, ranked in ((40, True), (39, False)):
        asked = Options(rpe=(RpeOptions(10, "frames"),))
        (found,) = evaluate(truth, truth.select(slice(0, poses)), asked).rpe
        assert found.as_dict()["ranked"] is found.ranked is ranked
