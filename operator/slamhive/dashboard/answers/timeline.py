# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/analysis/timeline``: which node or core did what, and when; many runs are summed up by time."""

from __future__ import annotations

import heapq
import time
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import Column, ColumnKind, renumbered
from slamhive.analysis.flattening import spread, stack
from slamhive.analysis.frame import Frame
from slamhive.analysis.grouping import varying
from slamhive.analysis.selection import first_rows
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.answers.columns import heading
from slamhive.dashboard.problems import BadRequest
from slamhive.model.base import plural
from slamhive.model.results import Phase, Reason
from slamhive.tables.queries import select
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

RESERVED = ("from", "to", "format")
MOST_BARS = 1500
"""Runs that are drawn one by one; of more, what they did is summed up."""

MOST_LANES = 64
BINS = 240
_MOST_SETTINGS = 6
_TIMES = {"created", "started"}
_NODE, _PROCESSORS = "provenance.node", "usage.processors"


@dataclass(frozen=True, eq=False)
class Spans:
    """Spans of time in which runs were worked at; all arrays (n,), times in s since 1970.

    Attributes:
        frame: their rows.
        begin, start, end: when they were begun, when their program started and ended; NaN for a start that
            never came.
        failed: whether they ended, and not by being evaluated.
        live: whether they have not ended.
        lane: number of the lane of each.
        lanes: names of the lanes.
    """

    frame: Frame
    begin: Floats
    start: Floats
    end: Floats
    failed: Mask
    live: Mask
    lane: npt.NDArray[np.intp]
    lanes: list[str]

    def select(self, rows: Mask) -> Spans:
        """Return some of them, in the same lanes."""
        return replace(
            self,
            frame=self.frame.select(rows),
            begin=self.begin[rows],
            start=self.start[rows],
            end=self.end[rows],
            failed=self.failed[rows],
            live=self.live[rows],
            lane=self.lane[rows],
        )


def timeline(
    snapshot: Snapshot,
    pairs: Pairs,
    given: tuple[float | None, float | None],
    clock: Callable[[], float] = time.time,
) -> Body:
    """Return the times of runs' preparation and work, by node and core; superseded runs took theirs too.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        given: begin and end of the part of time that is meant, s since 1970; None for all.
        clock: time now, until which runs that have not ended go on.

    Raises:
        BadRequest: the end is not after the beginning.
    """
    low, high = given
    if low is not None and high is not None and not low < high:
        raise BadRequest("to: expected a time after that of from, in seconds since 1970", "to")
    chosen = select(_with_what_goes_on(snapshot), pairs, RESERVED, each=True, always=True)
    notes = list(chosen.notes)
    if earlier := chosen.frame.count_runs(chosen.frame.column("superseded").present):
        runs = (
            "1 run of an earlier version is" if earlier == 1 else f"{earlier:,} runs of earlier versions are"
        )
        notes.append(f"{runs} among them: {'it' if earlier == 1 else 'they'} took time too")
    spans = _spans(chosen.frame.select(first_rows(chosen.frame)), clock, notes)
    whole = _extent(spans)
    if low is not None or high is not None:
        inside = (spans.end > (-np.inf if low is None else low)) & (
            spans.begin < (np.inf if high is None else high)
        )
        spans = spans.select(inside)
    first, last = _extent(spans)
    extent = (first if low is None else low, last if high is None else high)
    content: dict[str, Any] = {
        "revision": snapshot.revision,
        "runs": len(spans.frame),
        "failed": int(spans.failed.sum()),
        "live": int(spans.live.sum()),
        "whole": whole,
        "extent": extent,
        "lanes": spans.lanes,
        "bars": None,
        "bins": None,
        "notes": notes,
    }
    if len(spans.frame) <= MOST_BARS:
        content["bars"] = _bars(spans)
    else:
        content["bins"] = _bins(spans, extent)
    return Body(content, lambda: as_columns(_rows(spans)))


