# SPDX-License-Identifier: Apache-2.0
"""The bundled manifests of VINS-Fusion, VINS-Mono and LIO-SAM, played to stand-ins of these programs.

A stand-in reads its settings with the parser of the real program, compares each with the dataset's own
calibration, takes the topics and publishes as the real one does; its poses are those of the ground truth.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.archive import Archive
from slamhive.data.store.datasets import materialise
from slamhive.local.home.catalog import bundled, load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file
from slamhive.model.sensors import ROLES, SensorMode
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import RunRecord

    Play = Callable[..., RunRecord]

pytestmark = pytest.mark.slow

STANDINS = Path(__file__).parent / "standins"
RIGS: dict[str, dict[str, Any]] = {
    "stereo-imu": {"sensors": ["Stereo", "Imu"], "camera": {"width": 160, "height": 120}},
    # The released VINS-Mono fails where the camera is turned against the IMU by 90° to 120°.
    "upright": {"sensors": ["Stereo", "Imu"], "camera": {"width": 160, "height": 120}, "rig": "Euroc"},
    "lidar-imu": {"sensors": ["Lidar", "Imu"], "lidar": {"rings": 8, "columns": 90}},
}
SHORT = {"durationSeconds": 7, "loops": 0.15}


@pytest.fixture(scope="session")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Dataset, dict[str, Any], Path]]:
    """Short recordings by name, each with its sensors and its ground truth."""
    folder = tmp_path_factory.mktemp("rigs")
    found = {}
    for name, recording in RIGS.items():
        dataset = Dataset.model_validate(
            {"metadata": {"name": name}, "spec": {"recording": {"synthetic": SHORT | recording}}}
        )
        entry = materialise(dataset, folder, folder)
        sensors = json.loads((entry.root / "sensors.json").read_text())["sensors"]
        found[name] = (dataset, sensors, entry.root)
    return found


@pytest.fixture
def play(
    ros: None,
    rigs: dict[str, tuple[Dataset, dict[str, Any], Path]],
    tmp_path: Path,
    environments: Path,
    notes: Any,
) -> Play:
    """Plays a recording to the stand-in of a system, and returns the record of the run."""

    def play(
        system: str,
        mode: str,
        *,
        rig: str = "stereo-imu",
        settings: dict[str, Any] | None = None,
        resolution: float = 1.0,
        frame_rate: float | None = None,
        edit: tuple[str, str] | None = None,
        image: Callable[[Path, str], str] | None = None,
        **parameters: Any,
    ) -> RunRecord:
        dataset, sensors, root = rigs[rig]
        folder = tmp_path / "algorithms" / system
        shutil.copytree(STANDINS, folder, dirs_exist_ok=True)
        roles = {str(role): sensors.get(str(role), sensors.get("left")) for role in ROLES[SensorMode(mode)]}
        told = {
            "sensors": roles,
            "cameras": [role for role in ("left", "right", "camera") if role in roles],
            "resolution": resolution,
            "settings": settings or {},
            "truth": str(root / "groundtruth.txt") if image is None else "/opt/standins/truth.txt",
        }
        (folder / "expected.json").write_text(json.dumps(told))
        (manifest,) = load_file(bundled("algorithms") / system / "algorithm.yaml")
        body = manifest.as_json()
        if edit is not None:
            for file in body["spec"]["files"]:
                file["template"] = file["template"].replace(*edit)
        if image is None:
            body["spec"]["local"] = {"adapter": "adapter.py", "requirements": "requirements.txt"}
        else:
            shutil.copyfile(root / "groundtruth.txt", folder / "truth.txt")
            body["spec"]["image"] = image(folder, f"standin-{system}")
        (tmp_path / "environments").unlink(missing_ok=True)
        (tmp_path / "environments").symlink_to(environments)
        (tmp_path / "datasets").mkdir(exist_ok=True)
        if not (tmp_path / "datasets" / root.name).exists():
            (tmp_path / "datasets" / root.name).symlink_to(root)
        home = Home.at(tmp_path)
        workshop = load_workshop()
        workshop.add([Algorithm.model_validate(body)], folder)
        workshop.add([dataset], tmp_path)
        template = {
            "algorithmRef": {"name": system},
            "datasetRef": {"name": rig},
            "sensors": mode,
            "parameters": parameters,
            "input": {"rate": 2, "resolution": resolution, "frameRate": frame_rate},
            "retries": 0,
        }
        sweep = Sweep.model_validate({"metadata": {"name": "play"}, "spec": {"template": {"spec": template}}})
        with Archive.open(home.archive_url) as archive:
            job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
            Runner(Workbench(home, workshop, archive), notes, parallelism=1).run([job])
        record: RunRecord = notes.records[-1]
        return record

    return play


def output(record: RunRecord) -> Path:
    return Path(record.folder or "") / "run" / "output"


def frames_of(record: RunRecord) -> Path:
    """Return the file with the stamps of the frames that were played, in ns."""
    return Path(record.folder or "") / "run" / "dataset" / "frames.txt"


def measured(record: RunRecord) -> dict[str, Any]:
    """Return the measured values of a run, after making sure that there are any."""
    assert record.phase == "Succeeded", f"{record.message}\n{record.log_tail}"
    return record.results[0].values


def exact(values: dict[str, Any]) -> None:
    """The stand-ins publish the ground truth: another frame, stamp or unit is far off."""
    assert values["ate"]["rmse"] < 1e-6
    assert values["ateRotationDeg"]["rmse"] < 1e-4


@pytest.mark.parametrize(
    ("system", "mode", "rig"),
    [
        ("vins-fusion", "stereo-inertial", "stereo-imu"),
        ("vins-mono", "mono-inertial", "upright"),
        ("lio-sam", "lidar-inertial", "lidar-imu"),
    ],
)
def test_the_manifest_and_an_image_are_enough(
    play: Play, image_of: Callable[[Path, str], str], system: str, mode: str, rig: str
) -> None:
    settings = {"vins-mono": {"loop_closure": 1}}.get(system, {})
    record = play(system, mode, rig=rig, settings=settings, image=image_of)
    values = measured(record)
    assert values["ate"]["rmse"] < 1e-5
    assert record.provenance.image_id is not None
    assert record.usage is not None
    assert record.usage.source.startswith("cgroup")


@pytest.mark.parametrize("mode", ["mono-inertial", "stereo"])
def test_vins_fusion(play: Play, mode: str) -> None:
    record = play(
        "vins-fusion", mode, settings={"max_cnt": 77, "F_threshold": 2.5}, max_cnt=77, F_threshold=2.5
    )
    values = measured(record)
    exact(values)
    assert record.frames is not None
    # It uses every second image, and has no pose for its first window.
    assert 20 < record.frames.processed <= record.frames.offered / 2
    rows = np.loadtxt(output(record) / "vio.csv", delimiter=",", usecols=range(8))
    poses = np.loadtxt(output(record) / "trajectory.txt")
    np.testing.assert_allclose(rows[:, 0] / 1e9, poses[:, 0], atol=1e-6)


def test_loops_of_vins_fusion_are_keyframes_beside_its_odometry(play: Play) -> None:
    asked = {"min_dist": 15, "multiple_thread": 0, "estimate_extrinsic": 1}
    record = play(
        "vins-fusion",
        "stereo-inertial",
        settings=asked,
        resolution=0.5,
        loop_closure=True,
        multiple_thread=False,
        estimate_extrinsic=1,
    )
    values = measured(record)
    exact(values)
    keyframes = values["beside"]["keyframes"]
    exact(keyframes)
    assert 5 < keyframes["poses"] <= values["poses"] / 3 + 1


def test_vins_mono_on_a_rig_that_it_can_be_run_on(play: Play) -> None:
    asked = {"freq": 5, "keyframe_parallax": 7.5, "loop_closure": 1}
    record = play("vins-mono", "mono-inertial", rig="upright", settings=asked, freq=5, keyframe_parallax=7.5)
    values = measured(record)
    exact(values)
    exact(values["beside"]["keyframes"])
    poses = np.loadtxt(output(record) / "trajectory.txt")
    assert np.diff(poses[:, 0]).min() > 0.19


def test_vins_mono_without_loops_has_no_keyframes(play: Play) -> None:
    values = measured(play("vins-mono", "mono-inertial", settings={"loop_closure": 0}, loop_closure=False))
    exact(values)
    assert "beside" not in values


@pytest.mark.parametrize("rate", [None, 5])
def test_positions_of_lio_sam_are_those_of_mid_scan(play: Play, rate: float | None) -> None:
    asked = {"mappingProcessInterval": 0.0, "surroundingkeyframeAddingDistThreshold": 0.3}
    record = play("lio-sam", "lidar-inertial", rig="lidar-imu", settings=asked, frame_rate=rate, **asked)
    values = measured(record)
    assert values["ate"]["rmse"] < 1e-5
    assert 0.01 < values["ateRotationDeg"]["rmse"] < 2  # its rotations are those of the scan's start
    assert values["beside"]["keyframes"]["ate"]["rmse"] < 1e-5
    # The last two scans stay in its queue.
    poses, scans = (np.loadtxt(path) for path in (output(record) / "trajectory.txt", frames_of(record)))
    assert poses[-1, 0] == pytest.approx(scans[-3] / 1e9 + 0.05, abs=1e-6)


@pytest.mark.parametrize(
    ("found", "instead", "message"),
    [
        ("transform(body, role)", "transform(role, body)", "settings: body_T_cam0 is"),
        ("discrete_noise(imu.gyroscopeNoise, rate)", "imu.gyroscopeNoise", "settings: gyr_n is 0.001,"),
        ("rosrun vins ", "rosrun vins_fusion ", "package 'vins_fusion' not found"),
    ],
)
def test_settings_that_are_wrong_are_noticed(play: Play, found: str, instead: str, message: str) -> None:
    record = play("vins-fusion", "stereo-inertial", edit=(found, instead))
    assert (record.phase, record.reason) == ("Failed", "AlgorithmFailed")
    assert message in (record.message or "")
