# SPDX-License-Identifier: Apache-2.0
"""The run folder as adapters see it, and what they write there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import adapter_support
import numpy as np
import pytest
from adapter_support import (
    AdapterError,
    HealthLog,
    Run,
    Stopwatch,
    Trajectory,
    quaternions,
    run_adapter,
    write_results,
)

from slamhive_eval import read_health

if TYPE_CHECKING:
    from conftest import Maker

LIDAR = {
    "type": "Lidar",
    "topic": "/points",
    "stamp": "ScanStart",
    "timeOffset": 0.005,
    "lidar": {"rings": 4},
}


def rotation(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def test_reads_a_sensor(maker: Maker) -> None:
    maker.configure({"lidar": LIDAR})
    sensor = Run.from_folder(maker.folder).sensor("lidar")
    assert (sensor.topic, sensor.stamp, sensor.offset, sensor.detail("rings")) == (
        "/points",
        "ScanStart",
        5_000_000,
        4,
    )


@pytest.mark.parametrize(
    ("text", "value"), [("5e-6", 5e-6), ("1e3", 1000.0), ("-2.5E+1", -25.0), ("'5e-6'", "5e-6"), ("7", 7)]
)
def test_reads_numbers_as_json_has_them(maker: Maker, text: str, value: Any) -> None:
    (maker.folder / "config.yaml").write_text(f"{{kind: RunConfiguration, parameters: {{a: {text}}}}}")
    assert Run.from_folder(maker.folder).parameter("a") == value


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda run: run.sensor("imu"), "the mode lidar needs a sensor imu; config.yaml has lidar"),
        (lambda run: run.parameter("size"), "config.yaml has no parameter size, which the adapter needs"),
        (lambda run: run.recording(), "the recording recording.bag isn't in the run folder"),
        (
            lambda run: run.sensor("lidar").detail("columns"),
            "config.yaml gives no columns for the sensor lidar, which is needed",
        ),
    ],
)
def test_says_what_is_missing(maker: Maker, ask: Any, sentence: str) -> None:
    maker.configure({"lidar": LIDAR})
    with pytest.raises(AdapterError) as error:
        ask(Run.from_folder(maker.folder))
    assert str(error.value) == sentence


@pytest.mark.parametrize("text", ["kind: [", "kind: Sweep", "", "- 1"])
def test_refuses_what_is_no_run_configuration(tmp_path: Path, text: str) -> None:
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(AdapterError, match=r"config\.yaml"):
        Run.from_folder(tmp_path)


def test_a_program_without_a_run_folder_ends_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SLAMHIVE_RUN", raising=False)
    with pytest.raises(SystemExit, match="SLAMHIVE_RUN isn't set"):
        run_adapter(print)


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (AdapterError("the bag is empty"), "the bag is empty"),
        (ValueError("too\n few points"), "the algorithm failed: too few points"),
        (KeyError(), "the algorithm failed: KeyError"),
        (MemoryError(), "the algorithm asked for more memory than there is"),
    ],
)
def test_a_failed_program_ends_with_a_sentence(
    maker: Maker, monkeypatch: pytest.MonkeyPatch, error: Exception, sentence: str
) -> None:
    maker.configure({})
    monkeypatch.setenv("SLAMHIVE_RUN", str(maker.folder))

    def fail(_: Run) -> None:
        raise error

    with pytest.raises(SystemExit) as ending:
        run_adapter(fail)
    assert ending.value.code == sentence


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 2, 3), (-3, 1, -2)])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, np.pi - 1e-9, np.pi])
def test_quaternions(axis: tuple[float, float, float], angle: float) -> None:
    expected = np.append(np.sin(angle / 2) * np.array(axis) / np.linalg.norm(axis), np.cos(angle / 2))
    found = quaternions(rotation(axis, angle)[None])[0]
    assert abs(abs(found @ expected) - 1) < 1e-12
    assert found[3] >= 0


def test_writes_tum_with_exact_stamps_in_order(tmp_path: Path) -> None:
    trajectory = Trajectory()
    pose = np.eye(4)
    pose[:3, 3] = [1.5, -2.25, 1e-9]
    trajectory.add(1_600_000_001_123_456_789, pose)
    trajectory.add(1_600_000_000_000_000_001, np.eye(4))
    trajectory.write(tmp_path / "trajectory.txt")
    first, second = (tmp_path / "trajectory.txt").read_text().splitlines()
    assert first.split() == ["1600000000.000000001"] + ["0.000000000"] * 6 + ["1.000000000"]
    assert second.split()[:4] == ["1600000001.123456789", "1.500000000", "-2.250000000", "0.000000001"]
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.txt"]


def test_leaves_poses_out_that_are_not_finite(tmp_path: Path) -> None:
    trajectory = Trajectory()
    trajectory.add(1, np.full((4, 4), np.nan))
    assert (trajectory.lost, trajectory.stamps) == (1, [])
    trajectory.write(tmp_path / "trajectory.txt")
    assert (tmp_path / "trajectory.txt").read_text() == "# the algorithm gave no pose\n"


def test_an_algorithm_that_was_given_nothing_has_failed(maker: Maker) -> None:
    maker.configure({})
    with pytest.raises(AdapterError, match="no frame was given to the algorithm; 3 were empty or refused"):
        write_results(Run.from_folder(maker.folder), Trajectory(), Stopwatch(), 0.25, dropped=3)


def test_the_sentence_is_the_last_of_both_streams(maker: Maker) -> None:
    code = """
