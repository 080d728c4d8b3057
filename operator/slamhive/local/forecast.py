# SPDX-License-Identifier: Apache-2.0
"""Forecast of sweeps that have not run: CPU time, wall time, memory and disk, with intervals.

`slamhive plan --estimate` shows it. Nothing is changed by it.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.predicting import Interval, Nearness, Prediction, Quantity, design, predict
from slamhive.data.store import is_made
from slamhive.local.costs import planned_settings
from slamhive.local.extent import Tally
from slamhive.model.errors import SlamHiveError
from slamhive.plan import whole_cores

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.analysis.predicting import Floats, Integers
    from slamhive.local.costs import Combinations, Knowledge, Planned
    from slamhive.local.workbench import Workbench


MOST_RECORDINGS = 1_000
"""Ways to read a dataset whose prepared recordings are looked for."""


@dataclass
class Wanted:
    """The runs of a sweep that are to be done.

    Attributes:
        points: all of its runs.
        indices: those that are to be done, in the order in which they are started.
        at_a_time: runs at the same time at most; None: as many as fit.
    """

    points: Combinations
    indices: Sequence[int]
    at_a_time: int | None = None


@dataclass
class Told:
    """A cost of a forecast.

    Attributes:
        quantity: which.
        interval: of the sum over all runs, or of the largest run's memory.
        runs: number of finished runs that it comes from.
    """

    quantity: Quantity
    interval: Interval
    runs: int


@dataclass
class Forecast:
    """What sweeps are expected to cost.

    Attributes:
        runs: number of runs that are counted.
        told: costs that something is known of.
        nearness: number of runs by how near the nearest known ones are.
        unknown: number of runs of each algorithm that nothing is known of: they are not counted.
        unmeasured: datasets whose length nobody knows.
        processors: finished runs that it comes from, by the model of their processor.
        algorithms: the same by their algorithm.
        at_a_time: the most runs at the same time.
        idle: s a run that its program did not run yet, as it was made ready.
    """

    runs: int = 0
    told: dict[Quantity, Told] = field(default_factory=dict)
    nearness: Counter[Nearness] = field(default_factory=Counter)
    unknown: Counter[str] = field(default_factory=Counter)
    unmeasured: list[str] = field(default_factory=list)
    processors: Counter[str | None] = field(default_factory=Counter)
    algorithms: Counter[str] = field(default_factory=Counter)
    at_a_time: int = 0
    idle: float = 0.0


def forecast(
    wanted: Sequence[Wanted], knowledge: Knowledge, processor: str | None, cores: int | None
) -> Forecast:
    """Return what sweeps are expected to cost, done one after another.

    Args:
        wanted: their runs.
        knowledge: of finished runs.
        processor: model of the processor that they are to run on.
        cores: of the machine; None: as many as are needed.
    """
    known = knowledge.known(folders=True)
    planned, rows = _planned(wanted, knowledge, processor)
    settings = [one.setting for one in planned]
    found = Forecast(idle=knowledge.starting_seconds())
    regression = design(known, settings)
    counts = np.zeros(len(planned))
    for sweep in rows:
        np.add.at(counts, sweep, 1.0)
    for setting, near, count in zip(settings, regression.nearness, counts.tolist(), strict=True):
        if near is Nearness.NOTHING:
            found.unknown[setting.algorithm] += int(count)
        else:
            found.nearness[near] += int(count)
    counted = np.array([near is not Nearness.NOTHING for near in regression.nearness], dtype=bool)
    found.runs = int(counts[counted].sum())
    if not found.runs:
        return found
    regression = regression.only(counted)
    planned = [one for one, counts_here in zip(planned, counted.tolist(), strict=True) if counts_here]
    settings = [one.setting for one in planned]
    place = np.cumsum(counted) - 1
    rows = [place[sweep[counted[sweep]]] for sweep in rows]
    counts = counts[counted]
    asked = {setting.algorithm for setting in settings}
    near = [one for one in known if one.setting.algorithm in asked]
    found.processors = Counter(one.setting.processor for one in near)
    found.algorithms = Counter(one.setting.algorithm for one in near)
    found.unmeasured = sorted({setting.dataset for setting in settings if not setting.frames})
    limits = np.array([one.limit for one in planned])
    needs = np.array([whole_cores(one.cpu) for one in planned])
    for quantity in Quantity:
        prediction = predict(quantity, known, settings, regression)
        if prediction is None:
            continue
        from_runs = sum(quantity in one.costs for one in near)
        if quantity is Quantity.WALL:
            draws, found.at_a_time = _wall(prediction, wanted, rows, _Room(limits, needs, cores), found.idle)
        elif quantity is Quantity.MEMORY:
            draws = prediction.largest()
        else:
            draws = prediction.total(counts, limits * needs if quantity is Quantity.CPU else None)
        found.told[quantity] = Told(quantity, Interval.of(draws), from_runs)
    return found


def makespan(walls: Iterable[float], cores: Iterable[int], slots: int, room: int | None) -> float:
    """Return how long runs take that begin one after another as soon as there is room for them, s.

    Args:
        walls: of each run, s, in the order of being started.
        cores: that each needs.
        slots: runs at the same time at most.
        room: cores that there are; None: enough.
    """
    under_way: list[tuple[float, int]] = []
    free, now, end = room, 0.0, 0.0
    for wall, wish in zip(walls, cores, strict=True):
        need = wish if room is None else min(wish, room)
        while under_way and (len(under_way) >= slots or (free is not None and free < need)):
            now, given = heapq.heappop(under_way)
            free = None if free is None else free + given
        free = None if free is None else free - need
        heapq.heappush(under_way, (now + wall, need))
        end = max(end, now + wall)
    return end


@dataclass
class _Room:
    """What bounds runs: the time of each setting, the cores that it needs, and those that there are."""

    limits: Floats
    needs: Integers
    cores: int | None


def _wall(
    prediction: Prediction,
    wanted: Sequence[Wanted],
    rows: Sequence[Integers],
    room: _Room,
    idle: float,
) -> tuple[Floats, int]:
    """Return draws of the wall time of all sweeps, and the most runs at a time.

    The runs are laid out once as they are most likely; what is drawn of their sum makes that longer or
    shorter.
    """
    each = np.minimum(prediction.middles(), room.limits)
    total, most = np.zeros(1), 0
    for sweep, of_sweep in zip(wanted, rows, strict=True):
        if not len(of_sweep):
            continue
        walls, needs = each[of_sweep], room.needs[of_sweep]
        fitting = len(of_sweep) if room.cores is None else max(1, room.cores // int(needs.min()))
        slots = max(1, min(sweep.at_a_time or fitting, fitting, len(of_sweep)))
        most = max(most, slots)
        laid = makespan((walls + idle).tolist(), needs.tolist(), slots, room.cores)
        counts = np.bincount(of_sweep, minlength=len(each)).astype(np.float64)
        waiting = idle * len(of_sweep)
        draws = prediction.total(counts, room.limits)
        total = total + laid * (draws + waiting) / (walls.sum() + waiting)
    return total, most


def _planned(
    wanted: Sequence[Wanted], knowledge: Knowledge, processor: str | None
) -> tuple[list[Planned], list[Integers]]:
    """Return what combinations need, and for each sweep the place of that of each of its runs."""
    planned: list[Planned] = []
    rows = []
    for sweep in wanted:
        combinations = np.asarray(sweep.indices, dtype=np.intp) // sweep.points.repetitions
        used, places = np.unique(combinations, return_inverse=True)
        rows.append(places.reshape(-1) + len(planned))
        planned += planned_settings(sweep.points, used.tolist(), knowledge, processor)
    return planned, rows


@dataclass
class Recordings:
    """Prepared recordings that runs need.

    Attributes:
        there: number of those that are there.
        missing: number of those that are to be made first.
        size: bytes of the recordings that these are made of, counted for each: about what they take at most.
        unknown: datasets that are not here, so that nothing can be said of theirs.
    """

    there: int = 0
    missing: int = 0
    size: int = 0
    unknown: set[str] = field(default_factory=set)


def recordings_needed(bench: Workbench, wanted: Sequence[Wanted]) -> Recordings:
    """Return which prepared recordings runs need, of the datasets that are here."""
    found, met, folders = Recordings(), set(), set()
    for sweep in wanted:
        points = sweep.points
        for row in dict.fromkeys(index // points.repetitions for index in sweep.indices):
            settings = points.settings(row)
            read = tuple((path, value) for path, value in settings.items() if path[0] == "input")
            key = (*points.short_spec(settings).values(), read)
            if key in met or len(met) >= MOST_RECORDINGS:
                continue
            met.add(key)
            spec = points.point(row * points.repetitions).spec
            name = spec["datasetRef"]["name"]
            try:
                place = bench.workshop.dataset(name)
                algorithm = bench.workshop.algorithm(spec["algorithmRef"]["name"]).algorithm
                if not is_made(place.dataset, place.folder, bench.home.path / "datasets"):
                    found.unknown.add(name)
                    continue
                folder = bench.variant(spec, algorithm)
            except (SlamHiveError, OSError, KeyError):
                continue  # what run would say of it is not ours to say
            if folder in folders:
                continue
            folders.add(folder)
            if folder.is_dir():
                found.there += 1
                continue
            found.missing += 1
            entry = bench.dataset(name)
            files = (entry.root / file.path for file in entry.dataset.spec.recording.files)
            found.size += Tally().of(*files).size
    return found
