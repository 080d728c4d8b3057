# SPDX-License-Identifier: Apache-2.0
"""Answers of ``/api/v1/analysis/common``: runs measured again over the time in which all have poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from slamhive.analysis.boards import COMPETITORS
from slamhive.analysis.common import measure_in_common, ranked_medians
from slamhive.analysis.derived import PACE
from slamhive.analysis.grouping import Outcomes, apart
from slamhive.dashboard.answering.encoding import Body, plain
from slamhive.dashboard.problems import BadRequest
from slamhive.model.results import Outcome
from slamhive.runfiles.clocks import CONFIGURATIONS, configuration_of
from slamhive.runfiles.errors import FileAwayError, FileMissingError, FileTooLargeError, RunFileError
from slamhive.runfiles.stored import bring_all
from slamhive.runfiles.trajectories import TRAJECTORIES, extrinsic_of, read_poses
from slamhive.tables.queries import columns, outcomes, select
from slamhive.tables.text import as_columns
from slamhive_eval import EvaluationError, Options, RpeOptions, Trajectory, evaluate

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from slamhive.analysis.common import Common
    from slamhive.archive.records import CatalogEntry
    from slamhive.dashboard.sources.archived import Snapshot, Source
    from slamhive.model.results import Result, RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth
    from slamhive.tables.queries import Pairs
    from slamhive_eval import Evaluation

RESERVED = ("by", "outcomes", "format")
MOST_RESULTS = 60
"""Results that one question measures again at most: each takes some 50 ms."""

_FACETS = ("dataset", "evaluation", "alignment")
_CLOSE = 1e-3
_LITTLE = 0.5


@dataclass(frozen=True, eq=False)
class _Run:
    """A result that can be measured again, or why it can't.

    Attributes:
        row: columns of it.
        own: ATE over all of its poses as the evaluation has it, m; None for none.
        problem: why it can't be measured again.
        poses, options: what it wrote, and how that was measured.
        unlike: whether measuring it here gives another error than the evaluation's.
        found: what it is over the common support.
    """

    row: dict[str, Any]
    own: float | None = None
    problem: str | None = None
    poses: Trajectory | None = None
    options: Options = field(default_factory=Options)
    unlike: bool = False
    found: Evaluation | None = None

    @property
    def error(self) -> float | None:
        """ATE over the common support, m."""
        return self.found.ate.rmse if self.found is not None and self.found.ate is not None else None


@dataclass(frozen=True)
class Meant:
    """The results that are to be measured again.

    Attributes:
        rows: columns of each, by dataset, evaluation and alignment.
        told: columns that tell competitors apart.
        tracked: whether other runs have failed and don't say what is in common.
        notes: sentences on what is left out.
    """

    rows: list[list[dict[str, Any]]]
    told: list[str]
    tracked: bool
    notes: list[str]


@dataclass(frozen=True)
class ResultMaterial:
    """Records, run folders and ground truth that selected results are measured again from.

    Attributes:
        meant: the results.
        records: of their runs, by UID.
        places: folders of those that have one.
        absences: why those have none whose files were removed.
        truths: ground truth of each group of ``meant.rows``.
        algorithms: the catalog's.
    """

    meant: Meant
    records: dict[str, RunRecord]
    places: dict[str, ArtifactFolder]
    absences: dict[str, str]
    truths: list[DatasetTruth | None]
    algorithms: list[CatalogEntry]


def meant(snapshot: Snapshot, pairs: Pairs, by: str | None, which: str) -> Meant:
    """Return the results that a question means.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        by: list of columns that tell competitors apart; default: algorithm, sensors.
        which: all, or tracked: other runs then have failed and don't say what is in common.

    Raises:
        BadRequest: too many results are meant.
    """
    told = columns(snapshot.frame, by, "by", COMPETITORS)
    tracked = outcomes(which) is Outcomes.TRACKED
    chosen = select(snapshot.frame, pairs, RESERVED)
    frame = chosen.frame.select(chosen.frame.column("outcome").present)
    if PACE in apart(frame, [*told, *_FACETS], ())[1]:
        told = [*told, PACE]  # never pooled
    if len(frame) > MOST_RESULTS:
        raise BadRequest(
            f"{len(frame):,} results are selected, and at most {MOST_RESULTS} are measured again at a time: "
            "choose by dataset, evaluation or sweep",
            "where",
        )
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    names = list(dict.fromkeys([*_FACETS, "uid", "run", "status", "coverage", *told]))
    for row in frame.records(names):
        groups.setdefault(tuple(row[name] for name in _FACETS), []).append(row)
    ordered = sorted(groups.items(), key=lambda item: [str(part) for part in item[0]])
    return Meant([rows for _, rows in ordered], told, tracked, list(chosen.notes))


def material(source: Source, meant: Meant) -> ResultMaterial:
    """Look up what results are measured again by: records, folders, ground truth."""
    records, places, absences = {}, {}, {}
    truths = []
    for rows in meant.rows:
        label = None
        for row in rows:
            uid = str(row["uid"])
            record = source.record(uid)
            if record is not None:
                records[uid] = record
                label = label or record.labels.get("dataset")
                try:
                    place = source.place(record)
                except FileAwayError as error:
                    absences[uid] = str(error)
                    continue
                if place is not None:
                    places[uid] = place
                elif absence := source.absence(record):
                    absences[uid] = absence
        truths.append(source.truth(str(rows[0]["dataset"]), label))
    for uid, trouble in bring_all(places, (*TRAJECTORIES, *CONFIGURATIONS)).items():
        absences[uid] = str(trouble)
        del places[uid]
    return ResultMaterial(meant, records, places, absences, truths, source.catalog("Algorithm"))


def common(snapshot: Snapshot, given: ResultMaterial) -> Body:
    """Return results over the runs' own and over their common support, by dataset and evaluation."""
    meant = given.meant
    found = [_group(given, rows, truth) for rows, truth in zip(meant.rows, given.truths, strict=True)]
    content = {
        "revision": snapshot.revision,
        "rows": sum(map(len, meant.rows)),
        "by": meant.told,
        "groups": found,
        "notes": meant.notes,
    }
    return Body(
        content, lambda: as_columns([{**group["facets"], **run} for group in found for run in group["runs"]])
    )


