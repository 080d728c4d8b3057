# SPDX-License-Identifier: Apache-2.0
"""A system's own confidence against its losses: leads, false warnings, AUC and NEES known exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import (
    Confidence,
    HealthRule,
    Preparation,
    Trajectory,
    TrajectoryError,
    evaluate_health,
    read_trajectory,
    read_tum,
)
from slamhive_eval.statistics import chi_square_quantile

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive_eval.rotation import FloatArray

SE3 = Preparation(alignment="se3")
OK, DEGRADED, LOST, SILENT = 0, 1, 2, -1


def straight(seconds: float = 60.0, speed: float = 0.8) -> Trajectory:
    """Along x at 10 Hz from time 0."""
    stamps = np.arange(round(seconds * 10) + 1) / 10
    positions = np.column_stack((speed * stamps, 0 * stamps, 0 * stamps))
    return Trajectory(stamps, positions, np.tile((0.0, 0.0, 0.0, 1.0), (len(stamps), 1)))


def frozen(truth: Trajectory, *times: tuple[float, float]) -> Trajectory:
    """The same, standing still from one time to another: it is short of what was travelled ever after."""
    steps = np.diff(truth.positions, axis=0, prepend=truth.positions[:1])
    for begin, end in times:
        steps[(truth.stamps > begin + 1e-9) & (truth.stamps <= end + 1e-9)] = 0.0
    return Trajectory(truth.stamps, np.cumsum(steps, axis=0), truth.quaternions)


def said(truth: Trajectory, *times: tuple[float, float, int], usual: int = OK) -> Confidence:
    """Flags at each pose: the given ones from a time until before another."""
    flags = np.full(len(truth), usual, dtype=np.int8)
    for begin, end, flag in times:
        flags[(truth.stamps >= begin - 1e-9) & (truth.stamps < end - 1e-9)] = flag
    return Confidence(truth.stamps, np.full(len(truth), np.nan), flags)


# What stood for three steps of a window is off by 0.24 m of 0.8 m: so is the time up to such a pose.
BEGIN, END = 30.2, 40.7


def test_a_loss_with_its_lead(wander: Callable[..., Trajectory]) -> None:
    truth = straight()
    found = evaluate_health(truth, frozen(truth, (30, 40)), SE3, said=said(truth, (27.1, 35, DEGRADED)))
    (loss,) = found["healthLosses"]
    assert loss["begin"] == pytest.approx(BEGIN)
    assert loss["end"] == pytest.approx(END)
    health = found["health"]
    assert health["warning"]["lead"] == pytest.approx(BEGIN - 27.1)
    assert health["warning"]["seconds"] == pytest.approx(35 - 27.1)
    assert (health["losses"], health["warning"]["losses"], health["missed"]["losses"]) == (1, 1, 0)
    assert health["lostSeconds"] == pytest.approx(END - BEGIN)
    assert health["false"]["share"] == 0  # all of it is within ten seconds before, or in it
    assert health["missed"]["share"] == pytest.approx((END - 35) / (END - BEGIN))
    assert health["seconds"] == pytest.approx(59.1)  # the first window has no error to look back by
    assert (health["auc"], health["values"]) == (None, 0)


def test_crying_wolf_and_missing_the_wolf() -> None:
    truth = straight()
    wolves = said(truth, (10, 14, LOST), (18, BEGIN - 6, DEGRADED), (50, 52, LOST))
    health = evaluate_health(truth, frozen(truth, (30, 40)), SE3, said=wolves)["health"]
    warned = 4 + BEGIN - 6 - 18 + 2
    assert health["warning"]["seconds"] == pytest.approx(warned)
    # 20.1 to 24.1 s is within ten seconds before the loss.
    assert health["false"]["share"] == pytest.approx((warned - 4) / warned)
    assert health["missed"] == {"share": pytest.approx(1.0), "losses": 1}
    assert health["warning"]["lead"] is None


def test_a_late_warning_has_a_lead_below_zero() -> None:
    truth = straight()
    estimate = frozen(truth, (20, 25), (40, 45))
    health = evaluate_health(truth, estimate, SE3, said=said(truth, (22.1, 24, LOST), (39.1, 41, LOST)))
    assert [loss["lead"] for loss in health["healthLosses"]] == pytest.approx([-1.9, 1.1])
    assert health["health"]["warning"]["lead"] == pytest.approx(-0.4)
    assert health["health"]["warning"]["leadMin"] == pytest.approx(-1.9)


def test_a_warning_that_never_ends_is_no_lead_of_the_second_loss() -> None:
    truth = straight()
    found = evaluate_health(truth, frozen(truth, (20, 25), (40, 45)), SE3, said=said(truth, usual=LOST))
    assert found["healthLosses"][1]["lead"] == pytest.approx(40.2 - 25.7)


def test_who_was_never_lost_has_no_lead() -> None:
    truth = straight()
    health = evaluate_health(truth, truth, SE3, said=said(truth, (10, 20, DEGRADED)))["health"]
    assert (health["losses"], health["lostSeconds"], health["warning"]["lead"]) == (0, 0.0, None)
    assert health["false"]["share"] == 1.0
    assert health["missed"] == {"share": None, "losses": 0}
    silent = evaluate_health(truth, truth, SE3, said=said(truth))["health"]
    assert (silent["warning"]["seconds"], silent["false"]["share"]) == (0.0, None)


def test_a_jump_is_no_loss_and_drift_is_none() -> None:
    truth = straight()
    jumped, drifted = truth.positions.copy(), truth.positions * 1.05
    jumped[300:] += (0.0, 5.0, 0.0)
    for positions in (jumped, drifted):
        estimate = Trajectory(truth.stamps, positions, truth.quaternions)
        assert evaluate_health(truth, estimate, SE3, said=said(truth))["healthLosses"] == []


def test_an_estimate_that_ends_or_pauses_is_lost_there() -> None:
    truth = straight()
    kept = np.flatnonzero((truth.stamps < 20) | ((truth.stamps > 24.95) & (truth.stamps < 50)))
    found = evaluate_health(truth, truth.select(kept), SE3, said=said(truth, (49, 60, LOST)))
    times = [(loss["begin"], loss["end"], loss["lead"]) for loss in found["healthLosses"]]
    assert times == [pytest.approx((19.9, 25.0, None)), pytest.approx((49.9, 60.0, 0.9))]


def test_what_was_said_holds_for_a_second() -> None:
    truth = straight()
    once = Confidence(np.array([5.0, 28.6]), np.full(2, np.nan), np.array([LOST, LOST], dtype=np.int8))
    health = evaluate_health(truth, frozen(truth, (30, 40)), SE3, said=once)["health"]
    assert health["warning"]["seconds"] == pytest.approx(2.0)
    assert health["warning"]["lead"] is None  # it was over when the loss came
    assert health["false"]["share"] == pytest.approx(0.5)


@pytest.mark.parametrize(("good", "bad", "auc"), [(1.0, 0.0, 1.0), (0.0, 1.0, 0.0), (3.0, 3.0, 0.5)])
def test_auc_of_values(good: float, bad: float, auc: float) -> None:
    truth = straight()
    off = (truth.stamps > BEGIN + 0.05) & (truth.stamps < END + 0.05)
    values = np.where(off, bad, good)
    values[:5] = np.nan
    nothing = Confidence(truth.stamps, values, np.full(len(truth), SILENT, dtype=np.int8))
    health = evaluate_health(truth, frozen(truth, (30, 40)), SE3, said=nothing)["health"]
    assert health["auc"] == pytest.approx(auc)
    assert health["values"] == 591
    assert not {"warning", "false", "missed"} & set(health)


def test_auc_is_the_share_of_pairs_in_order() -> None:
    truth, rng = straight(), np.random.default_rng(3)
    values = rng.integers(0, 20, len(truth)).astype(float)
    health = evaluate_health(
        truth,
        frozen(truth, (30, 40)),
        SE3,
        said=Confidence(truth.stamps, values, np.full(len(truth), SILENT, dtype=np.int8)),
    )["health"]
    off = (truth.stamps > BEGIN + 0.05) & (truth.stamps < END + 0.05)
    bad, good = values[off][:, np.newaxis], values[~off & (truth.stamps > 0.95)]
    assert health["auc"] == pytest.approx(np.mean((bad < good) + 0.5 * (bad == good)))


def test_scale_is_not_moved_by_a_loss(wander: Callable[..., Trajectory]) -> None:
    truth = straight()
    small = frozen(truth, (30, 40)).transformed(np.eye(3), np.zeros(3), 0.2)
    found = evaluate_health(truth, small, Preparation(alignment="sim3"), said=said(truth))
    assert [loss["begin"] for loss in found["healthLosses"]] == pytest.approx([BEGIN])


@pytest.mark.parametrize("size", [3, 6])
def test_nees_of_drawn_errors(wander: Callable[..., Trajectory], size: int) -> None:
    truth, rng = wander(4000, rate=20.0), np.random.default_rng(6)
    root = rng.normal(0, 0.02, (size, size)) + 0.05 * np.eye(size)
    covariance = root @ root.T
    drawn = rng.normal(0, 1, (len(truth), size)) @ root.T
    estimate = disturbed(truth, drawn)
    given = truth.stamps[::2], np.broadcast_to(covariance, (2000, size, size)).copy()
    nees = evaluate_health(truth, estimate, Preparation(), covariances=given)["health"]["nees"]
    assert set(nees) == ({"position"} if size == 3 else {"position", "rotation"})
    for found in nees.values():
        assert (found["count"], found["withoutCovariance"]) == (2000, 2000)
        assert found["low"] < found["mean"] < found["high"]
        assert found["within95"] == pytest.approx(0.95, abs=0.015)
    sure = given[0], given[1] / 4
    overconfident = evaluate_health(truth, estimate, Preparation(), covariances=sure)["health"]["nees"]
    assert overconfident["position"]["mean"] > 3 * overconfident["position"]["high"]


def disturbed(truth: Trajectory, drawn: FloatArray) -> Trajectory:
    """The truth with errors of positions, and rotation vectors in the world where there are six."""
    from slamhive_eval import rotation

    quaternions = truth.quaternions
    if drawn.shape[1] == 6:
        angle = np.linalg.norm(drawn[:, 3:], axis=1)[:, np.newaxis]
        off = np.hstack((drawn[:, 3:] / angle * np.sin(angle / 2), np.cos(angle / 2)))
        quaternions = rotation.multiply(off, quaternions)
    return Trajectory(truth.stamps, truth.positions + drawn[:, :3], quaternions)


def test_chi_square() -> None:
    tables = {(0.025, 30): 16.791, (0.975, 30): 46.979, (0.975, 6): 14.449, (0.025, 100): 74.222}
    for (share, degrees), value in tables.items():
        assert chi_square_quantile(share, degrees) == pytest.approx(value, rel=1e-3)


def test_no_orientations(wander: Callable[..., Trajectory]) -> None:
    truth = wander()
    bare = Trajectory(truth.stamps, truth.positions, truth.quaternions, oriented=False)
    with pytest.raises(TrajectoryError, match="without orientations"):
        evaluate_health(bare, truth, SE3, said=said(truth))


@pytest.mark.parametrize(("number", "losses", "least"), [("052", 0, 0.0), ("063", 1, 60.0)])
def test_real_runs_are_lost_where_they_have_no_poses(
    icra2023: Path, number: str, losses: int, least: float
) -> None:
    """ORB-SLAM2 and 3, whose poses are a camera's beside ground truth of another frame of the body."""
    (folder,) = (icra2023 / "runs").glob(f"*{number}")
    config = (folder / "config.yaml").read_text()
    (name,) = (one for one in (icra2023 / "groundtruth").iterdir() if one.stem in config)
    estimate = read_tum(folder / "traj.txt")
    how = Preparation(alignment="sim3", max_difference_seconds=0.02)
    health = evaluate_health(read_trajectory(name), estimate, how, said=said(estimate))["health"]
    assert health["losses"] == losses
    assert health["lostSeconds"] >= least


def test_the_horizon_is_what_makes_an_early_warning_true() -> None:
    truth = straight()
    estimate, early = frozen(truth, (30, 40)), said(truth, (BEGIN - 8, BEGIN, LOST))
    shares = [
        evaluate_health(truth, estimate, SE3, said=early, rule=HealthRule(horizon=seconds))["health"]["false"]
        for seconds in (0.0, 2.0, 10.0)
    ]
    assert [one["share"] for one in shares] == pytest.approx([1.0, 0.75, 0.0])
