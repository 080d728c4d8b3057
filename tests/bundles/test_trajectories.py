# SPDX-License-Identifier: Apache-2.0
"""Trajectories of somebody else: any format gives the same figures, and none is taken for an own run's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.archive import Archive
from slamhive.local.home.folder import Home
from slamhive_eval import Trajectory, read_tum, write_tum
from slamhive_eval.formats.writing import write_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    Command = Callable[..., tuple[int, str, str]]

SOURCE = "https://example.org/results"
MINE = ("--dataset", "tiny", "--algorithm", "my-slam", "--sensors", "lidar", "--source", SOURCE)
PAPER = Path(__file__).parents[3] / "shared" / "data" / "icra2023"


def runs_of(home: Path) -> list[Any]:
    with Archive.open(Home.at(home).archive_url, read_only=True) as archive:
        return list(archive.runs())


@pytest.fixture
def estimate(tiny: Path) -> Trajectory:
    """The ground truth, its positions off by some centimetres."""
    truth = read_tum(next(tiny.glob("tiny-*/groundtruth.txt")))
    wave = 0.05 * np.sin(np.arange(len(truth)))[:, np.newaxis]
    return Trajectory(truth.stamps, truth.positions + wave * [1, 0, 0], truth.quaternions)


def euroc(path: Path, estimate: Trajectory) -> None:
    rows = [
        f"{round(stamp * 1e9)}," + ",".join(map(repr, [*position, quaternion[3], *quaternion[:3]]))
        for stamp, position, quaternion in zip(
            estimate.stamps.tolist(), estimate.positions.tolist(), estimate.quaternions.tolist(), strict=True
        )
    ]
    path.write_text("\n".join(["#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z", *rows, ""]))


def test_every_format_gives_the_same_figures(
    elsewhere: Path, estimate: Trajectory, tmp_path: Path, run_command: Command
) -> None:
    write_tum(tmp_path / "poses.txt", estimate)
    for form in ("kitti", "csv"):
        write_trajectory(tmp_path / f"poses.{form}", estimate, form)
    shifted = Trajectory(estimate.stamps + 1.5e9, estimate.positions, estimate.quaternions)
    euroc(tmp_path / "data.csv", shifted)
    for name, more in (
        ("poses.txt", ()),
        ("poses.kitti", ()),
        ("poses.csv", ()),
        ("data.csv", ("--offset", "-1.5e9")),
    ):
        code, out, err = run_command("import", "trajectories", tmp_path / name, *MINE, *more)
        assert code == 0, err
        assert "my-slam @example.org on tiny, not run here: 1 run imported" in out
    found = runs_of(elsewhere)
    errors = [one.results[0].values["ate"]["rmse"] for one in found]
    assert len(errors) == 4
    assert errors == pytest.approx([errors[0]] * 4, rel=1e-5)
    assert sorted(one.spec["repetition"] for one in found) == [0, 1, 2, 3]
    assert {one.origin.source for one in found} == {SOURCE}
    assert all(one.usage is None and one.provenance.content_hash is None for one in found)
    code, out, err = run_command("import", "trajectories", tmp_path / "poses.txt", *MINE)
    assert "0 runs imported, 0 evaluated, 1 there already" in out
    code, out, err = run_command(
        "results", "list", "--format", "json", "--columns", "origin,usage.cpu.seconds"
    )
    assert {json.dumps(one) for one in json.loads(out)} == {
        '{"origin": "not run here (example.org)", "usage.cpu.seconds": null}'
    }
    code, out, err = run_command("results", "table")
    assert f"my-slam @example.org: not run here (4 runs from {SOURCE})" in err
    code, out, err = run_command("results", "measure", "--sweep", "trajectories @example.org")
    assert code == 0, err


def test_results_of_two_addresses_of_a_server_stand_side_by_side(
    elsewhere: Path, estimate: Trajectory, tmp_path: Path, run_command: Command
) -> None:
    write_tum(tmp_path / "poses.txt", estimate)
    for number in (1, 2):
        other = ("--algorithm", f"slam-{number}", "--source", f"https://example.org/{number}")
        code, _, err = run_command("import", "trajectories", tmp_path / "poses.txt", *MINE, *other)
        assert code == 0, err
    code, out, err = run_command("results", "list", "--format", "json", "--columns", "algorithm")
    found = sorted(one["algorithm"] for one in json.loads(out))
    assert found == ["slam-1 @example.org", "slam-2 @example.org"]
    assert "left out" not in err


def test_stamps_of_another_clock_are_told_with_their_offset(
    elsewhere: Path, estimate: Trajectory, tmp_path: Path, run_command: Command
) -> None:
    path, truth = tmp_path / "poses.txt", tmp_path / "truth.txt"
    few = estimate.select(np.arange(0, len(estimate), 50))
    write_tum(truth, few)
    words = ("import", "trajectories", path, *MINE, "--dataset", "hall", "--ground-truth", truth)
    for offset, said in (
        (1000.0, "the offset is -1000.000000 s: --offset -1000.000000 if both begin at once"),
        (0.03, "the nearest one is -0.030000 s off: --offset -0.030000 if that is a delay"),
    ):
        write_tum(path, Trajectory(few.stamps + offset, few.positions, few.quaternions))
        code, _, err = run_command(*words)
        assert code == 2
        assert "poses.txt: no pose of the estimate" in " ".join(err.split())
        assert said in " ".join(err.split())
    assert not runs_of(elsewhere)
    code, out, err = run_command(*words, "--offset", "-0.03")
    assert code == 0, err
    assert "1 run imported, 1 evaluated" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--source", "somewhere"), "--source: 'somewhere': expected an address, https://… or doi:10.…"),
        (("--dataset", "nowhere"), "unknown dataset 'nowhere'"),
        (("--algorithm", "My SLAM"), "--algorithm: expected a name of lower-case letters"),
        (("--frame", "camera"), "--frame: dataset 'tiny' has no sensor 'camera'; known: body, lidar"),
        (("--label", "a b"), "--label: 'a b': a label has letters"),
        (("--parameter", "fast"), "--parameter: expected NAME=VALUE, found 'fast'"),
        (
            ("--ground-truth", "poses.txt", "--dataset", "hall", "--frame", "lidar"),
            "there is ground truth alone",
        ),
        (("..",), "..: a folder; name the files in it"),
        (("--alignment", "yaw"), "Yaw needs a Dataset and an Algorithm"),
    ],
)
def test_what_is_wrong_is_said(
    *,
    elsewhere: Path,
    estimate: Trajectory,
    tmp_path: Path,
    run_command: Command,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    said: str,
) -> None:
    write_tum(tmp_path / "poses.txt", estimate)
    monkeypatch.chdir(tmp_path)
    code, _, err = run_command("import", "trajectories", tmp_path / "poses.txt", *MINE, *words)
    assert code == 2
    assert said in " ".join(err.split())


def test_a_file_that_is_here_already_is_not_read_otherwise(
    elsewhere: Path, estimate: Trajectory, tmp_path: Path, run_command: Command
) -> None:
    write_trajectory(tmp_path / "poses.txt", estimate, "kitti")
    words = ("import", "trajectories", tmp_path / "poses.txt", *MINE, "--parameter", "gain=nan")
    assert run_command(*words)[0] == 0
    (tmp_path / "times.txt").write_text("\n".join(map(repr, (estimate.stamps + 0.004).tolist())))
    for more in (("--times", tmp_path / "times.txt"), ("--frame", "lidar")):
        code, _, err = run_command(*words, *more)
        assert code == 2
        assert "is here already as my-slam-tiny-" in " ".join(err.split())
    code, out, _ = run_command(*words, "--format", "kitti")
    assert code == 0
    assert "1 there already" in out
    assert len(runs_of(elsewhere)) == 1


def test_a_file_of_poses_alone_tells_the_command(tmp_path: Path, run_command: Command) -> None:
    (tmp_path / "poses.txt").write_text("1 2 3 4 0 0 0 1\n")
    code, _, err = run_command("import", tmp_path / "poses.txt")
    assert code == 2
    assert "slamhive import trajectories FILE --dataset NAME" in " ".join(err.split())


def test_broken_files_keep_no_others_out(
    elsewhere: Path, estimate: Trajectory, tmp_path: Path, run_command: Command
) -> None:
    write_tum(tmp_path / "poses.txt", estimate)
    (tmp_path / "words.txt").write_text("no poses at all\n")
    write_trajectory(tmp_path / "half.kitti", estimate.select(np.arange(10)), "kitti")
    code, _, err = run_command(
        "import",
        "trajectories",
        *(tmp_path / name for name in ("words.txt", "half.kitti", "poses.txt")),
        *MINE,
    )
    assert code == 1
    assert "words.txt, line 1" in " ".join(err.split())
    assert "its 10 poses have no time stamps" in " ".join(err.split())
    assert len(runs_of(elsewhere)) == 1
    code, _, err = run_command(
        "import", "trajectories", tmp_path / "poses.txt", *MINE[:-1], "https://example.org/b"
    )
    assert code == 2
    assert "is taken: my-slam @example.org is from https://example.org/results" in " ".join(err.split())


def test_the_papers_trajectories_have_the_errors_of_the_reference(
    elsewhere: Path, run_command: Command
) -> None:
    if not PAPER.is_dir():
        pytest.skip("the runs of the original paper are not there (../shared/data/icra2023)")
    files = [PAPER / "runs" / number / "traj.txt" for number in ("052", "053")]
    words = ("--dataset", "mh-01-easy", "--ground-truth", PAPER / "groundtruth" / "MH_01_easy.txt")
    source = ("--source", "https://github.com/SLAM-Hive/slam_hive_results", "--label", "icra2023")
    reference = {run["id"]: run for run in json.loads((PAPER / "reference.json").read_text())["runs"]}
    for algorithm, mode, path, alignment in (
        ("orb-slam2", "mono", files[0], "sim3"),
        ("vins-fusion", "mono-inertial", files[1], "se3"),
    ):
        words = (*words[:4], "--algorithm", algorithm, "--sensors", mode, "--alignment", alignment)
        code, _, err = run_command("import", "trajectories", path, *words, *source)
        assert code == 0, err
        ate = runs_of(elsewhere)[-1].results[0].values["ate"]
        expected = reference[int(path.parent.name)][f"ate_{alignment}"]
        assert ate["rmse"] == pytest.approx(expected["rmse"], rel=1e-9)
