# SPDX-License-Identifier: Apache-2.0
"""Forecast of sweeps that have not run: CPU time, wall time, memory and disk, with intervals.

`slamhive plan --estimate` shows it. Nothing is changed by it.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.design import Nearness, Quantity, design
from slamhive.analysis.predicting import CostInterval, Prediction, predict
from slamhive.data.store.datasets import is_made
from slamhive.local.home.extent import DiskTally
from slamhive.local.running.costs import planned_settings
from slamhive.model.errors import SlamHiveError
from slamhive.plan import whole_cores

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from slamhive.analysis.design import Design, Floats, Integers, Known
    from slamhive.local.running.costs import Combinations, Knowledge, PlannedSetting
    from slamhive.local.running.workbench import Workbench


MOST_RECORDINGS = 1_000
"""Ways to read a dataset whose prepared recordings are looked for."""


@dataclass
class WantedSweep:
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
    interval: CostInterval
    runs: int


@dataclass
class Forecast:
    """Forecast of the CPU, time, memory and disk space that sweeps take, and the runs that it comes from.

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
    wanted: Sequence[WantedSweep], knowledge: Knowledge, processor: str | None, cores: int | None
) -> Forecast:
    """Return the expected cost of sweeps, done one after another.

    Args:
        wanted: their runs.
        knowledge: of finished runs.
        processor: model of the processor that they are to run on.
        cores: of the machine; None: as many as are needed.
    """
    known = knowledge.known(folders=True)
    planned, rows = _planned(wanted, knowledge, processor)
    regression = design(known, [one.setting for one in planned])
    counts = np.zeros(len(planned))
    for sweep in rows:
        np.add.at(counts, sweep, 1.0)
    found = Forecast(idle=knowledge.starting_seconds())
    for one, nearness, count in zip(planned, regression.nearness, counts.tolist(), strict=True):
        if nearness is Nearness.NOTHING:
            found.unknown[one.setting.algorithm] += int(count)
        else:
            found.nearness[nearness] += int(count)
    found.runs = found.nearness.total()
    if not found.runs:
        return found
    counted = np.array([one is not Nearness.NOTHING for one in regression.nearness], dtype=bool)
    place = np.cumsum(counted) - 1
    _predict(
        found,
        known,
        regression.only(counted),
        _PredictedRuns(
            [one for one, counts_too in zip(planned, counted.tolist(), strict=True) if counts_too],
            counts[counted],
            wanted,
            [place[sweep[counted[sweep]]] for sweep in rows],
            cores,
        ),
    )
    return found


@dataclass
class _PredictedRuns:
    """Runs whose costs are predicted: their settings, how many have each, and their sweeps.

    Attributes:
        planned: what settings need.
        counts: number of runs of each, (a,).
        wanted: the sweeps.
        rows: for each sweep the place of the setting of each of its runs.
        cores: that there are; None: as many as are needed.
    """

    planned: list[PlannedSetting]
    counts: Floats
    wanted: Sequence[WantedSweep]
    rows: list[Integers]
    cores: int | None


def _predict(found: Forecast, known: Sequence[Known], regression: Design, asked: _PredictedRuns) -> None:
    """Add what runs cost to a forecast."""
    settings = [one.setting for one in asked.planned]
    names = {setting.algorithm for setting in settings}
    related = [one for one in known if one.setting.algorithm in names]
    found.processors = Counter(one.setting.processor for one in related)
    found.algorithms = Counter(one.setting.algorithm for one in related)
    found.unmeasured = sorted({setting.dataset for setting in settings if not setting.frames})
    limits = np.array([one.limit for one in asked.planned])
    needs = np.array([whole_cores(one.cpu) for one in asked.planned])
    alone = np.array([one.alone for one in asked.planned])
    held = needs if asked.cores is None else np.where(alone, asked.cores, needs)
    for quantity in Quantity:
        runs = sum(quantity in one.costs for one in related)
        # Other algorithms' costs alone say nothing of these: rather no figure than a guess.
        prediction = predict(quantity, known, settings, regression) if runs else None
        if prediction is None:
            continue
        if quantity is Quantity.WALL:
            draws, found.at_a_time = _wall(prediction, asked, limits, held, found.idle)
        elif quantity is Quantity.MEMORY:
            draws = prediction.largest()
        else:
            draws = prediction.total(asked.counts, limits * needs if quantity is Quantity.CPU else None)
        found.told[quantity] = Told(quantity, CostInterval.of(draws), runs)


def makespan(walls: Iterable[float], cores: Iterable[int], slots: int, room: int | None) -> float:
    """Return the time of runs that begin one after another as soon as there is room for them, s.

    Args:
        walls: of each run, s, in the order of being started.
        cores: that each needs.
        slots: runs at the same time at most.
        room: cores that there are; None: enough.
    """
    under_way: list[tuple[float, int]] = []
    free, now, end = room, 0.0, 0.0
    for wall, wish in zip(walls, cores, strict=True):
        # A run that wants more cores than there are gets all of them, as the runner has it.
        need = wish if room is None else min(wish, room)
        while under_way and (len(under_way) >= slots or (free is not None and free < need)):
            now, given = heapq.heappop(under_way)
            free = None if free is None else free + given
        free = None if free is None else free - need
        heapq.heappush(under_way, (now + wall, need))
        end = max(end, now + wall)
    return end


def _wall(
    prediction: Prediction, asked: _PredictedRuns, limits: Floats, needs: Integers, idle: float
) -> tuple[Floats, int]:
    """Return draws of the wall time of all sweeps, and the most runs at a time.

    The runs are laid out once as they are most likely; what is drawn of their sum makes that longer or
    shorter.

    Args:
        prediction: of the programs' wall time.
        asked: the runs.
        limits: s that a run of each setting may take.
        needs: cores of each that no other run has.
        idle: s until a program begins.
    """
    # A run never takes longer than its limit, whatever is predicted for it.
    each = np.minimum(prediction.middles(), limits)
    total, most = np.zeros(1), 0
    for sweep, rows in zip(asked.wanted, asked.rows, strict=True):
        if not len(rows):
            continue
        walls, cores = each[rows], needs[rows]
        fitting = len(rows) if asked.cores is None else max(1, asked.cores // int(cores.min()))
        slots = max(1, min(sweep.at_a_time or fitting, fitting, len(rows)))
        most = max(most, slots)
        laid = makespan((walls + idle).tolist(), cores.tolist(), slots, asked.cores)
        counts = np.bincount(rows, minlength=len(each)).astype(np.float64)
        waiting = idle * len(rows)
        total = total + laid * (prediction.total(counts, limits) + waiting) / (walls.sum() + waiting)
    return total, most


def _planned(
    wanted: Sequence[WantedSweep], knowledge: Knowledge, processor: str | None
) -> tuple[list[PlannedSetting], list[Integers]]:
    """Return the needs of combinations, and for each sweep the place of that of each of its runs."""
    planned: list[PlannedSetting] = []
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


def recordings_needed(bench: Workbench, wanted: Sequence[WantedSweep]) -> Recordings:
    """Return the prepared recordings that runs need, of the datasets that are here."""
    found = Recordings()
    met: set[tuple[Any, ...]] = set()
    folders: set[Path] = set()
    for sweep in wanted:
        points = sweep.points
        for row in dict.fromkeys(index // points.repetitions for index in sweep.indices):
            settings = points.settings(row)
            read = tuple((path, value) for path, value in settings.items() if path[0] == "input")
            key = (*points.short_spec(settings).values(), read)
            # Each costs hashes and a look at the disk: beyond a thousand the answer is not worth the wait.
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
            found.size += DiskTally().of(*files).size
    return found
