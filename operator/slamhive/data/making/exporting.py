# SPDX-License-Identifier: Apache-2.0
"""Export of a dataset in the form that a program takes: what a run would be given, for anyone.

The folder appears whole or not at all. A bag comes with a manifest by which it can be added elsewhere, a
folder of files with ``sensors.yaml``, as its own form leaves much of the calibration out.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive.data.files.once import settle
from slamhive.data.files.publishing import MANIFEST
from slamhive.data.making.orders import make_recording, order_of
from slamhive.data.store.groundtruth import write_ground_truth
from slamhive.model.base import API_VERSION
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.formats import FILE_NAMES, DataFormat, folder_files, holds
from slamhive.model.sensors import ROLE_TYPES, Role
from slamhive_eval import Trajectory, write_tum

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.data.making.orders import MadeRecording, Order
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.model.dataset import DatasetSpec
    from slamhive.model.run import InputOptions

SENSORS = "sensors.yaml"
_FIRST: dict[DataFormat, tuple[tuple[Role, ...], ...]] = {
    DataFormat.EUROC: ((Role.LEFT, Role.RIGHT), (Role.CAMERA,)),
    DataFormat.TUM: ((Role.COLOR, Role.DEPTH), (Role.CAMERA,)),
    DataFormat.KITTI: ((Role.LEFT, Role.RIGHT), (Role.CAMERA,), ()),
}
"""Cameras of a folder where none are asked for, the first that the dataset has."""


def export_dataset(
    entry: DatasetEntry,
    roles: Sequence[Role],
    options: InputOptions,
    target: DataFormat,
    out: Path,
    *,
    truth: GroundTruthPoses | None = None,
    cache: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> MadeRecording:
    """Write a dataset into a new folder.

    Args:
        entry: The dataset, materialised.
        roles: The sensors wanted.
        options: Rate, resolution, cut and the like, as a run's input.
        target: The form.
        out: The folder to make.
        truth: Its ground truth, to be written beside.
        cache: Folder in which poses of topics are kept.
        progress: Called with the share done, 0 to 1.

    Returns:
        What is in it.

    Raises:
        InputError: The folder exists, or the form doesn't fit the dataset.
        DataError: The recording can't be used.
        SystemFault: The disk refuses.
    """
    require_new(out)
    order = order_of(entry, roles, options, target)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        try:
            made = make_recording(order, aside, progress, link=False)
            _write_beside(order, made, truth, aside, cache)
            aside.chmod(0o777 & ~_umask())
            settle(aside, read_only=False)
            aside.rename(out)
        except BaseException:
            with suppress(OSError):
                shutil.rmtree(aside)
            raise
    except OSError as error:
        raise SystemFault(f"{out}: {error.strerror or error}") from error
    return made


def require_new(out: Path) -> None:
    """Check that a folder to make isn't there.

    Raises:
        InputError: It is.
    """
    if os.path.lexists(out):
        raise InputError(f"{out}: exists already; choose another folder or remove it")


def all_roles(entry: DatasetEntry, target: DataFormat) -> tuple[Role, ...]:
    """Return the sensors of an export that names none: all that the dataset has and the form holds.

    Raises:
        InputError: There are none.
    """
    spec = entry.dataset.spec
    named = [role for role in Role if _fits(spec, role) and spec.sensor_for(role) == role]
    found = tuple(named)
    if target.is_folder:
        cameras = [group for group in _FIRST[target] if all(_fits(spec, role) for role in group)]
        beside = [role for role in named if role in {Role.IMU, Role.LIDAR}]
        others = [role for role in beside if holds(target, (Role.CAMERA, role))]
        found = (*cameras[0], *others) if cameras else ()
    if not holds(target, found) or not found:
        raise InputError(
            f"dataset {entry.name!r} has no sensors for {target}; it has: {', '.join(sorted(spec.sensors))} "
            "(--sensors names a mode)"
        )
    return found


def _fits(spec: DatasetSpec, role: Role) -> bool:
    try:
        return spec.sensors[spec.sensor_for(role)].type is ROLE_TYPES[role]
    except InputError:
        return False


def _umask() -> int:
    now = os.umask(0)
    os.umask(now)
    return now


def _write_beside(
    order: Order, made: MadeRecording, truth: GroundTruthPoses | None, folder: Path, cache: Path | None
) -> None:
    """Write ground truth and what describes the recording; a folder's files come to the top."""
    about = _write_truth(order.entry, truth, folder, cache) if truth is not None else None
    recording = FILE_NAMES[order.target]
    if order.target.is_folder:
        for item in (folder / recording).iterdir():
            item.rename(folder / item.name)
        (folder / recording).rmdir()
        _write_yaml(folder / SENSORS, _sensors(order, made))
    else:
        _write_yaml(folder / MANIFEST, _manifest(order, made, about))


_FORMATS: dict[str, dict[str, Any]] = {
    "relations": {"format": "Relations"},
    "points": {"format": "ControlPoints"},
    "positions": {"format": "Table", "table": {"columns": ["t", "tx", "ty", "tz"]}},
}


def _write_truth(
    entry: DatasetEntry, truth: GroundTruthPoses, folder: Path, cache: Path | None
) -> dict[str, Any]:
    """Write ground truth, poses as those of the body in TUM format, all else as it is; return what it is."""
    pose = truth.T_body_frame
    if isinstance(truth.poses, Trajectory) and truth.poses.oriented and not np.array_equal(pose, np.eye(4)):
        write_tum(folder / "groundtruth.txt", truth.poses.moved(np.linalg.inv(pose).astype(np.float64)))
        return {"file": "groundtruth.txt"}
    name = f"groundtruth.{'txt' if truth.kind == 'poses' else truth.kind}"
    write_ground_truth(entry, truth, folder / name, cache)
    if truth.kind == "poses":
        return {"file": name}
    about = {"file": name, **_FORMATS[truth.kind]}
    return about | {"T_body_frame": pose.tolist()}


def _manifest(order: Order, made: MadeRecording, truth: dict[str, Any] | None) -> dict[str, Any]:
    spec = order.entry.dataset.spec
    declared = spec.as_json()
    sensors = {view.name: view.as_json() for view in made.views.values()}
    for sensor in sensors.values():
        del sensor["name"]
    body = {key: declared[key] for key in ("description", "homepage", "license") if declared.get(key)}
    body["recording"] = {"format": str(order.target), "files": [{"path": FILE_NAMES[order.target]}]}
    body["sensors"] = sensors
    if truth is not None:
        body["groundTruth"] = truth
    body |= {"gravityAligned": spec.has_level_truth, "attributes": dict(spec.attributes)}
    return {
        "apiVersion": API_VERSION,
        "kind": "Dataset",
        "metadata": {"name": order.entry.name},
        "spec": body,
    }


def _sensors(order: Order, made: MadeRecording) -> dict[str, Any]:
    chosen = made.selection
    encodings = {role: view.camera.encoding if view.camera else None for role, view in made.views.items()}
    return {
        "dataset": order.entry.name,
        "format": str(order.target),
        "files": {str(key): path for key, path in folder_files(order.target, encodings).items()},
        "startTime": chosen.first / 10**9 + chosen.primary.time_offset,
        "durationSeconds": (chosen.last - chosen.first) / 10**9,
        "frames": chosen.frames(chosen.primary),
        "sensors": {str(role): view.as_json() for role, view in made.views.items()},
    }


def _write_yaml(path: Path, value: dict[str, Any]) -> None:
    text = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=110)
    path.write_text(text, encoding="utf-8")