def _group(given: ResultMaterial, rows: list[dict[str, Any]], truth: DatasetTruth | None) -> dict[str, Any]:
    runs = []
    for row in rows:
        if given.meant.tracked and row["status"] != Outcome.TRACKED.value:
            runs.append(_Run(row, problem=f"{row['status']}: only tracked runs count here"))
        else:
            runs.append(_run(given, row, truth))
    able = [place for place, run in enumerate(runs) if run.poses is not None]
    shared = None
    if truth is not None and able:
        poses = [run.poses for run in runs if run.poses is not None]
        shared = measure_in_common(truth.poses, poses, [runs[place].options for place in able])
        for place, found in zip(able, shared.evaluations, strict=True):
            problem = None if found is not None and found.ate is not None else _nothing(shared)
            runs[place] = replace(runs[place], found=found, problem=problem)
    return {
        "facets": {name: rows[0][name] for name in _FACETS},
        "support": _support_json(shared),
        "entries": _entries(runs, given.meant.told),
        "runs": [_run_json(run) for run in runs],
        "notes": _notes(truth, runs, shared),
    }


def _run(given: ResultMaterial, row: dict[str, Any], truth: DatasetTruth | None) -> _Run:
    """Return a run as it can be measured again."""
    uid = str(row["uid"])
    record = given.records.get(uid)
    result = next(
        (one for one in (record.results if record else ()) if one.evaluation == row["evaluation"]), None
    )
    if record is None or result is None:
        return _Run(row, problem="the result is gone")
    own = _rmse(result)
    if truth is None:
        return _Run(row, own, "the ground truth of this dataset is not at hand here")
    if own is None:
        return _Run(row, own, "it has no absolute error")
    try:
        place, poses = _poses(given, uid)
        extrinsic = extrinsic_of(record, configuration_of(place), given.algorithms, truth)
        return _fitting(_Run(row, own, poses=poses), result, truth, extrinsic)
    except (RunFileError, EvaluationError) as error:
        return _Run(row, own, str(error))


