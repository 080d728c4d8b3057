# SPDX-License-Identifier: Apache-2.0
"""Tests of the options of ape and rpe: reading, matching, moving and aligning."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import OptionError, Preparation, Trajectory, prepare, read_tum, rotation, write_tum
from slamhive_eval.command import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

EXTRINSIC = np.eye(4)
EXTRINSIC[:3, :3] = rotation.to_matrix(np.array((0.5, -0.5, 0.5, 0.5)))
EXTRINSIC[:3, 3] = (0.3, 0.4, -0.2)


@pytest.fixture(name="truth")
def truth_fixture(wander: Callable[..., Trajectory], tmp_path: Path) -> Trajectory:
    truth = wander(1200, rate=20.0, seed=3)
    write_tum(tmp_path / "gt", truth)
    return truth


def ape(folder: Path, capsys: pytest.CaptureFixture[str], *words: str, command: str = "ape") -> Any:
    assert main([command, str(folder / "gt"), str(folder / "est"), *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    "words", [["--extrinsic", "{folder}/extrinsic"], ["--hand-eye"], ["--hand-eye", "--offset", "auto"]]
)
def test_an_estimate_of_another_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory, words: list[str]
) -> None:
    late = 0.25 if "auto" in words else 0.0
    write_tum(tmp_path / "est", truth.moved(EXTRINSIC).shifted(late))
    (tmp_path / "extrinsic").write_text(json.dumps(EXTRINSIC.tolist()))
    assert ape(tmp_path, capsys, "--align", "se3", "--offset", str(-late))["rmse"] > 0.1
    found = ape(tmp_path, capsys, "--align", "se3", *[word.format(folder=tmp_path) for word in words])
    assert found["rmse"] < 1e-3
    if "--hand-eye" in words:
        np.testing.assert_allclose(found["handEye"]["extrinsic"], EXTRINSIC, atol=2e-3)
    if late:
        assert found["clock"]["offsetSeconds"] == pytest.approx(-late, abs=1e-4)


@pytest.mark.parametrize(
    ("words", "method"),
    [([], "se3"), (["--unscaled"], "sim3"), (["--gravity-aligned"], "yaw")],
)
def test_automatic_alignment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory, words: list[str], method: str
) -> None:
    write_tum(tmp_path / "est", truth)
    assert ape(tmp_path, capsys, "--align", "auto", *words)["alignment"]["method"] == method


def test_matching_and_robust_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory
) -> None:
    positions = truth.positions.copy()
    positions[100:300] += 50
    write_tum(tmp_path / "est", Trajectory(truth.stamps + 0.02, positions, truth.quaternions))
    assert ape(tmp_path, capsys, "--match", "unique", "--max-diff", "0.024")["poses"] == 1200
    assert ape(tmp_path, capsys, "--match", "interpolate", "--max-gap", "0.06")["poses"] == 1199
    found = ape(
        tmp_path, capsys, "--offset", "-0.02", "--align", "se3", "--robust", "trimmed", "--keep", "0.8"
    )
    assert found["median"] < 1e-6
    assert found["notes"] == ["240 of 1200 poses that fit worst were left out of the alignment"]
    found = ape(tmp_path, capsys, "--offset", "-0.02", "--align", "se3", "--robust", "huber", command="rpe")
    assert found["median"] < 1e-6


def test_drift_of_the_clock(tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory) -> None:
    middle = truth.stamps.mean()
    stamps = truth.stamps + 1e-3 * (truth.stamps - middle) - 2.0
    write_tum(tmp_path / "est", Trajectory(stamps, truth.positions, truth.quaternions))
    found = ape(tmp_path, capsys, "--offset", "drift", "--match", "interpolate")
    assert found["rmse"] < 1e-3
    assert found["clock"]["drift"] == pytest.approx(-1e-3, rel=0.02)
    assert main(["ape", *[str(tmp_path / name) for name in ("gt", "est")], "--offset", "drift"]) == 0
    assert "drift -999.0 ppm" in capsys.readouterr().out


def test_several_estimates(tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory) -> None:
    for k in (1, 2):
        moved = truth.transformed(np.eye(3), np.array((k, 0.0, 0.0)))
        write_tum(tmp_path / f"est{k}", moved)
    words = ["ape", *[str(tmp_path / name) for name in ("gt", "est1", "est2")]]
    assert main([*words, "--json"]) == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert [result["mean"] for result in results] == pytest.approx([1.0, 2.0])
    assert [result["estimate"] for result in results] == words[2:]
    assert main(words) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0] == "trans_part [m], alignment none"
    assert table[3].split()[:2] == [words[3], "2.000000"]


def test_formats_and_stamps_of_kitti(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory
) -> None:
    rows = np.concatenate((truth.matrices, truth.positions[:, :, None]), axis=2).reshape(-1, 12)
    np.savetxt(tmp_path / "gt", rows, "%.17g")
    np.savetxt(tmp_path / "times", truth.stamps, "%.9f")
    write_tum(tmp_path / "est", truth.select(np.arange(0, 1200, 2)))
    found = ape(tmp_path, capsys, "--times", str(tmp_path / "times"))
    assert (found["poses"], found["max"]) == (600, pytest.approx(0, abs=1e-9))
    np.savetxt(tmp_path / "est", rows[:700], "%.17g")
    assert ape(tmp_path, capsys, "--by-index")["poses"] == 700
    words = ("--format", "kitti", "--reference-format", "kitti", "--by-index")
    assert ape(tmp_path, capsys, *words)["poses"] == 700


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--offset", "soon"], "'soon' is neither a number of seconds, auto nor drift"),
        (["--extrinsic", "{folder}/gt"], "16 or 12 numbers of a matrix row by row, or 7"),
        (["--extrinsic", "{folder}/zero"], "the quaternion is zero"),
        (["--extrinsic", "{folder}/odd"], "upper left 3×3 part is no rotation"),
        (["--extrinsic", "x", "--hand-eye"], "not allowed with argument"),
        (["--robust", "huber"], "the alignment none fits no positions"),
        (["--robust", "huber", "--n-to-align", "3", "--align", "se3"], "by all poses, not by the first"),
        (["--format", "kitti"], "found 8 of 12 values"),
        (["--topic", "/odom"], "is no recording; only those have topics such as '/odom'"),
    ],
)
def test_wrong_options_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory, words: list[str], says: str
) -> None:
    write_tum(tmp_path / "est", truth)
    (tmp_path / "zero").write_text("1 2 3 0 0 0 0")
    (tmp_path / "odd").write_text("2 0 0 1 0 2 0 1 0 0 2 1")
    words = [word.format(folder=tmp_path) for word in words]
    try:
        code = main(["ape", str(tmp_path / "gt"), str(tmp_path / "est"), *words])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert says in err


def test_seven_numbers_of_an_extrinsic(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory
) -> None:
    write_tum(tmp_path / "est", truth.moved(EXTRINSIC))
    (tmp_path / "extrinsic").write_text("0.3 0.4 -0.2  1 -1 1 1\n")
    assert ape(tmp_path, capsys, "--extrinsic", str(tmp_path / "extrinsic"))["max"] < 1e-9


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"matching": "best"}, "unknown matching 'best'"),
        ({"alignment": "auto"}, "unknown alignment 'auto'"),
        ({"clock": "mine"}, "unknown clock 'mine'; known are given, offset, drift"),
        ({"clock": "offset", "offset_seconds": 1.0}, "either given or found"),
        ({"hand_eye": True, "extrinsic": np.eye(4)}, "either given or found"),
    ],
)
def test_preparations_that_make_no_sense(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        Preparation(**arguments)


def test_prepared(tmp_path: Path, truth: Trajectory) -> None:
    found = prepare(truth, read_tum(tmp_path / "gt"), Preparation(alignment="sim3", hand_eye=True))
    assert json.loads(json.dumps(found.as_dict()))["handEye"]["motions"] > 10


@pytest.mark.parametrize(("poses", "ranked"), [(30, False), (31, True)])
def test_few_pairs_are_not_ranked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory, poses: int, ranked: bool
) -> None:
    write_tum(tmp_path / "est", truth.select(slice(0, poses)))
    found = ape(tmp_path, capsys, command="rpe")
    assert (found["pairs"], found["ranked"]) == (poses - 1, ranked)
    assert bool(found["notes"]) == (not ranked)
