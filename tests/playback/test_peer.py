# SPDX-License-Identifier: Apache-2.0
"""A node of another make (RustDDS, built by cargo): no ROS, no Fast DDS, no shared memory."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from slamhive.local.home.catalog import Workshop
from slamhive.local.home.folder import Home
from slamhive.model.algorithm import Algorithm

sys.path.append(str(Path(__file__).parent))
import rig

if TYPE_CHECKING:
    from slamhive.model.results import RunRecord

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

SECONDS = 5
COUNTED = {"clouds": "/points", "images": "/left/image_raw", "imu": "/imu"}
SPEC = {
    "local": {"command": ["peer"]},
    "recording": ["Mcap"],
    "modes": [{"name": "lidar-inertial", "roles": ["lidar", "imu", "left"]}],
    "output": {"frame": "lidar"},
    "paces": ["Realtime"],
    "realtime": {"queue": 1000},
    "ros2": {"poses": {"topic": "/peer/poses", "type": "Odometry"}},
}


@pytest.fixture(scope="module")
def peer(environments: Path) -> Path:
    """The program, which outlives sessions; cargo builds what isn't up to date."""
    cargo = shutil.which("cargo")
    if cargo is None:
        pytest.skip("no cargo here: install Rust by https://rustup.rs")
    target = environments.parent / "peer"
    command = [cargo, "build", "--release", "--locked", "--quiet"]
    source = Path(__file__).parent / "peer"
    built = subprocess.run(
        command,
        cwd=source,
        env=os.environ | {"CARGO_TARGET_DIR": str(target)},
        capture_output=True,
        text=True,
        check=False,
    )
    if built.returncode:
        pytest.skip(f"the peer can't be built: {built.stderr.strip()[-500:]}")
    return target / "release" / "peer"


@pytest.fixture(scope="module")
def played(peer: Path, environments: Path, tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """A run of the peer on a heavy recording, at the speed at which it was recorded."""
    path = tmp_path_factory.mktemp("peer")
    (path / "environments").symlink_to(environments)
    for folder in ("node", "rig"):
        (path / folder).mkdir()
    shutil.copyfile(peer, path / "node" / "peer")
    (path / "node" / "peer").chmod(0o755)
    rig.record(path / "rig" / "rig.bag", SECONDS)
    workshop = Workshop()
    workshop.add([Algorithm.model_validate({"metadata": {"name": "peer"}, "spec": SPEC})], path / "node")
    workshop.add([rig.dataset(path / "rig" / "rig.bag")], path / "rig")
    record = rig.play(Home.at(path), workshop, "peer", "peer")
    assert record.phase == "Succeeded", f"{record.message}\n{record.log_tail}"
    return record


def sums(bag: Path) -> dict[str, int]:
    """Return the number of messages of each kind in a bag, and the sums of their contents' checksums."""
    found = dict.fromkeys([*COUNTED, *(f"{name}Sum" for name in COUNTED)], 0)
    names = {topic: name for name, topic in COUNTED.items()}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            name = names.get(connection.topic)
            if name is None:
                continue
            message = reader.deserialize(raw, connection.msgtype)
            if name == "imu":
                force = message.linear_acceleration
                data = np.array([force.x, force.y, force.z]).tobytes()
            else:
                data = message.data.tobytes()
            found[name] += 1
            found[f"{name}Sum"] += zlib.crc32(data)
    return found


def test_it_receives_everything_whole(played: RunRecord) -> None:
    folder = Path(played.folder or "")
    wanted = sums(folder.parents[2] / "rig" / "rig.bag")
    assert wanted["clouds"] == 10 * SECONDS
    assert json.loads((folder / "run" / "output" / "counts.json").read_text()) == wanted


def test_its_odometry_is_recorded(played: RunRecord) -> None:
    rows = np.loadtxt(Path(played.folder or "") / "run" / "output" / "trajectory.txt")
    assert len(rows) == 10 * SECONDS
    np.testing.assert_allclose(rows[:, 1], rows[:, 0] - 1.6e9, atol=1e-6)
    assert played.frames is not None
    assert played.frames.offered == played.frames.processed == 10 * SECONDS
