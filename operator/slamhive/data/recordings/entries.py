# SPDX-License-Identifier: Apache-2.0
"""A dataset at hand, and the hashes that identify what is in it."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.model.canonical import digest
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.model.dataset import Dataset


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
    if spec.repair is not None:
        parts["repair"] = spec.repair.model_dump(mode="json", by_alias=True, exclude_defaults=True)
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


def check_sums(entry: DatasetEntry, cache: Path | None = None) -> None:
    """Check that the files of a dataset are what their checksums say, where they state one.

    Args:
        entry: The dataset.
        cache: As for `recording_sha256`.

    Raises:
        DataError: One isn't, or can't be read.
    """
    spec = entry.dataset.spec
    stated = [("recording.files", file.path, file.sha256) for file in spec.recording.files]
    if spec.ground_truth is not None and spec.ground_truth.file is not None:
        stated.append(("groundTruth.file", spec.ground_truth.file, spec.ground_truth.sha256))
    for where, path, expected in stated:
        found = file_sha256(entry.root / path, cache) if expected else None
        if found != expected:
            raise DataError(
                f"dataset {entry.name!r}: {where}: {entry.root / path} has sha256 {found}, "
                f"expected {expected}"
            )


def state_of(path: Path) -> list[Any]:
    """Return a file's place, size, time of change and inode: as long as they stay, so does its content.

    Raises:
        OSError: It can't be looked at.
    """
    place = path.resolve()
    state = place.stat()
    return [str(place), state.st_size, str(state.st_mtime_ns), state.st_ino]


def _remembered(path: Path, cache: Path | None) -> str:
    key = digest(state_of(path))
    note = cache / key if cache else None
    if note is not None and note.is_file():
        known = note.read_text(encoding="ascii").strip()
        if len(known) == 64:
            return known
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if note is not None:
        remember(note, found)
    return found


def remember(note: Path, found: str) -> None:
    """Keep a hash for the next time; where the disk refuses, it is computed again then."""
    # Process ids are the same in many pods, which may share the folder.
    aside = note.with_name(f"{note.name}.{os.urandom(6).hex()}")
    try:
        note.parent.mkdir(parents=True, exist_ok=True)
        aside.write_text(found, encoding="ascii")
        aside.replace(note)
    except OSError:
        with suppress(OSError):
            aside.unlink()
