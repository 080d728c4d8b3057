# SPDX-License-Identifier: Apache-2.0
"""Estimate of how long a sweep still takes: from what the archive knows, then from the sweep itself.

A run is expected to take as long as its setting did, in this sweep or before the edit; else as the algorithm
took on that dataset; else as the runs of this sweep do.
"""

from __future__ import annotations

from functools import cached_property
from statistics import fmean, median
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from slamhive.local.outlook import Outlook, Points

    Kind = tuple[str, str]

MOST_TOLD_APART = 5_000
"""Settings whose algorithm and dataset are looked at one by one; beyond, all count alike."""


class Walls(Protocol):
    """What knows how long programs ran: the archive."""

    def wall_seconds(
        self, algorithms: Iterable[str], datasets: Iterable[str], limit: int = ...
    ) -> dict[Kind, list[float]]:
        """Return how long programs ran by algorithm and dataset, the latest runs first."""


class Estimate:
    """How long the runs of a sweep take.

    Args:
        points: the runs.
        outlook: what was there of them before.
        walls: how long programs ran before, s, by algorithm and dataset.
    """

    def __init__(
        self, points: Points, outlook: Outlook | None, walls: Mapping[Kind, Collection[float]]
    ) -> None:
        self._points = points
        self._repetitions = points.repetitions
        self._kinds: dict[int, Kind | None] = {}
        self._known = {kind: median(found) for kind, found in walls.items() if found}
        self._of_row: dict[int, list[float]] = {}
        self._of_kind: dict[Kind | None, list[float]] = {}
        self._beside: list[float] = []
        before = (*outlook.finished.items(), *outlook.replaced.items()) if outlook is not None else ()
        for index, run in before:
            if run.wall_seconds is not None:
                self._of_row.setdefault(self._row(index), []).append(run.wall_seconds)
        self._fresh: set[int] = set()

    @classmethod
    def of(cls, points: Points, outlook: Outlook | None, archive: Walls) -> Estimate:
        """Return the estimate for a sweep by an archive."""
        return cls(points, outlook, archive.wall_seconds(points.algorithm_names(), points.dataset_names()))

    def note(self, index: int, wall: float, took: float) -> None:
        """Note how long a run took.

        Args:
            index: which.
            wall: its program, s.
            took: all of it, with what was prepared and measured, s.
        """
        row = self._row(index)
        if row not in self._fresh:  # what this sweep measures counts more than what was before
            self._fresh.add(row)
            self._of_row[row] = []
        self._of_row[row].append(wall)
        self._of_kind.setdefault(self._kind(row), []).append(wall)
        self._beside.append(max(0.0, took - wall))

    def seconds(self, index: int) -> float | None:
        """Return how long a run takes, s; None where nobody knows."""
        wall = self._wall(self._row(index))
        return None if wall is None else wall + self._overhead()

    def left(self, waiting: Iterable[int], running: Mapping[int, float], at_a_time: int) -> float | None:
        """Return how long the rest takes, s; None where nobody knows.

        Args:
            waiting: runs that have not begun.
            running: for how long others have been at work, s.
            at_a_time: runs at the same time.
        """
        rows: dict[int, int] = {}
        for index in waiting:
            row = self._row(index)
            rows[row] = rows.get(row, 0) + 1
        walls = {row: self._wall(row) for row in {*rows, *map(self._row, running)}}
        known = [wall for wall in walls.values() if wall is not None]
        if not known:
            return 0.0 if not walls else None
        usual, overhead = fmean(known), self._overhead()

        def each(row: int) -> float:
            wall = walls[row]
            return overhead + (usual if wall is None else wall)

        still = [max(0.0, each(self._row(index)) - elapsed) for index, elapsed in running.items()]
        total = sum(count * each(row) for row, count in rows.items()) + sum(still)
        return max([total / max(at_a_time, 1), *still])

    def _wall(self, row: int) -> float | None:
        if found := self._of_row.get(row):
            return median(found)
        kind = self._kind(row)
        if found := self._of_kind.get(kind):
            return median(found)
        return self._known.get(kind) if kind is not None else None

    def _overhead(self) -> float:
        return median(self._beside) if self._beside else 0.0

    def _row(self, index: int) -> int:
        return index // self._repetitions

    def _kind(self, row: int) -> Kind | None:
        """Return algorithm and dataset of a setting."""
        if row not in self._kinds:
            algorithms, datasets = self._names
            alone = len(algorithms) == len(datasets) == 1
            if alone:
                self._kinds[row] = (algorithms[0], datasets[0])
            elif len(self._points) > MOST_TOLD_APART * self._repetitions:
                self._kinds[row] = None
            else:
                spec = self._points.point(row * self._repetitions).spec
                self._kinds[row] = (spec["algorithmRef"]["name"], spec["datasetRef"]["name"])
        return self._kinds[row]

    @cached_property
    def _names(self) -> tuple[list[str], list[str]]:
        return list(self._points.algorithm_names()), list(self._points.dataset_names())
