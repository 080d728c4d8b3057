# SPDX-License-Identifier: Apache-2.0
"""Columns that follow from others: what became of a run, whether it is superseded, whether its load is sound.

``status``             an outcome, or in one word why there is none
``disturbed``          other work on a run's cores, or throttling, falsified its load and wall time
``algorithm.version``  8 digits of what the algorithm was: its Algorithm's spec, its environment or image
``dataset.version``    8 digits of what the dataset was: its files, and how they were prepared
``search``             method of the search whose results chose a run, or how often its setting was run
``origin``             whose a run is, in tables that hold runs of somebody else: run here, not run here
                       (LABEL), somebody else's (LABEL), repeated here (LABEL)
``superseded``         why a run is no current one: algorithm changed, dataset changed, sweep edited
``ate.extended``       the original system's error that grows as coverage falls
``lateSeconds``        how late a node's poses came in real time, where that is more than a few frames
``usage.undisturbedSeconds``  the wall time without the wait for processors that others used
``beside.online.…``    causal figures, which are the final ones where no pose was published otherwise later
"""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.analysis.columns import Column, ColumnKind, renumbered
from slamhive.analysis.frame import DERIVED, Frame
from slamhive.analysis.grouping import ORIGIN, where_equal
from slamhive.analysis.measures import CAUSAL, KEPT_BESIDE, LATE_SECONDS, UNDISTURBED
from slamhive.model.algorithm import Pace
from slamhive.model.results import OriginKind, Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices, Mask

MAX_CONTENDED = 0.1
MAX_THROTTLED = 0.01
"""Shares of the wall time from which a run counts as disturbed."""

ALGORITHM_CHANGED = "algorithm changed"
DATASET_CHANGED = "dataset changed"
SWEEP_EDITED = "sweep edited"

PACE = "input.pace"
LATENCY = "metrics.latencySeconds."
"""Beginning of the columns of the time from a frame to the first pose for it."""
PUBLISHED = "metrics.posesPublished"
"""Column of how many stamps a player heard a pose for."""

FEW_FRAMES = 5
"""Frames up to which nothing is said of a node that is so many behind: some hold back as many by design."""
FEW_SECONDS = 1.0
"""Time in their place where the frame rate isn't known, s."""

_COPIED = re.compile(rf"({'|'.join(('outcome', 'coverage', *sorted(KEPT_BESIDE)))})([.\[].*)?")

NOT_EVALUATED = "NotEvaluated"

RUN_HERE, NOT_RUN_HERE = "run here", "not run here"
SOMEBODY_ELSES, REPEATED_HERE = "somebody else's", "repeated here"
_SAME_EXPERIMENT = ("provenance.specHash", "provenance.algorithmHash", "provenance.datasetSha256")

_PLACE = ("cluster", "namespace", "origin.label")
_ENVIRONMENT = "provenance.environment"
_IMAGE = "provenance.imageID"
"""There where it ran from an image: a process and a container of an algorithm don't supersede each other."""
_ALGORITHM = ("provenance.algorithmHash", _ENVIRONMENT)
_DATASET = ("provenance.datasetSha256", "provenance.preparation")
_PREPARED_BY = "provenance.preparedBy"
"""Digest of the program that prepared the data, compared by program: a dataset may have several."""
_DIGITS = 8


class SweepVersion(NamedTuple):
    """A sweep as it was asked for at some time; versions of a sweep share name and place.

    Attributes:
        uid: its identity.
        name: its name.
        cluster, namespace: where it is; None on a workstation.
        created: when it was last asked for, s since 1970; None when that isn't known.
        search: method by which results choose its runs; None where they don't.
    """

    uid: str
    name: str
    cluster: str | None = None
    namespace: str | None = None
    created: float | None = None
    search: str | None = None


