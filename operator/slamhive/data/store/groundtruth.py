# SPDX-License-Identifier: Apache-2.0
"""Ground truth as the evaluator reads it: TUM lines, positions, control points or relations.

Whatever a dataset keeps it as, it is read, repaired and written for evaluators here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.files.once import make_once
from slamhive.data.recordings.entries import recording_sha256
from slamhive.data.recordings.posetopics import poses_of_topic
from slamhive.data.recordings.reading import Recording, recording_paths
from slamhive.model.canonical import digest
from slamhive.model.dataset import TruthFormat, TruthTable
from slamhive.model.errors import DataError
from slamhive_eval import (
    ControlPoints,
    EvaluationError,
    Relations,
    Trajectory,
    read_columns,
    read_euroc,
    read_kitti,
    read_relations,
    read_tum,
    write_tum,
)
from slamhive_eval.formats.files import read_text

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.model.dataset import Dataset, GroundTruth
    from slamhive.model.variant import TruthKind

VERSION = 1
"""Raised when conversion makes something else of the same input."""

_POSES, _POSITIONS = "groundtruth.txt", "groundtruth.positions"
"""Names of what is kept of a topic."""
_KEPT = (TruthFormat.TUM, TruthFormat.RELATIONS)
"""Formats that evaluators read as they are."""


@dataclass(frozen=True, eq=False)
class GroundTruthPoses:
    """The reference that runs on a dataset are measured against.

    Attributes:
        poses: Poses over time, perhaps positions alone; relations between pairs of times; or control points.
            What lies in declared holes is left out, of relations nothing.
        T_body_frame: Pose in the body of the frame that they are poses of, (4, 4).
    """

    poses: Trajectory | Relations | ControlPoints
    T_body_frame: npt.NDArray[np.float64]

    @property
    def kind(self) -> TruthKind:
        """Return its kind, as a variant's description and the reports of datasets call it."""
        if isinstance(self.poses, Relations):
            return "relations"
        if isinstance(self.poses, ControlPoints):
            return "points"
        return "poses" if self.poses.oriented else "positions"


def ground_truth(entry: DatasetEntry, cache: Path | None = None) -> GroundTruthPoses | None:
    """Read a dataset's ground truth, whatever it is kept as.

    Args:
        entry: The dataset, materialised.
        cache: Folder in which the poses of a topic are kept, as getting them takes reading the recording.

    Returns:
        None for a dataset without ground truth.

    Raises:
        DataError: It is missing, damaged, or has no poses.
        SystemFault: The disk refuses.
    """
    truth = entry.dataset.spec.ground_truth
    if truth is None:
        return None
    try:
        poses = _read(entry, truth, cache)
    except EvaluationError as error:
        raise DataError(f"dataset {entry.name!r}: ground truth: {error}") from None
    begin = truth_range(poses)[0]
    if isinstance(poses, Trajectory) and truth.holes:
        poses = _without_holes(poses, truth, entry.name)
    poses = _repaired(poses, entry.dataset, begin)
    if isinstance(poses, Trajectory) and truth.format is TruthFormat.CONTROL_POINTS:
        return GroundTruthPoses(ControlPoints.of(poses), _frame(entry, truth))
    return GroundTruthPoses(poses, _frame(entry, truth))


def write_ground_truth(
    entry: DatasetEntry, truth: GroundTruthPoses, path: Path, cache: Path | None = None
) -> None:
    """Write a dataset's ground truth as evaluators get it: TUM lines, ``t x y z``, or relations as they are.

    What was read from TUM lines keeps its digits, so that reading it again gives the very same poses.

    Args:
        entry: The dataset.
        truth: Its ground truth.
        path: The file to make.
        cache: As for `ground_truth`.

    Raises:
        DataError: It can't be read any more.
        OSError: The disk refuses.
    """
    if truth.kind in ("positions", "points") and not isinstance(truth.poses, Relations):
        _write_positions(truth.poses, path)
        return
    spec = entry.dataset.spec.ground_truth
    source = _lines_of(entry, spec, cache)
    repair = entry.dataset.spec.repair
    is_moved = repair is not None and repair.ground_truth is not None
    if isinstance(truth.poses, Trajectory) and (
        spec is None or source is None or is_moved or truth.poses.nan_rows
    ):
        write_tum(path, truth.poses)
        return
    try:
        text = read_text(str(source))
    except EvaluationError as error:
        raise DataError(f"dataset {entry.name!r}: ground truth: {error}") from None
    if isinstance(truth.poses, Trajectory) and spec is not None and spec.holes:
        text = "\n".join(line for line in text.split("\n") if not _lies_in_hole(line, spec))
    if isinstance(truth.poses, Relations) and is_moved:
        text = _with_times(text, truth.poses)
    path.write_text(text, encoding="utf-8")


