# SPDX-License-Identifier: Apache-2.0
"""Trajectories and usage over time, thinned for plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.model.algorithm import AlgorithmSpec
from slamhive.model.errors import SlamHiveError
from slamhive.model.results import MemoryKind
from slamhive.model.run import Perturbation
from slamhive.model.sensors import SensorMode
from slamhive.plan.misleading import right_pose
from slamhive.runfiles.errors import FileMissingError
from slamhive.runfiles.numberfiles import numbers_of, read_numbers, stacked
from slamhive_eval import Trajectory, associate
from slamhive_eval.formats.decimals import parse_rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices
    from slamhive.archive.records import CatalogEntry
    from slamhive.model.results import Result, RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth

    Matrix = npt.NDArray[np.float64]

TRAJECTORIES = ("output/trajectory.txt", "run/output/trajectory.txt", "traj.txt")
_MEMORY_KINDS = {
    b"resident_bytes": MemoryKind.RESIDENT,
    b"memory_bytes": MemoryKind.WORKING_SET,
    b"memory_usage": MemoryKind.CONTAINER,
}
"""By the column of memory: usage.csv, that of earlier versions, profiling.csv."""
USAGES = ("usage.csv", "run/output/usage.csv", "run/usage.csv", "output/usage.csv", "profiling.csv")
_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
_MAX_DIFFERENCE = 0.01
_CLOSE = 1e-3
_UNLIKE = (
    "these errors are not quite those of the evaluation: it used another ground truth, frame or tolerance "
    "than what is at hand here"
)


@dataclass(frozen=True, eq=False)
class Path:
    """Trajectory that a run wrote, thinned where its file has too many poses.

    Attributes:
        poses: as they were read.
        count: how many the file has.
        every: how many of those each one stands for; 1 where all were read.
    """

    poses: Trajectory
    count: int
    every: int = 1


def read_poses(place: ArtifactFolder) -> Path:
    """Return the trajectory in a run's TUM file; lines that can't be read are left out.

    Raises:
        FileMissingError: there is no file, or no line can be read.
        FileTooLargeError: the file is too large to be drawn.
    """
    found = read_numbers(place, TRAJECTORIES, _poses)
    table = found.rows.reshape(-1, 8)
    if not len(table):
        raise FileMissingError(f"{found.name}: no pose in it can be read")
    table = table[np.argsort(table[:, 0], kind="stable")]
    norms = np.linalg.norm(table[:, 4:], axis=1)
    table[norms == 0, 4:] = (0.0, 0.0, 0.0, 1.0)
    table[:, 4:] /= np.linalg.norm(table[:, 4:], axis=1)[:, None]
    return Path(Trajectory(table[:, 0], table[:, 1:4], table[:, 4:]), found.count, found.every)


def _poses(lines: bytes) -> Matrix:
    """Return the rows of some lines, (k, 8); a rotation that is missing is none."""
    table = parse_rows(lines)
    if table is None or table.shape[1] < 4:
        rows = []
        for line in lines.splitlines():
            numbers = numbers_of(b" ".join(line.split(b"#")[0].replace(b",", b" ").split()[:8]))
            if len(numbers) >= 4:
                rows.append([*numbers, *_NO_ROTATION[len(numbers) - 4 :]])
        table = stacked(rows, 8)
    elif table.shape[1] < 8:
        missing = np.tile(_NO_ROTATION[table.shape[1] - 4 :], (len(table), 1))
        table = np.hstack([table, missing])
    table = table[:, :8]
    return table[np.isfinite(table).all(axis=1)]


def drawn(
    given: Path,
    result: Result | None,
    truth: DatasetTruth | None,
    extrinsic: Matrix | None,
    most: int,
    *,
    whole: bool = True,
) -> dict[str, Any]:
    """Return a run's path over its ground truth, thinned, with the error of each pose.

    Args:
        given: what the algorithm wrote.
        result: the evaluation whose alignment is taken; None to leave the path as it is.
        truth: ground truth of the dataset.
        extrinsic: T_truth_estimate, (4, 4); None when unknown.
        most: poses shown at most.
        whole: whether the run had all of the recording: then all of the ground truth is shown, also what the
            estimate misses; else that of the estimate's time.
    """
    notes: list[str] = []
    poses = given.poses
    if given.every > 1:
        notes.append(f"of {given.count:,} poses one in {given.every} is read: errors are of those")
    transform = _transform(result)
    path = poses.positions
    if transform is not None:
        path = path @ transform[:3, :3].T + transform[:3, 3]
    else:
        notes.append("the evaluation has no alignment: the path is drawn as the algorithm wrote it")
    errors = np.full(len(poses), np.nan)
    reference = points = None
    if truth is None:
        notes.append("the ground truth of this dataset is not at hand here")
    elif truth.are_points:
        points = _points(truth.poses, result)
    elif transform is None:
        reference = truth.poses
    else:
        reference, errors, off = _against(poses, path, (truth, extrinsic), _rmse(result))
        if not off <= _CLOSE and given.every == 1:
            notes.append(_UNLIKE)
    shown = _thinned(errors, len(poses), most)
    estimate = _columns(poses.stamps[shown], path[shown]) | {"error": errors[shown]}
    return {
        "evaluation": result.evaluation if result else None,
        "alignment": result.values.get("alignment") if result else None,
        "poses": given.count,
        "shown": len(shown),
        "estimate": estimate,
        "reference": _reference(reference, None if whole else poses, most),
        "points": points,
        "notes": notes,
    }


def _points(points: Trajectory, result: Result | None) -> dict[str, Any]:
    """Return control points with the errors that an evaluation lists; NaN where it lists none."""
    errors = np.full(len(points), np.nan)
    listed = (result.values.get("pointErrors") if result else None) or []
    for one in listed if isinstance(listed, list) else []:
        nearest = int(np.argmin(np.abs(points.stamps - float(one["time"]))))
        errors[nearest] = float(one["error"])
    return _columns(points.stamps, points.positions) | {"error": errors}


def _against(
    poses: Trajectory, path: Floats, given: tuple[DatasetTruth, Matrix | None], expected: float | None
) -> tuple[Trajectory, Floats, float]:
    """Return the ground truth in the estimate's frame, errors, and how far their RMSE is from the expected.

    The evaluation may have left the ground truth in its own frame: what fits its RMSE better is taken.
    """
    truth, extrinsic = given
    tried = []
    for matrix in (extrinsic, None) if extrinsic is not None else (None,):
        # Bare positions have no orientation by which they could be moved.
        moves = truth.poses.oriented
        reference = truth.poses.moved(matrix) if matrix is not None and moves else truth.poses
        pairs = associate(reference, poses, _MAX_DIFFERENCE)
        errors = np.full(len(poses), np.nan)
        differences = reference.positions[pairs.reference] - path[pairs.estimate]
        errors[pairs.estimate] = np.linalg.norm(differences, axis=1)
        rmse = float(np.sqrt(np.mean(differences**2) * 3)) if len(pairs) else np.nan
        off = abs(rmse / expected - 1) if expected else 0.0
        tried.append((reference, errors, off))
    return min(tried, key=lambda one: np.inf if np.isnan(one[2]) else one[2])


def _transform(result: Result | None) -> Matrix | None:
    given = result.values.get("transform") if result else None
    try:
        matrix = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return matrix if matrix.shape == (4, 4) and np.isfinite(matrix).all() else None


def _rmse(result: Result | None) -> float | None:
    error = (result.values.get("ate") or {}) if result else {}
    value = error.get("rmse") if isinstance(error, dict) else None
    return float(value) if isinstance(value, int | float) and value > 0 else None


def _thinned(errors: Floats, count: int, most: int) -> Indices:
    """Return places of evenly spaced poses and of the one with the largest error."""
    if count <= most:
        return np.arange(count)
    shown = np.linspace(0, count - 1, most - 1).round().astype(np.intp)
    known = np.flatnonzero(~np.isnan(errors))
    worst = known[np.argmax(errors[known])][None] if len(known) else np.empty(0, dtype=np.intp)
    return np.union1d(shown, worst)


def _columns(stamps: Floats, positions: Floats) -> dict[str, Any]:
    x, y, z = (np.ascontiguousarray(positions[:, axis]) for axis in range(3))
    return {"t": np.ascontiguousarray(stamps), "x": x, "y": y, "z": z}


def _reference(reference: Trajectory | None, during: Trajectory | None, most: int) -> dict[str, Any] | None:
    if reference is None:
        return None
    stamps = reference.stamps
    first, last = (during.stamps[0] - 1, during.stamps[-1] + 1) if during else (-np.inf, np.inf)
    inside = np.flatnonzero((stamps >= first) & (stamps <= last))
    if not len(inside):
        return None
    shown = inside[_thinned(np.full(len(inside), np.nan), len(inside), most)]
    return _columns(reference.stamps[shown], reference.positions[shown])


def extrinsic_of(
    record: RunRecord,
    configuration: Mapping[str, Any],
    algorithms: list[CatalogEntry],
    truth: DatasetTruth | None,
) -> Matrix | None:
    """Return T_truth_estimate of a run, (4, 4), from its configuration and its Algorithm; None if unknown."""
    name = (record.spec.get("algorithmRef") or {}).get("name")
    entries = [entry for entry in algorithms if entry.name == name]
    if truth is None or not entries:
        return None
    try:
        spec = AlgorithmSpec.model_validate(entries[-1].spec)
        output = spec.output_of(spec.mode(SensorMode(configuration["mode"])))
        pose = np.eye(4)
        if output.frame != "body":
            asked = (record.spec.get("input") or {}).get("perturb")
            perturb = Perturbation.model_validate(asked) if asked else None
            pose = right_pose(configuration["sensors"][output.frame]["T_body_sensor"], output.frame, perturb)
    except (SlamHiveError, ValueError, KeyError, TypeError, OverflowError):
        return None
    return np.linalg.inv(truth.T_body_frame) @ pose if pose.shape == (4, 4) else None


def usage_columns(place: ArtifactFolder, most: int) -> dict[str, Any]:
    """Return CPU and memory over time from usage.csv, or the original system's profiling.csv, thinned.

    `kind` says what the memory is, as its header tells.

    Raises:
        FileMissingError: there is no file, or no line can be read.
        FileTooLargeError: the file is too large to be drawn.
    """
    found = read_numbers(place, USAGES, _samples, _stretch, headed=True)
    if not found.count:
        raise FileMissingError(f"{found.name}: no sample in it can be read")
    kind = next((kind for named, kind in _MEMORY_KINDS.items() if named in found.header), None)
    table = found.rows
    edges = np.linspace(0, len(table), min(most, len(table)) + 1).round().astype(np.intp)
    begins = edges[:-1]
    # A plot of fewer points must not lose the peak: of each stretch the largest memory, the mean load.
    counts = np.diff(edges)
    return {
        "t": np.ascontiguousarray(table[begins, 0]),
        "cpu": np.add.reduceat(table[:, 1], begins) / counts,
        "memory": np.maximum.reduceat(table[:, 2], begins),
        "anonymous": None if np.isnan(table[:, 3]).all() else np.fmax.reduceat(table[:, 3], begins),
        "kind": kind,
        "samples": found.count,
    }


def _samples(lines: bytes) -> Matrix:
    """Return the rows of some lines, (k, 4); what is missing of the last column is NaN."""
    rows = (numbers_of(b",".join(line.split(b",")[:4]), b",") for line in lines.splitlines())
    return stacked([[*numbers, np.nan][:4] for numbers in rows if len(numbers) >= 3], 4)


def _stretch(rows: Matrix) -> Matrix:
    """Return one row for the samples of a stretch each, as above, (n, k, 4) to (n, 4)."""
    time, load, memory, anonymous = (rows[:, :, column] for column in range(4))
    return np.stack(
        [time[:, 0], load.mean(axis=1), memory.max(axis=1), np.fmax.reduce(anonymous, axis=1)], axis=1
    )
