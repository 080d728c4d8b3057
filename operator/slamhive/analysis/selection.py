# SPDX-License-Identifier: Apache-2.0
"""The rows that a question means, what is left out of them (docs/results.md, "What counts"), their order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.analysis.columns import Column, ColumnKind, count_distinct
from slamhive.analysis.expressions import parse_where
from slamhive.analysis.grouping import where_equal
from slamhive.model.base import plural
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.results import Phase, Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.conditions import Node
    from slamhive.analysis.frame import Frame

UNIQUE = ("id", "evaluation")
"""Columns that every order ends with, so that no two rows are equal in it."""

_VERSION = "evaluationVersion"
_CONTENT = ("provenance.contentHash", "evaluation", "settings")
_LEAST_UID = 8
_UNFINISHED = frozenset(phase.value for phase in Phase if not phase.is_finished)
_INFRASTRUCTURE = frozenset(reason.value for reason in Reason if reason.is_infrastructure)


@dataclass(frozen=True)
class Selection:
    """The rows that a question selects.

    Attributes:
        sweeps: only runs of these sweeps: names, NAMESPACE/NAME (/NAME for a workstation's), or digits of
            an identity; none for all.
        evaluation: only this evaluation.
        where: a condition.
        superseded: whether results of earlier versions are meant too.
        each: whether runs are meant one by one: those of equal content too, and unfinished ones.
    """

    sweeps: tuple[str, ...] = ()
    evaluation: str | None = None
    where: str | None = None
    superseded: bool = False
    each: bool = False

    @property
    def sentences(self) -> list[str]:
        """Return the choices in words, a phrase each."""
        parts = []
        if self.sweeps:
            parts.append(f"{'sweep' if len(self.sweeps) == 1 else 'sweeps'} {', '.join(self.sweeps)}")
        if self.evaluation:
            parts.append(f"evaluation {self.evaluation}")
        if self.where:
            parts.append(f"where {self.where}")
        if self.superseded:
            parts.append("superseded results too")
        return parts


class Chosen(NamedTuple):
    """Rows, and sentences on what is left out of them.

    Attributes:
        frame: the rows.
        notes: sentences.
        superseded: number of runs left out as they are superseded.
        repeated: number of runs left out as others have the same content.
    """

    frame: Frame
    notes: tuple[str, ...]
    superseded: int = 0
    repeated: int = 0


def choose(frame: Frame, selection: Selection) -> Chosen:
    """Return the rows that a selection means.

    Args:
        frame: all rows.
        selection: what is meant.

    Raises:
        InputError: a sweep or evaluation is unknown, or the condition can't be understood.
    """
    if selection.sweeps:
        chosen = np.zeros(len(frame), dtype=bool)
        for name in selection.sweeps:
            chosen |= of_sweep(frame, name)
        frame = frame.select(chosen)
    if selection.evaluation is not None:
        frame = _of_evaluation(frame, selection.evaluation)
    node = parse_where(selection.where, frozenset(frame.names)) if selection.where else None
    return meeting(frame, node, superseded=selection.superseded, each=selection.each)


def meeting(frame: Frame, node: Node | None, *, superseded: bool = False, each: bool = False) -> Chosen:
    """Return the rows that meet a condition: of current versions, equal content once, unless told otherwise.

    Args:
        frame: the rows.
        node: the condition; None for all.
        superseded: whether results of earlier versions are meant too.
        each: whether runs are meant one by one: those of equal content too, and unfinished ones.
    """
    frame = _with_versions(frame)
    inside = np.ones(len(frame), dtype=bool) if node is None else node.mask(frame)
    left_out = np.zeros(len(frame), dtype=bool)
    if not superseded:
        left_out = inside & frame.column("superseded").present
        inside = inside & ~left_out
    old = frame.count_runs(left_out)
    notes = []
    if old:
        notes.append(f"{plural(old, 'run')} of earlier versions left out ({_why(frame, left_out)})")
    if not inside.all():
        frame = frame.select(inside)
    again = 0
    if not each:
        frame, waiting = finished(frame)
        notes += waiting
        kept = once(frame)
        again = frame.count_runs(~kept)
        if again:
            repeat = "repeats" if again == 1 else "repeat"
            notes.append(f"{plural(again, 'run')} {repeat} the content of others: equal content counts once")
            frame = frame.select(kept)
    if not len(frame) and old:
        are = "is" if old == 1 else "are"
        why = notes[0].partition("(")[2].rstrip(")")
        notes = [
            f"all {plural(old, 'run')} selected {are} of earlier versions ({why}): ask for superseded results"
        ]
    return Chosen(frame, (*notes, *_outdated_notes(frame)), old, again)


def finished(frame: Frame) -> tuple[Frame, list[str]]:
    """Return the rows of finished runs, and a sentence on the others where there are any."""
    unfinished = frame.column("phase").among(_UNFINISHED)
    if not unfinished.any():
        return frame, []
    note = f"{plural(frame.count_runs(unfinished), 'run')} not finished yet"
    return frame.select(~unfinished), [note]


def _with_versions(frame: Frame) -> Frame:
    """Return the rows with the version of the evaluation where a result names none: it is of the first."""
    version = frame.column(_VERSION)
    if version.is_empty or not version.kind.is_numeric:  # an evaluator that isn't ours may write anything
        return frame
    numbers = np.where(frame.column("outcome").present & ~version.present, 1.0, version.numbers)
    return frame.replaced({_VERSION: Column.of_numbers(numbers, ColumnKind.INTEGER)})


def _outdated_notes(frame: Frame) -> list[str]:
    """Say how many runs an earlier version measured than others in the same evaluation."""
    numbers = frame.column(_VERSION).floats()
    if np.isnan(numbers).all():
        return []
    evaluations, names = frame.column("evaluation").factorized()
    newest = np.zeros(len(names))
    np.maximum.at(newest, evaluations, np.nan_to_num(numbers))
    count = frame.count_runs(numbers < newest[evaluations])
    if not count:
        return []
    runs = "1 run was" if count == 1 else f"{count:,} runs were"
    what = "evaluationVersion tells them apart, slamhive results measure brings them up to date"
    return [f"{runs} measured by an earlier version of the evaluation: {what}"]


def _why(frame: Frame, mask: Mask) -> str:
    """Return the reasons of superseded runs, each once."""
    column = frame.column("superseded")
    return ", ".join(column.values[code] for code in np.unique(column.codes[mask]).tolist())


def once(frame: Frame) -> Mask:
    """Tell which rows stay when equal content counts once an evaluation and its settings, (n,).

    Of equal ones a measured run stays, by the latest version of the evaluation; then one that the machine and
    the user let end; then one that was computed and not reused; then the latest.
    """
    repeated = np.flatnonzero(frame.standing(_repeated, frozenset(_CONTENT)))
    kept = np.ones(len(frame), dtype=bool)
    if len(repeated):
        inside = frame.select(repeated)
        order = preference(inside)
        _, firsts = np.unique(contents(inside)[order], return_index=True)
        kept[repeated] = False
        kept[repeated[order[firsts]]] = True
    return kept


def find_repeated(frame: Frame) -> None:
    """Find the rows of equal content in a whole table, so that no question about a part of it has to."""
    frame.standing(_repeated, frozenset(_CONTENT))


def _repeated(frame: Frame) -> Mask:
    """Tell which rows have a content that others have too, (n,)."""
    groups = contents(frame)
    known = groups >= 0
    if count_distinct(groups[known]) == np.count_nonzero(known):
        return np.zeros(len(frame), dtype=bool)
    _, places, counts = np.unique(groups, return_inverse=True, return_counts=True)
    found: Mask = known & (counts[places] > 1)
    return found


def contents(frame: Frame) -> Indices:
    """Return a number for each content, evaluation and settings, (n,); -1 where the content isn't known."""
    content = frame.column(_CONTENT[0])
    if content.kind.is_numeric:
        return np.full(len(frame), -1)
    groups = content.codes.astype(np.int64)
    for name in _CONTENT[1:]:
        column = frame.column(name)
        codes = np.full(len(frame), -1) if column.kind.is_numeric else column.codes
        groups = groups * (len(column.values) + 1) + codes + 1
    return np.where(content.codes >= 0, groups, -1)


def preference(frame: Frame) -> Indices:
    """Return the places of the rows, those first that stay of equal content."""
    created = frame.column("created").floats()
    return np.lexsort(
        (
            -frame.column("id").floats(),
            -np.where(np.isnan(created), -np.inf, created),
            frame.column("provenance.reusedFrom").present,
            _ended_by_others(frame),
            -np.nan_to_num(frame.column(_VERSION).floats()),
            ~frame.column("outcome").present,
        )
    )


def _ended_by_others(frame: Frame) -> Mask:
    return frame.column("reason").among(_INFRASTRUCTURE) | frame.column("phase").among(
        {Phase.CANCELLED.value}
    )


def of_sweep(frame: Frame, name: str) -> Mask:
    """Tell which rows belong to the sweep that a name means, in all of its versions, (n,).

    Args:
        frame: all rows.
        name: a name, NAMESPACE/NAME, or at least 8 digits of a sweep's identity.

    Raises:
        InputError: no sweep is called so, or several in different places are.
    """
    namespace, slash, short = name.rpartition("/")
    chosen = where_equal(frame, "sweep", short)
    if slash:
        here = where_equal(frame, "namespace", namespace)
        chosen &= here if namespace else ~frame.column("namespace").present
    elif not chosen.any() and len(name) >= _LEAST_UID:
        uids = frame.column("sweep.uid")
        chosen = uids.among({uid for uid in uids.values if str(uid).startswith(name)})
    if not chosen.any():
        known = [str(one) for one in frame.column("sweep").unique() if one is not None]
        raise UnknownNameError("sweep", name, known, argument="sweep")
    namespaces = frame.select(chosen).column("namespace").unique()
    if not slash and len(namespaces) > 1:
        places = ", ".join(f"{one or ''}/{name}" for one in namespaces)
        raise InputError(f"several sweeps are called {name!r}: write which of {places}", "sweep")
    return chosen


def _of_evaluation(frame: Frame, name: str) -> Frame:
    """Return the rows of an evaluation: of runs that it measured, or was meant to measure."""
    chosen = where_equal(frame, "evaluation", name)
    if not chosen.any():
        known = [str(one) for one in frame.column("evaluation").unique() if one is not None]
        raise UnknownNameError("evaluation", name, known, argument="evaluation")
    return frame.select(chosen)


def first_rows(frame: Frame) -> Indices:
    """Return the place of the first row of each run, in their order."""
    ids = frame.column("id").floats()
    if (ids[1:] >= ids[:-1]).all():
        return np.flatnonzero(np.append(np.ones(min(len(ids), 1), dtype=bool), ids[1:] != ids[:-1]))
    _, firsts = np.unique(ids, return_index=True)
    return np.sort(firsts)


def order_rows(frame: Frame, sort: Sequence[str]) -> Indices:
    """Return the places of the rows in the order of some columns.

    Args:
        frame: the rows.
        sort: names; a dash before one turns its order round. What is missing comes last either way.
    """
    keys = [direction(frame, name) for name in complete(sort)]
    return np.lexsort(keys[::-1])


def complete(sort: Sequence[str]) -> list[str]:
    """Return the columns of an order, with those that leave no two rows equal in it."""
    return [*sort, *UNIQUE]


def direction(frame: Frame, name: str) -> Floats:
    """Return numbers, (n,), in the order of a column, turned round by a dash; +inf where missing."""
    ranks = frame.column(name.removeprefix("-")).ranks()
    return np.where(np.isinf(ranks), np.inf, -ranks) if name.startswith("-") else ranks
