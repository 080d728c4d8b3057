# SPDX-License-Identifier: Apache-2.0
"""From the archive to the rows that are meant: as ``slamhive results`` chooses them, but in columns."""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.columns import Column
from slamhive.analysis.expressions import parse_where
from slamhive.analysis.grouping import Groups, where_equal, with_facets
from slamhive.archive import Archive
from slamhive.archive.connection import connect
from slamhive.dashboard.loading import load
from slamhive.dashboard.rows import PREFIXES
from slamhive.local.home import Home
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.results import Outcome, Phase

if TYPE_CHECKING:
    from slamhive.analysis.columns import Mask
    from slamhive.analysis.frame import Frame

NOT_EVALUATED = "NotEvaluated"
REVISION_DIGITS = 16

_OF_RUN = frozenset(
    (
        *("id", "uid", "run", "name", "sweep", "index", "algorithm", "sensors", "dataset", "repetition"),
        *("seed", "phase", "reason", "message", "attempts", "created", "started", "finished", "folder"),
        *("disturbed",),
    )
)
_PREFIXES_OF_RUN = tuple(f"{prefix}." for prefix, _, _ in PREFIXES)
_REVISED = ("uid", "evaluation", "status", "coverage", "ate.rmse", "usage.cpu.seconds", "finished")


@dataclass(frozen=True)
class Selection:
    """Which rows are meant.

    Attributes:
        sweeps: only runs of these sweeps; none for all.
        evaluation: only this evaluation.
        where: a condition.
        option: what stands before the names of these in a complaint, ``--`` on the command line.
    """

    sweeps: tuple[str, ...] = ()
    evaluation: str | None = None
    where: str | None = None
    option: str = ""

    @property
    def sentences(self) -> list[str]:
        """Return what was chosen, in words."""
        parts = []
        if self.sweeps:
            parts.append(f"{'sweep' if len(self.sweeps) == 1 else 'sweeps'} {', '.join(self.sweeps)}")
        if self.evaluation:
            parts.append(f"evaluation {self.evaluation}")
        if self.where:
            parts.append(f"where {self.where}")
        return parts


def archive_url(place: str | os.PathLike[str] | None = None) -> str:
    """Return the database URL of an archive.

    Args:
        place: a database URL, a home, or an SQLite file; None for the home that ``$SLAMHIVE_HOME`` names.

    Raises:
        InputError: there is no such place.
    """
    if place is None:
        return Home.from_environment().archive_url
    text = os.fspath(place)
    if "://" in text:
        return text
    path = Path(text).expanduser().absolute()
    if "?" in str(path):  # what follows it in a database URL would be taken for options
        raise InputError(f"{path}: a path with a question mark is not allowed")
    if path.is_dir():
        path /= "archive.sqlite"
    return f"sqlite:///{path}"


def read_archive(url: str) -> Frame:
    """Read all runs of an archive, one row a run and evaluation.

    Raises:
        InputError: there is no archive at the URL.
        SystemFault: the database doesn't answer.
    """
    file = url.removeprefix("sqlite:///")
    if file != url and not Path(file).is_file():
        raise InputError(f"no archive at {file}; slamhive demo, run and import make one")
    engine = connect(url)
    with closing(Archive(engine)):
        return load(engine).frame


def select(frame: Frame, selection: Selection, *, failed_everywhere: bool = False) -> Frame:
    """Return the rows that a selection means.

    Args:
        frame: all rows.
        selection: what is meant.
        failed_everywhere: give failed runs the evaluations of the others before the condition is asked, so
            that one on evaluations does not lose them.

    Raises:
        InputError: a sweep or evaluation is unknown, or the condition can't be understood.
    """
    if selection.sweeps:
        known = [str(name) for name in frame.column("sweep").factorized()[1] if name is not None]
        chosen = np.zeros(len(frame), dtype=bool)
        for name in selection.sweeps:
            if name not in known:
                raise UnknownNameError("sweep", name, known, f"{selection.option}sweep")
            chosen |= where_equal(frame, "sweep", name)
        frame = frame.select(chosen)
    if selection.evaluation is not None:
        frame = _of_evaluation(frame, selection.evaluation, f"{selection.option}evaluation")
    if failed_everywhere:
        # The column anew, so that it knows of no evaluation but those of the rows that are left.
        evaluations = Column.of(frame.column("evaluation").tolist())
        frame = with_facets(frame.replaced({"evaluation": evaluations}))
    if selection.where:
        frame = frame.select(parse_where(selection.where, frozenset(frame.names)).mask(frame))
    return frame


def with_figure(frame: Frame, metric: str) -> tuple[Frame, list[str]]:
    """Return the runs without those of evaluations that have no such figure: they did not fail in it.

    Args:
        frame: the runs.
        metric: column that is ranked by.
    """
    numbers, tracked = frame.column(metric).floats(), where_equal(frame, "status", Outcome.TRACKED.value)
    kept, notes = np.ones(len(frame), dtype=bool), []
    groups = Groups(frame, ("evaluation",))
    for rows, keys in zip(groups.members(), groups.keys, strict=True):
        if tracked[rows].any() and np.isnan(numbers[rows]).all():
            kept[rows] = False
            notes.append(f"evaluation {keys['evaluation']} has no {metric}: its runs are not shown here")
    return (frame, notes) if kept.all() else (frame.select(kept), notes)


def _of_evaluation(frame: Frame, name: str, where: str) -> Frame:
    """Return each run once: with its result of an evaluation, or without any."""
    chosen = where_equal(frame, "evaluation", name)
    if not chosen.any():
        known = [str(one) for one in frame.column("evaluation").factorized()[1] if one is not None]
        raise UnknownNameError("evaluation", name, known, where)
    ids = frame.column("id").floats()
    _, first = np.unique(ids, return_index=True)
    rest = np.zeros(len(frame), dtype=bool)
    rest[first] = True
    rest &= ~np.isin(ids, ids[chosen])
    kept = frame.select(chosen | rest)
    return _without_results(kept, rest[chosen | rest])


def _without_results(frame: Frame, rows: Mask) -> Frame:
    """Return the rows with some of them as those of runs that nothing measured."""
    measured = rows & frame.column("outcome").present
    if not measured.any():
        return frame
    changed = {
        name: _emptied(frame.column(name), measured)
        for name in [*frame.stored, "ate.extended"]
        if name not in _OF_RUN and name != "status" and not name.startswith(_PREFIXES_OF_RUN)
    }
    succeeded = measured & where_equal(frame, "phase", Phase.SUCCEEDED.value)
    words = [
        NOT_EVALUATED if missing else word
        for word, missing in zip(frame.column("status").tolist(), succeeded.tolist(), strict=True)
    ]
    return frame.replaced({**changed, "status": Column.of(words)})


def _emptied(column: Column, rows: Mask) -> Column:
    if column.kind.is_numeric:
        return Column(column.kind, np.where(rows, np.nan, column.numbers), column.codes)
    codes = np.where(rows, -1, column.codes).astype(np.int32)
    return Column(column.kind, column.numbers, codes, column.values)


def revision(frame: Frame) -> str:
    """Return 16 digits that differ whenever runs or what was found of them differ."""
    columns = [frame.column(name).tolist() for name in _REVISED]
    lines = sorted(json.dumps(row, default=str) for row in zip(*columns, strict=True))
    return hashlib.sha256("\n".join(lines).encode("utf-8", "replace")).hexdigest()[:REVISION_DIGITS]
