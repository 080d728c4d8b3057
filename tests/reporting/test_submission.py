# SPDX-License-Identifier: Apache-2.0
"""Submissions: which runs become which files, moved to the frame that is wanted, or a sentence why not."""

from __future__ import annotations

import hashlib
import json
import shutil
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.archive import Archive
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome, Phase, Result, RunRecord, TrajectoryInfo
from slamhive.reporting.submission import CHALLENGES, Pick, by_sequence, choose_run, find_challenge
from slamhive_eval import Trajectory, interpolate, read_kitti, read_tum, write_tum

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.local.home.folder import Home

LEVER = [[0.0, -1.0, 0.0, 0.3], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.55], [0.0, 0.0, 0.0, 1.0]]
SPEC: dict[str, Any] = {
    "algorithmRef": {"name": "other"},
    "sensors": "lidar",
    "parameters": {"a": 1},
    "input": {"remap": {}},
}


def record(name: str, dataset: str, repetition: int = 0, ate: float | None = None, **spec: Any) -> RunRecord:
    found = {"ate": None if ate is None else {"rmse": ate}}
    results = [Result(evaluation="se3", outcome=Outcome.TRACKED, coverage=1.0, values=found)]
    return RunRecord(
        uid=f"uid-{name}",
        name=name,
        sweep="odometry",
        spec=SPEC | {"datasetRef": {"name": dataset}, "repetition": repetition} | spec,
        phase=Phase.SUCCEEDED,
        results=results,
    )


def test_datasets_are_the_sequences_that_end_their_names() -> None:
    runs = [record("a", "kitti-odometry-11"), record("b", "kitti-odometry-12"), record("c", "drive")]
    kitti = find_challenge("kitti")
    found = by_sequence(kitti, runs, {"drive": "13"})
    assert {name: [one.name for one in ones] for name, ones in found.items()} == {
        "11": ["a"],
        "12": ["b"],
        "13": ["c"],
    }
    hilti = by_sequence(CHALLENGES["hilti2023"], [record("a", "hilti2023-site1-handheld-2")], {})
    assert list(hilti) == ["site1_handheld_2"]
    of_2022 = record("a", "hilti-2022-exp21-outside-building")
    assert list(by_sequence(CHALLENGES["hilti2022"], [of_2022], {})) == ["exp21_outside_building"]
    with pytest.raises(InputError, match=r"which sequence is the dataset 'drive'.* --name drive=SEQUENCE"):
        by_sequence(kitti, runs, {})
    with pytest.raises(InputError, match="drive and kitti-odometry-11 are both sequence 11"):
        by_sequence(kitti, runs, {"drive": "11"})
    with pytest.raises(InputError, match="did you mean 'kitti'"):
        find_challenge("kity")


def test_runs_of_several_configurations_are_no_submission() -> None:
    runs = [record("a", "kitti-11"), record("b", "kitti-12", parameters={"a": 2})]
    with pytest.raises(InputError, match="a and b differ in parameters; choose by --algorithm or --where"):
        by_sequence(CHALLENGES["kitti"], runs, {})


@pytest.mark.parametrize(
    ("pick", "name", "why"),
    [
        (Pick.FIRST, "r0", "the first of 4 repetitions"),
        (Pick.BEST, "r2", "the least ATE of 4 repetitions, 0.1 m"),
        (Pick.MEDIAN, "r3", "the median ATE of 4 repetitions, 0.2 m"),
    ],
)
def test_which_repetition_is_stated(pick: Pick, name: str, why: str) -> None:
    runs = [record(f"r{k}", "kitti-11", k, ate) for k, ate in enumerate((0.4, 0.3, 0.1, 0.2))]
    found, reason = choose_run(runs[::-1], pick)
    assert (found.name, reason) == (name, why)
    assert choose_run(runs[:1], pick)[1] == "the only run"


def test_without_ground_truth_the_best_is_not_known() -> None:
    with pytest.raises(InputError, match=r"r1 has no ATE to choose by; .*take --repetition first"):
        choose_run([record("r0", "kitti-11", 0, 0.1), record("r1", "kitti-11", 1)], Pick.BEST)


