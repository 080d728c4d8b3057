# SPDX-License-Identifier: Apache-2.0
"""Verdicts on own results beside published ones: equal, better, worse, or why they can't be compared.

A verdict is given only where what was measured is known to be the same: the recording by its length, the
system with its sensors and parameters, the alignment, whether keyframes alone are measured, the statistic.
What the paper doesn't say can't be compared.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import aggregate
from slamhive.analysis.measures import measure_of
from slamhive.analysis.statistics import ENOUGH, LEVEL
from slamhive.model.base import Choice
from slamhive.model.evaluation import Alignment
from slamhive.model.published import PublishedStatistic

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.columns import Integers, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.model.base import Scalar
    from slamhive.model.published import PublishedRow, PublishedTable

NEAR = 0.1
"""Share of a published number within which an own one is equal to it, where the paper gives no spread."""
DEVIATIONS = 2
"""Standard deviations that the paper gives within which an own number is equal to its own."""
SAME_LENGTH = 0.1
"""Share by which the length of a recording may differ from that of the sequence."""
_APART = 10.0
"""Factor from which on another unit or another quantity is more likely than another result."""
_ENOUGH = 3
"""Different own results from which on their range says something."""
RULE = (
    "own runs: the mean, beside a median the median. Within: it differs by at most "
    f"{DEVIATIONS} standard deviations that the paper gives; where it gives none, by at most {NEAR:.0%}, "
    f"or the range of {_ENOUGH} or more different own results, from {ENOUGH} on the {LEVEL:.0%} interval, "
    "contains it"
)
"""The rule that verdicts follow, as a sentence."""
_MEASURED = re.compile(r"(?:only |the )?(key[ _-]?frames?|all (?:frames|scans|poses))\b", re.IGNORECASE)
_BODY = frozenset({"body", "imu"})


class Agreement(Choice):
    """Words for an own result beside a published one."""

    WITHIN = "Within"
    BETTER = "Better"
    WORSE = "Worse"
    DIFFERS = "Differs"
    NOT_TRACKED = "NotTracked"
    NOT_COMPARABLE = "NotComparable"
    NOT_RUN = "NotRun"


@dataclass(frozen=True)
class Assessment:
    """A verdict on own results beside one published number.

    Attributes:
        verdict: the word.
        sentence: the same with the rule that was applied, or why they can't be compared.
        own: own number in the stored unit; None where there are none or several.
    """

    verdict: Agreement
    sentence: str
    own: float | None = None

    @property
    def is_alike(self) -> bool:
        """Tell whether both were measured alike, whether or not own runs succeeded."""
        return self.verdict not in {Agreement.NOT_COMPARABLE, Agreement.NOT_RUN}


class OwnRuns:
    """Own runs on one sequence, and which of them are on that recording and no other of its name.

    Args:
        frame: the runs on its dataset.
        sequence: the sequence, as its publishers call it.
        metres, seconds: how long it is; None where that isn't known.

    Attributes:
        why: why some or all runs aren't on that recording, as far as is known; empty where all are.
        is_other: whether all are known to be on another recording.
    """

    def __init__(
        self, frame: Frame, sequence: str, metres: float | None = None, seconds: float | None = None
    ) -> None:
        self._frame = frame
        self._columns: dict[str, tuple[Integers, list[Any]]] = {}
        self._cells: dict[tuple[object, ...], list[Cell] | Assessment] = {}
        self.why = ""
        told, off = np.zeros(len(frame), bool), np.zeros(len(frame), bool)
        for right, unit, what, name in (
            (metres, "m", "ground truth", "pathLength"),
            (seconds, "s", "recording", "prepared.durationSeconds"),
        ):
            if right is None:
                continue
            found = frame.column(name).floats()
            told |= ~np.isnan(found)
            differs = np.abs(found - right) > SAME_LENGTH * right  # never of what isn't known
            if differs.any():
                own = f"{found[differs][0]:.4g} {unit}"
                self.why = self.why or f"the {what} here is {own} long, that of {sequence} {right:g} {unit}"
            off |= differs
        # A run that nothing measured is on the recording that the others are on.
        self._recorded = ~off & told.any()
        self.is_other = bool(off.any() and (off | ~told).all())
        if self.is_other:
            self._recorded = np.zeros(len(frame), bool)
        if not self._recorded.any() and not self.why:
            whose = f"{sequence} is" if metres is None and seconds is None else "the recording here is"
            self.why = f"how long {whose} isn't known"

    def judge(
        self, table: PublishedTable, row: PublishedRow, column: str, number: float, spread: float | None
    ) -> Assessment:
        """Return the verdict on own runs beside a published number.

        Args:
            table: its table.
            row: its row.
            column: what it is of, an error.
            number: it, in the stored unit.
            spread: its standard deviation in that unit, where the paper gives it.
        """
        asked = (row.system, row.sensors, *sorted(row.parameters.items()), column)
        key = (*asked, table.alignment, table.poses, table.frame, table.statistic)
        if key not in self._cells:
            self._cells[key] = self._alike(table, row, column)
        cells = self._cells[key]
        if isinstance(cells, Assessment):
            return cells
        median = table.statistic is PublishedStatistic.MEDIAN
        return _together([_compared(one, column, number, spread, median=median) for one in cells])

    def _alike(  # noqa: PLR0911 - a reason each
        self, table: PublishedTable, row: PublishedRow, column: str
    ) -> list[Cell] | Assessment:
        """Return own figures of what was measured alike, or why there are none."""
        if not self._recorded.any():
            return _not(self.why)
        mask = self._recorded & self._of_system(row)
        if not mask.any():
            named = [row.system, *([str(row.sensors)] if row.sensors else [])]
            named += [f"with {name} {value}" for name, value in row.parameters.items()]
            return Assessment(Agreement.NOT_RUN, f"no own run of {' '.join(named)}")
        mask &= ~self._changed()
        if not mask.any():
            return _not("own runs had their frames changed on purpose (input.perturb, input.preparedBy)")
        if table.alignment is None:
            return _not("the alignment isn't said")
        wanted = table.alignment.lower()
        aligned = mask & self._of("alignment", lambda one: one.lower() == wanted)
        if not aligned.any():
            own = ", ".join(alignment_words(self._frame.select(mask)))
            return _not(f"aligned by {table.alignment}, own runs by {own or 'what nobody knows'}")
        alike = aligned
        if measured := _MEASURED.match(table.poses or ""):
            keyframes, some = self._of("keyframes", bool), measured[1].lower().startswith("key")
            alike = aligned & (keyframes if some else ~keyframes)
            if not alike.any():
                own = "all poses" if some else "keyframes alone"
                return _not(f"measured are {table.poses}, here {own}")
        if table.frame is not None and table.frame.lower() not in _BODY:
            return _not(f"poses of the {table.frame} are measured, own runs in the frame that they wrote")
        if table.statistic is PublishedStatistic.BEST:
            return _not(f"the best of {table.runs or 'several'} runs, own figures are of all")
        found = aggregate(self._frame.select(alike), [column]).cells
        cells = [one for one in found if one.figures[column].summary]
        return cells or Assessment(Agreement.NOT_TRACKED, "no own run of it was tracked")

    def _of_system(self, row: PublishedRow) -> Mask:
        """Return the runs of a row's system with its sensors and parameters, (n,)."""
        mask = self._of("algorithm", lambda name: is_system(name, row.system))
        wanted: dict[str, Any] = {f"parameters.{name}": value for name, value in row.parameters.items()}
        if row.sensors is not None:
            wanted["sensors"] = row.sensors
        for name, value in wanted.items():
            mask &= self._of(name, partial(_is_same, value))
        return mask

    def _changed(self) -> Mask:
        """Return the runs whose frames aren't those that were recorded, (n,)."""
        found: Mask = np.zeros(len(self._frame), bool)
        for name in self._frame.stored:
            if name == "input.preparedBy" or (name.startswith("input.perturb.") and "seed" not in name):
                found |= self._of(name, bool)
        return found

    def _of(self, name: str, fits: Callable[[Any], object]) -> Mask:
        """Return the rows whose value of a column fits, (n,); one that isn't known doesn't."""
        if name not in self._columns:
            self._columns[name] = self._frame.column(name).factorized()
        codes, values = self._columns[name]
        good = np.array([value is not None and bool(fits(value)) for value in values])
        found: Mask = good[codes]
        return found


