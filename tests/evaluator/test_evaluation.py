# SPDX-License-Identifier: Apache-2.0
"""Coverage, frames and outcome, by cases whose answer is known."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

import slamhive_eval
from slamhive_eval import (
    Options,
    Outcome,
    RpeOptions,
    Trajectory,
    associate,
    evaluate,
    measure_coverage,
    rotation,
)
from slamhive_eval.evaluation import judge
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any


def road(n: int = 101, rate: float = 10.0, speed: float = 1.0) -> Trajectory:
    """A straight path at constant speed."""
    t = np.arange(n) / rate
    return Trajectory(100 + t, np.outer(speed * t, (1.0, 0, 0)), np.tile((0.0, 0, 0, 1), (n, 1)))


def share(reference: Trajectory, estimate: Trajectory, **options: object) -> float:
    return measure_coverage(reference, estimate, associate(reference, estimate), **options).share


@pytest.mark.parametrize(
    ("kept", "keyframes", "expected"),
    [
        (range(101), None, 1.0),
        (range(51), None, 0.5),
        (range(20, 81), None, 0.6),
        ([*range(41), *range(61, 101)], None, 0.79),
        ([*range(41), *range(50, 101)], None, 1.0),
        (range(0, 101, 20), None, 1.0),
        (range(0, 101, 20), False, 0.0),
        (range(0, 101, 20), True, 1.0),
        ([0, 60], True, 0.0),
        ([0, 50], True, 0.5),
        ([3], None, 0.0),
    ],
)
def test_share_of_the_path(kept: Sequence[int], keyframes: bool | None, expected: Any) -> None:
    found = share(road(), road().select(np.array(kept)), keyframes=keyframes)
    assert found == pytest.approx(expected)


def test_half_a_metre_is_covered_however_long_it_takes() -> None:
    slow = road(speed=0.04)
    assert share(slow, slow.select(np.array([0, 1, 2, 100]))) == pytest.approx(1.0)


def test_steps_over_gaps_of_the_ground_truth_do_not_count() -> None:
    holes = road().select(np.array([*range(31), *range(51, 101)]))
    found = measure_coverage(holes, road(), associate(holes, road()))
    assert found.path_length == pytest.approx(7.9)
    assert found.share == pytest.approx(1.0)
    half = road().select(slice(0, 31))
    assert share(holes, half) == pytest.approx(3.0 / 7.9)


def test_the_window_of_the_run() -> None:
    half = road().select(slice(0, 51))
    found = measure_coverage(road(), half, associate(road(), half), window=(102.0, 106.0))
    assert found.path_length == pytest.approx(4.0)
    assert found.share == pytest.approx(0.75)
    assert evaluate(road(), half, Options(window=(100.0, 105.0))).outcome == "Tracked"


def test_coverage_of_time_where_nothing_moves() -> None:
    still = road(speed=0.0)
    assert share(still, still.select(slice(0, 51))) == pytest.approx(0.5)


def test_ground_truth_is_moved_to_the_sensor(wander: Callable[..., Trajectory]) -> None:
    truth = wander(400)
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.4, -0.8, 1.9]])))[0]
    extrinsic[:3, 3] = (0.3, -0.5, 0.2)
    poses = np.tile(np.eye(4), (400, 1, 1))
    poses[:, :3, :3] = rotation.to_matrix(truth.quaternions)
    poses[:, :3, 3] = truth.positions
    sensor = poses @ extrinsic
    world = np.linalg.inv(sensor[0])
    sensor = world @ sensor
    estimate = Trajectory(truth.stamps, 0.2 * sensor[:, :3, 3], rotation.from_matrix(sensor[:, :3, :3]))
    found = evaluate(truth, estimate, Options("sim3", extrinsic, has_scale=False))
    assert found.ate.max < 1e-9
    assert found.ate_rotation_deg.max < 1e-5
    assert found.scale == pytest.approx(5.0)
    assert found.rpe[0].statistics.max < 1e-9
    assert found.outcome == "Tracked"
    assert evaluate(truth, estimate, Options("sim3", has_scale=False)).ate.rmse > 0.01


def test_an_algorithm_may_say_that_it_writes_keyframes(wander: Callable[..., Trajectory]) -> None:
    truth = wander(400)
    sparse = truth.select(np.arange(0, 400, 20))
    assert evaluate(truth, sparse).coverage.share > 0.9
    assert evaluate(truth, sparse, Options(keyframes=False)).outcome == "Lost"


def statistics(rmse: float) -> Statistics:
    return Statistics(rmse, rmse, rmse, 0.0, rmse, rmse, rmse)


@pytest.mark.parametrize(
    ("share", "rmse", "scale", "options", "expected"),
    [
        (0.9, 1.0, 1.0, Options(), Outcome.TRACKED),
        (0.8999, 1.0, 1.0, Options(), Outcome.PARTIAL),
        (0.5, 1.0, 1.0, Options(), Outcome.PARTIAL),
        (0.4999, 1.0, 1.0, Options(), Outcome.LOST),
        (0.1, 1.0, 0.49, Options(), Outcome.DIVERGED),
        (1.0, 1.0, 2.01, Options(), Outcome.DIVERGED),
        (1.0, 1.0, 2.0, Options(), Outcome.TRACKED),
        (1.0, 1.0, 50.0, Options(has_scale=False), Outcome.TRACKED),
        (1.0, 1.0, None, Options(), Outcome.TRACKED),
        (1.0, 10.0, 1.0, Options(), Outcome.TRACKED),
        (0.2, 10.01, 1.0, Options(has_scale=False), Outcome.DIVERGED),
        (0.7, 1.0, 1.0, Options(min_coverage=0.7), Outcome.TRACKED),
        (1.0, 1.0, 1.0, Options(max_ate=0.5), Outcome.PARTIAL),
        (1.0, 0.5, 1.0, Options(max_ate=0.5), Outcome.TRACKED),
    ],
)
def test_outcome(share: float, rmse: float, scale: float, options: Options, expected: Any) -> None:
    coverage = slamhive_eval.Coverage(share, 100.0, 100.0 * share, keyframes=False)
    outcome, message = judge(coverage, statistics(rmse), scale, options)
    assert outcome is expected
    assert bool(message) == (expected is not Outcome.TRACKED)


def test_statistics() -> None:
    found = Statistics.of(np.array((1.0, 2.0, 2.0, 7.0)))
    assert found == Statistics(np.sqrt(58 / 4), 3.0, 2.0, np.sqrt(5.5), 1.0, 7.0, 58.0)
    assert Statistics.of(np.empty(0)) is None
    assert Statistics.of(np.full(3, 1e100)).as_dict()["sse"] == pytest.approx(3e200)
    assert statistics(np.inf).as_dict()["rmse"] is None


def test_names_of_the_result(wander: Callable[..., Trajectory]) -> None:
    found = evaluate(wander(), wander(), Options(rpe=(RpeOptions(1, "s", "consecutive"),))).as_dict()
    assert found.keys() == {
        "outcome", "message", "coverage", "keyframes", "scale", "alignment", "transform", "poses",
        "referencePoses", "estimatePoses", "pathLength", "coveredLength", "ate", "ateRotationDeg", "rpe",
        "notes",
    }  # fmt: skip
    names = {"rmse", "mean", "median", "std", "min", "max", "sse"}
    assert found["ate"].keys() == found["ateRotationDeg"].keys() == names
    (relative,) = found["rpe"]
    assert relative.keys() == names | {
        "delta",
        "unit",
        "pairs",
        "relTolerance",
        "count",
        "ranked",
        "rotationDeg",
    }
    assert (relative["delta"], relative["unit"], relative["pairs"]) == (1.0, "s", "consecutive")
    assert relative["count"] == 19


def test_error_arrays_stay_reachable(wander: Callable[..., Trajectory]) -> None:
    truth, estimate = wander(), wander(seed=1)
    found = evaluate(truth, estimate)
    assert found.poses.errors.shape == found.poses.rotation_errors_deg.shape == (200,)
    np.testing.assert_allclose(
        found.poses.errors,
        np.linalg.norm(found.poses.reference.positions - found.poses.estimate.positions, axis=1),
    )
    assert len(found.rpe[0].errors) == len(found.rpe[0].pairs)


def test_every_exported_name_exists() -> None:
    assert len(slamhive_eval.__all__) == len(set(slamhive_eval.__all__))
    for name in slamhive_eval.__all__:
        assert getattr(slamhive_eval, name).__module__.startswith("slamhive_eval.")
    assert set(slamhive_eval.__all__) == set(slamhive_eval._HOME) <= set(dir(slamhive_eval))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = slamhive_eval.nothing


def test_numpy_alone_is_imported() -> None:
    code = (
        "import sys; import slamhive_eval; assert 'numpy' not in sys.modules\n"
        "from slamhive_eval import *; import slamhive_eval.command, slamhive_eval.subcommands\n"
        "print(*{name.partition('.')[0] for name in sys.modules} - set(sys.stdlib_module_names))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    found = {name for name in out.split() if not name.startswith("_")}
    assert found - {"sitecustomize"} == {"numpy", "slamhive_eval"}  # that one is a distribution's own


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101])
def test_median(n: int) -> None:
    errors = np.random.default_rng(n).random(n)
    assert Statistics.of(errors).median == np.median(errors)