def with_derived(columns: Mapping[str, Column], length: int, sweeps: Sequence[SweepVersion] = ()) -> Frame:
    """Return the table of some columns, with those that follow from others.

    Args:
        columns: by name, equally long; what followed from others before is made anew.
        length: number of rows.
        sweeps: all versions of the sweeps that runs belong to.
    """
    given = {name: column for name, column in columns.items() if name not in DERIVED}
    if (told := given.get("usage.includesReader")) is not None and told.kind is ColumnKind.BOOLEAN:
        given["usage.includesReader"] = _includes_reader(Frame(given, length))
    frame = Frame(given, length)
    extra = {
        "status": _status(frame),
        "disturbed": _disturbed(frame),
        "algorithm.version": _version(frame, _ALGORITHM),
        "dataset.version": _version(frame, _DATASET),
        "search": _search(frame, sweeps),
        ORIGIN: _origin(frame),
        "superseded": _superseded(frame, sweeps),
        "ate.extended": _extended(frame),
        LATE_SECONDS: _lateness(frame),
        UNDISTURBED: _undisturbed(frame),
        **_causal(frame),
    }
    kept = {name: column.packed() for name, column in extra.items() if not column.is_empty}
    return Frame({**given, **kept}, length)


def _codes(frame: Frame, name: str) -> tuple[npt.NDArray[np.int64], list[Any]]:
    """Return a number for each row, -1 where missing, and what the numbers stand for."""
    column = frame.column(name)
    if not column.kind.is_numeric:
        return column.codes.astype(np.int64), list(column.values)
    codes, values = column.factorized()
    if values and values[-1] is None:
        return np.where(codes == len(values) - 1, -1, codes).astype(np.int64), values[:-1]
    return codes.astype(np.int64), values


def _crossed(parts: Sequence[tuple[npt.NDArray[np.int64], list[Any]]], length: int) -> npt.NDArray[np.int64]:
    """Return one number for each row by the numbers of several columns."""
    combined, count = np.zeros(length, dtype=np.int64), 1
    for codes, values in parts:
        width = len(values) + 1
        used, combined = renumbered(combined * width + codes + 1, count * width)
        count = len(used)
    return combined


def _status(frame: Frame) -> Column:
    parts = [_codes(frame, name) for name in ("outcome", "phase", "reason")]
    combined = _crossed(parts, len(frame))
    _, firsts, places = np.unique(combined, return_index=True, return_inverse=True)
    words = []
    for row in firsts.tolist():
        outcome, phase, reason = (values[codes[row]] if codes[row] >= 0 else None for codes, values in parts)
        if not outcome and phase == Phase.SUCCEEDED.value:
            outcome = NOT_EVALUATED
        words.append(str(outcome or reason or phase))
    kept = sorted(set(words))
    lookup = np.array([kept.index(word) for word in words], dtype=np.int32)
    return Column.of_codes(lookup[places], kept)


def _includes_reader(frame: Frame) -> Column:
    """Tell if CPU figures hold the reader: not known where nothing was taken out, and none said so.

    Records of earlier versions say false then.
    """
    told = frame.column("usage.includesReader").floats()
    silent = (told == 0) & ~frame.column("usage.readerCpuSeconds").present
    return Column.of_numbers(np.where(silent, np.nan, told), ColumnKind.BOOLEAN)


def _disturbed(frame: Frame) -> Column:
    wall = frame.column("usage.wallSeconds").floats()
    contended = np.nan_to_num(frame.column("usage.contendedSeconds").floats())
    throttled = np.nan_to_num(frame.column("usage.throttledSeconds").floats())
    found = (wall > 0) & ((contended > MAX_CONTENDED * wall) | (throttled > MAX_THROTTLED * wall))
    return Column.of_numbers(found, ColumnKind.BOOLEAN)


def _undisturbed(frame: Frame) -> Column:
    """Column of the time that runs would have taken alone, as far as it is known.

    Threads that run side by side also wait side by side: where a run has several, its wall time is taken to
    have been stretched as its threads' time was.
    """
    wall, busy = (frame.column(f"usage.{name}").floats() for name in ("wallSeconds", "cpu.seconds"))
    waited = np.nan_to_num(frame.column("usage.contendedSeconds").floats())
    with np.errstate(divide="ignore", invalid="ignore"):
        stretched = wall * np.nan_to_num(busy / (busy + waited))
    return Column.of_numbers(np.maximum(wall - waited, stretched))


