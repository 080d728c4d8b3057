# SPDX-License-Identifier: Apache-2.0
"""Styles of series that colour-blind eyes and grey prints tell apart: colour, mark and dashes all differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from slamhive.model.base import Choice

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#000000")
"""Okabe and Ito 2008, as on pages and in reports: for colour-blind eyes; neighbours differ as greys too."""

MARKS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "h", "*", "p")
_SIZES = (1.0, 0.95, 1.1, 0.9, 1.1, 1.25, 1.25, 1.1, 1.1, 1.15, 1.7, 1.2)
"""Shapes of equal size to the eye."""

DASHES: tuple[Any, ...] = (
    "-",
    (0, (4, 1.5)),
    (0, (1, 1)),
    (0, (5, 1.5, 1, 1.5)),
    (0, (7, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)
HATCHES = ("", "////", "....", "xxxx", "\\\\\\\\", "----", "oo")
ASIDE = "#8c8c8c"
"""Of what is no series: ground truth, a front."""

SCALE = ("#d6c35d", "#aa9f71", "#7d7c78", "#535b6d", "#243c6e")
"""Of heat maps, dark is worse: cividis without its ends, for colour-blind eyes too, as on all pages."""


@dataclass(frozen=True)
class Style:
    """Colour, marks, dashes and hatching of a series in a figure; no two of the first 84 are alike.

    Attributes:
        number: of the series.
    """

    number: int

    @property
    def colour(self) -> str:
        """Colour of its marks and lines."""
        return COLOURS[self.number % len(COLOURS)] if self.number >= 0 else ASIDE

    @property
    def mark(self) -> str:
        """Shape of its marks."""
        return MARKS[self.number % len(MARKS)]

    @property
    def size(self) -> float:
        """Size of its marks over that of a disc."""
        return _SIZES[self.number % len(_SIZES)]

    @property
    def dashes(self) -> Any:
        """Dashes of its lines."""
        return DASHES[self.number % len(DASHES)] if self.number >= 0 else "-"

    @property
    def hatch(self) -> str:
        """Hatching of its boxes."""
        return HATCHES[self.number % len(HATCHES)]


class Face(Choice):
    """Fonts of a figure; all come with matplotlib, so that a figure is the same everywhere."""

    SANS = "sans"
    SERIF = "serif"

    @property
    def families(self) -> list[str]:
        """Fonts, each for what those before it lack."""
        return ["DejaVu Sans"] if self is Face.SANS else ["STIXGeneral", "DejaVu Serif", "DejaVu Sans"]


def settings(points: float, face: Face) -> dict[str, Any]:
    """Return matplotlib's settings: fonts embedded whole as TrueType, names never taken for formulas.

    Args:
        points: size of letters.
        face: which letters.
    """
    return {
        "pdf.fonttype": 42,
        "svg.fonttype": "path",
        "svg.hashsalt": "slamhive",
        "text.parse_math": False,
        "font.family": face.families,
        "font.size": points * 0.875,
        "axes.titlesize": points * 0.875,
        "axes.labelsize": points * 0.9375,
        "legend.fontsize": points * 0.8125,
        "xtick.labelsize": points * 0.8125,
        "ytick.labelsize": points * 0.8125,
        "axes.linewidth": 0.075 * points,
        "axes.edgecolor": "#404040",
        "axes.unicode_minus": True,
        "xtick.major.width": 0.075 * points,
        "ytick.major.width": 0.075 * points,
        "xtick.minor.width": 0.05 * points,
        "ytick.minor.width": 0.05 * points,
        "xtick.major.size": 0.35 * points,
        "ytick.major.size": 0.35 * points,
        "xtick.minor.size": 0.2 * points,
        "ytick.minor.size": 0.2 * points,
        "grid.color": "#dddddd",
        "grid.linewidth": 0.06 * points,
        "lines.linewidth": 0.14 * points,
        "lines.markersize": 0.5 * points,
        "hatch.linewidth": 0.05 * points,
        "patch.linewidth": 0.1 * points,
        "legend.frameon": False,
        "legend.handlelength": 2.2,
        "legend.columnspacing": 1.1,
        "legend.handletextpad": 0.5,
        "legend.labelspacing": 0.35,
        "legend.borderaxespad": 0.2,
    }