import ctypes
from adapter_support import AdapterError, run_adapter
def program(run):
    print("a frame was processed")
    ctypes.CDLL(None).printf(b"so says the library\\n")
    raise AdapterError("the map is empty")
run_adapter(program)
"""
    maker.configure({})
    (maker.folder / "adapter.py").write_text(code)
    folder = Path(adapter_support.__file__).parent
    environment = {"SLAMHIVE_RUN": str(maker.folder), "PYTHONPATH": str(folder)}
    ended = subprocess.run(
        [sys.executable, str(maker.folder / "adapter.py")],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    lines = ended.stdout.decode().splitlines()
    assert (ended.returncode, lines[-1]) == (1, "the map is empty")
    assert set(lines[:-1]) == {"a frame was processed", "so says the library"}


def test_a_pose_is_kept_as_it_was(tmp_path: Path) -> None:
    trajectory, pose = Trajectory(), np.eye(4)
    trajectory.add(1, pose)
    pose[0, 3] = 9
    assert trajectory.poses[0][0, 3] == 0


def test_writes_health_in_the_order_of_time(tmp_path: Path) -> None:
    health = HealthLog()
    health.write(tmp_path / "health.csv")
    assert not (tmp_path / "health.csv").exists()
    health.add(1_600_000_001_500_000_000, 12, "degraded")
    health.add(1_600_000_000_000_000_001, flag="lost")
    health.write(tmp_path / "health.csv")
    said = read_health(tmp_path / "health.csv")
    assert (said.flags.tolist(), said.values[1]) == ([2, 1], 12.0)


def test_writes_metrics(maker: Maker) -> None:
    maker.configure({})
    run, trajectory, watch = Run.from_folder(maker.folder), Trajectory(), Stopwatch()
    trajectory.add(1, np.eye(4))
    watch.seconds = [0.1, 0.3]
    write_results(run, trajectory, watch, 0.25, dropped=3, keyframes=7)
    assert json.loads((run.output / "metrics.json").read_text()) == {
        "framesOffered": 5,
        "framesProcessed": 2,
        "framesDropped": 3,
        "framesLost": 0,
        "readerCpuSeconds": 0.25,
        "timePerFrame": {"mean": 0.2, "max": 0.3},
        "keyframes": 7,
    }
