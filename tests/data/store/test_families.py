# SPDX-License-Identifier: Apache-2.0
"""Each family of the catalogue, added by its name: small files as its publisher has them, in their places."""

from __future__ import annotations

import io
import re
import shutil
import tarfile
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bagsamples import COLOR, FIX, GREY, HESAI, IMU, OUSTER, SCANS, VELODYNE, as_rosbag2, drive, write_bag
from layouts import asl, boreas, dense, helipr, kitti, kitti_raw, mulran, nclt, tum_rgbd

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model import catalogue
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file
from slamhive.model.sensors import SensorType, Stamp, TimesSince
from thinning import thinned

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive_eval import Trajectory

OWN = Path(catalogue.__file__).resolve().parent.parent / "catalogue"
LIDAR = "/os1_cloud_node/points"
IDENTITY = np.eye(4)


@dataclass
class Publisher:
    """Publisher of a family's files, on its servers or in the folder of what is fetched by hand.

    Attributes:
        site: Folder of the server.
        hand: Folder of what is fetched by hand.
        work: Folder for what is packed.
    """

    site: Path
    hand: Path
    work: Path

    def serve(self, address: str, content: str | bytes | Path) -> None:
        """Put a file where an address leads, without its host; of Google Drive its id."""
        place = self.site / address
        place.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, Path):
            shutil.copyfile(content, place)
        else:
            place.write_bytes(content.encode() if isinstance(content, str) else content)

    def give(self, name: str, content: str | Path) -> None:
        """Put a file or folder to those that are fetched by hand."""
        place = self.hand / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, str):
            place.write_text(content)
        else:
            shutil.move(content, place)

    def zip(self, folder: Path, top: str, *, only: str = "") -> bytes:
        """Pack a folder, whose members begin with a name or with nothing."""
        made = io.BytesIO()
        with zipfile.ZipFile(made, "w") as archive:
            for path in sorted(folder.rglob("*")):
                name = path.relative_to(folder).as_posix()
                if path.is_file() and name.startswith(only):
                    archive.write(path, f"{top}/{name}" if top else name)
        return made.getvalue()

    def tar(self, folder: Path, top: str, mode: str = "w:gz") -> bytes:
        """Pack a folder by tar."""
        made = io.BytesIO()
        with tarfile.open(fileobj=made, mode=mode) as archive:  # type: ignore[call-overload]
            archive.add(folder, top or ".")
        return made.getvalue()


@dataclass(frozen=True)
class Sample:
    """A sequence of a family.

    Attributes:
        sequence: Its name.
        publish: Puts its files where they belong.
        sensors: Kinds of its sensors, by the topics that they come from.
        stamp: What the stamps of its LiDAR mean.
        time_field: Field of the points' times, None where they have none.
        since: What these count from, where it isn't the header stamp.
        lever: Where in the body what the ground truth has poses of is, m; None: not looked at.
        positions: Positions of the ground truth; None: those of the generated drive.
    """

    sequence: str
    publish: Callable[[Publisher], object]
    sensors: dict[str, str]
    stamp: Stamp | None = None
    time_field: str | None = None
    since: TimesSince | None = None
    lever: tuple[float, float, float] | None = None
    positions: Any = field(default=None)


def tum(poses: Trajectory, *, only: str = "") -> str:
    """Return rows as the TUM format has them; ``only`` positions: with a quaternion of zeros."""
    rows = np.column_stack((poses.stamps, poses.positions, poses.quaternions * (not only)))
    return "".join(" ".join(f"{value:.9f}" for value in row) + "\n" for row in rows.tolist())


