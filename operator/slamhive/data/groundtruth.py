# SPDX-License-Identifier: Apache-2.0
"""Ground truth as the evaluator reads it: TUM lines, or relations, whatever the dataset keeps it as."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.once import make_once
from slamhive.data.posetopics import poses_of_topic
from slamhive.data.recordings import open_recording
from slamhive.data.store import file_sha256, recording_sha256
from slamhive.model.canonical import digest
from slamhive.model.dataset import TruthFormat
from slamhive.model.errors import DataError
from slamhive_eval import (
    EvaluationError,
    Relations,
    Trajectory,
    read_euroc,
    read_kitti,
    read_relations,
    read_tum,
    write_tum,
)

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.store import DatasetEntry
    from slamhive.model.dataset import GroundTruth, Hole
    from slamhive.model.sensors import Matrix4

_IDENTITY: Matrix4 = np.eye(4).tolist()
VERSION = 1
"""Raised when conversion makes something else of the same input."""


@dataclass(frozen=True)
class TruthFile:
    """Ground truth ready for the evaluator.

    Attributes:
        path: A TUM file, or a file of relations.
        is_relations: Which of the two.
        T_body_frame: Pose in the body of the frame that the file's poses are of, 4×4 by rows.
        holes: Spans not to be trusted.
    """

    path: Path
    is_relations: bool
    T_body_frame: Matrix4
    holes: list[Hole]

    def read(self) -> Trajectory | Relations:
        """Read the file.

        Raises:
            DataError: It is damaged.
        """
        try:
            return read_relations(self.path) if self.is_relations else read_tum(self.path)
        except EvaluationError as error:
            raise DataError(f"ground truth: {error}") from None


def ground_truth(entry: DatasetEntry, cache: Path) -> TruthFile | None:
    """Return a dataset's ground truth in a form that the evaluator reads.

    TUM files and relations are used where they are; everything else is converted once.

    Args:
        entry: The dataset, materialised.
        cache: Folder for converted files.

    Returns:
        None for a dataset without ground truth.

    Raises:
        DataError: It is missing, damaged, or has no poses.
        SystemFault: The disk refuses.
    """
    truth = entry.dataset.spec.ground_truth
    if truth is None:
        return None
    frame = _frame(entry, truth)
    if truth.file is not None:
        path = entry.root / truth.file
        if not path.is_file():
            raise DataError(f"dataset {entry.name!r}: groundTruth.file: {path} does not exist")
        if truth.format in (TruthFormat.TUM, TruthFormat.RELATIONS):
            return TruthFile(path, truth.format is TruthFormat.RELATIONS, frame, truth.holes)
    folder = cache / _key(entry, truth, cache)

    def make(aside: Path) -> None:
        write_tum(aside / "groundtruth.txt", _convert(entry, truth))

    make_once(folder, make)
    return TruthFile(folder / "groundtruth.txt", is_relations=False, T_body_frame=frame, holes=truth.holes)


def require_overlap(truth: Trajectory | Relations, start: float, end: float, where: str) -> None:
    """Check that ground truth covers some of a recording.

    Args:
        truth: The ground truth.
        start: Sensor time at which the recording begins, s.
        end: Sensor time at which it ends, s.
        where: What it is, for the message.

    Raises:
        DataError: It doesn't; the sentence names both ranges.
    """
    first, last = truth_range(truth)
    if last < start or first > end:
        gap = first - end if first > end else start - last
        hint = "; they differ by more than a year: one of them may not be Unix time" if gap > 3e7 else ""
        raise DataError(
            f"{where}: the ground truth ({first:.3f} to {last:.3f} s) doesn't overlap with the recording "
            f"({start:.3f} to {end:.3f} s){hint}"
        )


def truth_range(truth: Trajectory | Relations) -> tuple[float, float]:
    """Return the first and last time of ground truth, s."""
    if isinstance(truth, Trajectory):
        return float(truth.stamps[0]), float(truth.stamps[-1])
    times = np.concatenate((truth.begin, truth.end))
    return float(times.min()), float(times.max())


def _frame(entry: DatasetEntry, truth: GroundTruth) -> Matrix4:
    if truth.T_body_frame is not None:
        return truth.T_body_frame
    if truth.frame == "body":
        return _IDENTITY
    return entry.dataset.spec.sensors[truth.frame].T_body_sensor


def _key(entry: DatasetEntry, truth: GroundTruth, cache: Path) -> str:
    hashes = cache / ".hashes"
    if truth.file is None:
        source = [recording_sha256(entry, hashes)]
    else:
        source = [file_sha256(entry.root / path, hashes) for path in (truth.file, truth.times) if path]
    parts = {"version": VERSION, "source": source, "format": truth.format, "topic": truth.topic}
    return digest(parts)[:32]


def _convert(entry: DatasetEntry, truth: GroundTruth) -> Trajectory:
    try:
        if truth.topic is not None:
            with open_recording(entry.dataset, entry.root) as recording:
                return poses_of_topic(recording, truth.topic)
        path = entry.root / str(truth.file)
        if truth.format is TruthFormat.EUROC:
            return read_euroc(path)
        if truth.times is None:
            raise DataError("groundTruth.times: needed for the format Kitti, whose poses carry no stamps")
        return read_kitti(path, entry.root / truth.times)
    except EvaluationError as error:
        raise DataError(f"dataset {entry.name!r}: ground truth: {error}") from None
