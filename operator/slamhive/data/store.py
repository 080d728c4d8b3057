# SPDX-License-Identifier: Apache-2.0
"""Datasets on this machine: making synthetic ones, adding others, and the hashes that identify them."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from slamhive.data import synthetic
from slamhive.data.once import make_once
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.canonical import digest
from slamhive.model.dataset import DataFile, Dataset, GroundTruth, Recording
from slamhive.model.errors import DataError, InputError
from slamhive.model.sensors import Sensor

if TYPE_CHECKING:
    from collections.abc import Callable

MANIFEST = "dataset.yaml"


@dataclass(frozen=True)
class DatasetEntry:
    """A dataset whose files are at hand.

    Attributes:
        dataset: The dataset, its sensors filled in.
        root: The folder that its paths start from.
    """

    dataset: Dataset
    root: Path

    @property
    def name(self) -> str:
        """Return the dataset's name."""
        return self.dataset.name


def materialise(
    dataset: Dataset, root: Path, datasets: Path, progress: Callable[[float], None] | None = None
) -> DatasetEntry:
    """Return a dataset with its files at hand; a synthetic recording is made unless it was before.

    Args:
        dataset: The dataset as declared.
        root: The folder that its paths start from.
        datasets: The home's folder for datasets; generated ones go to ``NAME-HASH`` in it.
        progress: Called with the share made, 0 to 1.

    Raises:
        DataError: A file is missing.
        SystemFault: The disk refuses.
    """
    spec = dataset.spec.recording.synthetic
    if spec is None:
        for file in dataset.spec.recording.files:
            _require(dataset, root, file)
        return DatasetEntry(dataset, root)
    key = digest({"recording": spec.model_dump(mode="json", by_alias=True), "generator": _generator_hash()})
    folder = datasets / f"{dataset.name}-{key[:16]}"

    def make(aside: Path) -> None:
        synthetic.generate(spec, aside, progress)

    make_once(folder, make)
    return DatasetEntry(_with_files(dataset, folder), folder)


def _require(dataset: Dataset, root: Path, file: DataFile) -> None:
    if not (root / file.path).exists():
        hint = f"; get it from {file.url}" if file.url else ""
        raise DataError(f"dataset {dataset.name!r}: recording.files: {root / file.path} does not exist{hint}")


def _with_files(dataset: Dataset, folder: Path) -> Dataset:
    """Describe a synthetic dataset by the files that were made for it."""
    calibration = json.loads((folder / "sensors.json").read_text(encoding="utf-8"))["sensors"]
    sensors = {role: _sensor(entry) for role, entry in calibration.items()}
    spec = dataset.spec.replace(
        recording=Recording(format=RecordingFormat.ROSBAG1, files=[DataFile(path="recording.bag")]),
        sensors=sensors | dataset.spec.sensors,
        ground_truth=dataset.spec.ground_truth or GroundTruth(file="groundtruth.txt"),
        gravity_aligned=True,
        attributes=dict(_attributes(dataset)) | dataset.spec.attributes,
    )
    return dataset.replace(spec=spec)


def _attributes(dataset: Dataset) -> dict[str, Any]:
    spec = dataset.spec.recording.synthetic
    return {} if spec is None else spec.attributes()


def _sensor(entry: dict[str, Any]) -> Sensor:
    return Sensor.model_validate({key: value for key, value in entry.items() if key != "name"})


def _generator_hash() -> str:
    """Hash the generator's own source: another generator makes another recording."""
    folder = Path(synthetic.__file__).parent
    sources = sorted(folder.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


def add_dataset(dataset: Dataset, root: Path, datasets: Path) -> Path:
    """Make a dataset known to a home: its manifest is written there, its files are linked.

    Returns:
        The manifest in the home.

    Raises:
        InputError: A file is missing, or another dataset of that name is known.
    """
    folder = datasets / dataset.name
    text = yaml.safe_dump(dataset.as_json(), sort_keys=False, allow_unicode=True)
    manifest = folder / MANIFEST
    if manifest.exists() and manifest.read_text(encoding="utf-8") != text:
        raise InputError(
            f"dataset {dataset.name!r} is known already and differs; results stay valid only if a "
            f"dataset never changes: give it another name, or remove {folder}"
        )
    for relative in _paths(dataset):
        source, link = (root / relative).absolute(), folder / relative
        if not source.exists():
            raise DataError(f"dataset {dataset.name!r}: {source} does not exist")
        link.parent.mkdir(parents=True, exist_ok=True)
        if not (link.is_symlink() or link.exists()):
            link.symlink_to(source)
    folder.mkdir(parents=True, exist_ok=True)
    manifest.write_text(text, encoding="utf-8")
    return manifest


def _paths(dataset: Dataset) -> list[str]:
    truth = dataset.spec.ground_truth
    paths = [file.path for file in dataset.spec.recording.files]
    return paths + ([path for path in (truth.file, truth.times) if path] if truth else [])


def recording_sha256(entry: DatasetEntry, cache: Path | None = None) -> str:
    """Return the hash of a dataset's recording, from declared checksums where there are any.

    Args:
        entry: The dataset.
        cache: Folder in which computed hashes are remembered by path, size and time of change.

    Raises:
        DataError: A file cannot be read.
    """
    files = entry.dataset.spec.recording.files
    return digest([file.sha256 or file_sha256(entry.root / file.path, cache) for file in files])


def dataset_sha256(entry: DatasetEntry, cache: Path | None = None) -> str:
    """Return the hash of all that results depend on: recording, calibration, ground truth.

    Args:
        entry: The dataset.
        cache: Folder in which computed hashes are remembered by path, size and time of change.

    Raises:
        DataError: A file cannot be read.
    """
    spec = entry.dataset.spec
    truth = spec.ground_truth
    parts: dict[str, Any] = {
        "recording": recording_sha256(entry, cache),
        "sensors": {name: sensor.as_json() for name, sensor in spec.sensors.items()},
        "gravityAligned": spec.gravity_aligned,
    }
    if truth is not None:
        parts["groundTruth"] = truth.as_json()
        parts["groundTruthFiles"] = [
            (truth.sha256 if path == truth.file else None) or file_sha256(entry.root / path, cache)
            for path in (truth.file, truth.times)
            if path
        ]
    return digest(parts)


def file_sha256(path: Path, cache: Path | None = None) -> str:
    """Return the SHA-256 of a file, or of a folder's file names and contents.

    Args:
        path: The file or folder.
        cache: Folder in which hashes are remembered by path, size and time of change.

    Raises:
        DataError: It cannot be read.
    """
    try:
        if path.is_dir():
            files = sorted(item for item in path.rglob("*") if item.is_file())
            return digest([[str(item.relative_to(path)), file_sha256(item, cache)] for item in files])
        return _remembered(path.resolve(), cache)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from None


def _remembered(path: Path, cache: Path | None) -> str:
    state = path.stat()
    key = digest([str(path), state.st_size, str(state.st_mtime_ns), state.st_ino])
    note = cache / key if cache else None
    if note is not None and note.is_file():
        known = note.read_text(encoding="ascii").strip()
        if len(known) == 64:
            return known
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if note is not None:
        note.parent.mkdir(parents=True, exist_ok=True)
        aside = note.with_name(f"{key}.{os.getpid()}")
        aside.write_text(found, encoding="ascii")
        aside.replace(note)
    return found
