# SPDX-License-Identifier: Apache-2.0
"""A desk with what a reader is taken to have: small stand-ins carry the names that the documents use."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import yaml

from slamhive.cli import main
from slamhive.data.store.datasets import materialise
from slamhive.local.home.catalog import bundled
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.programs.engines import Engine

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(Path(__file__).parent / "doclab"))
RECORDINGS = {
    "synthetic-lidar": {"sensors": ["Lidar", "Imu"], "lidar": {"rings": 4, "columns": 36}},
    "synthetic-camera": {"sensors": ["Stereo", "Imu"], "camera": {"width": 64, "height": 48, "rate": 5}},
}
STAND_INS = ("kiss-icp", "genz-icp")
ADAPTER = """\
import os
import shutil
import sys
from pathlib import Path

run = Path(os.environ["SLAMHIVE_RUN"])
shutil.copyfile(run / "assets" / "truth.txt", run / "output" / "trajectory.txt")
"""


@pytest.fixture(scope="session")
def furnished(tmp_path_factory: pytest.TempPathFactory, environments: Path) -> Path:
    """A home in which datasets and algorithms of the catalog are replaced by small ones."""
    home = tmp_path_factory.mktemp("furnished")
    (home / "environments").symlink_to(environments)
    for name, recording in RECORDINGS.items():
        _stand_in_dataset(home / "datasets" / name, name, recording)
    truth = next(home.glob("datasets/synthetic-lidar-*/groundtruth.txt")).read_text()
    for name in STAND_INS:
        _stand_in_algorithm(home / "algorithms" / name, name, truth)
    return home


def _stand_in_dataset(folder: Path, name: str, recording: dict[str, Any]) -> None:
    manifest = yaml.safe_load((bundled("examples") / "datasets" / f"{name}.yaml").read_text())
    manifest["spec"]["recording"] = {"synthetic": {"durationSeconds": 7, "loops": 0.15, **recording}}
    folder.mkdir(parents=True)
    (folder / "dataset.yaml").write_text(yaml.safe_dump(manifest))
    dataset = load_file(folder / "dataset.yaml")[0]
    assert isinstance(dataset, Dataset)
    materialise(dataset, folder, folder.parent)


def _stand_in_algorithm(folder: Path, name: str, truth: str) -> None:
    manifest = yaml.safe_load((bundled("algorithms") / name / "algorithm.yaml").read_text())
    manifest["spec"] |= {
        "local": {"adapter": "adapter.py", "requirements": "requirements.txt"},
        "assets": [{"name": "truth.txt", "path": "truth.txt"}],
        "output": {"frame": "body", "stamp": "Header"},
    }
    folder.mkdir(parents=True)
    (folder / "algorithm.yaml").write_text(yaml.safe_dump(manifest))
    # The true adapter reads its parameters: a check looks for their names.
    (folder / "adapter.py").write_text(f"{ADAPTER}UNUSED = {sorted(manifest['spec']['parameters'])}\n")
    (folder / "requirements.txt").write_text("")
    (folder / "truth.txt").write_text("".join(f"{x}\n" for x in truth.splitlines() if x[0] != "#"))


@pytest.fixture
def desk(furnished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with what a reader is taken to have, and a home of its own."""
    home, folder = tmp_path / "home", tmp_path / "desk"
    shutil.copytree(furnished, home, symlinks=True)
    folder.mkdir()
    recording = next(home.glob("datasets/synthetic-lidar-*/recording.bag"))
    shutil.copyfile(recording, folder / "my.bag")
    _euroc(folder / "V1_01_easy" / "mav0")
    (folder / "intel.log").write_text(
        "".join(f"FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 {stamp}.5 nohost 1\n" for stamp in (10, 11, 12))
    )
    (folder / "intel.relations").write_text("10.5 11.5 0 0 0 0 0 0\n")
    shared = ROOT.parent / "shared" / "data" / "icra2023"
    if shared.is_dir():
        for name in ("runs", "groundtruth"):
            (folder / name).symlink_to(shared / name)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    # Neither containers nor a cluster of this machine: what the stand-ins write is no image's.
    monkeypatch.setenv("KUBECONFIG", os.devnull)
    monkeypatch.setattr("slamhive.conformance.workstation.find_engine", _no_engine)
    # What the stand-ins write fits this recording alone.
    monkeypatch.setattr("slamhive.conformance.recordings.recording_for", lambda _: "synthetic-lidar")
    return folder


def _no_engine() -> Engine:
    raise Unavailable("needs a container engine")


def _euroc(folder: Path) -> None:
    camera = folder / "cam0"
    (camera / "data").mkdir(parents=True)
    stamps = [10**9 + k * 50_000_000 for k in range(4)]
    for stamp in stamps:
        assert cv2.imwrite(str(camera / "data" / f"{stamp}.png"), np.full((48, 64), 90, np.uint8))
    (camera / "data.csv").write_text("#\n" + "".join(f"{stamp},{stamp}.png\n" for stamp in stamps))
    calibration = {
        "camera_model": "pinhole",
        "distortion_model": "none",
        "intrinsics": [60, 60, 32, 24],
        "resolution": [64, 48],
        "rate_hz": 20,
        "T_BS": {"data": np.eye(4).ravel().tolist()},
    }
    (camera / "sensor.yaml").write_text(yaml.safe_dump(calibration))


@pytest.fixture
def slamhive(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """The command, in this process: returns its exit code."""

    def call(*words: str) -> int:
        monkeypatch.setattr("sys.argv", ["slamhive", *words])
        try:
            main.main()
        except SystemExit as end:
            return int(end.code or 0)
        return 0

    return call
