# SPDX-License-Identifier: Apache-2.0
"""Measuring one run's trajectory: the settings of an Evaluation translated for the evaluator.

The workstation, the importer and the evaluator's container all measure through here, so that equal
settings mean the same everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from slamhive.model.base import plural, seconds
from slamhive.model.canonical import digest, normalize
from slamhive.model.dataset import TruthFormat
from slamhive.model.errors import InputError
from slamhive.model.evaluation import Alignment, EvaluationSettings
from slamhive.model.results import IntendedEvaluation, Outcome, Result
from slamhive_eval import (
    ControlPoints,
    NoPosesError,
    Options,
    Relations,
    RpeOptions,
    Trajectory,
    TrajectoryError,
    evaluate,
    evaluate_pieces,
    evaluate_points,
    evaluate_relations,
    number_poses,
    read_tum,
)
from slamhive_eval.evaluation import NO_POSE, VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.model.dataset import DatasetSpec
    from slamhive.model.sensors import SensorMode
    from slamhive_eval import Piece, RelationErrors

SETTINGS_KEY = "settings"
"""Key of a result's values under which the hash of its settings stands."""

VERSION_KEY = "evaluationVersion"
"""Key of a result's values under which the version of the evaluator stands; see `version_of`."""

RELATIONS = "relations"
"""Name of the evaluation against relative poses, unless an Evaluation names it."""

SEGMENTS = "segments.csv"
"""Beside a run's trajectory: when it tracked without a break, in which of its maps."""

CPU_SECONDS = 600
"""CPU time that measuring a run may take, wherever it happens: a few for the longest."""

_SHORT_SECONDS = 10.0
_MOST_MAPS = 20
"""Maps of a run that are measured: what they take, and what is kept of them, is bounded."""

Method = Literal["none", "origin", "se3", "sim3", "yaw"]
_METHODS: dict[Alignment, Method] = {
    Alignment.SE3: "se3",
    Alignment.SIM3: "sim3",
    Alignment.YAW: "yaw",
    Alignment.ORIGIN: "origin",
    Alignment.NONE: "none",
}


@dataclass(frozen=True)
class Subject:
    """The evaluator's inputs for one run.

    Attributes:
        mode: its sensor mode.
        extrinsic: T_truth_estimate, (4, 4): the estimate's frame in the ground truth's; None to leave it.
        gravity_aligned: whether both the dataset's and the algorithm's world have z pointing up.
        keyframes: whether the estimate holds keyframes alone; None when unknown.
        window: first and last sensor time of the run's input in s; None for all of the ground truth.
    """

    mode: SensorMode
    extrinsic: npt.NDArray[np.float64] | None = None
    gravity_aligned: bool = False
    keyframes: bool | None = None
    window: tuple[float, float] | None = None


def method(settings: EvaluationSettings, subject: Subject) -> Method:
    """Return the alignment that the settings mean for a run.

    Raises:
        InputError: yaw alone, but the worlds are not known to be gravity-aligned.
    """
    if settings.alignment is Alignment.AUTO:
        return "se3" if subject.mode.has_scale else "sim3"
    if settings.alignment is Alignment.YAW and not subject.gravity_aligned:
        raise InputError(
            "evaluation.alignment: Yaw needs a Dataset and an Algorithm that are both gravityAligned; use SE3"
        )
    return _METHODS[settings.alignment]


def intended_evaluations(
    settings: EvaluationSettings, mode: SensorMode, dataset: DatasetSpec | None, name: str | None = None
) -> list[IntendedEvaluation]:
    """Return the evaluations that a run is meant for: one, or none where nothing can measure it.

    It is recorded with each run, so that one that fails counts in the evaluation that it would have had and
    in no other.

    Args:
        settings: how runs are measured.
        mode: the run's sensor mode.
        dataset: its dataset; None when that isn't known any more.
        name: the evaluation's name; default: the alignment.
    """
    alignment: Method = "se3" if mode.has_scale else "sim3"
    if settings.alignment is not Alignment.AUTO:
        alignment = _METHODS[settings.alignment]
    usual: str = alignment
    if dataset is not None:
        truth = dataset.ground_truth
        if truth is None and dataset.recording.synthetic is None and not dataset.is_to_fetch:
            return []
        if truth is not None and truth.format is TruthFormat.RELATIONS:
            alignment, usual = "none", RELATIONS
    hashed = settings_hash(settings)
    return [IntendedEvaluation(evaluation=name or usual, alignment=alignment, settings=hashed)]