def _with_what_goes_on(snapshot: Snapshot) -> Frame:
    """Return the runs that ended, and below them those of a workstation that are at work."""
    frame = snapshot.frame
    ended = frame.column("uid")
    at_work = [run for run in snapshot.at_work if not ended.among((run["uid"],)).any()]
    if not at_work:
        return frame
    values: dict[str, Sequence[Any]] = {"id": [-1 - number for number in range(len(at_work))]}
    spread(values, "", at_work)
    columns = {name: Column.of(found) for name, found in values.items()}
    for name in _TIMES & columns.keys():
        columns[name] = Column.of_numbers(columns[name].floats(), ColumnKind.TIME)
    parts = [(columns, len(at_work))]
    if len(frame):
        parts.insert(0, ({name: frame.column(name) for name in frame.stored}, len(frame)))
    return Frame(*stack(parts))


def _spans(frame: Frame, clock: Callable[[], float], notes: list[str]) -> Spans:
    """Return the spans that runs were worked at, without runs that nobody worked at."""
    taken = frame.column("provenance.reusedFrom").present
    if taken.any():
        runs = plural(int(taken.sum()), "run")
        notes.append(f"nothing was done for {runs} that took over the result of an equal one")
        frame = frame.select(~taken)
    created, start, end = (frame.column(name).floats() for name in ("created", "started", "finished"))
    live = ~frame.column("phase").among(_FINISHED)
    begin = np.fmin(created, start)
    end = np.where(np.isnan(end) & live & ~np.isnan(begin), clock(), end)
    known = ~np.isnan(begin) & (end >= begin)
    if not known.all():
        notes.append(f"left out: {plural(int((~known).sum()), 'run')} of which nobody noted when")
        frame = frame.select(known)
        begin, start, end, live = begin[known], start[known], end[known], live[known]
    failed = frame.column("status").among(_FAILURES)
    lane, lanes = _lanes(frame, begin, end)
    if len(lanes) > MOST_LANES:
        notes.append(f"of {len(lanes)} lanes the {MOST_LANES} first are drawn: filter the runs by node")
        shown = lane < MOST_LANES
        cut = Spans(frame, begin, start, end, failed, live, lane, lanes[:MOST_LANES])
        return cut.select(shown)
    return Spans(frame, begin, start, end, failed, live, lane, lanes)


_FINISHED = frozenset(phase.value for phase in Phase if phase.is_finished)
_FAILURES = frozenset(reason.value for reason in Reason if reason is not Reason.CANCELLED)


