# SPDX-License-Identifier: Apache-2.0
"""Scores of challenges: the published rules, point by point and over all sequences."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import ControlPoints, kitti_errors, read_kitti, write_tum
from slamhive_eval.command import main
from slamhive_eval.measures.challenges import POINT_RULES, score_points

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive_eval import Trajectory


@pytest.mark.parametrize(
    ("challenge", "errors", "scores"),
    [
        # README of hilti-slam-challenge-2023: <0.5 cm 20, <1 10, <3 6, <6 5, <10 3, <40 1
        (
            "hilti2023",
            [0, 0.0049, 0.005, 0.0099, 0.01, 0.029, 0.03, 0.059, 0.06, 0.099, 0.1, 0.39, 0.4, 9],
            [20, 20, 10, 10, 6, 6, 5, 5, 3, 3, 1, 1, 0, 0],
        ),
        # evaluation-2022/batch_evaluation.py of hilti-slam-challenge-2022: <1 cm 10, <3 6, <6 3, <10 1
        (
            "hilti2022",
            [0, 0.0099, 0.01, 0.029, 0.03, 0.059, 0.06, 0.099, 0.1, 9],
            [10, 10, 6, 6, 3, 3, 1, 1, 0, 0],
        ),
        # lamaria/utils/metrics.py: linear between (0.05, 20), (0.2, 18), (0.5, 15), (1, 12), (2, 8) …
        (
            "lamaria",
            [0, 0.05, 0.125, 0.5, 0.75, 1.5, 2, 5, 7.5, 10, 100],
            [20, 20, 19, 15, 13.5, 10, 8, 4, 2, 0, 0],
        ),
    ],
)
def test_published_rules(challenge: str, errors: list[float], scores: list[float]) -> None:
    assert POINT_RULES[challenge].scores_of(np.array(errors)) == pytest.approx(scores)


def test_points_that_are_missed_score_nothing(wander: Callable[..., Trajectory]) -> None:
    truth = wander(n=600)
    points = ControlPoints(truth.stamps[25::50], truth.positions[25::50])
    whole = score_points(POINT_RULES["hilti2023"], points, truth)
    assert (whole["score"], whole["sum"], whole["largest"]) == (100, 240, 240)
    half = score_points(POINT_RULES["hilti2023"], points, truth.select(slice(300)))
    assert (half["score"], half["met"]) == (50, 6)
    none = score_points(POINT_RULES["lamaria"], points, truth.shifted(1e4))
    assert (none["score"], none["recall"]) == (0, {"1m": 0, "5m": 0})
    assert "control points lie between" in none["message"]


def test_heights_do_not_count_for_lamaria(wander: Callable[..., Trajectory]) -> None:
    truth = wander(n=600)
    up = np.where(np.arange(120) % 2, 1.5, -1.5)[:, np.newaxis] * (0, 0, 1)
    points = ControlPoints(truth.stamps[::5], truth.positions[::5] + up)
    rule = POINT_RULES["lamaria"]
    assert score_points(rule, points, truth)["recall"] == {"1m": 1, "5m": 1}
    assert score_points(replace(rule, horizontal=False), points, truth)["recall"] == {"1m": 0, "5m": 1}


def told(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    assert main([str(word) for word in (*words, "--json")]) == 0
    return json.loads(capsys.readouterr().out)


def test_kitti_is_the_mean_over_the_segments_of_all_sequences(
    capsys: pytest.CaptureFixture[str], trajectories: Path, tmp_path: Path
) -> None:
    for folder in ("gt", "est"):
        (tmp_path / folder).mkdir()
    truth, estimate = trajectories / "KITTI_00_gt.txt", trajectories / "KITTI_00_ORB.txt"
    shutil.copyfile(truth, tmp_path / "gt" / "00.txt")
    shutil.copyfile(estimate, tmp_path / "est" / "00.txt")
    for source, folder in ((truth, "gt"), (estimate, "est")):
        text = "".join(source.read_text().splitlines(keepends=True)[:1500])
        (tmp_path / folder / "01.txt").write_text(text)
    # One sequence without an estimate isn't scored; 13 columns are read as well.
    shutil.copyfile(truth, tmp_path / "gt" / "02.txt")
    lines = (tmp_path / "est" / "00.txt").read_text().splitlines()
    (tmp_path / "est" / "00.txt").write_text("".join(f"{k} {line}\n" for k, line in enumerate(lines)))
    found = told(capsys, "score", "kitti", tmp_path / "gt", tmp_path / "est")
    wanted = kitti_errors(read_kitti(truth), read_kitti(estimate)).overall
    first, second = found["sequences"]["00"], found["sequences"]["01"]
    assert first["translationPercent"] == pytest.approx(wanted.translation_percent, rel=1e-12)
    assert first["rotationDegPer100m"] == pytest.approx(100 * wanted.rotation_deg_per_m, rel=1e-12)
    total = sum(one["segments"] * one["translationPercent"] for one in (first, second))
    assert found["segments"] == first["segments"] + second["segments"]
    assert found["translationPercent"] == pytest.approx(total / found["segments"])
    assert main(["score", "kitti", str(tmp_path / "gt"), str(tmp_path / "est")]) == 0
    assert "all" in capsys.readouterr().out


def test_hilti_over_folders_and_with_a_lever_arm(
    capsys: pytest.CaptureFixture[str], wander: Callable[..., Trajectory], tmp_path: Path
) -> None:
    lidar = np.eye(4)
    lidar[:3, 3] = 0.1, -0.2, 0.05
    for folder in ("gt", "est"):
        (tmp_path / folder).mkdir()
    for k in (1, 2):
        imu = wander(n=600, seed=k)
        seen = imu.moved(lidar)
        rows = zip(seen.stamps[::50].tolist(), seen.positions[::50].tolist(), strict=True)
        text = "".join(f"{t!r} {x!r} {y!r} {z!r} 0 0 0 1\n" for t, (x, y, z) in rows)
        (tmp_path / "gt" / f"site{k}_handheld_1.txt").write_text(text)
        write_tum(tmp_path / "est" / f"site{k}_handheld_1.txt", imu)
    (tmp_path / "T").write_text(" ".join(map(str, np.linalg.inv(lidar).ravel().tolist())))
    words = ("score", "hilti2023", tmp_path / "gt", tmp_path / "est")
    found = told(capsys, *words, "--extrinsic", tmp_path / "T")
    assert (found["score"], found["meanScore"]) == (200, 100)
    assert told(capsys, *words)["meanScore"] < 100
    (tmp_path / "gt" / "site2_handheld_1.txt").unlink()
    assert main([str(word) for word in words]) == 2
    assert "no ground truth for site2_handheld_1" in capsys.readouterr().err


def rows(path: Path, stamps: Any, positions: Any) -> None:
    """Write control points as Hilti publishes them, with a filler for the orientation."""
    lines = zip(stamps.tolist(), positions.tolist(), strict=True)
    path.write_text("# t x y z\n" + "".join(f"{t!r} {x!r} {y!r} {z!r} 0 0 0 1\n" for t, (x, y, z) in lines))


def test_hilti_takes_the_nearest_pose_at_the_tip_of_the_pole(
    capsys: pytest.CaptureFixture[str], wander: Callable[..., Trajectory], tmp_path: Path
) -> None:
    truth = wander(n=600)
    tip = np.eye(4)
    tip[:3, 3] = 0.059, -0.00855, 0.1964
    between = truth.stamps[20:580:40] + 0.3 * np.diff(truth.stamps[:2])
    seen = truth.moved(tip)
    positions = np.column_stack([np.interp(between, seen.stamps, seen.positions[:, k]) for k in range(3)])
    rows(tmp_path / "gt.txt", between, positions)
    write_tum(tmp_path / "est.txt", truth)
    found = told(capsys, "score", "hilti2022", tmp_path / "gt.txt", tmp_path / "est.txt")["sequences"]["est"]
    near = seen.positions[np.abs(seen.stamps[:, None] - between).argmin(axis=0)]
    # Kabsch 1976, by hand.
    left, right = near - near.mean(axis=0), positions - positions.mean(axis=0)
    u, _, vt = np.linalg.svd(right.T @ left)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    errors = np.linalg.norm(left @ turn.T - right, axis=1)
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-9)
    assert errors.max() > 0.001
    assert found["sum"] == np.select([errors < at for at in (0.01, 0.03, 0.06, 0.1)], [10, 6, 3, 1]).sum()


def test_sequences_that_count_twice_or_not(
    capsys: pytest.CaptureFixture[str], wander: Callable[..., Trajectory], tmp_path: Path
) -> None:
    truth = wander(n=600)
    names = {"hilti2023": ("site1_handheld_1", "site3_handheld_2"), "hilti2022": ("exp07_long_corridor",)}
    names["hilti2022"] += ("exp04_construction_upper_level",)
    for challenge, sequences in names.items():
        for folder in ("gt", "est"):
            (tmp_path / challenge / folder).mkdir(parents=True)
        for name in sequences:
            rows(tmp_path / challenge / "gt" / f"{name}.txt", truth.stamps[::50], truth.positions[::50])
            write_tum(tmp_path / challenge / "est" / f"{name}.txt", truth)
    (tmp_path / "I").write_text("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1")
    for challenge, total in (("hilti2023", 300), ("hilti2022", 100)):
        words = ("score", challenge, tmp_path / challenge / "gt", tmp_path / challenge / "est")
        found = told(capsys, *words, "--extrinsic", tmp_path / "I")
        assert (found["score"], found["meanScore"]) == (total, 100)
        assert main([str(word) for word in (*words, "--extrinsic", tmp_path / "I")]) == 0
        assert ("counts twice" if total == 300 else "not counted") in capsys.readouterr().out


def test_points_of_the_imu_need_no_lever_arm(
    capsys: pytest.CaptureFixture[str], wander: Callable[..., Trajectory], tmp_path: Path
) -> None:
    truth = wander(n=600)
    rows(tmp_path / "exp14_imu.txt", truth.stamps[::50], truth.positions[::50])
    rows(tmp_path / "exp14.txt", truth.stamps[::50], truth.positions[::50])
    write_tum(tmp_path / "est.txt", truth)
    best, worse = (
        told(capsys, "score", "hilti2022", tmp_path / name, tmp_path / "est.txt")["score"]
        for name in ("exp14_imu.txt", "exp14.txt")
    )
    assert best == 100 > worse


def test_too_few_poses_near_points(
    capsys: pytest.CaptureFixture[str], wander: Callable[..., Trajectory], tmp_path: Path
) -> None:
    truth = wander(n=600)
    rows(tmp_path / "gt.txt", truth.stamps[::50] + 1e4, truth.positions[::50])
    write_tum(tmp_path / "est.txt", truth)
    found = told(capsys, "score", "hilti2023", tmp_path / "gt.txt", tmp_path / "est.txt")["sequences"]["est"]
    assert found["score"] == 0
    assert found["message"] == "0 of 12 control points have a pose within 2 s; an error needs at least 3"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("kity", "a", "b"), "did you mean 'kitti'"),
        (("kitti", "a", "b"), "a: can't be read"),
    ],
)
def test_what_can_not_be_scored(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    assert main(["score", *words]) == 2
    assert message in capsys.readouterr().err
