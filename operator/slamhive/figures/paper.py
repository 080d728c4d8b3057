# SPDX-License-Identifier: Apache-2.0
"""Paper that figures are drawn on: width, height, letters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.figures.styles import Face

if TYPE_CHECKING:
    from slamhive.figures.widths import Width


@dataclass(frozen=True)
class Paper:
    """Size and font of a figure for a paper.

    Attributes:
        width: of the figure, with the size of its letters.
        height: in mm; None for what suits it.
        face: which letters.
    """

    width: Width
    height: float | None = None
    face: Face = Face.SANS
