# SPDX-License-Identifier: Apache-2.0
"""Sequences of catalogues, fetched from an https server: algorithms err as on the generated original."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
import yaml

from slamhive.model.catalogue import catalogue_folders
from slamhive_eval import Trajectory, read_tum

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "data" / "datalab"))

from serving import Site, make_certificate, serving

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Command = Callable[..., str]

pytestmark = pytest.mark.timeout(900)

ORIGINAL = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: original}
spec:
  recording:
    synthetic:
      {seed: 11, sensors: [Lidar, Imu], durationSeconds: 12, loops: 0.2, lidar: {rings: 16, columns: 360}}
"""
SWEEP = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: named}
spec: {catalogue: test/basement_2}
---
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: show}
spec:
  template: {spec: {sensors: lidar}}
  matrix:
    - {path: algorithm, values: [kiss-icp, genz-icp]}
    - {path: dataset, values: [original, test-basement-2, named]}
"""


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate: apt-get install openssl")
    certificate = make_certificate(tmp_path)
    (tmp_path / "served").mkdir()
    with serving(Site(tmp_path / "served"), *certificate) as served:
        yield served


@pytest.fixture
def families(tmp_path: Path) -> Path:
    """A folder of a lab's own families."""
    folder = tmp_path / "families"
    folder.mkdir()
    return folder


@pytest.fixture
def slamhive(home: Path, families: Path, tmp_path: Path) -> Command:
    """Runs the command, which knows the families and trusts the server; returns what it prints."""
    environment = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    environment |= {
        "SLAMHIVE_HOME": str(home),
        "SLAMHIVE_CATALOGUE": str(families),
        "SSL_CERT_FILE": str(tmp_path / "certificate.pem"),
    }

    def run(*words: str) -> str:
        command = [str(Path(sys.executable).with_name("slamhive")), *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_a_bag_of_the_catalogue_is_measured_as_its_original(
    slamhive: Command, families: Path, site: Site, tmp_path: Path
) -> None:
    (tmp_path / "original.yaml").write_text(ORIGINAL)
    slamhive("dataset", "add", "original.yaml")
    slamhive("dataset", "export", "original", "--format", "Rosbag1", "-o", "made", "--ground-truth")
    (tmp_path / "made" / "recording.bag").rename(site.folder / "exp14_basement_2.bag")
    (tmp_path / "made" / "groundtruth.txt").rename(site.folder / "exp14_basement_2_imu.txt")
    made = yaml.safe_load((tmp_path / "made" / "dataset.yaml").read_text())["spec"]
    family = {
        "name": "test",
        "title": "Bags as Hilti publishes them",
        "homepage": "https://localhost/",
        "license": "CC0-1.0",
        "cite": "Nobody",
        "layout": "Bag",
        "sensors": {"lidar": "Lidar", "imu": "Imu"},
        "parts": {"bag": {"url": f"{site.url}/{{bag}}.bag"}, "truth": {"url": f"{site.url}/{{bag}}_imu.txt"}},
        "dataset": {
            "recording": {"format": "Rosbag1", "files": [{"path": "{bag}.bag"}]},
            "sensors": made["sensors"],
            "groundTruth": {"file": "{bag}_imu.txt", "format": "Tum", "frame": "body"},
            "gravityAligned": True,
        },
        "sequences": {"basement_2": {"words": {"bag": "exp14_basement_2"}}},
    }
    (families / "test.yaml").write_text(yaml.safe_dump(family))
    slamhive("dataset", "add", "test/basement_2")
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    slamhive("run", "sweep.yaml")
    rows = json.loads(slamhive("results", "export", "--sweep", "show", "--format", "json"))
    errors = {(row["algorithm"], row["dataset"]): row["ate.rmse"] for row in rows}
    assert len(errors) == 6
    for (algorithm, _), error in errors.items():
        assert error == pytest.approx(errors[algorithm, "original"], abs=1e-6)


SYSTEMS = {"flow-odometry": "flow", "descriptor-odometry": "descriptors"}
CAMERAS = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: original}
spec:
  recording:
    synthetic:
      seed: 11
      sensors: [Stereo, Rgbd, Imu]
      durationSeconds: 8
      loops: 0.1
      depthOffsetSeconds: 0.02
      camera: {width: 240, height: 180, rate: 10}
"""
STEREO = ["lab-euroc-mh-01-easy", "lab-tum-vi-room1", "lab-kitti-00", "lab-hilti-2022-basement-2"]
RGBD = ["lab-tum-rgbd-freiburg1-xyz"]
LAYOUTS = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: layouts}
spec:
  template: {spec: {}}
"""


