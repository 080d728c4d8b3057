# SPDX-License-Identifier: Apache-2.0
"""Robustness card as a picture: a row for each system, a panel for each axis, and how far each goes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.analysis.metrics import label_of
from slamhive.analysis.searches.robustness import robustness
from slamhive.analysis.searches.thresholds import ThresholdStatus
from slamhive.figures.asking import check_categories
from slamhive.figures.pictures import Panel, Picture, PictureAxis, Reach
from slamhive.reporting.titles import keys_text

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.searches.robustness import RobustnessCard, RobustnessWish
    from slamhive.analysis.searches.thresholds import Threshold


def reaches(frame: Frame, wish: RobustnessWish) -> Picture:
    """Return the picture of the robustness card of some runs."""
    return card_picture(robustness(frame, wish))


def card_picture(card: RobustnessCard) -> Picture:
    """Return the picture of a robustness card."""
    check_categories("by", "the systems", len(card.rows))
    names = tuple(keys_text(key) for key in card.rows)
    panels = tuple(_panel(card, place) for place in range(len(card.axes)))
    first = panels[0].x or PictureAxis("")
    return Picture(
        x=first,
        y=PictureAxis("", categories=names[::-1]),
        panels=panels,
        series=(),
        notes=card.notes,
        columns=card.columns(),
        runs=card.runs,
    )


def _panel(card: RobustnessCard, place: int) -> Panel:
    cells = [row[place] for row in card.cells]
    tried = [one.value for cell in cells if cell is not None for one in cell.tallies]
    # What never fails has no direction of its own: it takes that of the others.
    falling = [cell.falls for cell in cells if cell is not None and cell.falls is not None]
    falls = falling.count(True) > falling.count(False)
    marks = [
        Reach(len(cells) - 1 - row, min(tried), min(tried), text="not run")
        if cell is None
        else _reach(cell, len(cells) - 1 - row, falls=falls)
        for row, cell in enumerate(cells)
    ]
    axis = PictureAxis(label_of(card.axes[place]), robust=False, ends=(min(tried), max(tried)))
    return Panel("", tuple(marks), axis)


def _reach(cell: Threshold, row: int, *, falls: bool) -> Reach:
    tried = [one.value for one in cell.tallies]
    falls = falls if cell.falls is None else cell.falls
    start, end = (tried[-1], tried[0]) if falls else (tried[0], tried[-1])
    shares = tuple((one.value, one.share) for one in cell.tallies if one.known)
    match cell.status:
        case ThresholdStatus.FOUND:
            passing = start if cell.passing is None else cell.passing
            text = f"{cell.counted(cell.passing)} | {cell.counted(cell.failing)}"
            return Reach(row, start, passing, cell.failing, sure=cell.sure, text=text)
        case ThresholdStatus.NEVER:
            return Reach(row, start, end, is_open=True, text=f"never, {cell.counted(end)}")
        case ThresholdStatus.NO_EFFECT:
            return Reach(row, start, end, is_open=True, text=f"no effect seen, {cell.counted(end)}")
        case ThresholdStatus.ALWAYS:
            return Reach(row, start, start, start, text=f"always, {cell.counted(start)}")
        case ThresholdStatus.NOT_MONOTONE:
            return Reach(row, start, start, text="not monotone", shares=shares)
    return Reach(row, start, start, text="unknown")
