# SPDX-License-Identifier: Apache-2.0
"""Drawing of pictures by matplotlib: sizes, axes, marks, and marks for what lies outside of the axes."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from itertools import chain, compress, takewhile
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.measures import Better
from slamhive.figures.pictures import Box, Dots, Line, MissingMark, PictureAxis, Ranges, Reach, Tiles
from slamhive.figures.reaching import draw_reach
from slamhive.figures.styles import SCALE, Style
from slamhive.figures.widths import MM
from slamhive.model import extras
from slamhive.reporting.markup import shortened

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from slamhive.figures.pictures import Mark, Panel, Picture
    from slamhive.figures.widths import Width


_NARROW = 5.4
"""Width of a panel in letters' heights × 2.54 below which panels begin a new line."""

_MOST_ACROSS = 4
_LETTER = 0.56
"""Width of a letter over its height, about."""
_SIGN = 3.4
"""Width of a sign of the legend with the room around it, over the size of letters."""
_FEWEST = 8
"""Letters that a text of the legend keeps."""

_SHAPE = 0.74
_WIDE = 50.0
_ALONE = {False: 0.58, True: 0.42}
"""Height over width of a panel by itself, and of one that is wider than 50 letters are high."""

_UP = ((-0.1, -1), (-0.1, -0.3), (-0.35, -0.3), (0, 0.4), (0.35, -0.3), (0.1, -0.3), (0.1, -1), (-0.1, -1))
_ARROWS = {
    "above": _UP,
    "below": tuple((x, -y) for x, y in _UP),
    "right": tuple((y, x) for x, y in _UP),
    "left": tuple((-y, x) for x, y in _UP),
}
"""Arrows with a shaft, which no mark of a series looks like."""

_INWARDS = {"left": (1, 0), "right": (-1, 0), "above": (0, -1), "below": (0, 1)}
_FIELD = "#ececec"
_INK = "#404040"
_MOST_VALUES = 2
"""Numbers outside of an axis at one place that are written one by one."""

_TOP = 0.85
"""Share of the height from which on there is no room for a number above."""

_MOST_LINES = 3
_MOST_DECADES = 6
"""Decades of an axis from which on there are no ticks between them."""

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LONGEST = 34


def library(name: str) -> Any:
    """Return a module of matplotlib.

    Raises:
        InputError: it isn't installed.
    """
    return extras.library(f"matplotlib.{name}" if name else "matplotlib", "plot", "a figure")