def _poses(given: ResultMaterial, uid: str) -> tuple[ArtifactFolder, Trajectory]:
    """Return the folder of a run, and all of its poses.

    Raises:
        RunFileError: it can't be had.
    """
    place = given.places.get(uid)
    if place is None:
        raise FileMissingError(given.absences.get(uid, "the run has no files here"))
    path = read_poses(place)
    if path.every > 1:
        raise FileTooLargeError(f"its {path.count:,} poses are too many to be measured again here")
    return place, path.poses


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _fitting(run: _Run, result: Result, truth: DatasetTruth, extrinsic: npt.NDArray[Any] | None) -> _Run:
    """Return a run with the options of its evaluation: of what they may have been, the ones that fit best."""
    best, least = run, math.inf
    for matrix in (extrinsic, None) if extrinsic is not None else (None,):
        options = _options(result, matrix)
        if run.poses is None or run.own is None:
            continue
        ate = evaluate(truth.poses, run.poses, replace(options, rpe=())).ate
        off = abs(ate.rmse / run.own - 1) if ate is not None and run.own else 0.0
        if off < least:
            best, least = replace(run, options=options, unlike=off > _CLOSE), off
    return best


def _options(result: Result, extrinsic: npt.NDArray[Any] | None) -> Options:
    asked = tuple(
        RpeOptions(one["delta"], one["unit"], one["pairs"], one.get("relTolerance", 0.1))
        for one in result.values.get("rpe") or ()
        if isinstance(one, dict)
        and {"delta", "unit", "pairs"} <= one.keys()
        and _number(one["delta"])
        and _number(one.get("relTolerance", 0.1))
    )
    return Options(alignment=result.values.get("alignment") or "se3", extrinsic=extrinsic, rpe=asked)


def _rmse(result: Result) -> float | None:
    error = result.values.get("ate")
    value = error.get("rmse") if isinstance(error, dict) else None
    return float(value) if isinstance(value, int | float) else None


def _nothing(shared: Common) -> str:
    return (
        "it has too few poses in what the runs have in common"
        if len(shared.spans)
        else "there is no time at which all runs have poses"
    )


def _support_json(shared: Common | None) -> dict[str, Any] | None:
    if shared is None:
        return None
    return {
        "spans": shared.spans.tolist(),
        "seconds": shared.seconds,
        "metres": shared.metres,
        "share": shared.share,
    }


def _run_json(run: _Run) -> dict[str, Any]:
    found = run.found
    return {name: value for name, value in run.row.items() if name not in _FACETS} | {
        "own": plain(run.own),
        "common": plain(run.error),
        "poses": found.matched if found is not None else None,
        "scale": plain(found.scale) if found is not None else None,
        "rpe": [plain(one.statistics.rmse) if one.statistics else None for one in found.rpe] if found else [],
        "problem": run.problem,
    }


def _entries(runs: list[_Run], told: Sequence[str]) -> list[dict[str, Any]]:
    """Return competitors with the medians of their runs, failed ones last, the best in common first."""
    members: dict[tuple[Any, ...], list[_Run]] = {}
    for run in runs:
        members.setdefault(tuple(run.row[name] for name in told), []).append(run)
    figures = [
        [[math.inf if value is None else value for value in values] for values in column]
        for column in (
            [[run.own if run.error is not None else None for run in one] for one in members.values()],
            [[run.error for run in one] for one in members.values()],
        )
    ]
    (own, own_ranks), (shared, ranks) = (ranked_medians(column) for column in figures)
    entries = [
        {
            "keys": dict(zip(told, key, strict=True)),
            "runs": len(one),
            "n": sum(run.error is not None for run in one),
            "own": plain(float(own[number])),
            "ownRank": float(own_ranks[number]),
            "common": plain(float(shared[number])),
            "rank": float(ranks[number]),
        }
        for number, (key, one) in enumerate(members.items())
    ]
    return sorted(entries, key=lambda entry: (entry["rank"], entry["ownRank"]))


def _notes(truth: DatasetTruth | None, runs: list[_Run], shared: Common | None) -> list[str]:
    notes = []
    if truth is None:
        notes.append("the ground truth of this dataset is not at hand here")
    if shared is not None and shared.share < _LITTLE:
        least = min(
            (run for run in runs if run.poses is not None), key=lambda run: run.row["coverage"] or 0.0
        )
        notes.append(
            f"the runs have {shared.share:.0%} of the ground truth's path in common; run {least.row['run']} "
            f"alone covers {least.row['coverage'] or 0.0:.0%}; without it the others are compared on more"
        )
    if unlike := sum(run.unlike for run in runs):
        notes.append(
            f"{unlike} of {len(runs)} results can't be reproduced here over the runs' own support: their "
            "evaluation used another ground truth, frame or tolerance than what is at hand"
        )
    return notes
