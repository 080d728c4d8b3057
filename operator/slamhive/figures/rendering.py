# SPDX-License-Identifier: Apache-2.0
"""Files of pictures: PDF, SVG and PNG, written by matplotlib with what it needn't do left out."""

from __future__ import annotations

import importlib
import io
import logging
import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from slamhive.figures.drawing import Drawing, library
from slamhive.figures.styles import settings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.figures.paper import Paper
    from slamhive.figures.pictures import Picture

DOTS = 300
"""Of a PNG, each inch."""

_CANVASES = {
    "pdf": ("backend_pdf", "FigureCanvasPdf"),
    "svg": ("backend_svg", "FigureCanvasSVG"),
    "png": ("backend_agg", "FigureCanvasAgg"),
}
_LAYOUT_TABLES = ("GSUB", "GPOS", "GDEF", "kern")
"""Tables of a font by which letters are set beside each other."""


def rendered(picture: Picture, paper: Paper, form: str, told: dict[str, Any]) -> bytes:
    """Return a picture as a file.

    Args:
        picture: with limits on its axes.
        paper: what it is drawn on.
        form: pdf, svg or png.
        told: what the file says of itself.

    Raises:
        InputError: matplotlib isn't installed.
    """
    style = library("").rc_context(settings(paper.width.points, paper.face))
    with style, warnings.catch_warnings(), _growing_axes(), _short_fonts(form):
        warnings.simplefilter("ignore")  # letters that the font lacks; they are drawn as boxes
        figure = Drawing(picture, paper.width, paper.height).draw()
        _lay_out(figure, form)
        stream = io.BytesIO()
        figure.savefig(stream, format=form, metadata=told, dpi=DOTS)
    return stream.getvalue()


def leave_out_documents() -> None:
    """Keep matplotlib from documenting its classes while it is imported: a seventh of a figure's time.

    For programs that draw and end. Where people look matplotlib up, as in a notebook, it is not called.

    Raises:
        InputError: matplotlib isn't installed.
    """
    library("")  # whose absence has its own sentence
    library("artist").kwdoc = lambda _: ""


@contextmanager
def _growing_axes() -> Iterator[None]:
    """Keep matplotlib from warning of axes that grow beyond their limits, as those of paths are meant to."""
    log = logging.getLogger("matplotlib.axes._base")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


@contextmanager
def _short_fonts(form: str) -> Iterator[None]:
    """Leave tables for layout out of fonts in a PDF, which are read for a tenth of a figure's time.

    Where letters stand is matplotlib's work, and no reader of PDF looks at them.
    """
    if form != "pdf":
        yield
        return
    subset: Any = importlib.import_module("fontTools.subset")
    load = subset.load_font

    def load_without(*args: Any, **options: Any) -> Any:
        font = load(*args, **options)
        for table in _LAYOUT_TABLES:
            if table in font:
                del font[table]
        return font

    subset.load_font = load_without
    try:
        yield
    finally:
        subset.load_font = load


def _lay_out(figure: Any, form: str) -> None:
    """Lay a figure out for a form of file; matplotlib would draw all of it once more for that."""
    module, canvas = _CANVASES[form]
    getattr(library(f"backends.{module}"), canvas)(figure)
    figure.get_layout_engine().execute(figure)
    figure.set_layout_engine(None)