def plain_name(name: str) -> str:
    """Return a sequence's or system's name without case and punctuation: ``MH_01_easy`` is ``mh-01-easy``."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def is_system(algorithm: str, system: str) -> bool:
    """Tell whether an algorithm is a system or a program of it: ``orb-slam3-program`` is ``ORB-SLAM3``."""
    return f"{algorithm}-".startswith(f"{plain_name(system)}-")


def _is_same(published: Scalar, own: Scalar) -> bool:
    """Tell whether settings are equal, however they are written: ``"5"`` is 5 and 5.0, but no ``true``."""
    both = str(published).lower(), str(own).lower()
    try:
        return float(both[0]) == float(both[1])
    except ValueError:
        return both[0] == both[1]


def alignment_words(frame: Frame) -> list[str]:
    """Return the alignments of runs, sorted, as they are called in manifests."""
    words = {one.lower(): str(one) for one in Alignment}
    return sorted(words.get(one, one) for one in frame.column("alignment").unique() if one is not None)


def _not(why: str) -> Assessment:
    return Assessment(Agreement.NOT_COMPARABLE, f"not comparable: {why}")


def _compared(cell: Cell, column: str, number: float, spread: float | None, *, median: bool) -> Assessment:
    """Return the verdict on one own figure."""
    summary = cell.figures[column].summary
    assert summary is not None  # noqa: S101 - only such cells are asked for
    own = summary.median if median else summary.mean
    sign = measure_of(column).sign
    if doubt := _doubt(own, number, spread):
        return Assessment(Agreement.NOT_COMPARABLE, f"not comparable: {doubt}; is the unit the same?", own)
    share = own / number - 1
    if spread is not None and abs(own - number) <= DEVIATIONS * spread:
        return Assessment(Agreement.WITHIN, f"within {DEVIATIONS} of the paper's standard deviations", own)
    if spread is None and abs(share) <= NEAR:
        return Assessment(Agreement.WITHIN, f"within {NEAR:.0%} ({_percent(share)})", own)
    if spread is None and (found := _own_range(cell, column, median=median)):
        (low, high), words = found
        if low <= number <= high:
            return Assessment(Agreement.WITHIN, f"within the {words} of own runs ({_percent(share)})", own)
    if sign * share < 0:
        return Assessment(Agreement.BETTER, f"better ({_percent(share)})", own)
    return Assessment(Agreement.WORSE, f"worse ({_percent(share)})", own)


def _doubt(own: float, number: float, spread: float | None) -> str:
    """Say why numbers seem to be in another unit, or of another quantity; empty where they don't."""
    if spread is not None and spread > number:
        return f"the paper's standard deviation {spread:.3g} is larger than its {number:.3g}"
    if min(own, number) <= 0 or not 1 / _APART < own / number < _APART:
        return f"{number:.3g} and {own:.3g} are more than {_APART:.0f} times apart"
    return ""


