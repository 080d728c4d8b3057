# SPDX-License-Identifier: Apache-2.0
"""Drawing of how far something goes along an axis: a bar, its interval, and what was counted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.figures.styles import COLOURS

if TYPE_CHECKING:
    from slamhive.figures.pictures import Reach

_BAR = COLOURS[5]
_EDGE = COLOURS[0]
_FAILS = COLOURS[4]
_INK = "#404040"
_HALF = 0.19
_LOW = 0.14
"""Distance of a bar below the middle of its row, whose counts stand above it."""


def draw_reach(axes: Any, mark: Reach, points: float) -> None:
    """Draw a bar to the last value that passes, a cross at the first that fails, and a whisker between which.

    Args:
        axes: of matplotlib, its limits set.
        mark: what is drawn.
        points: size of letters.
    """
    low, high = axes.get_xlim()
    middle = mark.row - _LOW
    line = 0.1 * points
    if mark.end != mark.start:
        axes.barh(
            middle, mark.end - mark.start, 2 * _HALF, left=mark.start, color=_BAR, linewidth=0, zorder=2
        )
    cross = {"marker": "x", "color": _FAILS, "markersize": 0.55 * points, "markeredgewidth": 0.14 * points}
    if mark.failing is not None:
        axes.plot([mark.failing], [middle], linestyle="none", zorder=5, clip_on=False, **cross)
    if mark.sure is not None:
        ends = (low if mark.sure[0] is None else mark.sure[0], high if mark.sure[1] is None else mark.sure[1])
        for end, known in zip(ends, (one is not None for one in mark.sure), strict=True):
            if known:
                axes.vlines(end, middle - 0.1, middle + 0.1, color=_EDGE, linewidth=line, zorder=4)
        axes.hlines(middle, *ends, color=_EDGE, linewidth=line, zorder=4)
    if mark.is_open:
        axes.plot(
            [mark.end],
            [middle],
            marker=">" if mark.end >= mark.start else "<",
            color=_EDGE,
            markersize=0.75 * points,
            clip_on=False,
            zorder=5,
        )
    for value, share in mark.shares:
        look = cross if share >= 0.5 else {"marker": "o", "color": _EDGE, "markersize": 0.45 * points}
        axes.plot([value], [middle], linestyle="none", zorder=5, clip_on=False, **look)
    _write(axes, mark, points)


def _write(axes: Any, mark: Reach, points: float) -> None:
    """Write the counts above the end of the bar, inside of the axes."""
    transform, back = axes.transData, axes.transAxes.inverted()
    share = float(back.transform(transform.transform((mark.end, mark.row)))[0])
    aligned = "left" if share < 0.3 else "right" if share > 0.7 else "center"
    axes.annotate(
        mark.text,
        (mark.end, mark.row + _HALF - _LOW + 0.04),
        (0.35 * points if share < 0.05 else 0, 0),
        textcoords="offset points",
        fontsize=0.72 * points,
        color=_INK,
        ha=aligned,
        va="bottom",
        zorder=6,
    )