class Drawing:
    """A picture as a figure of matplotlib.

    Args:
        picture: with limits on its axes.
        width: of the figure.
        millimetres: its height; None for what suits it.
    """

    def __init__(self, picture: Picture, width: Width, millimetres: float | None = None) -> None:
        self._picture = picture
        self._points = width.points
        self._em = width.points / 72
        self._inches = width.inches
        count = len(picture.panels)
        most = max(1, min(_MOST_ACROSS, int(width.inches / (self._em * 2.54 * _NARROW))))
        down = math.ceil(count / min(most, count))
        self._across = math.ceil(count / down)
        self._down = down
        self._legend = self._entries()
        inches = millimetres / MM if millimetres is not None else self._height(width.inches)
        figures = library("figure")
        self.figure = figures.Figure(figsize=(width.inches, inches), layout="constrained")
        self.figure.get_layout_engine().set(
            w_pad=0.3 * self._em, h_pad=0.3 * self._em, wspace=0.02, hspace=0.02
        )
        share: Any = not picture.apart
        grid = self.figure.subplots(
            down, self._across, squeeze=False, sharex=share and not picture.has_own_axes, sharey=share
        )
        self._axes = list(chain(*grid))

    def draw(self) -> Any:
        """Draw all of it; returns the figure."""
        picture = self._picture
        for axes in self._axes[len(picture.panels) :]:
            axes.remove()
        tiles = None
        panels = list(zip(self._axes, picture.panels, strict=False))
        for number, (axes, _) in enumerate(panels):
            self._prepare(axes, number)
        failed = [self._failed(axes, panel) for axes, panel in panels]
        lines = max((line + 1 for places in failed for *_, line in places), default=0)
        for number, (axes, panel) in enumerate(panels):
            for mark in panel.marks:
                made = self._draw(axes, mark)
                tiles = made if made is not None else tiles
            if lines:
                self._field(axes, failed[number], lines, named=number % self._across == 0)
            self._name(axes, panel, above=self._field_points(lines))
            if not picture.apart:
                self._outside(axes, panel)
        if tiles is not None:
            self._scale(tiles)
        self._labels()
        if self._legend:
            self._write_legend()
        return self.figure

    # Sizes

    def _height(self, inches: float) -> float:
        picture, em = self._picture, self._em
        legend = self._legend_rows(inches) * 1.35 * em if self._legend else 0.0
        if picture.rows:
            return picture.rows * 1.35 * em + 4.0 * em + legend
        wide = inches / self._across
        room = 3.2 * em  # for the axis' name and numbers
        categories = picture.y.categories
        if picture.has_own_axes:
            return self._down * (len(categories) * 2.1 * em + 3.9 * em)
        if categories and picture.colour is not None:
            tall = max(0.45 * wide, len(categories) * 2.0 * em + 2 * em)
        else:
            tall = (
                (wide * (0.9 if picture.equal else _SHAPE))
                if self._across > 1
                else wide * _ALONE[wide > _WIDE * em]
            )
        if self._turned():
            longest = max(len(shortened(text, _LONGEST)) for text in picture.x.categories)
            room += longest * _LETTER * 0.8 * em * 0.6
        titles = 1.4 * em if any(panel.title for panel in picture.panels) else 0.0
        field = self._field_points(_most_failed(picture.panels)) / 72
        return self._down * (tall + titles + field) + room + legend

    def _turned(self) -> bool:
        """Tell whether texts along x stand aslant, as they are too long side by side."""
        categories = self._picture.x.categories
        if not categories:
            return False
        wide = self._points * 0.8125 * _LETTER / 72
        count = len(categories)
        room = self._beside(count) if self._picture.colour is not None else self._room() / count
        return max(len(shortened(text, _LONGEST)) for text in categories) * wide > room

    def _beside(self, count: int) -> float:
        """Return the width of one of some tiles beside each other, in inches."""
        letter = self._points * 0.8125 * _LETTER / 72
        names = max(map(len, self._texts("y", self._picture.y)), default=0) * letter
        return (self._inches * 0.8 - names - 3 * self._em) / self._across / count

    def _texts(self, side: str, axis: PictureAxis) -> list[str]:
        """Return texts along an axis, as long as there is room for."""
        letter = self._points * 0.8125 * _LETTER / 72
        most = _LONGEST if side == "x" else max(8, int(0.42 * self._inches / self._across / letter))
        if side == "x" or not self._picture.has_own_axes:
            return told_apart(axis.categories, most)
        # Rows of a card are as high as two lines.
        return [_in_lines(text, most) for text in told_apart(axis.categories, 2 * most)]

    def _room(self) -> float:
        """Return the width of a panel without the numbers beside it, in inches."""
        return self._inches / self._across * (0.74 if self._picture.apart else 0.84)

    # Axes

    def _prepare(self, axes: Any, number: int) -> None:
        picture = self._picture
        axes.set_axisbelow(True)
        for side, axis in (("x", picture.panels[number].x or picture.x), ("y", picture.y)):
            self._prepare_axis(axes, side, axis)
        for place in ("top", "right"):
            axes.spines[place].set_visible(picture.colour is not None)
        if picture.equal:
            axes.set_aspect("equal", adjustable="datalim")
        if not picture.apart and not picture.has_own_axes:
            axes.label_outer()
            # The last of a column keeps its numbers where the row below it is shorter.
            below = number + self._across
            if below >= len(picture.panels):
                axes.tick_params(axis="x", which="both", labelbottom=True)

    def _prepare_axis(self, axes: Any, side: str, axis: PictureAxis) -> None:
        limits = axis.limits
        set_limits = getattr(axes, f"set_{side}lim")
        own = getattr(axes, f"{side}axis")
        ticker = library("ticker")
        if axis.categories:
            texts = self._texts(side, axis)
            turned = side == "x" and self._turned()
            own.set_ticks(range(len(texts)))
            own.set_ticklabels(
                texts, **({"rotation": 35, "ha": "right", "rotation_mode": "anchor"} if turned else {})
            )
            own.set_tick_params(length=0)
            set_limits(-0.5, len(texts) - 0.5)
            return
        if limits is None or self._picture.apart:
            axes.grid(visible=True, axis=side)
            return
        if axis.log:
            getattr(axes, f"set_{side}scale")("log")
        low, high = self._ends(axis, side)
        set_limits(low, high)
        axes.grid(visible=True, axis=side)
        if axis.log:
            decades = math.log10(high / low)
            subs = (1.0,) if decades > 2.5 else (1.0, 3.0) if decades > 1.6 else (1.0, 2.0, 5.0)
            most = max(3, int(1 / self._letters(8))) if side == "x" else 12
            own.set_major_locator(ticker.LogLocator(subs=subs, numticks=min(most, 12)))
            between = ticker.LogLocator(subs=tuple(range(2, 10)), numticks=50)
            own.set_minor_locator(between if decades < _MOST_DECADES else ticker.NullLocator())
            own.set_minor_formatter(ticker.NullFormatter())
            if decades < 0.5:
                own.set_major_locator(ticker.MaxNLocator(4))
        else:
            own.set_major_locator(ticker.MaxNLocator(4 if self._across > 2 else 5))
        own.set_major_formatter(ticker.FuncFormatter(_number))
        if axis.ticks and side == "x":
            self._tick_each(axes, axis.ticks)

    def _tick_each(self, axes: Any, ticks: Sequence[float]) -> None:
        """Set a tick at each number along x, and write those that have room."""
        written, lines = set(), _TextLines()
        for number in ticks:
            half = self._letters(len(_number(number)) + 1) / 2
            share = _share(axes, number)
            if not lines.take(share - half, share + half):
                written.add(number)
        axes.set_xticks(ticks, [_number(number) if number in written else "" for number in ticks])
        axes.set_xticks([], minor=True)

    def _ends(self, axis: PictureAxis, side: str) -> tuple[float, float]:
        """Return the ends of an axis: what it has to hold, and some air."""
        limits = axis.limits
        assert limits is not None  # noqa: S101 - the caller looked
        low, high = limits.low, limits.high
        marks = [mark for panel in self._picture.panels for mark in panel.marks]
        if axis.ends is not None:
            return low, high + 0.03 * (high - low)
        head = 0.12 if side == "y" and limits.above else 0.05
        if axis.log:
            air = (high / low) ** 0.05 if high > low else 1.5
            return low / air, high * ((high / low) ** head if high > low else air)
        if high == low:
            half = abs(high) / 2 or 0.5
            return low - half, high + half
        curves = side == "x" and all(isinstance(mark, Line) and not mark.marked for mark in marks)
        if 0 <= low < (0.6 if side == "y" else 0.1 if curves else 0.0) * high or low == 0:
            below = 0.0
        else:
            below = low if curves else low - 0.05 * (high - low)
        return below, high + (0.01 if curves else head) * (high - below)

    def _name(self, axes: Any, panel: Panel, above: float) -> None:
        if panel.title:
            letters = max(8, int(self._room() / (self._points * 0.98 * _LETTER / 72)))
            titles = [one.title for one in self._picture.panels]
            title = dict(zip(titles, told_apart(titles, letters), strict=True))[panel.title]
            axes.set_title(title, pad=0.35 * self._points + above)

    def _labels(self) -> None:
        """Name the axes of the outer panels; a long name takes several lines."""
        picture, size = self._picture, self._points * 0.9375
        count = len(picture.panels)
        wide = self._room()
        tall = self.figure.get_size_inches()[1] / self._down * (0.6 if self._legend else 0.8)
        for number, axes in enumerate(self._axes[:count]):
            own = picture.panels[number].x
            if picture.apart or own is not None or number + self._across >= count:
                axes.set_xlabel(_wrapped((own or picture.x).label, wide, size), fontsize=size)
            if picture.apart or number % self._across == 0:
                axes.set_ylabel(_wrapped(picture.y.label, tall, size), fontsize=size)

    # Marks

    def _draw(self, axes: Any, mark: Mark) -> Any:
        match mark:
            case Dots():
                self._dots(axes, mark)
            case Line():
                self._line(axes, mark)
            case Ranges():
                self._ranges(axes, mark)
            case Box():
                self._box(axes, mark)
            case Tiles():
                return self._tiles(axes, mark)
            case Reach():
                draw_reach(axes, mark, self._points)
        return None

    def _dots(self, axes: Any, mark: Dots) -> None:
        style = Style(mark.series)
        hollow = np.array(mark.hollow or (False,) * len(mark.x), dtype=bool)
        for chosen, is_hollow in ((~hollow, False), (hollow, True)):
            look = self._look(style, hollow=is_hollow)
            if mark.small:
                look |= {"marker": "o", "markersize": 0.26 * self._points, "markeredgecolor": style.colour}
            axes.plot(mark.x[chosen], mark.y[chosen], linestyle="none", zorder=4 if mark.small else 3, **look)

    def _line(self, axes: Any, mark: Line) -> None:
        style = Style(mark.series)
        wide = 0.07 if mark.thin else 0.14
        if mark.series < 0:
            wide, order = 0.3 if self._picture.equal else 0.12, 1
        else:
            order = 2
        if mark.low is not None and mark.high is not None:
            known = ~(np.isnan(mark.low) | np.isnan(mark.high))
            ends = np.abs(np.vstack([mark.y - mark.low, mark.high - mark.y]))[:, known]
            axes.errorbar(
                mark.x[known],
                mark.y[known],
                yerr=ends,
                fmt="none",
                ecolor=style.colour,
                elinewidth=0.09 * self._points,
                capsize=0.2 * self._points,
                capthick=0.09 * self._points,
                zorder=2,
            )
        x, y = mark.x, mark.y
        if mark.onward:
            x, y = np.append(x, axes.get_xlim()[mark.onward > 0]), np.append(y, y[-1])
        axes.plot(
            x,
            y,
            color=style.colour,
            linestyle=style.dashes,
            linewidth=wide * self._points,
            **(self._look(style) if mark.marked else {}),
            drawstyle="steps-post" if mark.steps else "default",
            alpha=0.75 if mark.thin else None,
            zorder=order,
        )
        drawn = np.flatnonzero(~(np.isnan(mark.x) | np.isnan(mark.y)))
        if self._picture.equal and len(drawn):
            for place, look in zip(drawn[[0, -1]], self._ends_look(style), strict=True):
                axes.plot(mark.x[place], mark.y[place], zorder=order + 2, **look)

    def _ends_look(self, style: Style) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the options that draw where a path starts, a ring, and where it ends, a square."""
        wide = 0.1 * self._points
        look = {"linestyle": "none", "markeredgecolor": style.colour, "markeredgewidth": wide}
        start = {"marker": "o", "markersize": 0.7 * self._points, "markerfacecolor": "none"}
        return look | start, look | {"marker": "s", "markersize": 0.35 * self._points, "color": style.colour}

    def _ranges(self, axes: Any, mark: Ranges) -> None:
        style = Style(mark.series)
        wide = {"color": style.colour, "linewidth": 0.1 * self._points, "zorder": 2}
        if mark.x_ends is not None:
            axes.hlines(mark.y, mark.x_ends[:, 0], mark.x_ends[:, 1], **wide)
        if mark.y_ends is not None:
            axes.vlines(mark.x, mark.y_ends[:, 0], mark.y_ends[:, 1], **wide)

    def _box(self, axes: Any, mark: Box) -> None:
        style, patches = Style(mark.series), library("patches")
        low, first, middle, third, high = mark.ends
        left, right = mark.at - mark.width / 2, mark.at + mark.width / 2
        line = {"color": style.colour, "linewidth": 0.1 * self._points, "zorder": 2}
        axes.vlines([mark.at] * 2, [low, third], [first, high], **line)
        quarter = mark.width / 4
        axes.hlines([low, high], mark.at - quarter, mark.at + quarter, **line)
        axes.add_patch(
            patches.Rectangle(
                (left, first),
                right - left,
                third - first,
                facecolor="white",
                edgecolor=style.colour,
                hatch=style.hatch,
                linewidth=0.1 * self._points,
                zorder=2.5,
            )
        )
        axes.hlines(middle, left, right, color=style.colour, linewidth=0.22 * self._points, zorder=3)

    # Failures

    def _field_points(self, lines: int) -> float:
        """Return the height of the field for failures over the axes, in points; 0 without lines."""
        return (lines * 0.95 + 0.4) * self._points if lines else 0.0

    def _failed(self, axes: Any, panel: Panel) -> list[tuple[float, int, str, int]]:
        """Return the places of failures along x: series, text and line of each, none over another."""
        found = [(mark.at, mark.series, f"{mark.count:,}") for mark in _counts(panel)]
        for mark in panel.marks:
            if isinstance(mark, Dots):
                found += [(x, mark.series, "") for x in mark.x[np.isnan(mark.y)].tolist()]
        lines, placed = _TextLines(), []
        for at, series, text in sorted(found):
            half = self._letters(len(text) + 2) / 2 if text else 0.0
            share = _share(axes, at)
            placed.append((at, series, text, lines.take(share - half, share + half) if text else 0))
        return placed

    def _letters(self, count: int) -> float:
        """Return the width of small letters as a share of a panel's."""
        return count * _LETTER * 0.75 * self._points / 72 / self._room()

    def _field(
        self, axes: Any, failed: Sequence[tuple[float, int, str, int]], lines: int, *, named: bool
    ) -> None:
        """Draw the field above the axes in which failures are counted, or crossed one by one."""
        points, size = self._points, 0.75 * self._points
        moved = library("transforms").offset_copy
        gap, tall = 0.15 * points, self._field_points(lines) - 0.25 * points
        middle = moved(axes.transAxes, self.figure, 0, gap + tall / 2, units="points")
        look = {"clip_on": False, "transform": middle}
        (strip,) = axes.plot([0, 1], [1, 1], color=_FIELD, linewidth=tall, solid_capstyle="butt", **look)
        strip.set_in_layout(False)
        text = {"fontsize": size, "color": _INK, "va": "center_baseline"}
        if named:
            beside = moved(middle, self.figure, -0.5 * points, 0, units="points")
            axes.text(0, 1, "failed", transform=beside, ha="right", **text)
        for at, series, words, line in failed:
            up = gap + tall - (0.65 + 0.95 * line) * points
            share = _share(axes, at)
            place = moved(axes.transAxes, self.figure, 0, up, units="points")
            style = Style(series)
            if not words:
                cross = {"marker": "x", "markersize": 0.45 * points, "markeredgewidth": 0.11 * points}
                axes.plot([share], [1], color=style.colour, clip_on=False, transform=place, **cross)
                continue
            if series >= 0:
                aside = -0.4 * len(words) * _LETTER * points
                own = moved(place, self.figure, aside, 0, units="points")
                axes.plot([share], [1], clip_on=False, transform=own, **self._look(style))
                place = moved(place, self.figure, 0.35 * points, 0, units="points")
            axes.text(share, 1, words, transform=place, ha="center", zorder=5, **text)

    def _tiles(self, axes: Any, mark: Tiles) -> Any:
        colour = self._picture.colour
        assert colour is not None  # noqa: S101 - a picture with tiles has one
        colors = library("colors")
        limits = colour.limits
        low, high = (limits.low, limits.high) if limits is not None else (0.0, 1.0)
        large_is_good = colour.better is Better.HIGHER
        norm = (colors.LogNorm if colour.log and high > low else colors.Normalize)(low, high)
        image = axes.imshow(
            np.ma.masked_invalid(mark.values),
            cmap=colors.LinearSegmentedColormap.from_list("errors", SCALE[:: -1 if large_is_good else 1]),
            norm=norm,
            aspect="auto",
            origin="lower",
            interpolation="nearest",
        )
        axes.set_facecolor("#f2f2f2")
        axes.set_xlim(-0.5, mark.values.shape[1] - 0.5)
        axes.set_ylim(-0.5, mark.values.shape[0] - 0.5)
        letters = max((len(text) for row in mark.texts for text in row), default=1)
        room = self._beside(mark.values.shape[1])
        size = min(0.8125 * self._points, room * 72 / (letters * _LETTER))
        if size < 0.5 * self._points:
            return image
        for row, texts in enumerate(mark.texts):
            for column, text in enumerate(texts):
                value = mark.values[row, column]
                share = 0.0 if math.isnan(value) else float(norm(min(max(value, low), high)))
                axes.text(
                    column,
                    row,
                    text,
                    ha="center",
                    va="center",
                    fontsize=size,
                    color="white" if not math.isnan(value) and (share < 0.5) == large_is_good else "black",
                )
        return image

    def _scale(self, image: Any) -> None:
        colour = self._picture.colour
        assert colour is not None  # noqa: S101 - a picture with tiles has one
        limits = colour.limits
        ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
        extend = ends[bool(limits and limits.below), bool(limits and limits.above)]
        drawn = self._axes[: len(self._picture.panels)]
        bar = self.figure.colorbar(image, ax=drawn, extend=extend, pad=0.02, aspect=24, fraction=0.08)
        bar.set_label(colour.label, fontsize=self._points * 0.9375)
        ticker = library("ticker")
        if not colour.log:
            bar.locator = ticker.MaxNLocator(5)
        bar.formatter = ticker.FuncFormatter(_number)
        bar.ax.minorticks_off()
        bar.outline.set_visible(False)
        bar.update_ticks()

    # Outside

    def _outside(self, axes: Any, panel: Panel) -> None:
        """Mark what lies outside of the axes by an arrow inside their edge, with its numbers."""
        found = sorted(
            (side, self._along(axes, side, place), place, value, getattr(mark, "series", -1))
            for mark in panel.marks
            for side, place, value in _beyond(mark, self._picture)
        )
        lines: dict[str, _TextLines] = {}
        for group in _neighbours(found, self._letters(4)):
            side, share, place = group[len(group) // 2][:3]
            across = side in {"above", "below"}
            series = {number for *_, number in group}
            colour = Style(series.pop()).colour if len(series) == 1 else _INK
            at = (place, float(side == "above")) if across else (float(side == "right"), place)
            look = {"marker": _ARROWS[side], "markersize": self._points, "color": colour}
            axes.plot(*([one] for one in at), **self._at_edge(axes, side, 0.2), **look)
            text = _values_text([value for *_, value, _ in group])
            # Beside the arrow, towards the middle; a line further inside where another is in the way.
            wide = self._letters(len(text) + 2) if across else 1.5 * self._points / 72 / self._tall()
            left = across and share + wide > 1
            begin = share - wide if left else share
            line = lines.setdefault(side, _TextLines()).take(begin, begin + wide)
            if line >= (_MOST_LINES if across else 1):
                continue  # the caption tells
            # Beside the top of the axes the title stands above.
            below = side == "above" or (not across and share > _TOP)
            aside = (-0.5 if left else 0.5) if across else -0.35 if below else 0.35
            axes.text(
                *at,
                text,
                transform=self._at_edge(axes, side, 0.2 + line, aside)["transform"],
                fontsize=0.75 * self._points,
                color=_INK,
                ha="right" if left or side == "right" else "left",
                va="top" if below else "bottom",
                zorder=6,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.3, "alpha": 0.8},
            )

    def _along(self, axes: Any, side: str, place: float) -> float:
        """Return a place along an edge as a share of its length."""
        if side in {"above", "below"}:
            return _share(axes, place)
        return float((axes.transData + axes.transAxes.inverted()).transform((axes.get_xlim()[0], place))[1])

    def _tall(self) -> float:
        """Return the height of a panel with what belongs to it, in inches."""
        return float(self.figure.get_size_inches()[1]) / self._down

    def _at_edge(self, axes: Any, side: str, share: float, aside: float = 0.0) -> dict[str, Any]:
        """Return the options that place a mark inside an edge of the axes, by shares of the font's size."""
        across = side in {"above", "below"}
        edge = axes.get_xaxis_transform() if across else axes.get_yaxis_transform()
        inwards = _INWARDS[side]
        moves = (aside, share * inwards[1]) if across else (share * inwards[0], aside)
        moved = (part * self._points for part in moves)
        placed = library("transforms").offset_copy(edge, self.figure, *moved, units="points")
        return {"transform": placed, "linestyle": "none", "clip_on": False, "zorder": 6}

    def _look(self, style: Style, *, hollow: bool = False) -> dict[str, Any]:
        """Return the options that draw a mark of a series."""
        return {
            "marker": style.mark,
            "markersize": 0.5 * style.size * self._points,
            "markerfacecolor": "white" if hollow else style.colour,
            "markeredgecolor": style.colour if hollow else "white",
            "markeredgewidth": (0.1 if hollow else 0.05) * self._points,
        }

    # Legend

    def _entries(self) -> list[tuple[int, str]]:
        picture = self._picture
        used = sorted(
            {mark.series for panel in picture.panels for mark in panel.marks if not isinstance(mark, Tiles)}
            - {-1}
        )
        entries = [(-1, "ground truth")] if picture.truth else []
        if len(used) > 1 or (picture.truth and any(picture.series)):
            entries += [(number, picture.series[number]) for number in used]
        elif picture.truth:
            entries += [(number, "estimate") for number in used]
        room = self._inches / self._em - _SIGN
        letters = int(room / (_LETTER * 0.8125))
        whole = [text for _, text in entries]
        texts = told_apart(whole, letters)
        # Letters may be wider than most are.
        while (widest := self._widest(texts)) > room and letters > _FEWEST:
            letters = max(_FEWEST, min(letters - 1, int(letters * room / widest)))
            texts = told_apart(whole, letters)
        return [(number, text) for (number, _), text in zip(entries, texts, strict=True)]

    def _widest(self, texts: Iterable[str]) -> float:
        """Return the width of the widest text of a legend, over the size of letters; 0 for none."""
        letters = library("font_manager").FontProperties(size=100 * 0.8125)
        measure = library("textpath").text_to_path.get_text_width_height_descent
        return max((measure(text, letters, ismath=False)[0] / 100 for text in texts), default=0.0)

    def _legend_rows(self, inches: float) -> int:
        entries = len(self._legend) + (2 if self._picture.equal else 0)
        return math.ceil(entries / self._legend_across(inches)) + bool(self._picture.shared)

    def _legend_across(self, inches: float) -> int:
        longest = max(len(text) for _, text in self._legend)
        wide = (longest * 0.9 * _LETTER * 0.8125 + _SIGN) * self._em
        widest = (self._widest(text for _, text in self._legend) + _SIGN) * self._em
        most = int(max(inches, wide) / wide)
        while most > 1 and most * widest > inches:
            most -= 1
        return min(len(self._legend) + (2 if self._picture.equal else 0), most)

    def _write_legend(self) -> None:
        handles = [self._handle(number) for number, _ in self._legend]
        texts = [f" {text}" if text.startswith("_") else text for _, text in self._legend]
        if self._picture.equal:
            lines = library("lines")
            handles += [lines.Line2D([], [], **look) for look in self._ends_look(Style(-1))]
            texts += ["start", "end"]
        across = self._legend_across(self._inches)
        letters = int(self._inches / self._em / _LETTER)
        title = shortened(self._picture.shared, letters) or None
        self.figure.legend(
            handles, texts, loc="outside lower center", ncols=across, title=title, title_fontsize="medium"
        )

    def _handle(self, number: int) -> Any:
        """Return the sign of a series in the legend: a box, a line, a mark, or a line with marks."""
        lines, patches, style = library("lines"), library("patches"), Style(number)
        own = [
            mark
            for panel in self._picture.panels
            for mark in panel.marks
            if not isinstance(mark, MissingMark | Tiles) and mark.series == number
        ]
        if any(isinstance(mark, Box) for mark in own):
            return patches.Patch(facecolor="white", edgecolor=style.colour, hatch=style.hatch)
        curves = [mark for mark in own if isinstance(mark, Line)]
        marked = any(mark.marked for mark in curves) or any(isinstance(mark, Dots) for mark in own)
        return lines.Line2D(
            [],
            [],
            color=style.colour,
            linestyle=style.dashes if curves else "none",
            linewidth=(0.3 if number < 0 else 0.14) * self._points,
            **(self._look(style) if marked else {}),
        )


