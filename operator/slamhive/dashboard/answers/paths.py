# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/analysis/paths``: paths of several runs over their ground truth, as of all repetitions of one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.derived import PACE
from slamhive.analysis.grouping import SUBJECT, Groups, varying, where_equal
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.answers.common_support import Meant
from slamhive.dashboard.problems import Missing
from slamhive.runfiles.clocks import configuration_of
from slamhive.runfiles.errors import FileMissingError, RunFileError
from slamhive.runfiles.trajectories import drawn, extrinsic_of, read_poses
from slamhive.tables.queries import select
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame
    from slamhive.dashboard.answers.common_support import ResultMaterial
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.runfiles.ground_truth import DatasetTruth
    from slamhive.tables.queries import Pairs

RESERVED = ("of", "points", "format")
MOST_PATHS = 60
"""Runs whose paths are drawn in one picture: each takes some 20 ms, and more can't be told apart."""

_FACETS = ("dataset", "evaluation", "alignment")
_SAME = 1e-3  # m
_SHOWN = ("uid", "run", "status", "coverage", "ate.rmse")


def meant(snapshot: Snapshot, pairs: Pairs, of: str | None) -> Meant:
    """Return the runs that a question means.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        of: UID of a run whose repetitions are meant: runs with the same settings on the same dataset, of the
            same versions.

    Raises:
        Missing: there is no such run.
    """
    chosen = select(snapshot.frame, pairs, RESERVED, each=True)
    frame, notes = chosen.frame, list(chosen.notes)
    if of is not None:
        frame = frame.select(_alike(frame, of))
    if len(frame) > MOST_PATHS:
        notes.append(f"of {len(frame):,} runs the first {MOST_PATHS} are drawn: choose fewer")
        frame = frame.select(np.arange(MOST_PATHS))
    named = ("algorithm", "sensors", PACE, *_settings(frame), "repetition")
    told = [name for name in named if _differs(frame, name)]
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in frame.records(list(dict.fromkeys([*_FACETS, *_SHOWN, *SUBJECT, *told]))):
        groups.setdefault(tuple(row[name] for name in _FACETS), []).append(row)
    ordered = sorted(groups.items(), key=lambda item: [str(part) for part in item[0]])
    return Meant([rows for _, rows in ordered], told, tracked=False, notes=notes)


def _settings(frame: Frame) -> list[str]:
    """Return the settings that differ: what a dataset is like is none."""
    return [name for name in varying(frame) if not name.startswith("dataset.attributes.")]


def _differs(frame: Frame, name: str) -> bool:
    return name == "repetition" or len(frame.column(name).unique()) > 1


def _alike(frame: Frame, uid: str) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Tell which runs are repetitions of one, (n,)."""
    itself = where_equal(frame, "uid", uid)
    if not itself.any():
        raise Missing(f"there is no run with the UID {uid[:100]!r} among these", "of")
    same = np.ones(len(frame), dtype=bool)
    for name in SUBJECT:  # settings are compared with runs of the same algorithm alone
        codes, _ = frame.column(name).factorized()
        same &= codes == codes[itself.argmax()]
    near = frame.select(same)
    keys = [PACE, *_settings(near), "algorithm.version", "dataset.version"]
    groups = Groups(near, keys)
    mine = groups.of_row[where_equal(near, "uid", uid).argmax()]
    same[same] = groups.of_row == mine
    return same


def paths(snapshot: Snapshot, given: ResultMaterial, most: int) -> Body:
    """Return the paths of runs, thinned, with errors, by dataset and evaluation.

    Args:
        snapshot: the data.
        given: the runs and what their paths are drawn from.
        most: poses shown of each path at most.
    """
    found = [
        _group(given, rows, truth, most) for rows, truth in zip(given.meant.rows, given.truths, strict=True)
    ]
    content = {
        "revision": snapshot.revision,
        "rows": sum(map(len, given.meant.rows)),
        "by": given.meant.told,
        "groups": found,
        "notes": given.meant.notes,
    }
    shown = ("uid", "run", "status", "coverage", "error", "problem")
    return Body(
        content,
        lambda: as_columns(
            [
                {**group["facets"], **run["keys"], **{name: run[name] for name in shown}}
                for group in found
                for run in group["runs"]
            ]
        ),
    )


def _group(
    given: ResultMaterial, rows: list[dict[str, Any]], truth: DatasetTruth | None, most: int
) -> dict[str, Any]:
    reference: dict[str, Any] | None = None
    runs = []
    notes: dict[str, None] = {}
    beside: dict[str, None] = {}
    first = None
    for row in rows:
        run: dict[str, Any] = {
            **{name: row[name] for name in ("uid", "run", "status", "coverage")},
            "keys": {name: row[name] for name in given.meant.told},
            "error": row["ate.rmse"],
            "track": None,
            "problem": None,
        }
        try:
            found = _drawn(given, row, truth, most)
        except RunFileError as error:
            run["problem"] = str(error)
        else:
            run["track"] = found["estimate"]
            if reference is None:
                reference, first = found["reference"], row["algorithm"]
            if apart(reference, found["reference"]):
                beside |= {str(row["algorithm"]): None}
            notes |= dict.fromkeys(found["notes"])
        runs.append(run)
    if beside:
        whose = f"{', '.join(beside)} are of another frame than those of {first}, as of the IMU and the LiDAR"
        notes[f"poses of {whose}: the ground truth drawn is that of {first}"] = None
    return {
        "facets": {name: rows[0][name] for name in _FACETS},
        "reference": reference,
        "runs": runs,
        "notes": list(notes),
    }


def apart(one: dict[str, Any] | None, other: dict[str, Any] | None) -> bool:
    """Tell whether two references are a millimetre or more apart at the first time that both have."""
    if one is None or other is None:
        return False
    _, first, second = np.intersect1d(one["t"], other["t"], return_indices=True)
    steps = [one[axis][first[:1]] - other[axis][second[:1]] for axis in "xyz"]
    return bool(np.linalg.norm(steps) > _SAME)


def _drawn(
    given: ResultMaterial, row: dict[str, Any], truth: DatasetTruth | None, most: int
) -> dict[str, Any]:
    """Return a run's path as its own page draws it.

    Raises:
        RunFileError: it can't be had.
    """
    uid = str(row["uid"])
    record, place = given.records.get(uid), given.places.get(uid)
    if record is None or place is None:
        raise FileMissingError(given.absences.get(uid, "the run has no files here"))
    result = next((one for one in record.results if one.evaluation == row["evaluation"]), None)
    extrinsic = extrinsic_of(record, configuration_of(place), given.algorithms, truth)
    return drawn(read_poses(place), result, truth, extrinsic, most)
