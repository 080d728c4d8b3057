# SPDX-License-Identifier: Apache-2.0
"""Datasets on this machine: making synthetic ones, adding others, and what runs need of each."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from slamhive.data.files.fetching import fetch
from slamhive.data.files.once import make_once
from slamhive.data.recordings.entries import (
    DatasetEntry,
    check_sums,
    dataset_sha256,
    file_sha256,
    recording_sha256,
)
from slamhive.data.store.groundtruth import GroundTruthPoses, ground_truth
from slamhive.data.store.obtaining import Listener, obtain
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.canonical import digest, normalize
from slamhive.model.catalogue import find_sequence
from slamhive.model.dataset import DataFile, Dataset, GroundTruth, Recording
from slamhive.model.errors import DataError, InputError
from slamhive.model.loading import load_file
from slamhive.model.sensors import Sensor

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "MANIFEST",
    "DatasetEntry",
    "GroundTruthPoses",
    "add_dataset",
    "dataset_sha256",
    "downloads_of",
    "file_sha256",
    "files_of",
    "ground_truth",
    "is_made",
    "made_folder",
    "made_from",
    "materialise",
    "recording_sha256",
]

MANIFEST = "dataset.yaml"
HASHES = ".hashes"
IMPORTED = "imported"
"""Folder of a dataset of the catalogue in the folder that is made for it."""


def materialise(
    dataset: Dataset, root: Path, datasets: Path, progress: Callable[[float], None] | None = None
) -> DatasetEntry:
    """Return a dataset with its files at hand, generated or fetched unless they were before.

    Args:
        dataset: The dataset as declared.
        root: The folder that its paths start from.
        datasets: The home's folder for datasets; generated ones go to ``NAME-HASH`` in it.
        progress: Called with the share made, 0 to 1.

    Raises:
        InputError: The catalogue has no such sequence, or a file of it is to be fetched by hand.
        DataError: A file is missing, or isn't what was said of it.
        SystemFault: The disk or the network refuses.
    """
    if dataset.spec.is_to_fetch:
        return _of_catalogue(dataset, datasets, progress)
    spec = dataset.spec.recording.synthetic
    if spec is None:
        return _with_recording(dataset, root, datasets)
    folder = made_folder(dataset, datasets)

    def make(aside: Path) -> None:
        from slamhive.data import synthetic  # noqa: PLC0415 - with OpenCV, for those who generate alone

        synthetic.generate(spec, aside, progress)

    make_once(folder, make)
    return DatasetEntry(_with_files(dataset, folder), folder)


def is_made(dataset: Dataset, root: Path, datasets: Path) -> bool:
    """Tell whether a dataset's files are at hand: whether `materialise` would neither generate nor fetch."""
    there = made_folder(dataset, datasets).is_dir()
    if dataset.spec.recording.synthetic is not None or dataset.spec.is_to_fetch:
        return there
    return there or all((root / file.path).exists() for file in dataset.spec.recording.files)


def made_folder(dataset: Dataset, datasets: Path) -> Path:
    """Return the folder of what is generated or fetched of a dataset, ``NAME-HASH``, made or not.

    Args:
        dataset: The dataset as declared.
        datasets: The home's folder for datasets.
    """
    spec = dataset.spec.recording.synthetic
    if dataset.spec.is_to_fetch:
        key = digest({"catalogue": dataset.spec.catalogue})
    elif spec is None:
        key = digest(normalize(dataset.spec.recording.as_json()))
    else:
        generator = _generator_hash()
        key = digest({"recording": spec.model_dump(mode="json", by_alias=True), "generator": generator})
    return datasets / f"{dataset.name}-{key[:16]}"


def made_from(dataset: Dataset, datasets: Path) -> str | None:
    """Return the hash of what a dataset is generated or fetched by; None where its files are its own."""
    if dataset.spec.recording.synthetic is None and not dataset.spec.is_to_fetch:
        return None
    return digest([made_folder(dataset, datasets).name, dataset.spec.replace(preparations=None).as_json()])


def _of_catalogue(dataset: Dataset, datasets: Path, progress: Callable[[float], None] | None) -> DatasetEntry:
    """Return a sequence of the catalogue under the name of a dataset, fetched if need be."""
    sequence = find_sequence(str(dataset.spec.catalogue))
    folder = made_folder(dataset, datasets)
    listener = Listener() if progress is None else Listener(share=progress)

    def make(aside: Path) -> None:
        obtain(sequence, aside / IMPORTED, dataset.name, downloads_of(datasets), listener=listener)

    make_once(folder, make)
    found = load_file(folder / IMPORTED / MANIFEST)[0]
    if not isinstance(found, Dataset):
        raise DataError(f"{folder}: not a dataset")
    declared = dataset.spec
    spec = declared.replace(
        recording=found.spec.recording,
        sensors=found.spec.sensors | declared.sensors,
        ground_truth=declared.ground_truth or found.spec.ground_truth,
        gravity_aligned=declared.gravity_aligned or found.spec.gravity_aligned,
        homepage=declared.homepage or found.spec.homepage,
        license=declared.license or found.spec.license,
        attributes=found.spec.attributes | declared.attributes,
    )
    return DatasetEntry(_whole(dataset.replace(spec=spec)), folder / IMPORTED)


