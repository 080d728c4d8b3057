# SPDX-License-Identifier: Apache-2.0
"""Tests of imports from folders that are right, wrong, equal, or already there."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.bridges.slamhive1 import find_runs, identify, read_usage
from slamhive.data.store.truthfolders import GroundTruthFolder, catalog_name
from slamhive.model.errors import DataError, InputError
from slamhive.model.run import MappingRunSpec

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Command = Callable[..., Any]
    MakeRun = Callable[..., Path]


@pytest.mark.parametrize(
    ("name", "algorithm", "sensors"),
    [
        ("orb-slam2-ros-mono", "orb-slam2", "mono"),
        ("orb-slam2-ros-rgbd", "orb-slam2", "rgbd"),
        ("orb-slam2-ros-rgb-d", "orb-slam2", "rgbd"),
        ("orb-slam3-ros-mono-inertial", "orb-slam3", "mono-inertial"),
        ("ORB_SLAM3-ros-stereo-imu", "orb-slam3", "stereo-inertial"),
        ("vins-mono", "vins-mono", "mono-inertial"),
        ("vins-fusion-mono-imu", "vins-fusion", "mono-inertial"),
        ("vins-fusion-stereo", "vins-fusion", "stereo"),
        ("lio-sam-ros", "lio-sam", "lidar-inertial"),
        ("a-loam", "a-loam", "lidar"),
        ("dso-ros-mono", "dso", "mono"),
        ("something", "something", None),
    ],
)
def test_names_tell_algorithm_and_sensors(name: str, algorithm: str, sensors: str | None) -> None:
    assert identify(name) == (algorithm, sensors)


@pytest.mark.parametrize(
    ("topics", "sensors"),
    [
        ({"mono_topic"}, "mono"),
        ({"image0_topic", "image1_topic", "imu_topic"}, "stereo-inertial"),
        ({"rgb_topic", "dep_topic"}, "rgbd"),
        ({"imu_topic"}, None),
    ],
)
def test_topics_tell_where_the_name_does_not(topics: set[str], sensors: str | None) -> None:
    assert identify("new-slam", topics) == ("new-slam", sensors)


def test_catalog_names() -> None:
    assert [catalog_name(name) for name in ("MH_01_easy", "_a b_", "2011_09_26/x", "??")] == [
        "mh-01-easy",
        "a-b",
        "2011-09-26-x",
        "unnamed",
    ]


@pytest.mark.parametrize(
    ("samples", "seconds", "wall"),
    [("0,0,100\n2,1.5,300\n3,0.5,200\n", 3.5, 3.0), ("0,0,100\n2,1.5,300\n8,0.5,200\n", None, None)],
)
def test_usage(tmp_path: Path, samples: str, seconds: float | None, wall: float | None) -> None:
    file = tmp_path / "profiling.csv"
    file.write_text(f"time,cpu_usage,memory_usage\n{samples}")
    usage = read_usage(file)
    assert usage is not None
    assert (usage.cpu.mean_cores, usage.cpu.max_cores) == (2 / 3, 1.5)
    assert (usage.memory.peak_bytes, usage.memory.mean_bytes) == (300, 200.0)
    assert (usage.memory.kind, usage.memory.working_set_peak_bytes) == ("Container", None)
    assert (usage.cpu.seconds, usage.wall_seconds, usage.samples) == (seconds, wall, 3)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a,b\n", r"profiling\.csv:1: expected the columns time,cpu_usage,memory_usage, found 'a,b'"),
        ("time,cpu_usage,memory_usage\n0,0,1\n1,x,2\n", r"profiling\.csv:3: expected three numbers"),
        ("time,cpu_usage,memory_usage\n0,0\n", r"profiling\.csv:2: expected three numbers"),
        ("time,cpu_usage,memory_usage\n0,nan,1\n", r"profiling\.csv:2: every number must be finite"),
    ],
)
def test_broken_samples(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "profiling.csv"
    file.write_text(text)
    with pytest.raises(DataError, match=problem):
        read_usage(file)


@pytest.mark.parametrize(
    "place",
    [
        "Hall_01.txt",
        "hall-01.csv",
        "Hall_01/groundtruth.txt",
        "Hall_01/mav0/state_groundtruth_estimate0/data.csv",
    ],
)
def test_places_of_ground_truth(tmp_path: Path, place: str) -> None:
    file = tmp_path / place
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    assert GroundTruthFolder(tmp_path).path("Hall_01") == file


def test_a_folder_without_runs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run folders"):
        find_runs(tmp_path)


def rows(show: Command, *words: str) -> list[dict[str, Any]]:
    outcome = show("export", "--format", "json", *words)
    assert outcome.exit_code == 0
    return list(json.loads(outcome.stdout))


def words(tmp_path: Path, *more: str) -> list[str]:
    return ["slam-hive", str(tmp_path / "runs"), "--ground-truth", str(tmp_path / "truth"), *more]


def test_equal_configurations_are_repetitions(
    tmp_path: Path, take: Command, show: Command, make_run: MakeRun
) -> None:
    for number in ("010", "009", "x"):
        make_run(number)
    make_run("011", algorithm="orb-slam2-ros-stereo")
    assert take(*words(tmp_path)).exit_code == 0
    found = {row["run"]: row for row in rows(show)}
    assert {run: row["repetition"] for run, row in found.items()} == {9: 0, 10: 1, "x": 2, 11: 0}
    assert {run: row["evaluation"] for run, row in found.items()} == {
        9: "sim3",
        10: "sim3",
        "x": "sim3",
        11: "se3",
    }
    assert found[9]["label.dataset"] == "Hall_01"
    assert found[9]["dataset.attributes.algorithm-remap.mono_topic"] == "/camera/image_raw"
    make_run("001")
    assert take(*words(tmp_path)).exit_code == 0
    assert {row["run"]: row["repetition"] for row in rows(show)} == {1: 3, 9: 0, 10: 1, "x": 2, 11: 0}


def test_imported_runs_follow_the_language(tmp_path: Path, take: Command, make_run: MakeRun) -> None:
    from slamhive.archive import Archive

    make_run()
    assert take(*words(tmp_path)).exit_code == 0
    with Archive.open(f"sqlite:///{tmp_path / 'home' / 'archive.sqlite'}") as archive:
        (record,) = archive.runs()
        spec = MappingRunSpec.model_validate(record.spec)
        assert (spec.algorithm_ref.name, spec.dataset_ref.name) == ("orb-slam2", "hall-01")
        assert [entry.name for entry in archive.catalog("Algorithm")] == ["orb-slam2"]
        assert [entry.name for entry in archive.catalog("Dataset")] == ["hall-01"]


def test_importing_again_changes_nothing_and_another_alignment_adds(
    tmp_path: Path, take: Command, show: Command, make_run: MakeRun
) -> None:
    make_run()
    assert take(*words(tmp_path, "--alignment", "sim3")).exit_code == 0
    first = rows(show)
    again = take(*words(tmp_path, "--alignment", "Sim3"))
    assert (again.exit_code, rows(show)) == (0, first)
    assert "0 runs imported, 0 runs evaluated, 1 run there already" in again.output
    assert take(*words(tmp_path, "--alignment", "se3")).exit_code == 0
    assert [row["evaluation"] for row in rows(show)] == ["se3", "sim3"]
    assert rows(show, "--evaluation", "sim3") == first


def test_the_configuration_as_the_original_named_it(
    tmp_path: Path, take: Command, show: Command, make_run: MakeRun
) -> None:
    folder = make_run("052")
    assert take(*words(tmp_path)).exit_code == 0
    first = rows(show)
    (folder / "config.yaml").rename(folder / "14_ORB2 mono.yaml")
    again = take(*words(tmp_path))
    assert (again.exit_code, rows(show)) == (0, first)
    (folder / "15.yaml").touch()
    outcome = take(*words(tmp_path))
    assert outcome.exit_code == 1
    assert "expected config.yaml or one other .yaml file, found 14_ORB2 mono.yaml, 15.yaml" in outcome.stderr


@pytest.mark.parametrize(
    ("changes", "sentence", "kept"),
    [
        (
            {"trajectory": ""},
            "holds no poses: every line is empty or a comment; kept as a failed run (NoTrajectory)",
            True,
        ),
        ({"trajectory": None}, "traj.txt: can't be read", True),
        ({"trajectory": "1 2 3\n"}, "traj.txt, line 1", True),
        ({"trajectory": "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n"}, "(InvalidTrajectory)", True),
        ({"config": "a: [\n"}, "config.yaml:2: not YAML", False),
        ({"config": "- 1\n"}, "config.yaml: expected one mapping", False),
        ({"config": "slam-hive-dataset: x\n"}, "slam-hive-algorithm: expected a name, found None", False),
        (
            {"config": "slam-hive-algorithm: a-mono\nslam-hive-dataset: x\nalgorithm-parameters: 5\n"},
            "config.yaml:3: algorithm-parameters: expected a mapping, found 5",
            False,
        ),
        (
            {"config": "slam-hive-algorithm: unheard-of\nslam-hive-dataset: x\n"},
            "don't tell the sensors",
            False,
        ),
        ({"dataset": "Nowhere"}, "no ground truth of the dataset 'Nowhere'", False),
        ({"profile": "x\n"}, "profiling.csv:1: expected the columns", False),
    ],
)
def test_a_broken_run_is_named_and_the_others_go_on(
    tmp_path: Path,
    take: Command,
    show: Command,
    make_run: MakeRun,
    *,
    changes: dict[str, Any],
    sentence: str,
    kept: bool,
) -> None:
    make_run("001")
    make_run("002", **changes)
    make_run("003")
    for expected in ("runs imported", "0 runs imported"):
        outcome = take(*words(tmp_path))
        assert outcome.exit_code == 1
        assert "error: 002: " in outcome.stderr
        assert sentence in outcome.stderr
        assert expected in outcome.stdout
    found = rows(show)
    assert [row["run"] for row in found if row["outcome"] == "Tracked"] == [1, 3]
    assert [row["run"] for row in found if row["phase"] == "Failed"] == ([2] if kept else [])


def test_an_alignment_that_needs_more_than_is_known(tmp_path: Path, take: Command, make_run: MakeRun) -> None:
    make_run()
    outcome = take(*words(tmp_path, "--alignment", "yaw"))
    assert isinstance(outcome.exception, InputError)
    assert "Yaw needs a Dataset and an Algorithm that are both gravityAligned" in str(outcome.exception)


def test_ground_truth_is_kept_for_the_dashboard(take: Command, make_run: MakeRun, tmp_path: Path) -> None:
    make_run()
    truth, kept = tmp_path / "truth", tmp_path / "home" / "groundtruth"
    words = ("slam-hive", tmp_path / "runs", "--ground-truth", truth)
    assert take(*words).exit_code == 0
    assert [file.name for file in kept.iterdir()] == ["hall-01.txt"]
    assert (kept / "hall-01.txt").read_bytes() == (truth / "Hall_01.txt").read_bytes()

    # A home of an earlier version gets it with runs that are there already.
    (kept / "hall-01.txt").unlink()
    assert "1 run there already" in take(*words).output
    assert [file.name for file in kept.iterdir()] == ["hall-01.txt"]


def test_ground_truth_that_is_there_stays(take: Command, make_run: MakeRun, tmp_path: Path) -> None:
    make_run()
    kept = tmp_path / "home" / "groundtruth"
    kept.mkdir(parents=True)
    (kept / "Hall_01.csv").write_text("mine")
    outcome = take("slam-hive", tmp_path / "runs", "--ground-truth", tmp_path / "truth")
    assert outcome.exit_code == 0
    assert "another ground truth of Hall_01, which stays" in " ".join(outcome.output.split())
    assert {file.name: file.read_text() for file in kept.iterdir()} == {"Hall_01.csv": "mine"}


def test_ground_truth_that_cannot_be_kept_is_said(take: Command, make_run: MakeRun, tmp_path: Path) -> None:
    make_run()
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "groundtruth").write_text("no folder")
    outcome = take("slam-hive", tmp_path / "runs", "--ground-truth", tmp_path / "truth")
    assert outcome.exit_code == 0
    assert "ground truth is not kept for the dashboard" in " ".join(outcome.output.split())
    assert "1 run imported" in outcome.output


def test_euroc_folders_are_kept_by_the_datasets_name(tmp_path: Path) -> None:
    place = tmp_path / "from" / "MH_01" / "mav0" / "state_groundtruth_estimate0"
    place.mkdir(parents=True)
    (place / "data.csv").write_text("#timestamp\n")
    (tmp_path / "to").mkdir()
    assert GroundTruthFolder(tmp_path / "from").copy("MH_01", tmp_path / "to")
    assert (tmp_path / "to" / "mh-01.csv").read_text() == "#timestamp\n"


@pytest.mark.parametrize("beside", ["runs", "."])
def test_a_folder_alone_brings_its_ground_truth(
    make_run: MakeRun, take: Command, tmp_path: Path, beside: str
) -> None:
    make_run()
    told = take(tmp_path / beside).exception
    assert isinstance(told, InputError)
    assert "--ground-truth DIR" in str(told)
    (tmp_path / "truth").rename(tmp_path / "groundtruth")
    assert "1 run imported, 1 run evaluated" in take(tmp_path / beside).output
