# SPDX-License-Identifier: Apache-2.0
"""Archives as publishers of datasets give them away, written from exports of a generated recording."""

from __future__ import annotations

import io
import shutil
import tarfile
import zipfile
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import yaml

from slamhive.model.catalogue import catalogue_folders
from slamhive_eval import Trajectory, read_tum

if TYPE_CHECKING:
    from pathlib import Path


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
