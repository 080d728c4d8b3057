# SPDX-License-Identifier: Apache-2.0
"""Pictures before they are drawn: panels of marks on shared axes, in numbers and words alone.

Each kind of figure makes one; ``drawing`` turns it into matplotlib's objects and knows nothing of runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.limits import GAIN, STEEP, Limits, robust_limits
from slamhive.analysis.measures import Better

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.analysis.columns import Floats


_MOST_TOLD = 4
"""Numbers outside of an axis that are told one by one."""


@dataclass(frozen=True)
class PictureAxis:
    """An axis that all panels share.

    Attributes:
        label: its name, with a unit where it has one.
        log: whether it is logarithmic; None where the numbers are to say.
        categories: texts at 0, 1, 2, …; empty where numbers stand along it.
        ticks: numbers that are written beside it, such as the few values of a setting; empty for round ones.
        robust: whether a few numbers far out may be left outside.
        ends: the numbers at its ends, whatever is drawn; None where the marks say.
        limits: what it holds, once that is known.
        better: which numbers are good; large ones are light then, where it is colours.
    """

    label: str
    log: bool | None = None
    categories: tuple[str, ...] = ()
    ticks: tuple[float, ...] = ()
    robust: bool = True
    ends: tuple[float, float] | None = None
    limits: Limits | None = None
    better: Better = Better.NONE


@dataclass(frozen=True, eq=False)
class Dots:
    """Some runs, or what stands for several, each at its place.

    Attributes:
        series: number of their series.
        x, y: (n,); a y of NaN is a run that failed, whose cross stands in a field above the others.
        hollow: those that are drawn without filling, (n,).
        small: whether they stand beside something that says more.
    """

    series: int
    x: Floats
    y: Floats
    hollow: tuple[bool, ...] = ()
    small: bool = False


@dataclass(frozen=True, eq=False)
class Line:
    """A way through numbers; NaN interrupts it.

    Attributes:
        series: number of its series; negative for what is no series: ground truth, a front.
        x, y: (n,).
        low, high: the ends of what each y stands for, (n,); None for none.
        steps: whether y stays as it is up to the next x.
        onward: the end of the axis along x to which the last y goes on: 1 for the larger, -1 for the smaller.
        marked: whether each place has a mark.
        thin: whether it is one of many.
    """

    series: int
    x: Floats
    y: Floats
    low: Floats | None = None
    high: Floats | None = None
    steps: bool = False
    onward: int = 0
    marked: bool = False
    thin: bool = False


@dataclass(frozen=True, eq=False)
class Ranges:
    """Bars around places: from one end to the other along x, along y, or both.

    Attributes:
        series: number of their series.
        x, y: (n,).
        x_ends, y_ends: (n, 2); None for none.
    """

    series: int
    x: Floats
    y: Floats
    x_ends: Floats | None = None
    y_ends: Floats | None = None


@dataclass(frozen=True, eq=False)
class Box:
    """Median, quartiles, and whiskers to the last number within 1.5 quartile distances; dots stand for few.

    Attributes:
        series: number of its series.
        at, width: its place along x.
        values: (n,).
    """

    series: int
    at: float
    width: float
    values: Floats

    @cached_property
    def ends(self) -> tuple[float, float, float, float, float]:
        """The lower whisker, the lower quartile, the median, the upper quartile and the upper whisker."""
        first, middle, third = np.percentile(self.values, (25, 50, 75)).tolist()
        reach = 1.5 * (third - first)
        inside = self.values[(self.values >= first - reach) & (self.values <= third + reach)]
        return float(inside.min()), first, middle, third, float(inside.max())

    @property
    def outside(self) -> Floats:
        """The numbers beyond the whiskers, (k,)."""
        return self.values[(self.values < self.ends[0]) | (self.values > self.ends[-1])]


@dataclass(frozen=True, eq=False)
class Tiles:
    """A grid of numbers as colours: columns along x, rows along y, both by category.

    Attributes:
        values: (rows, columns), NaN where there is none.
        texts: what stands in each tile.
    """

    values: Floats
    texts: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class MissingMark:
    """A number of runs without a figure, written in a field above the axes, at their place."""

    series: int
    at: float
    count: int


@dataclass(frozen=True)
class Reach:
    """Stretch of an axis along which a system goes until it fails.

    Attributes:
        row: its place along y.
        start, end: where the bar begins, and the last value that passes.
        failing: the first value that fails; None where none does.
        sure: values between which the threshold lies; None for an end that isn't known.
        is_open: whether it goes on beyond what was tried.
        text: counts.
        shares: values one by one with the share that failed, where no bar would be true.
        series: of no series.
    """

    row: int
    start: float
    end: float
    failing: float | None = None
    sure: tuple[float | None, float | None] | None = None
    is_open: bool = False
    text: str = ""
    shares: tuple[tuple[float, float], ...] = ()
    series: int = -1


Mark = Dots | Line | Ranges | Box | Tiles | MissingMark | Reach


@dataclass(frozen=True)
class Panel:
    """One plot of several.

    Attributes:
        title: its title.
        marks: what it shows.
        x: its own axis along x; None for the one of the picture.
    """

    title: str
    marks: tuple[Mark, ...]
    x: PictureAxis | None = None


@dataclass(frozen=True)
class Picture:
    """All that a figure shows.

    Attributes:
        x, y: its axes.
        panels: its plots, side by side.
        series: what each series is called, in the order of their styles.
        notes: sentences for the caption: what is averaged, and what is left out.
        columns: the numbers, by column, for the file beside the figure.
        runs: number of runs behind it.
        colour: what the colours of tiles mean.
        equal: whether a metre is as long along y as along x.
        apart: whether each panel has limits of its own: places of different datasets have nothing in common.
        rows: height in lines of text instead of the usual one; 0 for that.
        truth: whether the lines of no series are ground truth.
        shared: what all series have in common, over the legend.
    """

    x: PictureAxis
    y: PictureAxis
    panels: tuple[Panel, ...]
    series: tuple[str, ...]
    notes: tuple[str, ...]
    columns: dict[str, list[Any]]
    runs: int
    colour: PictureAxis | None = None
    equal: bool = False
    apart: bool = False
    rows: int = 0
    truth: bool = False
    shared: str = ""

    def settled(self) -> Picture:
        """Return the picture with limits on its axes, and a sentence on what lies outside of them."""
        picture = self._renumbered()
        marks = [mark for panel in picture.panels for mark in panel.marks]
        x, y = (
            _settled(
                axis,
                [numbers for mark in marks for numbers in _numbers(mark, side)],
                [numbers for mark in marks for numbers in _middles(mark, side)],
            )
            for side, axis in (("x", self.x), ("y", self.y))
        )
        tiles = [mark.values.ravel() for mark in marks if isinstance(mark, Tiles)]
        colour = self.colour and _settled(self.colour, tiles)
        panels = tuple(
            panel if panel.x is None else replace(panel, x=_settled(panel.x, [np.array(panel.x.ends or ())]))
            for panel in picture.panels
        )
        notes = list(self.notes)
        for axis, side in ((x, "x"), (y, "y"), (colour, "")):
            if axis is not None and axis.limits is not None and axis.limits.outside:
                numbers = [one for mark in marks for one in _numbers(mark, side)] if side else tiles
                notes += _outside(axis, numbers, scale=not side)
        return replace(picture, x=x, y=y, panels=panels, colour=colour, notes=tuple(notes))

    @property
    def has_own_axes(self) -> bool:
        """Tell whether panels have an axis of their own along x."""
        return any(panel.x is not None for panel in self.panels)

    def _renumbered(self) -> Picture:
        """Return the picture with those series alone that are drawn, counted from 0."""
        numbers = {
            mark.series for panel in self.panels for mark in panel.marks if not isinstance(mark, Tiles)
        } - {-1}
        used = sorted(numbers)
        places = {number: place for place, number in enumerate(used)} | {-1: -1}
        panels = tuple(
            replace(
                panel,
                marks=tuple(
                    mark if isinstance(mark, Tiles) else replace(mark, series=places[mark.series])
                    for mark in panel.marks
                ),
            )
            for panel in self.panels
        )
        return replace(self, panels=panels, series=tuple(self.series[number] for number in used))


def _settled(axis: PictureAxis, numbers: Iterable[Floats], middles: Sequence[Floats] = ()) -> PictureAxis:
    """Return an axis with limits.

    Args:
        axis: as it was asked for.
        numbers: all that is drawn along it.
        middles: those of them that stand for several runs, and never lie outside.
    """
    if axis.categories:
        return replace(axis, log=False, limits=Limits(0.0, float(len(axis.categories) - 1)))
    drawn, kept = (
        np.concatenate([np.empty(0), *(np.ravel(part) for part in parts)]) for parts in (numbers, middles)
    )
    drawn = drawn[np.isfinite(drawn)]
    log = axis.log
    if log is None:
        plain = _limits(drawn, kept, robust=axis.robust, log=False)
        log = plain is not None and bool((drawn > 0).all()) and plain.high > STEEP * plain.low
    if axis.ends is not None:
        return replace(axis, log=log, limits=Limits(*axis.ends))
    return replace(axis, log=log, limits=_limits(drawn, kept, robust=axis.robust, log=log))


def _limits(drawn: Floats, kept: Floats, *, robust: bool, log: bool) -> Limits | None:
    """Return the limits of an axis over finite numbers, with the count of those outside; None for none."""
    inside = drawn[(drawn > 0) | (not log)]
    found = robust_limits(inside, log=log)
    if found is None:
        return None
    low, high = float(inside.min()), float(inside.max())
    if robust:
        middles = kept[np.isfinite(kept) & ((kept > 0) | (not log))]
        near, far = min([found.low, *middles.tolist()]), max([found.high, *middles.tolist()])
        ends = np.log([near, far, low, high]) if log else (near, far, low, high)
        if ends[3] - ends[2] >= GAIN * (ends[1] - ends[0]):
            low, high = near, far
    return Limits(low, high, int((drawn < low).sum()), int((drawn > high).sum()))


def _numbers(mark: Mark, side: str) -> Sequence[Floats]:
    """Return the numbers that a mark needs room for along one side."""
    found: list[Floats | None] = []
    if isinstance(mark, MissingMark | Box):
        found = [np.array([mark.at])] if side == "x" else [mark.values] if isinstance(mark, Box) else []
    elif isinstance(mark, Dots | Line):
        found = [mark.x if side == "x" else mark.y]
        if isinstance(mark, Line) and side == "y":
            found += [mark.low, mark.high]
    elif isinstance(mark, Ranges):
        found = [mark.x_ends if side == "x" else mark.y_ends]
    return [part for part in found if part is not None]


def _middles(mark: Mark, side: str) -> Sequence[Floats]:
    """Return the numbers of a mark that stand for several runs."""
    if isinstance(mark, Ranges) or (isinstance(mark, Line) and mark.marked):
        return [mark.x if side == "x" else mark.y]
    return [np.array(mark.ends[1:4])] if isinstance(mark, Box) and side == "y" else []


def _outside(axis: PictureAxis, numbers: Sequence[Floats], *, scale: bool) -> list[str]:
    """Say which numbers lie outside of an axis: each of a few."""
    limits = axis.limits
    assert limits is not None  # noqa: S101 - the caller looked
    drawn = np.unique(np.concatenate([np.empty(0), *(np.ravel(part) for part in numbers)]))
    found = drawn[((drawn < limits.low) | (drawn > limits.high)) & np.isfinite(drawn)].tolist()
    if len(found) <= _MOST_TOLD:
        what = ", ".join(format(number, ".3g") for number in found)
    else:
        what = f"{len(found):,} numbers from {found[0]:.3g} to {found[-1]:.3g}"
    verbs = ("lie", "have", "are") if len(found) > 1 else ("lies", "has", "is")
    where, how = (
        ("scale", f"{verbs[1]} the colour of its end")
        if scale
        else ("axis", f"{verbs[2]} told by arrows at its edge")
    )
    return [f"{axis.label}: {what} {verbs[0]} outside of the {where} and {how}"]