def _percent(share: float) -> str:
    return f"{share:+.0%}" if abs(share) > NEAR else f"{share:+.1%}"


def _own_range(cell: Cell, column: str, *, median: bool) -> tuple[tuple[float, float], str] | None:
    """Return the ends of own results and what they are: of many the interval, of few the range."""
    figure = cell.figures[column]
    interval = figure.median_interval if median else figure.mean_interval
    if interval is not None:
        return (interval.low, interval.high), f"{LEVEL:.0%} interval"
    summary = figure.summary
    if summary is None or cell.deterministic or summary.n < _ENOUGH:
        return None
    return (summary.min, summary.max), f"range of {summary.n}"


def _together(found: Sequence[Assessment]) -> Assessment:
    """Return one verdict on the figures of several settings."""
    if len({one.sentence for one in found}) == 1:
        return found[0]
    if all(one.verdict is Agreement.NOT_COMPARABLE for one in found):
        return Assessment(Agreement.NOT_COMPARABLE, found[0].sentence)
    words = [one.verdict for one in found]
    counts = {word: words.count(word) for word in dict.fromkeys(words)}
    names = {Agreement.NOT_COMPARABLE: "not comparable"}
    told = [f"{count} {names.get(word, word.lower())}" for word, count in counts.items()]
    if len(counts) == 1:
        return Assessment(words[0], f"{words[0].lower()}, all of {len(found)} settings")
    return Assessment(Agreement.DIFFERS, f"{len(found)} settings: {', '.join(told)}")
