# SPDX-License-Identifier: Apache-2.0
"""Import of folders in the ASL layout of the EuRoC MAV dataset, and of those that others publish in it.

``mav0/cam*``, ``imu0`` and ground truth, with the calibration of EuRoC (sensor.yaml), TUM VI (a Kalibr
camchain), Monado (Basalt's JSON) or LaMAria (JSON; its mav0 is named aria).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.data.importers import calibrations
from slamhive.data.importers.contents import (
    Contents,
    ImportedTruth,
    SensorStream,
    camera_encoding,
    camera_stream,
    imu_stream,
    measured_rate,
)
from slamhive.data.importers.lists import read_images
from slamhive.data.importers.sequences import sequence_folder
from slamhive.data.importers.tables import read_table
from slamhive.data.recordings.thinning import partners, rate_of
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError
from slamhive.model.sensors import Camera, Sensor
from slamhive_eval import EvaluationError, Trajectory, read_trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.importers import ImportOptions
    from slamhive.data.importers.calibrations import Calibration

TITLE = "a folder in EuRoC's layout (mav0/), also TUM VI's, Monado's and LaMAria's"

_BASES = ("mav0", "aria")
_TRUTHS = (
    "state_groundtruth_estimate0/data.csv",
    "mocap0/data.csv",
    "gt/data.csv",
    "../groundtruth.txt",
    "groundtruth.txt",
    "../ground_truth/pGT/*.txt",
    "../ground_truth/pseudo_dense/*.txt",
)
_IMU_ROW = "a stamp in ns, angular velocities, specific forces"
_MARKERS = ("vicon0", "leica0")
_LONG_GAP_SECONDS = 10.0


class _EurocRig(NamedTuple):
    """Calibration of the sensors by the names of their folders, and the layout that it is in."""

    sensors: dict[str, Calibration]
    family: str


def recognises(source: Path) -> bool:
    """Tell whether something is a folder with mav0 (of LaMAria: aria), that folder, or has such in it."""
    return _is_sequence(source) or any(next(source.glob(f"*/{name}"), None) for name in _BASES)


def _is_sequence(source: Path) -> bool:
    return (source / "mav0").is_dir() or any((path / "cam0").is_dir() for path in (source, source / "aria"))


def read(source: Path, options: ImportOptions) -> Contents:
    """Read a folder in EuRoC's layout: the folder with mav0, or mav0 itself, or one of several.

    The body frame is the one of its calibration, the IMU's.

    Raises:
        DataError: Something in the folder is missing or damaged.
        InputError: There are several sequences in it, and none is chosen.
    """
    source = sequence_folder(source, options.sequence, _is_sequence)
    base = next((source / name for name in _BASES if (source / name).is_dir()), source)
    cameras = [path for path in sorted(base.glob("cam[0-9]")) if _is_sensor(path, "images")]
    imus = [path for path in sorted(base.glob("imu[0-9]")) if _is_sensor(path, "samples")][:1]
    if not cameras and not imus:
        raise DataError(
            f"{base}: no cam0/data.csv and no imu0/data.csv in it: not a folder in EuRoC's layout"
        )
    notes: list[str] = []
    rig = _calibration(base, cameras, imus, notes)
    roles = ["camera"] if len(cameras) == 1 else ["left", "right", *(path.name for path in cameras[2:])]
    streams = [
        _camera(path, role, rig.sensors[path.name], notes) for path, role in zip(cameras, roles, strict=False)
    ]
    _note_pairs(streams, notes)
    streams += [_imu(path, rig.sensors[path.name], notes) for path in imus]
    return Contents(
        description=f"Imported from a folder in {rig.family} layout.",
        streams=streams,
        truth=_truth(base, streams, notes),
        gravity_aligned=True,
        notes=notes,
    )


def _is_sensor(folder: Path, what: str) -> bool:
    if (folder / "data.csv").is_file():
        return True
    if (folder / "data").is_dir() or (folder / "sensor.yaml").is_file():
        raise DataError(f"{folder / 'data.csv'} does not exist: it lists the {what} and their stamps")
    return False


def _calibration(base: Path, cameras: list[Path], imus: list[Path], notes: list[str]) -> _EurocRig:
    """Read the calibration of all sensors, wherever the layout has it."""
    names = [path.name for path in cameras]
    lacking = [path for path in (*cameras, *imus) if not (path / "sensor.yaml").is_file()]
    around = (base.parent, base)
    chain = _first(around, "dso/camchain*.yaml", "camchain*.yaml")
    pinholes = _first(around, "pinhole_calibrations/*.json")
    basalt = _first(around, "*calib*.json", "extras/*calib*.json", "../extras/*calib*.json")
    if not lacking:
        found = {path.name: calibrations.read_asl_camera(path / "sensor.yaml") for path in cameras}
        found |= {path.name: calibrations.read_asl_imu(path / "sensor.yaml") for path in imus}
        return _EurocRig(found, "EuRoC's")
    if chain is not None:
        imu = _first((chain.parent,), "imu_config.yaml", "imu*.yaml")
        found = calibrations.read_kalibr(chain, names)
        if imu is not None:
            found |= {path.name: calibrations.read_kalibr_imu(imu) for path in imus}
        return _EurocRig(_with_imu(found, imus, chain, notes), "TUM VI's")
    if pinholes is not None:
        found = calibrations.read_lamaria(pinholes, names)
        return _EurocRig(_with_imu(found, imus, pinholes, notes), "LaMAria's")
    if basalt is not None:
        return _EurocRig(calibrations.read_basalt(basalt, names), "Monado's")
    raise DataError(
        f"{lacking[0] / 'sensor.yaml'} does not exist, and there is no calibration of all sensors beside "
        f"{base.name}: dso/camchain.yaml (TUM VI), calibration.json (Monado) or pinhole_calibrations/*.json "
        "(LaMAria)"
    )


def _first(folders: tuple[Path, ...], *patterns: str) -> Path | None:
    found = (path for folder in folders for pattern in patterns for path in sorted(folder.glob(pattern)))
    return next(found, None)


def _with_imu(
    found: dict[str, Calibration], imus: list[Path], source: Path, notes: list[str]
) -> dict[str, Calibration]:
    """Add the IMU, which is the body, where nothing is stated of it."""
    for path in imus:
        if path.name not in found:
            found[path.name] = calibrations.Calibration(source, np.eye(4))
            notes.append(
                f"{path.name}: its noise is not stated beside {source.name}; typical noise is assumed"
            )
    return found


def _camera(folder: Path, role: str, known: Calibration, notes: list[str]) -> SensorStream:
    images = read_images(folder / "data.csv", folder / "data", "ns")
    notes += images.notes
    camera = known.camera | {"encoding": camera_encoding(images.files[0], str(folder), notes)}
    sensor = Sensor.model_validate(
        {
            "type": "Camera",
            "topic": f"/{folder.name}/image_raw",
            "frameId": folder.name,
            "rate": known.rate or measured_rate(images.stamps),
            "timeOffset": known.time_offset,
            "T_body_sensor": known.pose.tolist(),
            "camera": Camera.model_validate(camera),
        }
    )
    return camera_stream(role, sensor, images.stamps, images.files, known.source)


def _imu(folder: Path, known: Calibration, notes: list[str]) -> SensorStream:
    table = read_table(folder / "data.csv", 6, _IMU_ROW, stamp="ns")
    samples = table.ascending("samples", notes)
    sensor = Sensor.model_validate(
        {
            "type": "Imu",
            "topic": f"/{folder.name}",
            "frameId": folder.name,
            "rate": known.rate or measured_rate(samples.stamps),
            "T_body_sensor": known.pose.tolist(),
            "imu": known.imu,
        }
    )
    return imu_stream("imu", sensor, samples.stamps, samples.values[:, :3], samples.values[:, 3:])


def _note_pairs(streams: list[SensorStream], notes: list[str]) -> None:
    """Say how many frames of a pair have no partner: rows of the same number don't belong together then."""
    if len(streams) < 2:
        return
    left, right = streams[:2]
    rate = rate_of(left.stamps)
    pairs = partners(left.stamps, right.stamps, 0.5e9 / rate if rate else 0.5e9)
    alone = int(np.count_nonzero(pairs < 0))
    rest = right.stamps.size - (pairs.size - alone)
    if alone or rest:
        notes.append(
            f"{left.name} and {right.name} have {left.stamps.size} and {right.stamps.size} images; "
            f"{alone} and {rest} of them have no partner. Images are paired by their stamps"
        )