def settings_hash(settings: EvaluationSettings) -> str:
    """Return a hash that tells apart settings that may give different results."""
    return digest(normalize(EvaluationSettings.as_json(settings)))[:16]


def version_of(values: Mapping[str, Any]) -> int:
    """Return the version of the evaluator that a result's values are of: the first one named none."""
    version = values.get(VERSION_KEY)
    return version if isinstance(version, int) else 1


def is_current(values: Mapping[str, Any], settings: str) -> bool:
    """Tell whether measuring again with settings of a hash would give the values that a result has."""
    return values.get(SETTINGS_KEY) == settings and version_of(values) >= VERSION


def outdated_note(values: Mapping[str, Any]) -> str | None:
    """Return a sentence on a result of an earlier version of our evaluator; None for any other."""
    if SETTINGS_KEY not in values or version_of(values) >= VERSION:
        return None
    return (
        f"measured by version {version_of(values)} of the evaluation, {VERSION} is current: "
        "slamhive results measure brings it up to date"
    )


def measure(
    reference: Trajectory | Relations | ControlPoints,
    estimate: Trajectory | None,
    settings: EvaluationSettings,
    subject: Subject,
    name: str | None = None,
    *,
    pieces: Sequence[Piece] | None = None,
) -> Result:
    """Measure an estimate against its dataset's ground truth.

    Args:
        reference: poses or positions of the ground truth, control points, or relations between poses.
        estimate: what the algorithm wrote; None: it ran to its end and wrote no pose, which is a lost run.
        settings: how to measure.
        subject: what is known of the run.
        name: the evaluation's name; default: the alignment, such as ``se3``.
        pieces: what the algorithm says of its restarts and maps; None: it says nothing. The map over the
            longest path stands for the run.

    Raises:
        InputError: the settings don't fit the run.
        EvaluationError: no pose is in a piece.
    """
    if isinstance(reference, Relations):
        name = name or RELATIONS
        return _measure_relations(reference, estimate, settings, subject, name, pieces=pieces)
    asked = options(settings, subject)
    if isinstance(reference, ControlPoints):
        values = _measure_points(reference, estimate, asked, pieces)
    elif pieces is None or estimate is None:
        values = evaluate(reference, estimate, asked).as_dict()
    else:
        values = evaluate_pieces(reference, estimate, pieces, asked, most=_MOST_MAPS)
    outcome = Outcome(values.pop("outcome"))
    coverage = values.pop("coverage")
    return Result(
        evaluation=name or asked.alignment,
        outcome=outcome,
        coverage=coverage,
        values=_tagged(values, settings),
    )


def options(settings: EvaluationSettings, subject: Subject) -> Options:
    """Return the settings in the evaluator's words.

    Raises:
        InputError: they don't fit the run.
    """
    return Options(
        alignment=method(settings, subject),
        extrinsic=subject.extrinsic if settings.frame == "Estimate" else None,
        max_difference_seconds=seconds(settings.association.max_difference),
        offset_seconds=settings.association.offset,
        rpe=tuple(
            RpeOptions(
                delta=one.delta,
                unit=one.unit,
                pairs="all" if one.pairs == "All" else "consecutive",
                rel_tolerance=one.rel_tolerance,
            )
            for one in settings.rpe
        ),
        min_coverage=settings.success.min_coverage,
        max_ate=settings.success.max_ate,
        keyframes=subject.keyframes,
        has_scale=subject.mode.has_scale,
        window=subject.window,
    )


def _measure_points(
    reference: ControlPoints, estimate: Trajectory | None, options: Options, pieces: Sequence[Piece] | None
) -> dict[str, Any]:
    """Return the figures of the estimate's map over the longest path; others share no frame."""
    outside = 0
    if pieces is not None and estimate is not None:
        numbers, _ = number_poses(estimate, pieces)
        maps = [estimate.select(np.flatnonzero(numbers == k)) for k in np.unique(numbers[numbers >= 0])]
        if not maps:
            raise TrajectoryError(f"no pose of the estimate is in a piece of {SEGMENTS}")
        main = max(maps, key=lambda one: one.path_length)
        outside, estimate = len(estimate) - len(main), main
    values = evaluate_points(reference, estimate, options).as_dict()
    if outside:
        values["notes"].append(f"left out: {plural(outside, 'pose')} not of the map over the longest path")
    return values