class _TextLines:
    """Lines of texts from left to right, of which none lies over another."""

    def __init__(self) -> None:
        self._ends: list[float] = []

    def take(self, begin: float, end: float) -> int:
        """Return the first line with room for a text; texts come in the order of their beginnings."""
        line = next((line for line, taken in enumerate(self._ends) if taken <= begin), len(self._ends))
        self._ends[line : line + 1] = [end]
        return line


def _counts(panel: Panel) -> list[MissingMark]:
    return [mark for mark in panel.marks if isinstance(mark, MissingMark)]


def _most_failed(panels: Sequence[Panel]) -> int:
    """Return the number of lines that failures need at least: those at one place stand below each other."""
    crosses = any(
        isinstance(mark, Dots) and np.isnan(mark.y).any() for panel in panels for mark in panel.marks
    )
    counts = (Counter(mark.at for mark in _counts(panel)) for panel in panels)
    return max((count for found in counts for count in found.values()), default=int(crosses))


def _share(axes: Any, x: float) -> float:
    """Return the place along x as a share of the axes."""
    low, high = axes.get_xlim()
    if axes.get_xscale() == "log":
        x, low, high = (math.log(max(one, low)) for one in (x, low, high))
    return float((x - low) / (high - low))


def _neighbours(found: Sequence[Any], least: float) -> Iterator[list[Any]]:
    """Go through what lies outside, sorted by edge and share along it, those beside each other together."""
    group: list[Any] = []
    for one in found:
        if group and (one[0] != group[-1][0] or one[1] - group[-1][1] > least):
            yield group
            group = []
        group.append(one)
    if group:
        yield group