def _extended(frame: Frame) -> Column:
    coverage = frame.column("coverage").floats()
    error = frame.column("ate.rmse").floats()
    factor = np.select([coverage >= 0.75, coverage >= 0.5, coverage >= 0.25], [1.0, 2.0, 5.0], 10.0)
    return Column.of_numbers(np.where(np.isnan(coverage), np.nan, error * factor))


def _played(frame: Frame) -> Mask:
    """Tell which rows are of runs that were played to, (n,)."""
    found: Mask = np.zeros(len(frame), dtype=bool)
    for pace in Pace:
        if pace.is_played:
            found |= where_equal(frame, PACE, pace.value)
    return found


def late_seconds(latest: Floats, frame_rate: Floats, rate: Floats) -> Floats:
    """Return by how much poses came late, NaN where that is a few frames at most, (n,).

    Args:
        latest: longest time from a frame to its pose, s, (n,).
        frame_rate: of the recording that was played, Hz, NaN where it isn't known, (n,).
        rate: speed of playback, NaN for 1, (n,).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        few = FEW_FRAMES / (frame_rate * np.where(np.isnan(rate), 1.0, rate))
    few = np.where(np.isfinite(few), few, FEW_SECONDS)
    return np.where(latest > few, latest, np.nan)


def _lateness(frame: Frame) -> Column:
    """Return the column of how late poses came, where the clock waited for nobody."""
    latest = frame.column(f"{LATENCY}max").floats()
    found = late_seconds(
        latest, frame.column("prepared.frameRate").floats(), frame.column("input.rate").floats()
    )
    found[where_equal(frame, PACE, Pace.STEPPED.value)] = np.nan  # the frames did not wait, the clock did
    return Column.of_numbers(found)


def _causal(frame: Frame) -> dict[str, Column]:
    """Return the columns of causal figures that a table lacks, and those that it has in part.

    The player notes how many poses were published, and writes the first ones where a later one differs: where
    it wrote none, the first are the last.
    """
    outcome = frame.column(f"{CAUSAL}outcome")
    same = (frame.column(PUBLISHED).floats() > 0) & _played(frame) & frame.column("outcome").present
    same &= ~outcome.present & ~frame.column(f"{CAUSAL}message").present
    if not same.any():
        return {}
    rows = np.flatnonzero(same)
    return {
        f"{CAUSAL}{name}": _filled(frame.column(f"{CAUSAL}{name}"), frame.column(name), rows)
        for name in frame.stored
        if _COPIED.fullmatch(name)
    }


def _filled(column: Column, source: Column, rows: Indices) -> Column:
    """Return a column with another one's values at some places, (k,)."""
    if source.kind.is_numeric and column.kind.is_numeric:
        numbers = column.numbers.copy()
        numbers[rows] = source.numbers[rows]
        return Column.of_numbers(numbers, source.kind if column.is_empty else column.kind)
    values = column.tolist()
    for row, value in zip(rows.tolist(), source.take(rows).tolist(), strict=True):
        values[row] = value
    return Column.of(values)


def _version(frame: Frame, names: Sequence[str]) -> Column:
    """Return 8 digits of several values together; missing where one isn't known that other rows have."""
    parts = [_codes(frame, name) for name in names if not frame.column(name).is_empty]
    if not parts:
        return Column.missing(len(frame))
    combined = _crossed(parts, len(frame))
    _, firsts, places = np.unique(combined, return_index=True, return_inverse=True)
    digits: list[str | None] = []
    for row in firsts.tolist():
        known_parts = [str(values[codes[row]]) for codes, values in parts if codes[row] >= 0]
        text = "\0".join(known_parts)
        complete = len(known_parts) == len(parts)
        digits.append(hashlib.sha256(text.encode()).hexdigest()[:_DIGITS] if complete else None)
    known = sorted({text for text in digits if text})
    lookup = np.array([known.index(text) if text else -1 for text in digits], dtype=np.int32)
    return Column.of_codes(lookup[places], known)