def read_estimate(path: str | Path) -> Trajectory | None:
    """Read what an algorithm wrote, in TUM format; None where it wrote a file without a pose.

    Raises:
        EvaluationError: it is no trajectory.
    """
    try:
        return read_tum(path)
    except NoPosesError:
        return None


def _measure_relations(
    reference: Relations,
    estimate: Trajectory | None,
    settings: EvaluationSettings,
    subject: Subject,
    name: str,
    *,
    pieces: Sequence[Piece] | None,
) -> Result:
    tolerance, offset = seconds(settings.association.max_difference), settings.association.offset
    if subject.window is not None:
        reference = _within(reference, subject.window, tolerance)
    relations = len(reference)
    if pieces is not None and estimate is not None:
        reference, estimate = _in_one_map(reference, estimate, pieces, offset)
    if offset and estimate is not None:
        estimate = Trajectory(estimate.stamps + offset, estimate.positions, estimate.quaternions)
    found = evaluate_relations(
        reference,
        estimate,
        max_difference_seconds=tolerance,
        extrinsic=subject.extrinsic if settings.frame == "Estimate" else None,
    )
    share = found.count / relations
    message = NO_POSE if estimate is None else _relations_diverged(reference, found)
    if estimate is None:
        outcome = Outcome.LOST
    elif message:
        outcome = Outcome.DIVERGED
    elif share >= settings.success.min_coverage:
        outcome = Outcome.TRACKED
    else:
        outcome = Outcome.PARTIAL if share >= 0.5 else Outcome.LOST
    values = {"alignment": "none", "message": message, "relations": found.as_dict()}
    return Result(evaluation=name, outcome=outcome, coverage=share, values=_tagged(values, settings))


def _relations_diverged(reference: Relations, found: RelationErrors) -> str:
    """Say why an estimate has diverged: over short times it is worse than standing still; empty if it isn't.

    Drift alone can't do that: over seconds it is far smaller than the motion.
    """
    short = (np.abs(reference.end - reference.begin) <= _SHORT_SECONDS)[found.used]
    if not short.any():
        return ""
    moved = _rms(np.linalg.norm(reference.positions[found.used][short], axis=1))
    error = _rms(found.translation_errors[short])
    if error <= moved:
        return ""
    return (
        f"over relations up to {_SHORT_SECONDS:g} s apart the error is {error:.3g} m "
        f"where the robot moved {moved:.3g} m"
    )


def _rms(values: npt.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _within(relations: Relations, window: tuple[float, float], tolerance: float) -> Relations:
    """Return the relations between times of the run's input: it can't know of others."""
    low, high = window[0] - tolerance, window[1] + tolerance
    first = np.minimum(relations.begin, relations.end)
    last = np.maximum(relations.begin, relations.end)
    kept = (first >= low) & (last <= high)
    if not kept.any():
        raise InputError(
            f"the ground truth has no relation between two times of the run's input, "
            f"{window[0]:.3f} s to {window[1]:.3f} s"
        )
    return Relations(
        relations.begin[kept], relations.end[kept], relations.positions[kept], relations.quaternions[kept]
    )


def _in_one_map(
    relations: Relations, estimate: Trajectory, pieces: Sequence[Piece], offset: float
) -> tuple[Relations, Trajectory]:
    """Return the relations between poses of one map, and the poses of maps: two maps share no frame."""
    numbers, _ = number_poses(estimate, pieces)
    inside = np.flatnonzero(numbers >= 0)
    estimate, numbers = estimate.select(inside), numbers[inside]
    between = (estimate.stamps[1:] + estimate.stamps[:-1]) / 2
    first, last = (
        numbers[np.searchsorted(between, times - offset)] for times in (relations.begin, relations.end)
    )
    kept = first == last
    if not kept.any():
        raise InputError(f"no relation of the ground truth is between two poses of one map of {SEGMENTS}")
    chosen = (
        array[kept] for array in (relations.begin, relations.end, relations.positions, relations.quaternions)
    )
    return Relations(*chosen), estimate


def _tagged(values: dict[str, Any], settings: EvaluationSettings) -> dict[str, Any]:
    return {**values, SETTINGS_KEY: settings_hash(settings), VERSION_KEY: VERSION}