def _values_text(values: Sequence[float]) -> str:
    """Return numbers outside of an axis: a few one by one, more by their count and range."""
    found = sorted(
        {_number(float(f"{value:.3g}")): value for value in sorted(values)}.items(), key=itemgetter(1)
    )
    texts = [text for text, _ in found]
    if len(texts) <= _MOST_VALUES:
        return ", ".join(texts)
    return f"{len(texts)}: {texts[0]} to {texts[-1]}"


def _beyond(mark: Mark, picture: Picture) -> Iterator[tuple[str, float, float]]:
    """Go through what of a mark lies outside of the axes: which edge, the place along it, the number."""
    held = [axis.limits if not axis.categories else None for axis in (picture.x, picture.y)]
    for x, y in _points(mark):
        if math.isnan(x) or math.isnan(y):
            continue
        for value, place, limits, along, sides in (
            (y, x, held[1], held[0], ("below", "above")),
            (x, y, held[0], held[1], ("left", "right")),
        ):
            if limits is None or limits.low <= value <= limits.high:
                continue
            inside = min(max(place, along.low), along.high) if along is not None else place
            yield sides[value > limits.high], inside, value


def _points(mark: Mark) -> Iterator[tuple[float, float]]:
    """Go through the places that a mark reaches: of each mark, each end of a bar, the peak of a line."""
    match mark:
        case Box():
            yield from ((mark.at, mark.ends[0]), (mark.at, mark.ends[-1]))
        case Line() if not mark.marked:
            yield from _peaks(mark)
        case Ranges():
            for x, ends in zip(mark.x, mark.y_ends if mark.y_ends is not None else (), strict=False):
                yield from ((float(x), float(y)) for y in ends)
            for y, ends in zip(mark.y, mark.x_ends if mark.x_ends is not None else (), strict=False):
                yield from ((float(x), float(y)) for x in ends)
        case Dots() | Line():
            bars = (mark.low, mark.high) if isinstance(mark, Line) else ()
            for y in (mark.y, *(one for one in bars if one is not None)):
                yield from zip(mark.x.tolist(), y.tolist(), strict=True)