def _lanes(frame: Frame, begin: Floats, end: Floats) -> tuple[npt.NDArray[np.intp], list[str]]:
    """Return the lane of each run, and the lanes' names: node and cores, or a free place there."""
    nodes, names = frame.column(_NODE).factorized()
    cores, sets = frame.column(_PROCESSORS).factorized()
    pair = nodes.astype(np.intp) * max(1, len(sets)) + cores
    places = np.zeros(len(frame), dtype=np.intp)
    for number in np.unique(pair).tolist():
        if sets[number % len(sets)] is None:
            rows = np.flatnonzero(pair == number)
            places[rows] = _packed(begin[rows], end[rows])
    width = int(places.max(initial=0)) + 1
    used, of_row = renumbered(pair * width + places, len(names) * max(1, len(sets)) * width)
    keys = []
    for number, place in (divmod(one, width) for one in used.tolist()):
        held = sets[number % len(sets)]
        text = f"place {place + 1}" if held is None else f"cores {held}"
        keys.append((str(names[number // len(sets)] or "this machine"), held is None, text))
    order = sorted(
        range(len(keys)), key=lambda at: (_natural(keys[at][0]), keys[at][1], _natural(keys[at][2]))
    )
    rank = np.empty(len(keys), dtype=np.intp)
    rank[order] = np.arange(len(keys))
    nodes_with = Counter(node for node, _, _ in keys)
    shown = [
        node if free and nodes_with[node] == 1 else f"{node}, {text}"
        for node, free, text in (keys[at] for at in order)
    ]
    return rank[of_row], shown


def _natural(text: str) -> list[tuple[bool, int, str]]:
    words = text.replace(",", " ").replace("-", " ").split()
    return [(word.isdigit(), int(word) if word.isdigit() else 0, word) for word in words]


def _packed(begin: Floats, end: Floats) -> npt.NDArray[np.intp]:
    """Return for each span the first place that is free when it begins, (n,)."""
    order = np.argsort(begin, kind="stable")
    begins, ends = begin[order], end[order]
    # Who begins when all before have ended, and ends before the next begins, finds the first place free.
    meets_none = np.append(True, begins[1:] >= np.maximum.accumulate(ends)[:-1])
    shared = np.flatnonzero(~(meets_none & np.append(meets_none[1:], True)))
    of_shared: list[int] = []
    free: list[int] = []
    busy: list[tuple[float, int]] = []
    count = 0
    for start, stop in zip(begins[shared].tolist(), ends[shared].tolist(), strict=True):
        while busy and busy[0][0] <= start:
            heapq.heappush(free, heapq.heappop(busy)[1])
        if free:
            place = heapq.heappop(free)
        else:
            place, count = count, count + 1
        of_shared.append(place)
        heapq.heappush(busy, (stop, place))
    places = np.zeros(len(begin), dtype=np.intp)
    places[order[shared]] = of_shared
    return places


def _extent(spans: Spans) -> tuple[float | None, float | None]:
    if not len(spans.frame):
        return None, None
    return float(spans.begin.min()), float(spans.end.max())


def _bars(spans: Spans) -> dict[str, Any]:
    frame = spans.frame
    names = ["algorithm", "sensors", "dataset", *varying(frame)[:_MOST_SETTINGS], "repetition"]
    told = [name for name in names if len(frame.column(name).unique()) > 1]
    return {
        "keys": [heading(frame, name) for name in told],
        "settings": frame.records(told),
        **{name: frame.column(name).tolist() for name in ("uid", "run", "status")},
        "lane": spans.lane,
        "begin": spans.begin,
        "start": spans.start,
        "end": spans.end,
        "failed": spans.failed,
        "live": spans.live,
    }


def _bins(spans: Spans, extent: tuple[float | None, float | None]) -> dict[str, Any]:
    """Return the work of each lane in each of some equal parts of time, as shares of its length."""
    low, high = extent
    edges = np.linspace(low or 0.0, high or 1.0, BINS + 1)
    start = np.where(np.isnan(spans.start), spans.end, spans.start)
    shape = (len(spans.lanes), BINS)
    running, preparing = np.zeros(shape), np.zeros(shape)
    for lane in range(shape[0]):
        rows = spans.lane == lane
        running[lane] = _busy(start[rows], spans.end[rows], edges)
        preparing[lane] = _busy(spans.begin[rows], start[rows], edges)
    width = edges[1] - edges[0]
    at = np.clip(((spans.end - edges[0]) / width).astype(np.intp), 0, BINS - 1)
    inside = (spans.end >= edges[0]) & (spans.end <= edges[-1]) & ~spans.live
    ended, failed = (
        np.bincount((spans.lane * BINS + at)[rows], minlength=shape[0] * BINS).reshape(shape)
        for rows in (inside, inside & spans.failed)
    )
    return {
        "edges": edges,
        "running": (running / width).round(4).tolist(),
        "preparing": (preparing / width).round(4).tolist(),
        "ended": ended.tolist(),
        "failed": failed.tolist(),
    }


def _busy(begin: Floats, end: Floats, edges: Floats) -> Floats:
    """Return the part of some spans that lies between each two edges, (bins,) in s."""

    def passed(moments: Floats) -> Floats:
        """Sum up how long ago each of the moments was, at each edge."""
        ordered = np.sort(moments)
        before: Indices = np.searchsorted(ordered, edges)
        sums = np.concatenate([[0.0], np.cumsum(ordered - edges[0])])
        total: Floats = before * (edges - edges[0]) - sums[before]
        return total

    spent: Floats = np.diff(passed(begin) - passed(end))
    return spent


def _rows(spans: Spans) -> Sequence[dict[str, Any]]:
    records = spans.frame.records(["uid", "run", "status"])
    starts = [None if np.isnan(value) else value for value in spans.start.tolist()]
    parts = zip(records, spans.lane.tolist(), spans.begin.tolist(), starts, spans.end.tolist(), strict=True)
    return [
        {**record, "lane": spans.lanes[lane], "begin": begin, "start": start, "end": end}
        for record, lane, begin, start, end in parts
    ]
