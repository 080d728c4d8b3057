# SPDX-License-Identifier: Apache-2.0
"""Counts for captions: how many runs a figure is of, and what became of those that are left out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.analysis.grouping import Outcomes
from slamhive.model.base import plural
from slamhive.tables.text import counts_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.pareto import Spot


def span(numbers: Sequence[int]) -> str:
    """Return from where to where numbers go: ``3 to 7``, or ``5``."""
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low} to {high}"


@dataclass(frozen=True)
class Tally:
    """Runs of a figure.

    Attributes:
        runs, n: all of them, and different results of those that count.
        copies: those that count and repeat a result.
        failures: those that don't, by what became of them.
    """

    runs: int
    n: int
    copies: int
    failures: dict[str, int]

    @classmethod
    def of(cls, found: Iterable[Cell | Spot]) -> Tally:
        """Add up groups of runs."""
        runs, n, copies = 0, 0, 0
        failures: Counter[str] = Counter()
        for part in found:
            runs, n, copies = runs + part.runs, n + part.n, copies + part.copies
            failures.update(part.failures)
        return cls(runs, n, copies, dict(sorted(failures.items())))

    def notes(self, outcomes: Outcomes, *, above: bool = True) -> list[str]:
        """Say how many runs count, and what became of the others.

        Args:
            outcomes: which runs count.
            above: whether those left out are counted in the figure.
        """
        kind = "tracked run" if outcomes is Outcomes.TRACKED else "evaluated run"
        counted = plural(self.n + self.copies, kind)
        if self.copies:
            counted = f"{plural(self.n, 'different result')} of {counted}"
        if not self.failures:
            return [f"n = {counted}, none left out"]
        where = "; the grey field counts them at their place" if above else ""
        return [f"n = {counted} of {self.runs:,}; left out: {counts_text(self.failures)}{where}"]
