# SPDX-License-Identifier: Apache-2.0
"""slamhive-eval traj: described, cut, moved, matched, aligned, written."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import OptionError, Trajectory, read_trajectory, rotation, write_trajectory, write_tum
from slamhive_eval.command import main
from slamhive_eval.measures.description import describe

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MOTION = np.eye(4)
MOTION[:3, :3] = rotation.to_matrix(np.array((0.5, -0.5, 0.5, 0.5)))
MOTION[:3, 3] = (1.0, 2.0, 3.0)


@pytest.fixture(name="truth")
def truth_fixture(wander: Callable[..., Trajectory], tmp_path: Path) -> Trajectory:
    truth = wander(200)
    write_tum(tmp_path / "in.tum", truth)
    np.savetxt(tmp_path / "motion", MOTION)
    return truth


def traj(folder: Path, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[Any, Trajectory | None]:
    words = tuple(word.format(folder=folder) for word in words)
    assert main(["traj", str(folder / "in.tum"), *words, "--json"]) == 0
    out = folder / "out.tum"
    return json.loads(capsys.readouterr().out), read_trajectory(out) if out.exists() else None


def poses(trajectory: Trajectory) -> Any:
    made = np.tile(np.eye(4), (len(trajectory), 1, 1))
    made[:, :3, :3], made[:, :3, 3] = trajectory.matrices, trajectory.positions
    return made


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], lambda p: p),
        (["--transform", "{folder}/motion"], lambda p: MOTION @ p),
        (["--transform-right", "{folder}/motion"], lambda p: p @ MOTION),
        (["--transform", "{folder}/motion", "--invert"], lambda p: np.linalg.inv(MOTION) @ p),
        (["--transform-right", "{folder}/motion", "--invert"], lambda p: p @ np.linalg.inv(MOTION)),
        (["--every", "3"], lambda p: p[::3]),
        (["--start", "1600000001", "--end", "1600000001.95"], lambda p: p[10:20]),
    ],
)
def test_moved_and_cut(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    truth: Trajectory,
    words: list[str],
    expected: Callable[[Any], Any],
) -> None:
    found, written = traj(tmp_path, capsys, *words, "--output", "{folder}/out.tum")
    np.testing.assert_allclose(poses(written), expected(poses(truth)), atol=1e-12)
    assert found["poses"] == len(written)


def test_scaled(tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory) -> None:
    found, _ = traj(tmp_path, capsys, "--scale", "2.5")
    assert found["pathLength"] == pytest.approx(2.5 * truth.path_length)


def test_matched_and_aligned(tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory) -> None:
    half = truth.select(slice(50, 150)).transformed(MOTION[:3, :3], MOTION[:3, 3], 3.0).shifted(0.5)
    write_tum(tmp_path / "gt", half)
    words = [
        "--reference",
        "{folder}/gt",
        "--align",
        "sim3",
        "--offset",
        "0.5",
        "--output",
        "{folder}/out.tum",
    ]
    _, whole = traj(tmp_path, capsys, *words)
    assert len(whole) == 200
    np.testing.assert_array_equal(whole.stamps, truth.stamps + 0.5)
    np.testing.assert_allclose(whole.positions[50:150], half.positions, atol=1e-9)
    _, synced = traj(tmp_path, capsys, *words, "--sync")
    np.testing.assert_allclose(synced.positions, half.positions, atol=1e-9)


@pytest.mark.parametrize(
    ("ending", "kind"), [("tum", "tum"), ("csv", "csv"), ("kitti", "kitti"), ("x", "euroc")]
)
def test_formats(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory, ending: str, kind: str
) -> None:
    words = ["--output-format", "euroc"] if kind == "euroc" else []
    out = tmp_path / f"converted.{ending}"
    traj(tmp_path, capsys, "--output", str(out), *words)
    again = read_trajectory(out)
    np.testing.assert_array_equal(again.positions, truth.positions)
    np.testing.assert_allclose(again.matrices, truth.matrices, atol=1e-15)
    if kind == "kitti":
        assert again.stamps.tolist() == list(range(200))
    else:
        np.testing.assert_allclose(again.stamps, truth.stamps, rtol=0, atol=3e-7 if kind == "euroc" else 0)


def test_matrices_of_a_kitti_file_stay_as_they_are(tmp_path: Path, trajectories: Path) -> None:
    found = read_trajectory(trajectories / "KITTI_00_gt.txt")
    write_trajectory(tmp_path / "again", found, "kitti")
    np.testing.assert_array_equal(read_trajectory(tmp_path / "again").rotations, found.rotations)


def test_nanoseconds_are_exact(tmp_path: Path) -> None:
    one = Trajectory(np.array([1403636580.838555648, 1403636580.9]), np.zeros((2, 3)), np.ones((2, 4)))
    write_trajectory(tmp_path / "data.csv", one, "euroc")
    lines = (tmp_path / "data.csv").read_text().splitlines()
    assert lines[0].startswith("#timestamp [ns], p_RS_R_x [m]")
    assert lines[1].split(",")[0] == str(int(1403636580.838555648 * 2**30) * 10**9 // 2**30)


def test_bare_positions(tmp_path: Path) -> None:
    one = Trajectory(np.arange(3.0), np.eye(3), np.tile((0, 0, 0, 1.0), (3, 1)), oriented=False)
    write_trajectory(tmp_path / "out", one, "csv")
    assert not read_trajectory(tmp_path / "out").oriented
    with pytest.raises(OptionError, match="tum needs orientations"):
        write_tum(tmp_path / "out", one)
    with pytest.raises(OptionError, match="unknown format 'ply'"):
        write_trajectory(tmp_path / "out", one, "ply")
    assert describe(one)["turned"] is None


def test_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stamps = np.array([0, 0.1, 0.2, 0.2, 2.2, 2.3])
    x = np.array([0, 1, 2, 2, 3, 5.0])
    yaw = np.column_stack((np.zeros((6, 2)), np.linspace(0, np.pi / 2, 6)))
    quaternions = rotation.from_roll_pitch_yaw(yaw)
    made = Trajectory(stamps, np.column_stack((x, 0 * x, -x)), quaternions)
    write_tum(tmp_path / "in.tum", made)
    found, _ = traj(tmp_path, capsys)
    assert found == {
        "file": str(tmp_path / "in.tum"),
        "notes": [],
        "poses": 6,
        "start": 0.0,
        "end": 2.3,
        "duration": 2.3,
        "pathLength": pytest.approx(5 * np.sqrt(2)),
        "extent": [5, 0, 5],
        "medianStep": pytest.approx(0.1),
        "longestStep": 2.0,
        "gaps": 1,
        "equalStamps": 1,
        "meanSpeed": pytest.approx(5 * np.sqrt(2) / 2.3),
        "maxSpeed": pytest.approx(20 * np.sqrt(2)),
        "turned": pytest.approx(90),
        "keyframes": False,
        "oriented": True,
    }
    assert main(["traj", str(tmp_path / "in.tum"), str(tmp_path / "in.tum")]) == 0
    table = capsys.readouterr().out
    assert table.count("1 longer than 5 steps, 1 equal stamps") == 2
    lone = describe(made.select(slice(1)))
    assert (lone["medianStep"], lone["meanSpeed"], lone["gaps"], lone["turned"]) == (None, None, 0, 0.0)


def test_several_into_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory) -> None:
    (tmp_path / "out").mkdir()
    write_tum(tmp_path / "second.txt", truth)
    words = [str(tmp_path / name) for name in ("in.tum", "second.txt")]
    assert main(["traj", *words, "--output", str(tmp_path / "out"), "--output-format", "kitti"]) == 0
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["in.kitti", "second.kitti"]


@pytest.mark.parametrize(
    "words", [[], pytest.param(["--reference", "{folder}/in.tum", "--align", "se3"], marks=pytest.mark.slow)]
)
def test_a_plot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory, words: list[str]
) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is an extra")
    (tmp_path / "bare.csv").write_text("time,x,y\n1600000000,0,0\n1600000000,1,0\n1600000009,2,0\n")
    files = (
        [str(tmp_path / "in.tum"), str(tmp_path / "bare.csv")] if not words else [str(tmp_path / "in.tum")]
    )
    for ending in ("png", "svg"):
        out = tmp_path / f"plot.{ending}"
        plot = [*(word.format(folder=tmp_path) for word in words), "--plot", str(out)]
        assert main(["traj", *files, *plot]) == 0
        assert out.stat().st_size > 5000
    svg = out.read_text()
    assert all(f"<!-- {word} -->" in svg for word in ("in", "heading [deg]", "x [m]"))
    assert ("<!-- ground truth -->" in svg) == bool(words)
    assert main(["traj", *files, "--plot", str(tmp_path / "plot.bmp")]) == 2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--align", "se3"], "matching and aligning need ground truth: --reference"),
        (["--output", "{folder}/x.bag"], "name a format by --output-format, or by the ending: .csv, .kitti"),
        (["--output", "{folder}/none/x.tum"], "none/x.tum: can't be written: No such file"),
        (["{folder}/in.tum", "--output", "{folder}/x.tum"], "several trajectories need a folder that exists"),
        (["{folder}/in.tum", "--output", "{folder}"], "the files would have the same names"),
        (["--output-format", "tum"], "--output-format needs --output"),
        (["--every", "0"], "--every must be at least 1, not 0"),
        (
            ["--start", "5", "--end", "1"],
            "no pose lies within --start and --end; the poses are from 1600000000.0",
        ),
        (["--scale", "0"], "the scale must be a positive number, not 0"),
        (["--transform", "{folder}/in.tum"], "16 or 12 numbers"),
    ],
)
def test_wrong_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: Trajectory, words: list[str], says: str
) -> None:
    assert main(["traj", str(tmp_path / "in.tum"), *(word.format(folder=tmp_path) for word in words)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert says in err
