# SPDX-License-Identifier: Apache-2.0
"""Decision of a gate, made at looks while runs come in: better, no worse, worse, or not known yet.

Each look may spend a part of the allowed false alarms: however many there are, they come to α at most
(`spending`). Alarms are corrected for the number of figures, too (Holm 1979). That a figure is no worse needs
no such correction: all of them have to be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from slamhive.analysis.gating.figures import FAILURES
from slamhive.analysis.gating.spending import Spending, union_level
from slamhive.analysis.gating.testing import (
    failure_bound,
    failure_chances,
    failure_evidence,
    failure_share,
    permuted_chance,
    shift_of,
    standing_out,
)
from slamhive.analysis.statistics import holm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.gating.cells import GateCell
    from slamhive.analysis.gating.figures import GateFigure

ALARMS = 0.05
"""Share of gates that may call something worse though nothing changed, and of changes that may pass."""

_LEAST_BETTER = 0.001
"""Change below which nothing is called better: digits of another processor."""

_HOUR = "better, or a quieter hour: other work ran beside runs"


class GateAnswer(StrEnum):
    """Answer of a gate on a figure."""

    BETTER = "better"
    NO_WORSE = "no worse"
    WORSE = "worse"
    UNKNOWN = "can't tell"


@dataclass(frozen=True)
class GateFinding:
    """Answer on a figure, with what it rests on.

    Attributes:
        figure: what was asked.
        answer: what it came to.
        shift: how much worse it became, on the scale of tests; NaN where nothing tells.
        low, high: where that lies, at the level of the look that decided, each side for itself.
        counts: numbers before and now.
        why: what stands out, or why nothing can be told.
        cells: numbers of the cells that stand out.
        mends: whether more runs may tell.
    """

    figure: GateFigure
    answer: GateAnswer
    shift: float = math.nan
    low: float = -math.inf
    high: float = math.inf
    counts: tuple[int, int] = (0, 0)
    why: str = ""
    cells: tuple[int, ...] = ()
    mends: bool = True


@dataclass(frozen=True)
class _FigureLook:
    finding: GateFinding
    worse: float
    better: float
    passes: bool
    beyond: bool


@dataclass
class Gate:
    """A gate under way.

    Attributes:
        figures: what is asked.
        alarms: share of false alarms, of a gate as a whole.
        looks: how often it was looked.
        findings: answers of the last look; empty before the first.
        refused: figures that can't be compared, with the reason.
        is_beside_others: whether runs of either side may have had other work beside them. Hours differ in
            that: a load is then better only by more than its margin, which is for what such work does.
    """

    figures: Sequence[GateFigure]
    alarms: float = ALARMS
    looks: int = 0
    findings: list[GateFinding] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    is_beside_others: bool = False
    _settled: dict[str, GateFinding] = field(default_factory=dict)
    _passing: Spending = field(init=False)

    def __post_init__(self) -> None:
        self._passing = Spending(self.alarms)

    @property
    def answer(self) -> GateAnswer:
        """Answer of the gate as a whole: its worst."""
        answers = {one.answer for one in self.findings}
        order = (GateAnswer.WORSE, GateAnswer.UNKNOWN, GateAnswer.NO_WORSE, GateAnswer.BETTER)
        return next((one for one in order if one in answers), GateAnswer.UNKNOWN)

    @property
    def is_sure(self) -> bool:
        """Tell whether more runs would change nothing that matters."""
        waits = any(one.answer is GateAnswer.UNKNOWN and one.mends for one in self.findings)
        return bool(self.findings) and (self.answer is GateAnswer.WORSE or not waits)

    def look(self, cells: Sequence[GateCell], *, last: bool = False) -> list[GateFinding]:
        """Decide by what there is now.

        Args:
            cells: all of them, with their runs so far.
            last: whether no look follows.
        """
        self.looks += 1
        level = union_level(self.alarms, self.looks, last=last)
        passing = self._passing.level(_information(cells), last=last)
        seen = [self._look_at(one, cells, passing) for one in self.figures]
        worse, better = holm([one.worse for one in seen]), holm([one.better for one in seen])
        self.findings = []
        for one, chance_worse, chance_better in zip(seen, worse, better, strict=True):
            finding, name = one.finding, one.finding.figure.name
            answer = GateAnswer.UNKNOWN
            if chance_worse <= level and one.beyond:
                answer = GateAnswer.WORSE
            elif chance_better <= level and finding.shift < -_LEAST_BETTER:
                if self._may_be_the_hour(finding):
                    finding, answer = replace(finding, why=_HOUR), GateAnswer.NO_WORSE
                else:
                    answer = GateAnswer.BETTER
            elif one.passes:
                answer = GateAnswer.NO_WORSE
            elif name in self._settled:
                finding, answer = self._settled[name], self._settled[name].answer
            found = _answered(finding, answer)
            if answer in {GateAnswer.NO_WORSE, GateAnswer.BETTER}:
                self._settled[name] = found
            self.findings.append(found)
        if self.answer is GateAnswer.WORSE:
            open_ = {
                number
                for number, one in enumerate(self.findings)
                if one.answer is GateAnswer.UNKNOWN and one.mends
            }
            for number in open_:
                self.findings[number] = replace(self.findings[number], why="still open when it ended")
        return self.findings

    def _may_be_the_hour(self, finding: GateFinding) -> bool:
        """Tell whether what looks better may be that other work was less."""
        figure = finding.figure
        return self.is_beside_others and figure.follows_hours and finding.high >= -figure.bound

    def _look_at(self, figure: GateFigure, cells: Sequence[GateCell], level: float) -> _FigureLook:
        if figure.name in self.refused:
            return _nothing(figure, self.refused[figure.name])
        if figure.name == FAILURES:
            return self._of_failures(figure, cells)
        return _of_numbers(figure, cells, level)

    def _of_failures(self, figure: GateFigure, cells: Sequence[GateCell]) -> _FigureLook:
        worse, better = failure_chances(cells)
        before, now = (failure_share(cells, now=side) for side in (False, True))
        counts = sum(cell.before.count for cell in cells), sum(cell.now.count for cell in cells)
        failing = tuple(
            number
            for number, cell in enumerate(cells)
            if cell.now.failed
            and cell.now.failed / cell.now.count > cell.before.failed / max(1, cell.before.count)
        )
        high = failure_bound(cells, self.alarms)
        passes = failure_evidence(cells, figure.margin) >= 1 / self.alarms
        finding = GateFinding(figure, GateAnswer.UNKNOWN, now - before, -math.inf, high, counts, "", failing)
        # Any more that is no chance counts: one dataset of nine that is always lost is within any margin.
        return _FigureLook(finding, worse, better, passes=passes and worse > self.alarms, beyond=now > before)


def _information(cells: Sequence[GateCell]) -> float:
    """Return one over the variance of a mean shift, by the numbers of runs alone."""
    both = [cell for cell in cells if cell.before.count and cell.now.count]
    variance = sum(1 / cell.before.count + 1 / cell.now.count for cell in both)
    return len(both) ** 2 / variance if variance else 1e-9


def _nothing(figure: GateFigure, why: str) -> _FigureLook:
    finding = GateFinding(figure, GateAnswer.UNKNOWN, why=why, mends=False)
    return _FigureLook(finding, 1.0, 1.0, passes=False, beyond=False)


def _of_numbers(figure: GateFigure, cells: Sequence[GateCell], level: float) -> _FigureLook:
    shift = shift_of(figure, cells)
    if shift is None:
        known = any(cell.before.numbers(figure.name, logarithms=False).size for cell in cells)
        return _nothing(figure, f"no run {'now' if known else 'of the baseline'} has it")
    out = standing_out(figure, shift)
    chances = [one.chance * len(shift.cells) for one in out]
    counts = sum(one.counts[0] for one in shift.cells), sum(one.counts[1] for one in shift.cells)
    reach = shift.reach(level)
    finding = GateFinding(
        figure,
        GateAnswer.UNKNOWN,
        shift.mean,
        shift.mean - reach,
        shift.mean + reach,
        counts,
        "",
        tuple(one.cell for one in out),
    )
    overall = shift.chance() if shift.mean > figure.bound else 1.0
    if shift.error and overall <= ALARMS:
        overall = max(overall, permuted_chance(figure, cells))
    # Two tests of one figure, of all cells and of the worst: each has half of what is allowed.
    worse = min(1.0, 2 * min([overall, *chances]))
    return _FigureLook(
        finding,
        worse,
        shift.chance(worse=False),
        passes=shift.mean + reach < figure.bound and not out,
        beyond=True,
    )


def _answered(finding: GateFinding, answer: GateAnswer) -> GateFinding:
    why = finding.why
    if answer is GateAnswer.UNKNOWN and not why:
        if finding.figure.name == FAILURES:
            why = "too few runs to know that no more fail than before"
        elif math.isinf(finding.high):
            why = "one run of a setting says nothing of its spread"
        elif finding.cells:
            why = "some settings stand out, and too few runs tell whether that is chance"
        else:
            why = "the runs vary too much for so few of them"
    return replace(finding, answer=answer, why=why)
