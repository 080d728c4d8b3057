# SPDX-License-Identifier: Apache-2.0
"""Widths of columns and pages that figures are made for, so that their letters come out as large as meant."""

from __future__ import annotations

import re
from typing import NamedTuple

from slamhive.model.errors import InputError, suggestion

MM = 25.4
"""Millimetres of an inch."""

NARROWEST, WIDEST = 40.0, 1000.0
"""Widths in mm between which a figure can be read, or printed."""

_PAPER, _SLIDE = 8.0, 16.0
_MEASURE = re.compile(r"(\d+(?:\.\d+)?|\.\d+)\s*(mm|cm|in|pt)")
_IN_MM = {"mm": 1.0, "cm": 10.0, "in": MM, "pt": MM / 72.27}


class Width(NamedTuple):
    """A width, and how large letters are on it.

    Attributes:
        millimetres: the width.
        points: size of its letters.
    """

    millimetres: float
    points: float

    @property
    def inches(self) -> float:
        """The width as matplotlib counts it."""
        return self.millimetres / MM


WIDTHS = {
    "ieee-column": Width(88.9, _PAPER),
    "ieee-page": Width(181.9, _PAPER),
    "springer": Width(122.0, _PAPER),
    "springer-column": Width(84.0, _PAPER),
    "springer-page": Width(174.0, _PAPER),
    "slide": Width(254.0, _SLIDE),
}
"""By name: IEEE 3.5 and 7.16 in; Springer's proceedings 122 mm, its journals 84 and 174; a slide 10 in."""


def parse_width(text: str) -> Width:
    """Read a name of ``WIDTHS``, or a measure such as ``88mm``.

    Raises:
        InputError: it is neither, or nothing that could be read or printed.
    """
    if text in WIDTHS:
        return WIDTHS[text]
    match = _MEASURE.fullmatch(text.strip())
    if match is None:
        near = suggestion(text[:60], WIDTHS)
        raise InputError(f"{text[:60]!r} is neither a measure such as 88mm, 3.5in nor a name{near}", "width")
    millimetres = float(match[1]) * _IN_MM[match[2]]
    if not NARROWEST <= millimetres <= WIDEST:
        raise InputError(f"{text}: a figure is {NARROWEST:g} to {WIDEST:g} mm wide", "width")
    return Width(millimetres, _PAPER)


def parse_height(text: str) -> float:
    """Read a height in mm: ``60mm``.

    Raises:
        InputError: it is none that could be read or printed.
    """
    match = _MEASURE.fullmatch(text.strip())
    millimetres = float(match[1]) * _IN_MM[match[2]] if match else 0.0
    if not NARROWEST / 2 <= millimetres <= WIDEST:
        raise InputError(
            f"{text[:60]!r}: expected {NARROWEST / 2:g}mm to {WIDEST:g}mm, as mm, cm, in or pt", "height"
        )
    return millimetres