@pytest.fixture(name="drive")
def drive_fixture(home: Home, tiny: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A home with an algorithm and a dataset, and what puts finished runs into its archive."""
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    source = next(tiny.glob("tiny-*/recording.bag"))
    (home.path / "datasets").unlink()  # what all tests share
    for name in ("kitti-11", "site1-handheld-1"):
        folder = home.folder("datasets") / name
        folder.mkdir(parents=True)
        shutil.copyfile(source, folder / "walk.bag")
        sensors = {
            "lidar": {"type": "Lidar", "topic": "/points", "T_body_sensor": LEVER},
            "camera": {"type": "Camera", "topic": "/none", "T_body_sensor": np.eye(4).tolist()},
            "imu": {"type": "Imu", "topic": "/none2", "T_body_sensor": np.eye(4).tolist()},
        }
        spec = {"recording": {"files": [{"path": "walk.bag"}]}, "sensors": sensors}
        manifest = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Dataset", "metadata": {"name": name}}
        (folder / "dataset.yaml").write_text(json.dumps(manifest | {"spec": spec}))
    folder = home.folder("algorithms") / "other"
    folder.mkdir(parents=True)
    spec = {"image": "x", "modes": [{"name": "lidar"}], "output": {"frame": "lidar"}}
    manifest = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Algorithm", "metadata": {"name": "other"}}
    (folder / "algorithm.yaml").write_text(json.dumps(manifest | {"spec": spec}))
    truth = read_tum(source.with_name("groundtruth.txt"))

    def put(name: str, dataset: str, poses: Trajectory) -> None:
        path = home.path / "runs" / name / "run" / "output" / "trajectory.txt"
        path.parent.mkdir(parents=True)
        write_tum(path, poses)
        info = TrajectoryInfo(
            poses=len(poses),
            duration_seconds=float(poses.stamps[-1] - poses.stamps[0]),
            sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
            path="output/trajectory.txt",
        )
        with Archive.open(home.archive_url) as archive:
            made = record(name, dataset).replace(trajectory=info, folder=str(home.path / "runs" / name))
            archive.put_run(made)

    return put, truth


def test_kitti_wants_the_camera_of_every_frame(
    drive: Any, home: Home, tmp_path: Path, run_command: Any
) -> None:
    put, truth = drive
    put("whole", "kitti-11", truth.moved(np.array(LEVER)))  # poses of the LiDAR
    words = ("submission", "kitti", "--sweep", "odometry", "-o", tmp_path / "out.zip")
    code, out, err = run_command(*words)
    assert (code, out) == (2, "")
    assert "no finished run of 10 sequences: 12, 13, " in " ".join(err.split())
    code, out, err = run_command(*words, "--partial")
    assert code == 0, err
    assert "the only run" in out
    assert "left out: 12, 13" in " ".join(err.split())
    with zipfile.ZipFile(tmp_path / "out.zip") as archive:
        assert archive.namelist() == ["11.txt"]
        (tmp_path / "11.txt").write_bytes(archive.read("11.txt"))
    found = read_kitti(tmp_path / "11.txt")
    frames = np.array(
        [int(line) for line in next(home.path.glob("variants/*/frames.txt")).read_text().split()]
    )
    assert len(found) == len(frames)
    # The camera is the body here: its way is the ground truth's, seen from where it was at the first frame.
    there, positions, quaternions = interpolate(truth, frames / 1e9, 1.0)
    assert there.all()
    wanted = Trajectory(frames / 1e9, positions, quaternions)
    turn = wanted.matrices[0].T
    wanted = wanted.transformed(turn, -turn @ positions[0])
    assert found.positions == pytest.approx(wanted.positions, abs=1e-6)
    assert found.matrices == pytest.approx(wanted.matrices, abs=1e-6)
    code, _, err = run_command(*words, "--partial")
    assert code == 2
    assert "exists already" in err


def test_a_frame_without_a_pose_is_named(drive: Any, tmp_path: Path, run_command: Any) -> None:
    put, truth = drive
    put("half", "kitti-11", truth.moved(np.array(LEVER)).select(slice(len(truth) // 2, None)))
    code, _, err = run_command("submission", "kitti", "-o", tmp_path / "out.zip", "--partial")
    assert code == 2
    assert "frames have no pose, the first is frame 0; the challenge wants one for each" in " ".join(
        err.split()
    )
    assert list(tmp_path.glob("*out.zip*")) == []


def test_hilti_wants_lines_of_the_imu(drive: Any, tmp_path: Path, run_command: Any) -> None:
    put, truth = drive
    put("whole", "site1-handheld-1", truth.moved(np.array(LEVER)))
    words = ("submission", "hilti2023", "-o", tmp_path / "out.zip", "--partial", "--json")
    code, out, err = run_command(*words)
    assert code == 0, err
    with zipfile.ZipFile(tmp_path / "out.zip") as archive:
        assert archive.namelist() == ["site1_handheld_1.txt"]
        (tmp_path / "poses.txt").write_bytes(archive.read("site1_handheld_1.txt"))
    found = read_tum(tmp_path / "poses.txt")
    assert found.stamps.tolist() == truth.stamps.tolist()
    assert found.positions == pytest.approx(truth.positions, abs=1e-9)
    assert np.abs((found.quaternions * truth.quaternions).sum(axis=1)) == pytest.approx(1, abs=1e-12)
    assert json.loads(out)[0]["sequence"] == "site1_handheld_1"