def _truth(base: Path, streams: list[SensorStream], notes: list[str]) -> ImportedTruth | None:
    sources = [path for pattern in _TRUTHS if (path := _first((base,), pattern)) is not None]
    source = next(iter(sources), None)
    if source is None:
        markers = [name for name in _MARKERS if (base / name).is_dir()]
        if markers:
            notes.append(
                f"no ground truth: {' and '.join(markers)} hold poses of a marker, not of the body, and are "
                "left out"
            )
        return None
    if len(sources) > 1:
        named = [str(path.resolve().relative_to(base.resolve().parent)) for path in sources]
        notes.append(f"groundTruth: {named[0]} is taken; there is {', '.join(named[1:])}, too")
    manifest = GroundTruth(file="groundtruth.txt")
    try:
        poses = _poses(source)
    except EvaluationError as error:
        raise DataError(f"ground truth: {error}") from None
    if source.parent.name.startswith("state_") and "V1_01" in str(base.parent.name):
        notes.append(
            "the orientation of V1_01's published ground truth is inaccurate; OpenVINS (ov_data) offers a "
            "recomputed one"
        )
    _note_gap(poses, streams, notes)
    if any((base.parent / "ground_truth" / name).is_dir() for name in ("control_points", "sparse")):
        notes.append(
            "LaMAria's control points are left out: they are seen in images, not passed by the body; the "
            "pseudo-dense poses are the ground truth"
        )
    return ImportedTruth(manifest, source if source.name == "groundtruth.txt" else poses)


def _poses(source: Path) -> Trajectory:
    if source.suffix == ".csv":
        return read_trajectory(source, "euroc")
    poses = read_trajectory(source, "tum") if source.name == "groundtruth.txt" else None
    # LaMAria's have the columns of TUM, but stamps in ns.
    return poses or _in_nanoseconds(source)


def _in_nanoseconds(source: Path) -> Trajectory:
    samples = read_table(source, 7, "a stamp in ns, tx ty tz qx qy qz qw", stamp="ns")
    return Trajectory(samples.stamps / 1e9, samples.values[:, :3], samples.values[:, 3:])


def _note_gap(poses: Trajectory, streams: list[SensorStream], notes: list[str]) -> None:
    """Say where ground truth is absent for long: TUM VI's is, but in a room."""
    steps = np.diff(poses.stamps)
    gap = int(np.argmax(steps)) if steps.size else 0
    if steps.size and steps[gap] > _LONG_GAP_SECONDS:
        start = min(float(stream.stamps[0]) for stream in streams) / 1e9
        first, last = poses.stamps[gap] - start, poses.stamps[gap + 1] - start
        notes.append(
            f"ground truth has no poses from {first:.0f} to {last:.0f} s of the recording: only the rest is "
            "measured"
        )