def downloads_of(datasets: Path) -> Path:
    """Return the folder of what is being fetched for the datasets of a folder, beside it."""
    return datasets.parent / "downloads"


def _with_recording(dataset: Dataset, root: Path, datasets: Path) -> DatasetEntry:
    """Return a dataset whose files are there, fetched if need be, and are what their checksums say."""
    files = dataset.spec.recording.files
    missing = [file for file in files if not (root / file.path).exists()]
    for file in missing:
        if file.url is None:
            where = f"dataset {dataset.name!r}: recording.files"
            raise DataError(f"{where}: {root / file.path} does not exist")
    if missing:
        folder = made_folder(dataset, datasets)
        make_once(folder, lambda aside: _gather(dataset, root, aside, downloads_of(datasets)))
        root = folder
    entry = DatasetEntry(dataset, root)
    check_sums(entry, datasets / HASHES)
    return entry


def _gather(dataset: Dataset, root: Path, aside: Path, downloads: Path) -> None:
    """Fetch what isn't there, and link what is."""
    for file in dataset.spec.recording.files:
        if file.url and file.sha256 and not (root / file.path).exists():
            # What is aside goes when this ends before it is whole; what was fetched then stays.
            fetched = downloads / file.sha256
            fetch(file.url, fetched, file.sha256, f"dataset {dataset.name!r}")
            (aside / file.path).parent.mkdir(parents=True, exist_ok=True)
            fetched.replace(aside / file.path)
    for relative in files_of(dataset):
        link = aside / relative
        if not link.exists() and (root / relative).exists():
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to((root / relative).resolve())


def _with_files(dataset: Dataset, folder: Path) -> Dataset:
    """Describe a synthetic dataset by the files that were made for it."""
    calibration = json.loads((folder / "sensors.json").read_text(encoding="utf-8"))["sensors"]
    sensors = {role: _sensor(entry) for role, entry in calibration.items()}
    spec = dataset.spec.replace(
        recording=Recording(format=RecordingFormat.ROSBAG1, files=[DataFile(path="recording.bag")]),
        sensors=sensors | dataset.spec.sensors,
        ground_truth=dataset.spec.ground_truth or GroundTruth(file="groundtruth.txt"),
        gravity_aligned=dataset.spec.has_level_truth,
        attributes=dataset.spec.known_attributes,
    )
    return _whole(dataset.replace(spec=spec))


def _whole(dataset: Dataset) -> Dataset:
    """Return a dataset whose sensors are known now.

    Raises:
        InputError: Its repair is of others.
    """
    if misfit := dataset.spec.repair_misfit:
        raise InputError(f"dataset {dataset.name!r}: {misfit}")
    return dataset


def _sensor(entry: dict[str, Any]) -> Sensor:
    return Sensor.model_validate({key: value for key, value in entry.items() if key != "name"})


def _generator_hash() -> str:
    """Hash the generator's own source: another generator makes another recording."""
    folder = Path(__file__).parents[1] / "synthetic"
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
            f"dataset never changes: give it another name, have it take the place of the one that is known: "
            f"slamhive dataset add --replace, or forget that one: slamhive dataset remove {dataset.name}"
        )
    fetched = {file.path for file in dataset.spec.recording.files if file.url}
    for relative in [*files_of(dataset), *_programs_of(dataset, root)]:
        source, link = (root / relative).absolute(), folder / relative
        if not source.exists() and relative in fetched:
            continue
        if not source.exists():
            raise DataError(f"dataset {dataset.name!r}: {source} does not exist")
        link.parent.mkdir(parents=True, exist_ok=True)
        if not (link.is_symlink() or link.exists()):
            link.symlink_to(source)
    folder.mkdir(parents=True, exist_ok=True)
    # Never half of it under its name: a broken manifest in the home stops every command that reads it.
    aside = manifest.with_name(f".{MANIFEST}.{os.getpid()}")
    try:
        aside.write_text(text, encoding="utf-8")
        aside.replace(manifest)
    finally:
        aside.unlink(missing_ok=True)
    return manifest


def _programs_of(dataset: Dataset, root: Path) -> list[str]:
    """Return the paths of the programs that prepare a dataset, and of what their adapters may import."""
    programs = [one.local for one in (dataset.spec.preparations or {}).values() if one.local is not None]
    named = [path for program in programs for path in program.files]
    folders = {(root / program.adapter).parent for program in programs if program.command is None}
    beside = [str(path.relative_to(root)) for folder in folders for path in sorted(folder.glob("*.py"))]
    return [*dict.fromkeys([*named, *beside])]


def files_of(dataset: Dataset) -> list[str]:
    """Return the paths of all files that a dataset names, below its folder."""
    truth = dataset.spec.ground_truth
    paths = [file.path for file in dataset.spec.recording.files]
    return paths + ([path for path in (truth.file, truth.times) if path] if truth else [])
