# SPDX-License-Identifier: Apache-2.0
"""kitti, drift and repeated as a user calls them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import Options, Trajectory, evaluate, read_kitti, read_tum, rotation, write_tum
from slamhive_eval.command import main
from slamhive_eval.measures.kitti import kitti_errors
from slamhive_eval.measures.relative import sub_trajectory_errors
from slamhive_eval.measures.repeated import summarize

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

Call = "Callable[..., Any]"


@pytest.fixture(name="call")
def call_fixture(capsys: pytest.CaptureFixture[str]) -> Call:
    def call(*words: str) -> Any:
        assert main([*words]) == 0
        text = capsys.readouterr().out
        assert main([*words, "--json"]) == 0
        return text, json.loads(capsys.readouterr().out)

    return call


@pytest.fixture(name="files")
def files_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> list[str]:
    truth = wander(600, seed=5)
    estimates = []
    for k in range(4):
        noise = np.random.default_rng(k).normal(0, 0.01 * (k + 1), (600, 3))
        estimates.append(Trajectory(truth.stamps, truth.positions + noise, truth.quaternions))
    estimates[3] = estimates[3].select(slice(0, 50))
    names = [str(tmp_path / name) for name in ("gt", "a", "b", "c", "lost")]
    for name, trajectory in zip(names, (truth, *estimates), strict=True):
        write_tum(name, trajectory)
    return names


def test_kitti(trajectories: Path, call: Call) -> None:
    names = [str(trajectories / f"KITTI_00_{kind}.txt") for kind in ("gt", "ORB")]
    text, found = call("kitti", *names, "--lengths", "100", "4000", "--step", "100")
    expected = kitti_errors(*map(read_kitti, names), lengths=(100.0, 4000.0), step=100).as_dict()
    assert {name: found[name] for name in expected} == expected
    assert (found["scale"], found["byLength"][1]["count"]) == (1.0, 0)
    assert f"      4000 m       0  {'–':>9}" in text
    assert f"{found['translationPercent']:.4f}" in text
    both, several = call("kitti", names[0], names[1], names[1], "--step", "500", "--scale")
    assert both.count("segments") == len(several["results"]) == 2
    assert several["results"][0]["scale"] != 1.0


def test_drift(files: list[str], call: Call) -> None:
    text, found = call("drift", *files[:2], "--lengths", "2", "4", "--align", "none")
    expected = sub_trajectory_errors(*map(read_tum, files[:2]), (2.0, 4.0))
    assert found["subTrajectories"] == [one.as_dict() for one in expected]
    assert found["smoothness"]["jerk"] > found["referenceSmoothness"]["jerk"]
    assert found["velocity"]["rmse"] == pytest.approx(0.01 * np.sqrt(6) / 0.1, rel=0.1)
    assert found["scaleDrift"]["spread"] < 1.05
    assert "0 gaps" in text
    text, found = call("drift", files[0], files[4])
    assert found["secondsAfterLastPose"] == pytest.approx(55.0)
    assert "last 55.000 s before the end" in text
    _, found = call("drift", *files[:2], "--offset", "-2.0")
    assert (found["poses"], found["secondsAfterLastPose"]) == (580, pytest.approx(2.0))


def test_drift_after_a_yaw_alignment_is_split_as_rpg_does(
    files: list[str], call: Call, tmp_path: Path, wander: Callable[..., Trajectory]
) -> None:
    """rpg splits in the world of the estimate as it was given; tilts tell about which axes that was."""
    truth = wander(600, seed=5)
    angles = np.random.default_rng(1).normal(0, 0.1, (600, 3))
    turned = rotation.multiply(truth.quaternions, rotation.from_roll_pitch_yaw(angles))
    quarter = rotation.to_matrix(rotation.from_roll_pitch_yaw(np.array([[0.0, 0.0, 1.5]])))[0]
    estimate = Trajectory(truth.stamps, truth.positions, turned).transformed(quarter, np.ones(3))
    write_tum(tmp_path / "est", estimate)
    found = {}
    for method in ("none", "yaw", "se3"):
        words = ("drift", files[0], str(tmp_path / "est"), "--lengths", "2", "--align", method)
        found[method] = call(*words)[1]["subTrajectories"][0]
    assert found["yaw"] == found["none"]
    assert found["yaw"]["gravityDeg"]["mean"] != pytest.approx(found["se3"]["gravityDeg"]["mean"], rel=1e-5)
    assert found["yaw"]["rotationDeg"]["mean"] == pytest.approx(found["se3"]["rotationDeg"]["mean"])


def test_repeated(files: list[str], call: Call) -> None:
    text, found = call("repeated", *files, "--thresholds", "0.02", "1")
    truth = read_tum(files[0])
    rmse = [evaluate(truth, read_tum(name), Options(rpe=())).ate.rmse for name in files[1:4]]
    expected = summarize([*rmse, None], (0.02, 1.0)).as_dict()
    assert {name: found[name] for name in expected} == expected
    assert [run["outcome"] for run in found["each"]] == ["Tracked"] * 3 + ["Lost"]
    assert "95 % interval of the geometric mean" in text
    assert "within 1 m: 3 of 4" in text


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["kitti", "{gt}", "{est}", "--lengths", "0"], "positive numbers of metres"),
        (["kitti", "{gt}", "{est}", "--step", "0"], "at least 1 pose, not 0"),
        (["kitti", "{gt}", "{est}", "--offset", "1e6", "--scale"], "no pose of the estimate"),
        (["drift", "{gt}", "{est}", "--offset", "1e6"], "no pose of the estimate"),
        (["drift", "{gt}", "{est}", "--lengths", "-1"], "positive number, not -1"),
        (["repeated", "{gt}", "{est}", "nowhere"], "nowhere: can't be read"),
    ],
)
def test_wrong_input_is_one_sentence(
    files: list[str], capsys: pytest.CaptureFixture[str], words: list[str], says: str
) -> None:
    assert main([word.format(gt=files[0], est=files[1]) for word in words]) == 2
    out, err = capsys.readouterr()
    assert says in err
    assert (out, err.count("\n")) == ("", 1)
