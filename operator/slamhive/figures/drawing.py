# SPDX-License-Identifier: Apache-2.0
"""Drawing of pictures by matplotlib: sizes, axes, marks, and marks for what lies outside of the axes."""

from __future__ import annotations

import math
import textwrap
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.figures.pictures import Box, Dots, Line, MissingMark, PictureAxis, Ranges, Tiles
from slamhive.figures.styles import SCALE, Style
from slamhive.figures.widths import MM
from slamhive.model import extras

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.figures.pictures import Mark, Panel, Picture
    from slamhive.figures.widths import Width


_NARROW = 5.4
"""Width of a panel in letters' heights × 2.54 below which panels begin a new line."""

_MOST_ACROSS = 4
_LETTER = 0.56
"""Width of a letter over its height, about."""

_SHAPE = 0.74
_WIDE = 50.0
_ALONE = {False: 0.58, True: 0.42}
"""Height over width of a panel by itself, and of one that is wider than 50 letters are high."""

_ARROWS = {"left": 8, "right": 9, "above": 10, "below": 11}
"""Matplotlib's carets whose base lies at their place."""

_INWARDS = {"left": (1, 0), "right": (-1, 0), "above": (0, -1), "below": (0, 1)}
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
        grid = self.figure.subplots(down, self._across, squeeze=False, sharex=share, sharey=share)
        self._axes = list(chain(*grid))

    def draw(self) -> Any:
        """Draw all of it; returns the figure."""
        picture = self._picture
        for axes in self._axes[len(picture.panels) :]:
            axes.remove()
        tiles = None
        for number, (axes, panel) in enumerate(zip(self._axes, picture.panels, strict=False)):
            self._prepare(axes, number)
            for mark in panel.marks:
                made = self._draw(axes, mark)
                tiles = made if made is not None else tiles
            self._missing(axes, [mark for mark in panel.marks if isinstance(mark, MissingMark)])
            self._name(axes, panel)
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
        titles = 1.4 * em * self._down if any(panel.title for panel in picture.panels) else 0.0
        return self._down * tall + room + titles + legend

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
        return [shortened(text, most) for text in axis.categories]

    def _room(self) -> float:
        """Return the width of a panel without the numbers beside it, in inches."""
        return self._inches / self._across * (0.74 if self._picture.apart else 0.84)

    # Axes

    def _prepare(self, axes: Any, number: int) -> None:
        picture = self._picture
        axes.set_axisbelow(True)
        for side, axis in (("x", picture.x), ("y", picture.y)):
            self._prepare_axis(axes, side, axis)
        for place in ("top", "right"):
            axes.spines[place].set_visible(picture.colour is not None)
        if picture.equal:
            axes.set_aspect("equal", adjustable="datalim")
        if not picture.apart:
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
                texts,
                **({"rotation": 35, "ha": "right", "rotation_mode": "anchor"} if turned else {}),
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
            own.set_major_locator(ticker.LogLocator(subs=subs, numticks=12))
            own.set_minor_locator(ticker.LogLocator(subs=tuple(range(2, 10)), numticks=50))
            own.set_minor_formatter(ticker.NullFormatter())
            if decades < 0.5:
                own.set_major_locator(ticker.MaxNLocator(4))
        else:
            own.set_major_locator(ticker.MaxNLocator(4 if self._across > 2 else 5))
        own.set_major_formatter(ticker.FuncFormatter(_number))

    def _ends(self, axis: PictureAxis, side: str) -> tuple[float, float]:
        """Return the ends of an axis: what it has to hold, and some air."""
        limits = axis.limits
        assert limits is not None  # noqa: S101 - the caller looked
        low, high = limits.low, limits.high
        marks = [mark for panel in self._picture.panels for mark in panel.marks]
        head = 0.12 if side == "y" and any(isinstance(mark, MissingMark) for mark in marks) else 0.05
        if axis.ends is not None:
            return low, high + 0.03 * (high - low)
        if axis.log:
            air = (high / low) ** 0.05 if high > low else 1.5
            return low / air, high * (high / low) ** head if high > low else high * 1.5
        if high == low:
            half = abs(high) / 2 or 0.5
            return low - half, high + half
        curves = side == "x" and all(isinstance(mark, Line) and not mark.marked for mark in marks)
        if 0 <= low < (0.6 if side == "y" else 0.1 if curves else 0.0) * high or low == 0:
            below = 0.0
        else:
            below = low if curves else low - 0.05 * (high - low)
        return below, high + (0.01 if curves else head) * (high - below)

    def _name(self, axes: Any, panel: Panel) -> None:
        if panel.title:
            letters = max(8, int(self._room() / (self._points * 0.875 * _LETTER / 72)))
            axes.set_title(shortened(panel.title, letters), pad=0.35 * self._points)

    def _labels(self) -> None:
        """Name the axes of the outer panels; a long name takes several lines."""
        picture, size = self._picture, self._points * 0.9375
        count = len(picture.panels)
        wide = self._room()
        tall = self.figure.get_size_inches()[1] / self._down * (0.6 if self._legend else 0.8)
        for number, axes in enumerate(self._axes[:count]):
            if picture.apart or number + self._across >= count:
                axes.set_xlabel(_wrapped(picture.x.label, wide, size), fontsize=size)
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
        axes.plot(
            mark.x,
            mark.y,
            color=style.colour,
            linestyle=style.dashes,
            linewidth=wide * self._points,
            **(self._look(style) if mark.marked else {}),
            drawstyle="steps-post" if mark.steps else "default",
            alpha=0.75 if mark.thin else None,
            zorder=order,
        )

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

    def _missing(self, axes: Any, marks: Sequence[MissingMark]) -> None:
        """Write numbers of runs without a figure above their places, in as many lines as they need."""
        size = 0.75 * self._points
        low, high = axes.get_xlim()
        transform = axes.get_xaxis_transform()
        log = axes.get_xscale() == "log"
        ends: list[float] = []
        tall = self.figure.get_size_inches()[1] / self._down * 0.7
        for mark in sorted(marks, key=lambda mark: mark.at):
            text = f"{mark.count}×"
            share = math.log(mark.at / low) / math.log(high / low) if log else (mark.at - low) / (high - low)
            half = len(text) * 0.8 * size / 72 / self._room() / 2
            line = next((line for line, end in enumerate(ends) if end <= share - half), len(ends))
            ends[line : line + 1] = [share + half]
            axes.text(
                mark.at,
                0.99 - line * 1.25 * size / 72 / tall,
                text,
                transform=transform,
                ha="center",
                va="top",
                fontsize=size,
                color=Style(mark.series).colour if mark.series >= 0 else "#404040",
                zorder=5,
            )

    def _tiles(self, axes: Any, mark: Tiles) -> Any:
        colour = self._picture.colour
        assert colour is not None  # noqa: S101 - a picture with tiles has one
        colors = library("colors")
        limits = colour.limits
        low, high = (limits.low, limits.high) if limits is not None else (0.0, 1.0)
        norm = (colors.LogNorm if colour.log and high > low else colors.Normalize)(low, high)
        image = axes.imshow(
            np.ma.masked_invalid(mark.values),
            cmap=SCALE,
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
                dark = not math.isnan(value) and float(norm(min(max(value, low), high))) < 0.5
                axes.text(
                    column,
                    row,
                    text,
                    ha="center",
                    va="center",
                    fontsize=size,
                    color="white" if dark else "black",
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
        """Mark what lies outside of the axes at their edge: by an arrowhead, and its own mark before that.

        Both lie inside: above the edge is the title.
        """
        for mark in panel.marks:
            style = Style(getattr(mark, "series", -1))
            marked = isinstance(mark, Dots | Box) or (isinstance(mark, Line) and mark.marked)
            for x, y, side in _beyond(mark, self._picture):
                arrow = {"marker": _ARROWS[side], "markersize": 0.55 * self._points, "color": style.colour}
                axes.plot([x], [y], **self._at_edge(axes, side, 0.3), **arrow)
                if marked:
                    hollow = isinstance(mark, Dots) and bool(mark.hollow) and all(mark.hollow)
                    axes.plot([x], [y], **self._at_edge(axes, side, 0.8), **self._look(style, hollow=hollow))

    def _at_edge(self, axes: Any, side: str, share: float) -> dict[str, Any]:
        """Return the options that place a mark inside an edge of the axes, by a share of the font's size."""
        across = side in {"above", "below"}
        edge = axes.get_xaxis_transform() if across else axes.get_yaxis_transform()
        moves = (share * part * self._points for part in _INWARDS[side])
        placed = library("transforms").offset_copy(edge, self.figure, *moves, units="points")
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
        return entries

    def _legend_rows(self, inches: float) -> int:
        return math.ceil(len(self._legend) / self._legend_across(inches))

    def _legend_across(self, inches: float) -> int:
        longest = max(len(text) for _, text in self._legend)
        wide = (longest * 0.9 * _LETTER * 0.8125 + 3.4) * self._em
        return max(1, min(len(self._legend), int(inches / wide)))

    def _write_legend(self) -> None:
        handles = [self._handle(number) for number, _ in self._legend]
        texts = [f" {text}" if text.startswith("_") else text for _, text in self._legend]
        across = self._legend_across(self._inches)
        self.figure.legend(handles, texts, loc="outside lower center", ncols=across)

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


def _beyond(mark: Mark, picture: Picture) -> Iterator[tuple[float, float, str]]:
    """Go through what of a mark lies outside of the axes: its place on the edge, and which edge."""
    if isinstance(mark, Tiles | MissingMark):
        return
    if isinstance(mark, Box):
        points = [(mark.at, float(value)) for value in mark.values] if len(mark.values) > 60 else []
    elif isinstance(mark, Line) and not mark.marked:
        points = _peaks(mark)
    else:
        points = list(zip(mark.x.tolist(), mark.y.tolist(), strict=True))
    seen = set()
    for x, y in points:
        if math.isnan(x) or math.isnan(y):
            continue
        for place, limits, signs in (
            (x, picture.y.limits if not picture.y.categories else None, ("below", "above")),
            (y, picture.x.limits if not picture.x.categories else None, ("left", "right")),
        ):
            value = y if signs[0] == "below" else x
            if limits is None or limits.low <= value <= limits.high:
                continue
            sign = signs[0] if value < limits.low else signs[1]
            spot = (place, float(sign in {"above", "right"}))
            if (*spot, sign) in seen:
                continue
            seen.add((*spot, sign))
            yield (spot[0], spot[1], sign) if signs[0] == "below" else (spot[1], spot[0], sign)


def _peaks(mark: Line) -> list[tuple[float, float]]:
    """Return the highest place of a line: one mark tells that it leaves the axes."""
    known = np.flatnonzero(~np.isnan(mark.y))
    if not len(known):
        return []
    top = known[np.argmax(mark.y[known])]
    return [(float(mark.x[top]), float(mark.y[top]))]


def shortened(text: str, most: int) -> str:
    """Return a text without its middle where it is long: names often differ at their ends."""
    if len(text) <= most:
        return text
    end = (most - 1) // 2
    return f"{text[: most - 1 - end].rstrip()}…{text[len(text) - end :].lstrip()}"


def _wrapped(text: str, inches: float, points: float) -> str:
    """Return a text in lines of at most some length."""
    return "\n".join(textwrap.wrap(text, max(8, int(inches * 72 / (points * _LETTER))))) or text


def _number(value: float, _: int | None = None) -> str:
    """Return a number beside an axis."""
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.3g}"
    return f"{value:.6f}".rstrip("0").rstrip(".").replace("-", "−")