def _peaks(mark: Line) -> list[tuple[float, float]]:
    """Return the highest place of a line: one arrow tells that it leaves the axes."""
    known = np.flatnonzero(~np.isnan(mark.y))
    if not len(known):
        return []
    top = known[np.argmax(mark.y[known])]
    return [(float(mark.x[top]), float(mark.y[top]))]


def told_apart(texts: Sequence[str], most: int) -> list[str]:
    """Return texts of at most some length, long ones without the beginning that all of them share.

    Those that would be alike all the same have their beginning and the words in which they differ.
    """
    found = [shortened(text, most) for text in texts]
    if _differ(texts, found):
        return found
    long = [text for text, short in zip(texts, found, strict=True) if text != short]
    same = _shared(long)
    cut = [shortened(f"…{text[same:]}" if text in long else text, most) for text in texts]
    if _differ(texts, cut):
        return cut
    alike = {short: list(dict.fromkeys(compress(texts, map(short.__eq__, found)))) for short in found}
    return [
        short if len(alike[short]) == 1 else _by_difference(text, alike[short], most)
        for text, short in zip(texts, found, strict=True)
    ]


def _differ(texts: Sequence[str], short: Sequence[str]) -> bool:
    """Tell whether texts that differ do so when they are short."""
    return len(set(short)) == len(set(texts))