def _repaired(poses: Trajectory | Relations, dataset: Dataset, first: float) -> Trajectory | Relations:
    """Return ground truth under the repair of its dataset; a drift counts from the time `first`, s."""
    repair = dataset.spec.repair.ground_truth if dataset.spec.repair else None
    if repair is None:
        return poses

    def moved(stamps: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return stamps + (repair.shift or 0.0) + (stamps - first) * (repair.drift or 0.0)

    if isinstance(poses, Relations):
        return replace(poses, begin=moved(poses.begin), end=moved(poses.end))
    return replace(poses, stamps=moved(poses.stamps))


def _with_times(text: str, relations: Relations) -> str:
    """Return lines of relations with other times; the rest keeps its digits."""
    times = iter(zip(relations.begin.tolist(), relations.end.tolist(), strict=True))
    lines = []
    for line in text.split("\n"):
        words = line.split("#", 1)[0].replace(",", " ").split()
        lines.append(" ".join([*map(repr, next(times)), *words[2:]]) if words else line)
    return "\n".join(lines)


def _write_positions(truth: Trajectory | ControlPoints, path: Path) -> None:
    """Write positions with all their digits, a time in s before each."""
    rows = np.column_stack((truth.stamps, truth.positions)).tolist()
    lines = [" ".join(map(repr, row)) for row in rows]
    path.write_text("\n".join(["# t x y z", *lines, ""]), encoding="utf-8")


def _lines_of(entry: DatasetEntry, truth: GroundTruth | None, cache: Path | None) -> Path | None:
    """Return the file whose lines the ground truth is, if there is one."""
    if truth is None or (truth.topic is not None and cache is None):
        return None
    if truth.topic is not None and cache is not None:
        return _note_of_topic(entry, truth.topic, cache)
    return entry.root / str(truth.file) if truth.format in _KEPT else None


def _lies_in_hole(line: str, truth: GroundTruth) -> bool:
    words = line.split("#", 1)[0].replace(",", " ").split()
    return bool(words) and any(hole.start <= float(words[0]) <= hole.end for hole in truth.holes)


def require_overlap(
    truth: Trajectory | Relations | ControlPoints, start: float, end: float, where: str
) -> None:
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


def truth_range(truth: Trajectory | Relations | ControlPoints) -> tuple[float, float]:
    """Return the first and last time of ground truth, s."""
    if not isinstance(truth, Relations):
        return float(truth.stamps[0]), float(truth.stamps[-1])
    times = np.concatenate((truth.begin, truth.end))
    return float(times.min()), float(times.max())


def _frame(entry: DatasetEntry, truth: GroundTruth) -> npt.NDArray[np.float64]:
    if truth.T_body_frame is not None:
        return np.array(truth.T_body_frame, dtype=np.float64)
    if truth.frame == "body":
        return np.eye(4)
    return np.array(entry.dataset.spec.sensors[truth.frame].T_body_sensor, dtype=np.float64)


def _read(entry: DatasetEntry, truth: GroundTruth, cache: Path | None) -> Trajectory | Relations:
    if truth.topic is not None:
        return _of_topic(entry, truth.topic, cache)
    path = entry.root / str(truth.file)
    if not path.is_file():
        raise DataError(f"dataset {entry.name!r}: groundTruth.file: {path} does not exist")
    match truth.format:
        case TruthFormat.TUM:
            return read_tum(path)
        case TruthFormat.EUROC:
            return read_euroc(path)
        case TruthFormat.RELATIONS:
            return read_relations(path)
        case TruthFormat.TABLE | TruthFormat.CONTROL_POINTS:
            assert truth.columns is not None  # noqa: S101 - of these formats it never is
            times = None if truth.times is None else entry.root / truth.times
            return read_columns(path, truth.columns.form, times)
        case TruthFormat.KITTI:
            if truth.times is None:
                raise DataError(
                    f"dataset {entry.name!r}: groundTruth.times: needed for the format Kitti, whose poses "
                    f"carry no "
                    "stamps"
                )
            return read_kitti(path, entry.root / truth.times)


def _of_topic(entry: DatasetEntry, topic: str, cache: Path | None) -> Trajectory:
    if cache is not None:
        note = _note_of_topic(entry, topic, cache)
        return read_columns(note, TruthTable().form) if note.name == _POSITIONS else read_tum(note)
    # As recorded: its own repair is another than that of the sensors.
    with Recording(
        recording_paths(entry.dataset, entry.root), entry.dataset.spec.recording.format
    ) as recording:
        return poses_of_topic(recording, topic)


def _note_of_topic(entry: DatasetEntry, topic: str, cache: Path) -> Path:
    """Return the file in which the poses of a topic are kept, or positions alone, made if need be."""
    source = recording_sha256(entry, cache / ".hashes")
    folder = cache / digest({"version": VERSION, "source": source, "topic": topic})[:32]

    def make(aside: Path) -> None:
        poses = _of_topic(entry, topic, None)
        if poses.oriented:
            write_tum(aside / _POSES, poses)
        else:
            _write_positions(poses, aside / _POSITIONS)

    make_once(folder, make)
    positions = folder / _POSITIONS
    return positions if positions.exists() else folder / _POSES


def _without_holes(poses: Trajectory, truth: GroundTruth, name: str) -> Trajectory:
    kept = np.ones(len(poses), dtype=np.bool_)
    for hole in truth.holes:
        kept &= (poses.stamps < hole.start) | (poses.stamps > hole.end)
    if not kept.any():
        raise DataError(f"dataset {name!r}: groundTruth.holes: they leave none of {len(poses)} poses")
    return poses.select(np.flatnonzero(kept))