def _superseded(frame: Frame, sweeps: Sequence[SweepVersion]) -> Column:
    place = [_codes(frame, name) for name in _PLACE]
    order = _latest_last(frame)
    words = np.full(len(frame), -1, dtype=np.int32)
    reasons = (ALGORITHM_CHANGED, DATASET_CHANGED, SWEEP_EDITED)
    images, _ = _codes(frame, _IMAGE)
    executor = (np.minimum(images, 0), [_IMAGE])
    by = _codes(frame, "input.preparedBy")
    for reason, owner, names in ((0, "algorithm", _ALGORITHM), (1, "dataset", (*_DATASET, _PREPARED_BY))):
        names_of = _codes(frame, owner)
        for name in names:
            parts = [*place, names_of, *([executor] if name == _ENVIRONMENT else [])]
            parts += [by] if name == _PREPARED_BY else []
            group = _crossed(parts, len(frame))
            codes, values = _codes(frame, name)
            if len(values) > 1:
                known = np.where(names_of[0] < 0, -1, codes)  # a missing name is nobody else's
                words[(words < 0) & _differs_from_latest(known, group, order)] = reason
    words[(words < 0) & _of_earlier_sweep(frame, sweeps)] = 2
    return Column.of_codes(words, reasons)


def _search(frame: Frame, sweeps: Sequence[SweepVersion]) -> Column:
    """Return by which method the results of a search chose each run."""
    methods = {one.uid: one.search for one in sweeps if one.search is not None}
    if not methods:
        return Column.missing(len(frame))
    words = sorted(set(methods.values()))
    codes, values = _codes(frame, "sweep.uid")
    places = [words.index(methods[value]) if value in methods else -1 for value in values]
    return Column.of_codes(np.array([*places, -1], dtype=np.int32)[codes], words)


def _origin(frame: Frame) -> Column:
    """Return the words on whose each run is; of nothing in a table of own runs alone.

    A run of somebody else is repeated where an own one had the same settings, program and recording; that the
    environment is the same to the byte isn't asked for, as another machine has its own.
    """
    kinds = frame.column("origin.kind")
    if kinds.is_empty:
        return Column.missing(len(frame))
    labels = frame.column("origin.label").tolist()
    sames = list(zip(*(frame.column(name).tolist() for name in _SAME_EXPERIMENT), strict=True))
    own = {same for same, kind in zip(sames, kinds.tolist(), strict=True) if kind is None}
    words = []
    for kind, label, same in zip(kinds.tolist(), labels, sames, strict=True):
        if kind is None:
            words.append(RUN_HERE)
        elif kind == OriginKind.TRAJECTORY:
            words.append(f"{NOT_RUN_HERE} ({label})")
        else:
            is_known = None not in same and same in own
            words.append(f"{REPEATED_HERE if is_known else SOMEBODY_ELSES} ({label})")
    return Column.of(words)


def _latest_last(frame: Frame) -> Indices:
    """Return the places of the rows, those of the latest runs last."""
    created = frame.column("created").floats()
    return np.lexsort((frame.column("id").floats(), np.where(np.isnan(created), -np.inf, created)))


def _differs_from_latest(codes: npt.NDArray[np.int64], group: npt.NDArray[np.int64], order: Indices) -> Mask:
    """Tell which rows have another value than the latest row of their group that has one, (n,)."""
    known = order[codes[order] >= 0]
    latest = np.full(int(group.max(initial=0)) + 1, -1, dtype=np.int64)
    latest[group[known]] = codes[known]  # of several of a group the last one stays
    current = latest[group]
    differs: Mask = (codes >= 0) & (codes != current)
    return differs


def _of_earlier_sweep(frame: Frame, sweeps: Sequence[SweepVersion]) -> Mask:
    latest: dict[tuple[Any, ...], tuple[float, str]] = {}
    for one in sweeps:
        key = (one.name, one.cluster, one.namespace)
        moment = (-np.inf if one.created is None else one.created, one.uid)
        latest[key] = max(latest.get(key, moment), moment)
    current = {uid for _, uid in latest.values()}
    known = {one.uid for one in sweeps}
    codes, values = _codes(frame, "sweep.uid")
    earlier = np.array([value in known and value not in current for value in (*values, None)], dtype=bool)
    is_earlier: Mask = earlier[codes]
    return is_earlier