def _shared(texts: Sequence[str]) -> int:
    """Return the number of letters that texts begin with alike."""
    return sum(1 for _ in takewhile(lambda letters: len(set(letters)) == 1, zip(*texts, strict=False)))


def _by_difference(text: str, alike: Sequence[str], most: int) -> str:
    """Return the beginning of a text, and the whole words in which it differs from others."""
    front = text.rfind(" ", 0, _shared(alike)) + 1
    end = len(text) - _shared([one[front:][::-1] for one in alike])
    while end < len(text) and text[end] not in " ,":
        end += 1
    middle = shortened(text[front:end], most - 2)
    begin = text[: min(front, most - 2 - len(middle))].rstrip()
    return f"{begin}…{middle}{'…' if end < len(text) else ''}"


def _in_lines(text: str, most: int) -> str:
    """Return a text in two lines of at most some length, cut where that is too little."""
    if len(text) <= most:
        return text
    found = textwrap.wrap(text, most)
    return "\n".join(
        found if len(found) <= 2 else (text[:most].rstrip(), shortened(text[most:].lstrip(), most))
    )


def _wrapped(text: str, inches: float, points: float) -> str:
    """Return a text in lines of at most some length."""
    return "\n".join(textwrap.wrap(text, max(8, int(inches * 72 / (points * _LETTER))))) or text


def _number(value: float, _: int | None = None) -> str:
    """Return a number beside an axis."""
    if value and not 1e-4 <= abs(value) < 1e6:
        mantissa, power = f"{value:.2e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".")
        power = f"10{str(int(power)).translate(_RAISED)}"
        return power if mantissa == "1" else f"{mantissa}·{power}".replace("-", "−")
    return f"{value:.6f}".rstrip("0").rstrip(".").replace("-", "−")
