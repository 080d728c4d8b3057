# SPDX-License-Identifier: Apache-2.0
"""Tests of a program that takes a folder of files and writes poses by frame, on a workstation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.local.home.catalog import AlgorithmEntry
from slamhive.model.algorithm import Algorithm
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.catalog import Workshop

PROGRAM = """
import os, sys
from pathlib import Path

run = Path(os.environ["SLAMHIVE_RUN"])
folder = run / "dataset" / "recording"
scans = sorted((folder / "velodyne").glob("*.bin"))
if len(scans) != len((folder / "times.txt").read_text().split()) or not all(s.stat().st_size for s in scans):
    sys.exit("the scans are not those of times.txt")
(run / "output" / "read.yaml").write_text((run / "files" / "read.yaml").read_text())
(run / "output" / "config.yaml").write_text((run / "config.yaml").read_text())
poses = [f"1 0 0 {0.1 * k} 0 1 0 0 0 0 1 0" for k in range(len(scans))]
(run / "output" / "poses.txt").write_text("\\n".join(poses) + "\\n")
"""
TEMPLATE = """folder: {{ paths.recording|quoted }}
scans: {{ (paths.recording ~ '/' ~ dataset.recording.files.lidar)|quoted }}
calibration: {{ dataset.recording.files.calibration|quoted }}
offset: {{ sensors.lidar.timeOffset }}
"""


@pytest.fixture
def plain_program(workshop: Workshop, tmp_path: Path) -> None:
    """Put a program into the catalog that knows KITTI's folders and nothing else."""
    folder = tmp_path / "plain"
    folder.mkdir()
    (folder / "adapter.py").write_text(PROGRAM)
    (folder / "requirements.txt").write_text("")
    spec = {
        "local": {"adapter": "adapter.py", "requirements": "requirements.txt", "python": ">=3.11"},
        "modes": [{"name": "lidar"}],
        "recording": ["Kitti"],
        "files": [{"path": "read.yaml", "template": TEMPLATE}],
        "output": {"frame": "lidar", "trajectory": {"path": "poses.txt", "format": "Kitti"}},
    }
    body = {"metadata": {"name": "plain"}, "spec": spec}
    workshop.algorithm_entries["plain"] = AlgorithmEntry(Algorithm.model_validate(body), folder)


def test_a_program_that_knows_kitti_alone_is_measured(
    plain_program: None, run_acts: Callable[..., Any]
) -> None:
    assert plain_program is None
    sweep = {
        "template": {"algorithmRef": {"name": "plain"}, "input": {"frameRate": 5}},
        "matrix": [{"path": "input.duration", "values": ["4s"]}],
    }
    _, notes = run_acts([], **sweep)
    (record,) = notes.records
    assert record.phase is Phase.SUCCEEDED, (record.message, record.log_tail)
    run = Path(record.folder) / "run"
    frames = [int(line) for line in (run / "dataset" / "frames.txt").read_text().split()]
    stamps = [
        line.split()[0]
        for line in (run / "output" / "trajectory.txt").read_text().splitlines()
        if not line.startswith("#")
    ]
    assert [round(float(stamp) * 1e9, -3) for stamp in stamps] == [round(at, -3) for at in frames]
    assert len(frames) == 20
    assert record.results[0].outcome is not None
    told = yaml.safe_load((run / "output" / "config.yaml").read_text())["dataset"]["recording"]
    assert told == {
        "format": "Kitti",
        "path": "dataset/recording",
        "files": {"lidar": "velodyne", "times": "times.txt", "calibration": "calib.txt"},
    }
    assert yaml.safe_load((run / "output" / "read.yaml").read_text()) == {
        "folder": str(run / "dataset" / "recording"),
        "scans": str(run / "dataset" / "recording" / "velodyne"),
        "calibration": "calib.txt",
        "offset": 0.0,
    }
    assert not list((run / "dataset").rglob("*truth*"))
