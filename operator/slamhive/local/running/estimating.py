# SPDX-License-Identifier: Apache-2.0
"""Estimate of how long a sweep still takes: from what the archive knows, then from the sweep itself.

A run is expected to take as long as its setting did in this sweep; else what is predicted from the runs of
the archive and of this sweep (`slamhive.analysis.predicting`), as in `slamhive plan --estimate`.
"""

from __future__ import annotations

from statistics import fmean, median
from typing import TYPE_CHECKING, Protocol

from slamhive.analysis.design import Known, Nearness, Quantity, design
from slamhive.analysis.predicting import predict
from slamhive.local.running.costs import Knowledge, planned_settings
from slamhive.monitor.measuring.machine import cpu_model

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.analysis.design import Setting
    from slamhive.archive import Cost
    from slamhive.local.running.costs import Combinations

MOST_TOLD_APART = 5_000
"""Settings that are looked at one by one; of more, as many stand for those beside them."""

_AGAIN = 1.25
"""Growth in the number of measured runs after which all is predicted again."""


class Costs(Protocol):
    """Source of the costs of earlier runs: the archive."""

    def costs(
        self, algorithms: Iterable[str], datasets: Iterable[str], each: int = ..., most: int = ...
    ) -> Sequence[Cost]:
        """Return the costs of runs, the latest first."""


class Estimate:
    """Estimate of how long the runs of a sweep take, improved by each run that ends.

    Args:
        points: the runs.
        knowledge: of finished runs.
    """

    def __init__(self, points: Combinations, knowledge: Knowledge) -> None:
        self._repetitions = points.repetitions
        self._points, self._knowledge = points, knowledge
        rows = -(-len(points) // self._repetitions)
        self._step = max(1, -(-rows // MOST_TOLD_APART))
        self._settings: list[Setting] = []
        self._cover(rows)
        self._known = knowledge.known()
        self._fresh: dict[int, list[float]] = {}
        self._noted: list[Known] = []
        self._beside: list[float] = []
        self._predicted: list[float | None] = []
        self._due = 0.0

    @classmethod
    def of(cls, points: Combinations, archive: Costs) -> Estimate:
        """Return the estimate for a sweep by an archive."""
        return cls(points, Knowledge.of(archive.costs(points.algorithm_names(), points.dataset_names())))

    def _cover(self, rows: int) -> None:
        """Know the settings of so many rows: those of a search become more."""
        wanted = range(len(self._settings) * self._step, rows, self._step)
        planned = planned_settings(self._points, wanted, self._knowledge, cpu_model())
        self._settings += [one.setting for one in planned]

    def note(self, index: int, wall: float, took: float) -> None:
        """Note how long a run took.

        Args:
            index: which.
            wall: its program, s.
            took: all of it, with what was prepared and measured, s.
        """
        row = self._row(index)
        self._fresh.setdefault(row, []).append(wall)
        self._noted.append(Known(self._settings[row], {Quantity.WALL: wall}))
        self._beside.append(max(0.0, took - wall))

    def seconds(self, index: int) -> float | None:
        """Return the time that a run takes, s; None where nobody knows."""
        wall = self._wall(self._row(index))
        return None if wall is None else wall + self._overhead()

    def left(
        self, waiting: Iterable[int], running: Mapping[int, float], at_a_time: int, further: float = 0
    ) -> float | None:
        """Return the time that the rest takes, s; None where nobody knows.

        Args:
            waiting: runs that have not begun.
            running: for how long others have been at work, s.
            at_a_time: runs at the same time.
            further: runs of which nobody knows yet what they are.
        """
        rows: dict[int, int] = {}
        for index in waiting:
            row = self._row(index)
            rows[row] = rows.get(row, 0) + 1
        walls = {row: self._wall(row) for row in {*rows, *map(self._row, running)}}
        known = [wall for wall in walls.values() if wall is not None]
        if not known:
            return 0.0 if not walls and not further else None
        usual, overhead = fmean(known), self._overhead()

        def each(row: int) -> float:
            wall = walls[row]
            return overhead + (usual if wall is None else wall)

        still = [max(0.0, each(self._row(index)) - elapsed) for index, elapsed in running.items()]
        total = sum(count * each(row) for row, count in rows.items()) + sum(still)
        total += further * (overhead + usual)
        # Not sooner than the longest of those at work, however many cores are free for the others.
        return max([total / max(at_a_time, 1), *still])

    def _wall(self, row: int) -> float | None:
        if found := self._fresh.get(row):
            return median(found)
        # Predicting from thousands of runs takes seconds: again when a quarter more have been measured.
        if not self._predicted or len(self._noted) >= self._due:
            self._due = max(len(self._noted) + 1, len(self._noted) * _AGAIN)
            self._predicted = self._predictions()
        # What was drawn since then takes as long as others do.
        return self._predicted[row] if row < len(self._predicted) else None

    def _predictions(self) -> list[float | None]:
        # What this sweep measures counts alone where it has measured: the machine may do other things now.
        measured = {(one.setting.unit, one.setting.dataset) for one in self._noted}
        before = [one for one in self._known if (one.setting.unit, one.setting.dataset) not in measured]
        known = [*self._noted, *before]
        rows = design(known, self._settings)
        found = predict(Quantity.WALL, known, self._settings, rows)
        if found is None:
            return [None] * len(self._settings)
        return [
            None if near is Nearness.NOTHING else wall
            for near, wall in zip(rows.nearness, found.middles().tolist(), strict=True)
        ]

    def _overhead(self) -> float:
        return median(self._beside) if self._beside else 0.0

    def _row(self, index: int) -> int:
        row = index // self._repetitions // self._step
        if row >= len(self._settings):
            self._cover(index // self._repetitions + 1)
        return row
