# SPDX-License-Identifier: Apache-2.0
"""The algorithm in shell, run as a program of this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file

HERE = Path(__file__).parent
RECKONING = HERE / "shell-algorithm" / "dead-reckoning"

pytestmark = pytest.mark.skipif(
    not all(map(shutil.which, ("sh", "awk", "od", "perl"))), reason="needs sh, awk, od and perl"
)


def spec(folder: str) -> Any:
    (algorithm,) = load_file(HERE / folder / "algorithm.yaml")
    assert isinstance(algorithm, Algorithm)
    return algorithm.spec


def run(program: Path, folder: Path, timeout: float = 60) -> subprocess.CompletedProcess[str]:
    environment = {"SLAMHIVE_RUN": str(folder), "PATH": os.environ["PATH"], "TMPDIR": str(folder)}
    return subprocess.run(
        ["sh", program], env=environment, capture_output=True, text=True, check=False, timeout=timeout
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run folder with a bag of several chunks, in which the lidar isn't the only topic."""
    (tmp_path / "dataset").mkdir()
    (tmp_path / "output").mkdir()
    types = get_typestore(Stores.ROS1_NOETIC)
    message = types.types["std_msgs/msg/ByteMultiArray"]
    layout = types.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    with Writer(tmp_path / "dataset" / "recording.bag") as bag:
        bag.chunk_threshold = 5000
        topics = ["/points", "/points_raw", "/imu"]
        connections = [bag.add_connection(topic, message.__msgtype__, typestore=types) for topic in topics]
        data = types.serialize_ros1(message(layout=layout, data=np.zeros(700, np.int8)), message.__msgtype__)
        for index in range(90):
            bag.write(connections[index % 3], 1_600_000_000_000_000_000 + index * 33_333_333, data)
    return tmp_path


def configure(folder: Path, **changes: Any) -> None:
    config = {
        "apiVersion": "slamhive.io/v1alpha1",
        "dataset": {
            "name": 'it\'s "tiny"',
            "recording": {"format": "Rosbag1", "path": "dataset/recording.bag"},
        },
        "sensors": {"imu": {"topic": "/imu"}, "lidar": {"topic": "/points", "T_body_sensor": [[1.0], [0.0]]}},
        "parameters": {"speed": 1.5, **changes},
        "input": {"mode": "other"},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))


def test_the_shell_algorithm_gives_each_scan_a_pose_at_its_time(folder: Path) -> None:
    configure(folder)
    result = run(RECKONING, folder)
    assert result.returncode == 0, result.stderr
    with Reader(folder / "dataset" / "recording.bag") as bag:
        assert len(bag.chunk_infos) > 3
        expected = [time for connection, time, _ in bag.messages() if connection.topic == "/points"]
    rows = [line.split() for line in (folder / "output" / "trajectory.txt").read_text().splitlines()]
    assert [int(row[0].replace(".", "")) for row in rows] == expected
    moved = [1.5 * (time - expected[0]) / 1e9 for time in expected]
    assert np.allclose([float(row[1]) for row in rows], moved, atol=1e-8)
    assert yaml.safe_load((folder / "output" / "metrics.json").read_text())["framesProcessed"] == 30


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda folder: (folder / "config.yaml").write_text("sensors:\n"), "names no recording"),
        (lambda folder: (folder / "dataset" / "recording.bag").write_text("no bag"), "is no ROS 1 bag"),
        (
            lambda folder: (folder / "config.yaml").write_text(
                (folder / "config.yaml").read_text().replace("/points", "/nowhere")
            ),
            "has no topic /nowhere",
        ),
    ],
)
def test_the_shell_algorithm_ends_with_a_sentence(folder: Path, spoil: Any, sentence: str) -> None:
    configure(folder)
    spoil(folder)
    result = run(RECKONING, folder)
    assert result.returncode == 1
    assert sentence in result.stderr.splitlines()[-1]


def test_the_manifest_is_of_the_language() -> None:
    assert spec("shell-algorithm").local is None