@pytest.mark.slow
def test_five_layouts_of_archives_are_measured_as_what_they_were_made_of(
    slamhive: Command, home: Path, families: Path, site: Site, tmp_path: Path
) -> None:
    for name, points in SYSTEMS.items():
        write_system(home / "algorithms" / name, name, points)
    (tmp_path / "original.yaml").write_text(CAMERAS)
    slamhive("dataset", "add", "original.yaml")
    made = {}
    for form in ("Euroc", "Tum", "Kitti", "Rosbag1"):
        made[form] = tmp_path / "made" / form
        slamhive("dataset", "export", "original", "--format", form, "-o", str(made[form]), "--ground-truth")
    mirrored(families, site, "tum-vi", vi_archive(made["Euroc"], tmp_path / "vi"))
    mirrored(families, site, "euroc", euroc_archive(made["Euroc"]))
    mirrored(families, site, "tum-rgbd", tum_archive(made["Tum"]))
    mirrored(families, site, "kitti", kitti_archives(made["Kitti"]))
    bag = yaml.safe_load((made["Rosbag1"] / "dataset.yaml").read_text())["spec"]
    files = {
        "Challenges/2022/exp14_basement_2.bag": (made["Rosbag1"] / "recording.bag").read_bytes(),
        "Challenges/2022/exp14_basement_2_imu.txt": (made["Rosbag1"] / "groundtruth.txt").read_bytes(),
    }
    # The rig is the generated one: its topics and calibration take the place of Hilti's.
    kinds = {name: sensor["type"] for name, sensor in bag["sensors"].items()}
    mirrored(families, site, "hilti-2022", files, sensors=kinds, rig=bag["sensors"])
    for sequence in ("euroc/MH_01_easy", "tum-vi/room1", "kitti/00", "hilti-2022/basement_2"):
        slamhive("dataset", "add", f"lab-{sequence}")
    slamhive("dataset", "add", "lab-tum-rgbd/freiburg1_xyz")
    sweep = yaml.safe_load(LAYOUTS)
    data = [("stereo", name) for name in ("original", *STEREO)]
    data += [("rgbd", name) for name in ("original", *RGBD)]
    points = {f"{mode}-{name}": {"dataset": name, "sensors": mode} for mode, name in data}
    sweep["spec"]["matrix"] = [
        {"path": "algorithm", "values": [*SYSTEMS]},
        {"name": "data", "points": points},
    ]
    (tmp_path / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    slamhive("run", "sweep.yaml")
    rows = json.loads(slamhive("results", "export", "--sweep", "layouts", "--format", "json"))
    found = {(row["algorithm"], row["sensors"], row["dataset"]): row for row in rows}
    assert len(found) == len(SYSTEMS) * len(data)
    for (algorithm, mode, _), row in found.items():
        original = found[algorithm, mode, "original"]
        assert row["outcome"] == "Tracked"
        assert row["ate.rmse"] == pytest.approx(original["ate.rmse"], abs=1e-6)
        assert row["trajectory.poses"] == original["trajectory.poses"]


def write_system(folder: Path, name: str, points: str) -> None:
    """Write an algorithm that is the odometry beside these tests, by one kind of points."""
    folder.mkdir(parents=True)
    program = folder / "odometry.py"
    text = Path(__file__).with_name("odometry.py").read_text()
    program.write_text(f"#!{sys.executable}\n{text}")
    program.chmod(0o755)
    manifest = {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Algorithm",
        "metadata": {"name": name},
        "spec": {
            "local": {"command": [program.name]},
            "modes": [{"name": "stereo"}, {"name": "rgbd", "output": {"frame": "color"}}],
            "recording": ["Kitti", "Tum"],
            "parameters": {"points": {"type": "String", "default": points}},
            "output": {"frame": "left", "trajectory": {"path": "poses.txt", "format": "Kitti"}},
            "deterministic": "Yes",
        },
    }
    (folder / "algorithm.yaml").write_text(yaml.safe_dump(manifest))


def mirrored(
    families: Path,
    site: Site,
    name: str,
    files: dict[str, bytes],
    *,
    sensors: dict[str, str] | None = None,
    rig: dict[str, Any] | None = None,
) -> None:
    """Serve files under the paths of their publisher, and write the family that names them."""
    for path, content in files.items():
        (site.folder / path).parent.mkdir(parents=True, exist_ok=True)
        (site.folder / path).write_bytes(content)
    family = family_of(name)
    family["name"] = f"lab-{name}"
    for part in family["parts"].values():
        part["url"] = site.url + urlsplit(part["url"]).path
        part.pop("size", None)
    if rig is not None:
        family |= {"sensors": sensors, "dataset": family["dataset"] | {"sensors": rig}}
    (families / f"{family['name']}.yaml").write_text(yaml.safe_dump(family))


def family_of(name: str) -> dict[str, Any]:
    """Return a family of the catalogue, plain."""
    return dict(yaml.safe_load((catalogue_folders()[0] / f"{name}.yaml").read_text()))


def zipped(members: dict[str, bytes]) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return held.getvalue()


def tarred(folder: Path, name: str, mode: str) -> bytes:
    held = io.BytesIO()
    with tarfile.open(fileobj=held, mode=mode) as archive:  # type: ignore[call-overload]
        archive.add(folder, name)
    return held.getvalue()


def contents(folder: Path, place: str) -> dict[str, bytes]:
    return {
        f"{place}/{path.relative_to(folder)}": path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def table_of(poses: Trajectory, rest: int = 0) -> bytes:
    """Write poses as EuRoC's and TUM VI's tables have them, with zeros for what follows."""
    lines = ["#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], ..."]
    for stamp, place, (x, y, z, w) in zip(poses.stamps, poses.positions, poses.quaternions, strict=True):
        numbers = [*place, w, x, y, z, *[0.0] * rest]
        lines.append(",".join([str(round(stamp * 1e6) * 1000), *map(repr, map(float, numbers))]))
    return ("\n".join(lines) + "\n").encode()


def euroc_archive(made: Path) -> dict[str, bytes]:
    """Return a sequence in its zip, in the zip of its hall."""
    members = contents(made / "mav0", "mav0")
    members["mav0/state_groundtruth_estimate0/data.csv"] = table_of(read_tum(made / "groundtruth.txt"), 9)
    hall = zipped({"machine_hall/MH_01_easy/MH_01_easy.zip": zipped(members)})
    path = urlsplit(family_of("euroc")["parts"]["machine_hall"]["url"]).path
    return {path.lstrip("/"): hall}


def vi_archive(made: Path, folder: Path) -> dict[str, bytes]:
    """Return a tar with images of 16 bits, Kalibr's calibration of all sensors, and the IMU's poses."""
    shutil.copytree(made / "mav0", folder / "mav0")
    about = yaml.safe_load((made / "sensors.yaml").read_text())["sensors"]
    body_imu = np.array(about["imu"]["T_body_sensor"])
    chain = {}
    for name, role in (("cam0", "left"), ("cam1", "right")):
        camera = about[role]["camera"]
        chain[name] = {
            "T_cam_imu": (np.linalg.inv(about[role]["T_body_sensor"]) @ body_imu).tolist(),
            "camera_model": "pinhole",
            "distortion_model": "radtan",
            "distortion_coeffs": camera["coefficients"][:4],
            "intrinsics": [camera[key] for key in ("fx", "fy", "cx", "cy")],
            "resolution": [camera["width"], camera["height"]],
        }
        (folder / "mav0" / name / "sensor.yaml").unlink()
        for path in (folder / "mav0" / name / "data").iterdir():
            pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.uint16)
            cv2.imwrite(str(path), pixels << 8)
    noise = yaml.safe_load((folder / "mav0" / "imu0" / "sensor.yaml").read_text())
    imu = {key: value for key, value in noise.items() if key.endswith(("density", "walk"))}
    (folder / "mav0" / "imu0" / "sensor.yaml").unlink()
    (folder / "dso").mkdir()
    (folder / "dso" / "camchain.yaml").write_text(yaml.safe_dump(chain))
    (folder / "dso" / "imu_config.yaml").write_text(yaml.safe_dump(imu | {"update_rate": 200.0}))
    (folder / "mav0" / "mocap0").mkdir()
    poses = read_tum(made / "groundtruth.txt").moved(body_imu)
    (folder / "mav0" / "mocap0" / "data.csv").write_bytes(table_of(poses))
    name = "dataset-room1_512_16"
    return {f"tumvi/exported/euroc/512_16/{name}.tar": tarred(folder, name, "w")}


def tum_archive(made: Path) -> dict[str, bytes]:
    """Return a tgz; its camera is none of TUM's, so its calibration lies in it."""
    name = "rgbd_dataset_freiburg1_xyz"
    return {f"rgbd/dataset/freiburg1/{name}.tgz": tarred(made, name, "w:gz")}


def kitti_archives(made: Path) -> dict[str, bytes]:
    """Return archives of calibration, images and poses, times with six digits as KITTI's."""
    about = yaml.safe_load((made / "sensors.yaml").read_text())["sensors"]
    times = [float(line) for line in (made / "times.txt").read_text().split()]
    poses = read_tum(made / "groundtruth.txt").moved(np.array(about["left"]["T_body_sensor"]))
    at = [int(np.argmin(np.abs(poses.stamps - poses.stamps[0] - time))) for time in times]
    matrices = np.tile(np.eye(4), (len(at), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = poses.matrices[at], poses.positions[at]
    rows = (np.linalg.inv(matrices[0]) @ matrices)[:, :3].reshape(-1, 12)
    folder = "dataset/sequences/00"
    calibration = {
        f"{folder}/calib.txt": (made / "calib.txt").read_bytes(),
        f"{folder}/times.txt": "".join(f"{time:e}\n" for time in times).encode(),
    }
    poses_text = "".join(" ".join(f"{number:.12e}" for number in row) + "\n" for row in rows)
    images = contents(made / "image_0", f"{folder}/image_0") | contents(made / "image_1", f"{folder}/image_1")
    return {
        "avg-kitti/data_odometry_calib.zip": zipped(calibration),
        "avg-kitti/data_odometry_poses.zip": zipped({"dataset/poses/00.txt": poses_text.encode()}),
        "avg-kitti/data_odometry_gray.zip": zipped(images),
    }
