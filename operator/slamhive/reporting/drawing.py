# SPDX-License-Identifier: Apache-2.0
"""Charts as SVG, drawn here so that the page needs no script: axes, marks, ranges, lines.

Colours are classes (``c0`` to ``c5``), which the style sheet gives a value for light, dark and print; marks
differ in shape as well, for colour-blind eyes and grey prints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from slamhive.reporting.markup import Markup, clip, element, joined, shortened

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from slamhive.reporting.scales import Scale

WIDTH = 460
"""Of a chart in its own units: on a telephone its letters are still read."""

COLOURS = 6
SHAPES = 5
BAND = 26
"""Height of the band for failed runs."""

_SIZE = 4.5
_LETTER = 6.4


@dataclass
class SvgDrawing:
    """A chart that grows.

    Attributes:
        title: what it shows, for those who don't see it.
        height: in the chart's units.
        parts: what was drawn.
    """

    title: str
    height: float
    width: float = WIDTH
    parts: list[Markup] = field(default_factory=list)

    def svg(self) -> Markup:
        """Return the chart."""
        return element(
            "svg",
            *self.parts,
            viewBox=f"0 0 {self.width:g} {self.height:g}",
            role="img",
            aria_label=clip(self.title, 400),
        )

    def text(
        self, x: float, y: float, text: str, *, anchor: str = "start", class_: str | None = None
    ) -> None:
        """Write a line."""
        self.parts.append(element("text", text, x=_n(x), y=_n(y), text_anchor=anchor, class_=class_))

    def line(self, begin: tuple[float, float], end: tuple[float, float], class_: str) -> None:
        """Draw a straight line."""
        (x1, y1), (x2, y2) = begin, end
        self.parts.append(element("line", x1=_n(x1), y1=_n(y1), x2=_n(x2), y2=_n(y2), class_=class_))

    def path(self, points: Sequence[tuple[float, float]], class_: str) -> None:
        """Draw a line through points."""
        if len(points) > 1:
            way = "M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in points)
            self.parts.append(element("path", d=way, class_=f"curve {class_}"))

    def mark(self, x: float, y: float, style: SeriesStyle, title: str, *, hollow: bool = False) -> None:
        """Draw a mark with a sentence that shows when it is pointed at."""
        self.parts.append(
            element(
                "path",
                element("title", title),
                d=_shape(x, y, style.shape),
                class_=f"mark {style.colour}{' hollow' if hollow else ''}",
            )
        )

    def cross(self, x: float, y: float, style: SeriesStyle, title: str) -> None:
        """Draw the mark of a failure."""
        way = f"M{_n(x - 4)} {_n(y - 4)}l8 8m0 -8l-8 8"
        self.parts.append(element("path", element("title", title), d=way, class_=f"cross {style.colour}"))

    def x_axis(self, scale: Scale, top: float, bottom: float, title: str) -> None:
        """Draw rules, those of their numbers that have room, and the axis' name beneath."""
        taken = -math.inf
        for tick in scale.ticks:
            x = scale.at(tick)
            self.line((x, top), (x, bottom), "rule")
            half = (len(scale.label(tick)) + 1) * _LETTER / 2
            if x - half > taken:
                taken = x + half
                self.text(x, bottom + 15, scale.label(tick), anchor="middle")
        self.text((scale.begin + scale.end) / 2, bottom + 32, clip(title, 60), anchor="middle", class_="name")

    def y_axis(self, scale: Scale, left: float, right: float, title: str) -> None:
        """Draw rules, their numbers and the axis' name above."""
        for tick in scale.ticks:
            y = scale.at(tick)
            self.line((left, y), (right, y), "rule")
            self.text(left - 6, y + 4, scale.label(tick), anchor="end")
        self.text(4, 12, clip(title, 60), class_="name")

    def band(self, x: float, y: float, width: float, height: float) -> None:
        """Draw the ground on which failed runs stand."""
        self.parts.append(
            element("rect", x=_n(x), y=_n(y), width=_n(width), height=_n(height), class_="failed")
        )

    def dot(self, x: float, y: float, style: SeriesStyle) -> None:
        """Draw one run of several."""
        self.parts.append(element("circle", cx=_n(x), cy=_n(y), r="1.8", class_=f"dot {style.colour}"))


@dataclass(frozen=True)
class SeriesStyle:
    """Colour and shape of the marks of one series."""

    number: int

    @property
    def colour(self) -> str:
        """Class of its colour."""
        return f"c{self.number % COLOURS}"

    @property
    def shape(self) -> int:
        """Number of its shape."""
        return (self.number + self.number // COLOURS) % SHAPES


def legend(names: Sequence[str], only: Container[str] | None = None) -> Markup:
    """Return the legend of marks.

    Args:
        names: in the order of their styles.
        only: those that are drawn; None for all.
    """
    items = []
    for number, name in enumerate(names):
        if only is not None and name not in only:
            continue
        drawing = SvgDrawing(name, 16, 20)
        drawing.mark(10, 8, SeriesStyle(number), name)
        sign = element("svg", *drawing.parts, viewBox="0 0 20 16", aria_hidden="true")
        items.append(element("li", sign, clip(name, 80)))
    return element("ul", joined(items), class_="legend")


def cut(text: str, width: float) -> str:
    """Return as much of a text as about fits into a width: its beginning and end."""
    return shortened(text, max(4, int(width / _LETTER)))


def _shape(x: float, y: float, shape: int) -> str:
    s = _SIZE
    match shape:
        case 0:
            return f"M{_n(x - s)} {_n(y)}a{s} {s} 0 1 0 {2 * s} 0a{s} {s} 0 1 0 {-2 * s} 0z"
        case 1:
            return f"M{_n(x - s + 0.5)} {_n(y - s + 0.5)}h{2 * s - 1}v{2 * s - 1}h{1 - 2 * s}z"
        case 2:
            return f"M{_n(x)} {_n(y - s - 1)}l{s + 0.5} {2 * s}h{-2 * s - 1}z"
        case 3:
            return f"M{_n(x)} {_n(y - s - 1)}l{s + 1} {s + 1}l{-s - 1} {s + 1}l{-s - 1} {-s - 1}z"
        case _:
            return f"M{_n(x)} {_n(y + s + 1)}l{s + 0.5} {-2 * s}h{-2 * s - 1}z"


def _n(number: float) -> str:
    return f"{number:.1f}".removesuffix(".0")
