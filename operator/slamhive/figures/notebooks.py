# SPDX-License-Identifier: Apache-2.0
"""Figures of data frames, as `slamhive.results().figure("lines", x="nFeatures")` draws them in a notebook."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis import Outcomes
from slamhive.figures.asking import FigureKind, Log, Wish
from slamhive.figures.drawing import Drawing, library
from slamhive.figures.making import picture
from slamhive.figures.styles import Face, settings
from slamhive.figures.widths import parse_height, parse_width
from slamhive.model.base import Choice
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.reporting.dataframes import source
from slamhive.reporting.papertables import Statistic

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.local.home.folder import Home
    from slamhive.tables.homes import Beside

_ROWS = ("id", "evaluation")
"""Columns by which a row of a data frame is found again."""

pandas: Any = importlib.import_module("pandas")


@pandas.api.extensions.register_dataframe_accessor("figure")
class Figures:
    """Draws the runs of a data frame that `slamhive.results` returned, or of some of its rows.

    Args:
        frame: the data frame, with its columns `id` and `evaluation`.
    """

    def __init__(self, frame: Any) -> None:
        self._frame = frame

    def __call__(
        self,
        kind: str,
        x: str | None = None,
        y: str | None = None,
        by: str | None = None,
        facet: str | None = None,
        *,
        width: str = "ieee-page",
        height: str | None = None,
        font: str = "sans",
        log: str = "auto",
        limits: str = "robust",
        statistic: str = "median",
        outcomes: str = "tracked",
        each: bool = False,
    ) -> Any:
        """Return a figure of matplotlib; what is averaged and left out is its attribute `caption`.

        The arguments are the options of `slamhive figure`.

        Args:
            kind: such as `scatter`, `lines`, `box`, `pareto` or `ecdf`.
            x: column along x, such as `input.frameRate`.
            y: column along y, such as `ate.rmse:cm`.
            by: columns that tell series apart, joined by commas.
            facet: columns that tell panels apart, joined by commas.
            width: `ieee-column`, `ieee-page`, `springer`, `slide`, or a measure such as `88mm`.
            height: such as `60mm`; by default what suits it.
            font: `sans` or `serif`.
            log: logarithmic axes: `auto`, `x`, `y`, `xy` or `none`.
            limits: `robust` leaves a few numbers far out outside of the axes, marked; `all` none.
            statistic: `median` or `mean`.
            outcomes: which runs count: `tracked` or `all`.
            each: every run's path, error or usage, not one a series.

        Raises:
            slamhive.model.errors.InputError: it can't be drawn; the sentence says why.
        """
        wish = Wish(
            _choice(FigureKind, "kind", kind),
            x,
            y,
            by,
            facet,
            _choice(Outcomes, "outcomes", outcomes),
            _choice(Statistic, "statistic", statistic),
            _choice(Log, "log", log),
            {"robust": True, "all": False}[str(_choice(_AxisLimits, "limits", limits))],
            each,
        )
        size, face = parse_width(width), _choice(Face, "font", font)
        tall = None if height is None else parse_height(height)
        rows, home, others = self._source()
        made = picture(rows, wish, home, others)
        with library("").rc_context(settings(size.points, face)):
            figure = Drawing(made, size, tall).draw()
        figure.caption = ". ".join((*made.notes, ""))
        return figure

    def _source(self) -> tuple[Frame, Home, Sequence[Beside]]:
        """Return the rows of the archive's table that the data frame has, each once, and the homes."""
        found = source(self._frame)
        if found is None:
            sentence = "not a data frame that slamhive.results() returned here: call it (again)"
            raise InputError(f"figure: {sentence}")
        whole, home, others = found
        missing = [name for name in _ROWS if name not in self._frame.columns]
        if missing:
            sentence = f"needs the columns {' and '.join(_ROWS)}, of which {missing[0]!r} is gone"
            raise InputError(f"figure: {sentence}")
        # Failed runs have no evaluation: nothing that is missing equals nothing else that is.
        rows = self._frame[list(_ROWS)].itertuples(index=False)
        here = {(int(number), _text(name)) for number, name in rows}
        columns = (whole.column(name).tolist() for name in _ROWS)
        kept = [(int(number), _text(name)) in here for number, name in zip(*columns, strict=True)]
        return whole.select(np.array(kept, dtype=bool)), home, others


class _AxisLimits(Choice):
    ROBUST = "robust"
    ALL = "all"


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _choice(kind: Any, name: str, text: str) -> Any:
    """Return a value of an option.

    Raises:
        InputError: there is none of that name.
    """
    allowed = {str(one.value): one for one in kind}
    if text not in allowed:
        raise UnknownNameError(name, text, allowed, name)
    return allowed[text]