def split(poses: Trajectory, delimiter: str = ",", head: str = "") -> str:
    """Return rows with s and ns apart."""
    rows = []
    for at, position, turn in zip(
        poses.stamps.tolist(), poses.positions.tolist(), poses.quaternions.tolist(), strict=True
    ):
        nanoseconds = round(at * 1e9)
        values = (nanoseconds // 10**9, nanoseconds % 10**9, *position, *turn)
        rows.append(delimiter.join(map(repr, values)))
    return "\n".join([head, *rows] if head else rows) + "\n"


def path_of(family: str, sequence: str) -> Trajectory:
    """Return the drive of the frame whose poses a family's ground truth has."""
    spec = catalogue.load_family(OWN / f"{family}.yaml", 0).sequence_of(sequence).dataset
    truth = spec["groundTruth"]
    frame = truth.get("T_body_frame")
    if frame is None and truth.get("frame", "body") != "body":
        frame = spec["sensors"][truth["frame"]]["T_body_sensor"]
    return drive().moved(np.array(IDENTITY if frame is None else frame, dtype=np.float64))


def newer_college_2020(to: Publisher) -> None:
    topics = {LIDAR: OUSTER, "/os1_cloud_node/imu": IMU}
    names = ("2020-07-10-09-13-52_0", "2020-07-10-09-16-39_1", "2020-07-10-09-19-26_2")
    for k, name in enumerate(names):
        to.give(f"rooster_{name}.bag", write_bag(to.work / name, topics, first=4 * k, count=4))
    poses = path_of("newer-college-2020", "quad_with_dynamics")
    to.serve("1Cc7fiYUCtNL8qnvA0x-m4uQvRWQLdrWO", split(poses, head="#sec,nsec,x,y,z,qx,qy,qz,qw"))


def newer_college_mound(to: Publisher) -> None:
    for k, name in enumerate(("2020-07-10-09-31-24_0", "2020-07-10-09-34-11_1", "2020-07-10-09-36-58_2")):
        bag = write_bag(to.work / name, {LIDAR: OUSTER, "/os1_cloud_node/imu": IMU}, first=4 * k, count=4)
        to.give(f"rooster_{name}.bag", bag)
    to.serve("1CMcmw9pAT1Mm-Zh-nS87i015CO-xFHwl", tum(path_of("newer-college-2020", "parkland_mound")))


def newer_college_2021(to: Publisher) -> None:
    topics = {"/os_cloud_node/points": OUSTER, "/os_cloud_node/imu": IMU}
    to.serve("1hF2h83E1THbFAvs7wpR6ORmrscIHxKMo", write_bag(to.work / "a.bag", topics))
    to.serve("1BdQiOhb_NW7VqjNtbbRAjI0JH56uKFI-", split(path_of("newer-college-2021", "quad_easy")))


def oxford_spires(to: Publisher) -> None:
    color = (COLOR, (1080, 1440))
    cameras = {f"/alphasense_driver_ros/cam{k}/debayered/image/compressed": color for k in range(3)}
    topics = {"/hesai/pandar": HESAI, "/alphasense_driver_ros/imu": IMU, **cameras}
    bag = write_bag(to.work / "a.bag", topics)
    name = "1710755015_2024-03-18-09-43-36_0_blurred_filtered"
    to.give("christ_church_03", as_rosbag2(bag, to.work / "recording", name))
    lines = tum(path_of("oxford-spires", "christ_church_03")).splitlines(keepends=True)
    # Each pose is there again 3 ms later, which is not to be taken.
    again = [re.sub(r"^\S+", lambda found: f"{float(found[0]) + 0.003:.9f}", line) for line in lines]
    both = "".join(line for pair in zip(lines, again, strict=True) for line in pair)
    folder = "datasets/ori-drs/oxford_spires_dataset/resolve/main/sequences/2024-03-18-christ-church-03"
    to.serve(f"{folder}/processed/trajectory/gt-tum.txt", both)


def oxford_spires_in_two(to: Publisher) -> None:
    for k, name in enumerate(("1710752531_2024-03-18-09-02-12_0", "1710752531_2024-03-18-09-11-55_1")):
        topics = {"/hesai/pandar": HESAI, "/alphasense_driver_ros/imu": IMU}
        cameras = {
            f"/alphasense_driver_ros/cam{n}/debayered/image/compressed": (COLOR, (1080, 1440))
            for n in range(3)
        }
        bag = write_bag(to.work / f"{name}.bag", topics | cameras, first=6 * k, count=6)
        to.give(name, as_rosbag2(bag, to.work / name, name))
    folder = "datasets/ori-drs/oxford_spires_dataset/resolve/main/sequences/2024-03-18-christ-church-01"
    to.serve(f"{folder}/processed/trajectory/gt-tum.txt", tum(path_of("oxford-spires", "christ_church_01")))


def ntu_viral(to: Publisher) -> None:
    grey = (GREY, (480, 752))
    topics = {"/os1_cloud_node1/points": OUSTER, "/os1_cloud_node2/points": OUSTER, "/imu/imu": IMU}
    write_bag(to.work / "in" / "eee_01.bag", topics | {"/left/image_raw": grey, "/right/image_raw": grey})
    to.serve("api/access/datafile/68133", to.zip(to.work / "in", "eee_01"))
    poses = path_of("ntu-viral", "eee_01")
    rows = ["%time,field.header.seq,field.header.stamp,field.pose.position.x,field.pose.position.y,z,x,y,z,w"]
    for k, (at, place) in enumerate(zip(poses.stamps.tolist(), poses.positions.tolist(), strict=True)):
        stamp = round(at * 1e9)
        rows.append(",".join(map(str, (stamp + 12345, 8715 + k, stamp, *place, 0.0, 0.0, 0.0, 1.0))))
    to.serve("ntu-aris/ntuviral_gt/master/eee_01/ground_truth.csv", "\n".join(rows) + "\n")


def m2dgr(to: Publisher) -> None:
    color = (COLOR, (480, 640))
    topics = {"/velodyne_points": VELODYNE, "/handsfree/imu": IMU, "/ublox/fix": FIX}
    bag = write_bag(to.work / "a.bag", topics | {"/camera/color/image_raw/compressed": color})
    to.give("hall_01.bag", bag)
    to.give("hall_01.txt", tum(path_of("m2dgr", "hall_01"), only="positions"))


def geode(to: Publisher) -> None:
    to.give("Offroad1_beta.bag", write_bag(to.work / "a", {"/ouster/points": OUSTER, "/imu/data": IMU}))
    to.give("Offroad1.txt", tum(path_of("geode", "Offroad1_beta"), only="positions"))


def hilti(to: Publisher) -> None:
    bag = write_bag(to.work / "a.bag", {"/hesai/pandar": HESAI, "/alphasense/imu": IMU})
    place = "datasets/Hilti-Research/hilti-slam-challenge-2022/resolve/main"
    to.serve(f"{place}/rosbags/exp04_construction_upper_level.bag", bag)
    to.serve(f"{place}/ground_truth/exp_04_construction_upper_level_imu.txt", tum(drive()))


def hilti_points(to: Publisher) -> None:
    bag = write_bag(to.work / "a.bag", {"/hesai/pandar": HESAI, "/alphasense/imu": IMU})
    place = "datasets/Hilti-Research/hilti-slam-challenge-2022/resolve/main"
    to.serve(f"{place}/rosbags/exp21_outside_building.bag", bag)
    points = "# timestamp_s id x y z \n" + tum(path_of("hilti-2022", "exp21_outside_building"))
    place = "Hilti-Research/hilti-slam-challenge-2022/HEAD/groundtruth_2022"
    to.serve(f"{place}/exp21_outside_building.txt", points)


def hilti_2023(to: Publisher) -> None:
    bag = write_bag(to.work / "a.bag", {"/hesai/pandar": HESAI, "/alphasense/imu": IMU})
    to.serve("Challenges/2023/site3_handheld_2.bag", bag)
    place = "Hilti-Research/hilti-slam-challenge-2023/HEAD/groundtruth_2023"
    to.serve(f"{place}/site3_handheld_2.txt", tum(path_of("hilti-2023", "site3_handheld_2")))


def mcd(to: Publisher) -> None:
    to.serve(
        "127Rk2jX4I95CEWK1AOZRD9AQRxRVlWjY", write_bag(to.work / "a.bag", {"/os_cloud_node/points": OUSTER})
    )
    to.serve("1bBKRlzwG4v7K4mBmLAQzfwp_O6yOR0Ld", write_bag(to.work / "b.bag", {"/vn100/imu": IMU}))
    rows = tum(drive()).splitlines()
    numbered = [",".join((str(k), *row.split())) for k, row in enumerate(rows)]
    to.serve("1Pdj4_0SRES4v9WiyCVp8dYMcRvE8X3iH", "\n".join(["num,t,x,y,z,qx,qy,qz,qw", *numbered]) + "\n")


def enwide(to: Publisher) -> None:
    bag = write_bag(to.work / "a.bag", {"/ouster/points": OUSTER, "/ouster/imu": IMU})
    to.give("2023-08-08-17-12-37-tunnel_s.bag", bag)
    poses = path_of("enwide", "tunnel_s")
    rows = np.column_stack((poses.stamps, poses.positions)).tolist()
    to.give("gt-tunnel_s.csv", "".join(" ".join(f"{value:.18e}" for value in row) + "\n" for row in rows))


def botanic(to: Publisher) -> None:
    topics = {"/velodyne_points": VELODYNE, "/imu/data": IMU}
    to.give("1008_03.bag", write_bag(to.work / "a.bag", topics, back=True))
    to.give("1008_03_gt_output.txt", tum(path_of("botanic-garden", "1008_03")))


def euroc(to: Publisher) -> None:
    folder = asl.write_euroc(to.work / "MH_01_easy")
    (folder / "mav0" / "state_groundtruth_estimate0").mkdir()
    rows = [f"{asl.START + 5_000_000 * k},{k},0,0,1,0,0,0" + ",0" * 9 for k in range(80)]
    text = "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z\n" + "\n".join(rows) + "\n"
    (folder / "mav0" / "state_groundtruth_estimate0" / "data.csv").write_text(text)
    inner = to.work / "hall" / "MH_01_easy" / "MH_01_easy.zip"
    inner.parent.mkdir(parents=True)
    inner.write_bytes(to.zip(folder, ""))
    place = "server/api/core/bitstreams/7b2419c1-62b5-4714-b7f8-485e5fe3e5fe/content"
    to.serve(place, to.zip(to.work / "hall", "machine_hall"))


def tum_vi(to: Publisher) -> None:
    folder = asl.tum_vi(asl.write_asl, to.work / "room1")
    name = "dataset-room1_512_16"
    to.serve(f"tumvi/exported/euroc/512_16/{name}.tar", to.tar(folder, name, "w"))


def msd(to: Publisher) -> None:
    name = "MIPP01_pistolwhip_blackmagic_hard"
    folder = asl.monado(asl.write_asl, to.work / name)
    place = "datasets/collabora/monado-slam-datasets/resolve/main/M_monado_datasets/MI_valve_index"
    to.serve(f"{place}/extras/calibration.json", (folder / "calibration.json").read_text())
    to.serve(f"{place}/MIP_playing/MIPP_pistol_whip/{name}.zip", to.zip(folder, name, only="mav0"))


def lamaria(to: Publisher) -> None:
    folder = asl.write_asl(to.work / "R_01_easy", base="aria")
    to.serve("lamaria/asl_folder/training/R_01_easy.zip", to.zip(folder, "R_01_easy"))
    to.serve("lamaria/pinhole_calibrations/training/R_01_easy.json", asl.lamaria_calibration())
    to.serve("lamaria/ground_truth/pseudo_dense/R_01_easy.txt", asl.lamaria_truth())


def tum_desk(to: Publisher) -> None:
    name = "rgbd_dataset_freiburg1_xyz"
    folder = tum_rgbd.rgbd(asl.write_png, to.work / name)
    to.serve(f"rgbd/dataset/freiburg1/{name}.tgz", to.tar(folder, name))


def bonn(to: Publisher) -> None:
    folder = tum_rgbd.rgbd(asl.write_png, to.work / "balloon")
    to.serve("html/projects/rgbd_dynamic2019/rgbd_bonn_balloon.zip", to.zip(folder, "rgbd_bonn_balloon"))


def eth3d(to: Publisher) -> None:
    folder = tum_rgbd.eth3d(asl.write_png, to.work / "cables_1")
    (depth := to.work / "depth").mkdir()
    for name in ("depth", "depth.txt"):
        shutil.move(folder / name, depth / name)
    to.serve("data/slam/datasets/cables_1_mono.zip", to.zip(folder, "cables_1"))
    to.serve("data/slam/datasets/cables_1_rgbd.zip", to.zip(depth, "cables_1"))


def icl(to: Publisher) -> None:
    folder = tum_rgbd.icl(asl.write_png, to.work / "kt0")
    to.serve("~ahanda/living_room_traj0_frei_png.tar.gz", to.tar(folder, ""))


def openloris(to: Publisher) -> None:
    folder = tum_rgbd.loris(asl.write_png, to.work / "cafe1-1")
    inner = to.work / "package" / "cafe1-1.7z"
    inner.parent.mkdir()
    # What an archive is, its first bytes tell; where bsdtar is, test_a_7z_is_read_by_bsdtar reads one.
    inner.write_bytes(to.tar(folder, "cafe1-1"))
    place = "datasets/shixuesong/openloris-scene/resolve/main/package/cafe1-1_2-package.tar"
    with tarfile.open(to.work / "package.tar", "w") as archive:
        archive.add(inner, "cafe1-1.7z")
    to.serve(place, to.work / "package.tar")


def kitti_of(to: Publisher, kind: str) -> None:
    root = to.work / "kitti"
    folder = kitti.write_sequence(root, "08")
    images = to.work / kind / "sequences" / "08"
    images.mkdir(parents=True)
    for name in ("image_0", "image_1") if kind == "gray" else ("velodyne",):
        shutil.move(folder / name, images / name)
    calibration = {name: folder / name for name in ("calib.txt", "times.txt")}
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, path in calibration.items():
            archive.write(path, f"dataset/sequences/08/{name}")
    to.serve("avg-kitti/data_odometry_calib.zip", made.getvalue())
    to.serve("avg-kitti/data_odometry_poses.zip", to.zip(root, "dataset", only="poses"))
    to.serve(f"avg-kitti/data_odometry_{kind}.zip", to.zip(to.work / kind, "dataset"))


def raw(to: Publisher) -> None:
    kitti_raw.write_drive(to.work / "raw", first=1098)
    date, name = "2011_09_30", "2011_09_30_drive_0028"
    folder = to.work / "raw" / date
    to.serve(f"avg-kitti/raw_data/{date}_calib.zip", to.zip(folder, date, only="calib"))
    to.serve(f"avg-kitti/raw_data/{name}/{name}_sync.zip", to.zip(folder, date, only=f"{name}_sync"))


def tartanair(to: Publisher) -> None:
    folder = dense.write_trajectory(to.work / "P011", size=(480, 640))
    top, place = "ocean/ocean/Hard/P009", "datasets/theairlabcmu/tartanair/resolve/main/ocean/Hard"
    for kind in ("image_left", "image_right", "depth_left"):
        part = to.work / kind
        part.mkdir()
        shutil.copytree(folder / kind, part / kind)
        if kind.startswith("image"):
            name = f"pose_{kind.removeprefix('image_')}.txt"
            shutil.copyfile(folder / name, part / name)
        to.serve(f"{place}/{kind}.zip", to.zip(part, top))


def replica(to: Publisher) -> None:
    dense.write_scene(to.work / "Replica")
    to.serve("nice-slam/data/Replica.zip", to.zip(to.work / "Replica", "Replica"))


def nclt_session(to: Publisher) -> None:
    folder = nclt.write_session(to.work)
    truth = folder / "groundtruth_2012-01-08.csv"
    bucket = "nclt.perl.engin.umich.edu"
    to.serve(f"{bucket}/ground_truth/{truth.name}", truth)
    truth.unlink()
    (folder / "velodyne_hits.bin").write_bytes(b"hits")
    to.serve(f"{bucket}/velodyne_data/2012-01-08_vel.tar.gz", to.tar(folder, "2012-01-08"))


def helipr_town(to: Publisher) -> None:
    root = helipr.write_sequence(to.work / "a", "Ouster", helipr.some("Ouster"))
    to.serve("1FM5L17x12Lh3byp9m4h8njB-4RCP4HeZ", to.tar(root / "LiDAR" / "Ouster", "Ouster"))
    to.serve("17S4649polOCfN0IOBCCxQ85UrdXf1jhF", root / "LiDAR_GT" / "Ouster_gt.txt")
    to.serve("1R0Z7Z9BAhqOSNsD1ft6vqenH644rxXk9", mulran.imu_rows())


STEREO_IMU = {"/cam0/image_raw": "left", "/cam1/image_raw": "right", "/imu0": "imu"}
RGBD = {"/color/image_raw": "color", "/depth/image_raw": "depth"}
FORWARD = [[k, 0, 0] for k in range(4)]
START_OF_SCAN = {"stamp": Stamp.SCAN_START, "time_field": "t"}
SAMPLES = {
    "newer-college-2020": Sample(
        "quad_with_dynamics",
        newer_college_2020,
        {LIDAR: "lidar", "/os1_cloud_node/imu": "imu"},
        lever=(0.035643, 0.089026, -0.021653),
        **START_OF_SCAN,  # type: ignore[arg-type]
    ),
    "newer-college-2020 parkland": Sample(
        "parkland_mound",
        newer_college_mound,
        {LIDAR: "lidar", "/os1_cloud_node/imu": "imu"},
        lever=(0.035643, 0.089026, -0.021653),
        **START_OF_SCAN,  # type: ignore[arg-type]
    ),
    "newer-college-2021": Sample(
        "quad_easy",
        newer_college_2021,
        {"/os_cloud_node/points": "lidar", "/os_cloud_node/imu": "imu"},
        lever=(0.013642, -0.011607, -0.10583),
        **START_OF_SCAN,  # type: ignore[arg-type]
    ),
    "oxford-spires": Sample(
        "christ_church_03",
        oxford_spires,
        {
            "/hesai/pandar": "lidar",
            "/alphasense_driver_ros/imu": "imu",
            "/alphasense_driver_ros/cam0/debayered/image/compressed": "camera",
            "/alphasense_driver_ros/cam1/debayered/image/compressed": "camera2",
            "/alphasense_driver_ros/cam2/debayered/image/compressed": "camera3",
        },
        stamp=Stamp.SCAN_START,
        time_field="timestamp",
    ),
    "oxford-spires in two": Sample(
        "christ_church_01",
        oxford_spires_in_two,
        {"/hesai/pandar": "lidar", "/alphasense_driver_ros/imu": "imu"},
        stamp=Stamp.SCAN_START,
        time_field="timestamp",
    ),
    "ntu-viral": Sample(
        "eee_01",
        ntu_viral,
        {
            "/os1_cloud_node1/points": "lidar",
            "/os1_cloud_node2/points": "lidar2",
            "/imu/imu": "imu",
            "/left/image_raw": "left",
            "/right/image_raw": "right",
        },
        stamp=Stamp.SCAN_END,
        time_field="t",
        since=TimesSince.SCAN_START,
        lever=(-0.293656, -0.012288, -0.273095),
    ),
    "m2dgr": Sample(
        "hall_01",
        m2dgr,
        {
            "/velodyne_points": "lidar",
            "/handsfree/imu": "imu",
            "/camera/color/image_raw/compressed": "color",
            "/ublox/fix": "gnss",
        },
        stamp=Stamp.SAMPLE,
        time_field="time",
        lever=(-0.21374, 0.00146, 0.68356),
    ),
    "geode": Sample(
        "Offroad1_beta",
        geode,
        {"/ouster/points": "lidar", "/imu/data": "imu"},
        stamp=Stamp.SAMPLE,
        time_field="t",
        lever=(-0.027172, -0.034873, 0.062643),
    ),
    "hilti-2022": Sample(
        "construction_upper_level_1",
        hilti,
        {"/hesai/pandar": "lidar", "/alphasense/imu": "imu"},
        stamp=Stamp.SCAN_START,
        time_field="timestamp",
        lever=(0, 0, 0),
    ),
    "hilti-2022 points": Sample(
        "exp21_outside_building",
        hilti_points,
        {"/hesai/pandar": "lidar", "/alphasense/imu": "imu"},
        stamp=Stamp.SCAN_START,
        time_field="timestamp",
        lever=(0.059, -0.00855, 0.1964),
    ),
    "hilti-2023": Sample(
        "site3_handheld_2",
        hilti_2023,
        {"/hesai/pandar": "lidar", "/alphasense/imu": "imu"},
        stamp=Stamp.SCAN_START,
        time_field="timestamp",
        lever=(0.059, -0.00855, 0.1964),
    ),
    "mcd": Sample(
        "ntu_day_01",
        mcd,
        {"/os_cloud_node/points": "lidar", "/vn100/imu": "imu"},
        stamp=Stamp.SCAN_END,
        time_field="t",
        since=TimesSince.SCAN_START,
        lever=(0, 0, 0),
    ),
    "enwide": Sample(
        "tunnel_s",
        enwide,
        {"/ouster/points": "lidar", "/ouster/imu": "imu"},
        lever=(-0.006253, 0.011775, 0.10825),
        **START_OF_SCAN,  # type: ignore[arg-type]
    ),
    "botanic-garden": Sample(
        "1008_03",
        botanic,
        {"/velodyne_points": "lidar", "/imu/data": "imu"},
        stamp=Stamp.SCAN_END,
        time_field="time",
        lever=(0.0584867782, 0.00840419967, 0.168915522),
    ),
    "euroc": Sample("MH_01_easy", euroc, STEREO_IMU, positions=[[k, 0, 0] for k in range(80)]),
    "tum-vi": Sample("room1", tum_vi, STEREO_IMU, positions=[[0.01 * k, 0, 0] for k in range(48)]),
    "msd": Sample("MIPP01_pistolwhip_blackmagic_hard", msd, STEREO_IMU, positions=FORWARD),
    "lamaria": Sample("R_01_easy", lamaria, STEREO_IMU, positions=FORWARD),
    "tum-rgbd": Sample("freiburg1_xyz", tum_desk, RGBD, positions=[[k, 0, 0] for k in range(20)]),
    "bonn-rgbd": Sample("balloon", bonn, RGBD, positions=[[k, 0, 0] for k in range(20)]),
    "eth3d": Sample("cables_1", eth3d, RGBD, positions=[[k, 0, 0] for k in range(20)]),
    "icl-nuim": Sample(
        "living_room_kt0", icl, RGBD, positions=[[0.1 * n, -0.2, -2.25] for n in (1, 2, 3, 4, 10)]
    ),
    "openloris": Sample(
        "cafe1-1", openloris, RGBD | {"/imu": "imu"}, positions=[[k, 0, 0] for k in range(20)]
    ),
    "kitti": Sample(
        "08",
        lambda to: kitti_of(to, "gray"),
        {"/image_0/image_raw": "left", "/image_1/image_raw": "right"},
        positions=[[0.5, 0, k] for k in range(6)],
    ),
    "kitti-velodyne": Sample(
        "08",
        lambda to: kitti_of(to, "velodyne"),
        {"/velodyne": "lidar"},
        positions=[[0.5, 0, k] for k in range(6)],
    ),
    "kitti-raw": Sample(
        "08",
        raw,
        {
            "/image_0/image_raw": "left",
            "/image_1/image_raw": "right",
            "/velodyne": "lidar",
            "/imu": "imu",
        },
        stamp=Stamp.SCAN_START,
        time_field="time",
    ),
    "tartanair": Sample(
        "ocean_Hard_P009",
        tartanair,
        {"/left/image_raw": "left", "/right/image_raw": "right", "/depth_left/image_raw": "depth"},
        positions=[[10 + k, -20, 5] for k in range(3)],
    ),
    "replica": Sample("office0", replica, RGBD, positions=FORWARD[:3]),
    "nclt": Sample(
        "2012-01-08",
        nclt_session,
        {"/velodyne": "lidar"},
        stamp=Stamp.SAMPLE,
        positions=[[k, -2, 3] for k in range(3)],
    ),
    "mulran": Sample(
        "KAIST01",
        lambda to: to.give("KAIST01", mulran.write_sequence(to.work / "KAIST01")),
        {"/ouster": "lidar", "/imu": "imu"},
        stamp=Stamp.SCAN_START,
        time_field="time",
        positions=[[353000.5, 4026000 + k, 20] for k in range(2)],
    ),
    "helipr": Sample(
        "kaist_05",
        helipr_town,
        {"/ouster": "lidar", "/imu": "imu"},
        stamp=Stamp.SCAN_START,
        time_field="time",
        positions=FORWARD[:3],
    ),
    "boreas": Sample(
        "2021-09-02-11-42",
        lambda to: to.give("boreas-2021-09-02-11-42", boreas.write_sequence(to.work / "a")),
        {"/lidar": "lidar"},
        stamp=Stamp.SCAN_MID,
        time_field="time",
        positions=[[k, 2, 3] for k in range(3)],
    ),
}
"""A sequence of each family, by the family and what is particular of it."""


@pytest.fixture
def added(
    site: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Any
) -> Callable[[str], DatasetEntry]:
    """Add the sample of a family by its name, from servers that stand in for its own."""

    def add(title: str) -> DatasetEntry:
        family, sample = title.split(maxsplit=1)[0], SAMPLES[title]
        (folder := tmp_path / "families").mkdir()
        text = re.sub(r'(url: "?)https://[^/]+', rf"\g<1>{site.url}", (OWN / f"{family}.yaml").read_text())
        # Samples are smaller than what they stand for, and have other checksums.
        text = re.sub(r"\n +size: \d+|\b(sizes|sha256): \{[^}]*\},? ?", "", text)
        (folder / f"{family}.yaml").write_text(text)
        monkeypatch.setattr(catalogue, "catalogue_folders", lambda: [folder])
        monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
        (work := tmp_path / "work").mkdir()
        sample.publish(Publisher(site.folder, tmp_path / "home" / "downloads" / family, work))
        code, _, said = run_command("dataset", "add", f"{family}/{sample.sequence}", "--name", "sample")
        assert code == 0, said
        manifest = tmp_path / "home" / "datasets" / "sample" / "dataset.yaml"
        dataset = load_file(manifest)[0]
        assert isinstance(dataset, Dataset)
        assert dataset.spec.catalogue == f"{family}/{sample.sequence}"
        return DatasetEntry(dataset, manifest.parent)

    return add


def test_there_is_a_sample_of_each_family() -> None:
    assert {title.split()[0] for title in SAMPLES} == {path.stem for path in OWN.glob("*.yaml")}


@pytest.mark.parametrize("title", thinned(SAMPLES))
def test_a_family_is_added_by_its_name(added: Callable[[str], DatasetEntry], title: str) -> None:
    sample, entry = SAMPLES[title], added(title)
    sensors = entry.dataset.spec.sensors
    found = {sensor.topic: name for name, sensor in sensors.items()}
    assert found.items() >= sample.sensors.items()
    family = catalogue.load_family(OWN / f"{title.split(maxsplit=1)[0]}.yaml", 0)
    for name in sensors:
        assert sensors[name].type is family.head.sensors.get(name, sensors[name].type)
    if "lidar" in sensors and sample.stamp is not None:
        lidar = sensors["lidar"].lidar
        meaning = (sensors["lidar"].stamp, lidar.time_field, lidar.times_since)
        assert meaning == (sample.stamp, sample.time_field, sample.since)
    report, truth = inspect(entry), ground_truth(entry)
    assert "points.times.stamp" not in {finding.code for finding in report.findings}
    assert truth is not None
    if sample.lever is not None:
        assert truth.T_body_frame[:3, 3].tolist() == pytest.approx(sample.lever)
    if family.head.layout == catalogue.BAG:
        expected = path_of(family.name, sample.sequence)
        assert np.abs(truth.poses.stamps - expected.stamps).max() < 1e-6
        assert np.abs(truth.poses.positions - expected.positions).max() < 1e-6
        if truth.kind == "poses":
            assert np.abs(np.sum(truth.poses.quaternions * expected.quaternions, axis=1)).min() > 1 - 1e-9
        frames = [one.messages for one in report.sensors if one.type is not SensorType.IMU]
        assert frames == [SCANS] * len(frames)
    elif sample.positions is not None:
        assert np.abs(truth.poses.positions - np.array(sample.positions)).max() < 1e-6
    assert report.errors == []


def test_all_that_is_to_be_fetched_by_hand_is_named_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Any
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    code, _, said = run_command("dataset", "add", "newer-college-2020/parkland_mound")
    said = re.sub(r"\s+", " ", said)
    assert code == 2
    assert "rooster_2020-07-10-09-36-58_2.bag are to be fetched by hand: log in" in said
    code, _, said = run_command("dataset", "add", "boreas/2021-09-02-11-42")
    assert (code, "aws s3 sync --no-sign-request" in re.sub(r"\s+", " ", said)) == (2, True)
