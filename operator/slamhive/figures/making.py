# SPDX-License-Identifier: Apache-2.0
"""Making of figures: from runs and a wish to a file, with its numbers beside it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from slamhive import __version__
from slamhive.analysis.metrics import declared_units
from slamhive.data.files.outputs import output_whole
from slamhive.figures.asking import FigureKind
from slamhive.model.errors import InputError
from slamhive_eval.formats.csv_writing import csv_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Any

    from slamhive.analysis.frame import Frame
    from slamhive.figures.asking import Wish
    from slamhive.figures.paper import Paper
    from slamhive.figures.pictures import Picture
    from slamhive.local.home.folder import Home
    from slamhive.tables.homes import Beside
    from slamhive.tables.published import Published

FORMS = ("pdf", "svg", "png")

_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]+")


def picture(
    frame: Frame, wish: Wish, home: Home, also: Sequence[Beside] = (), *, published: bool = False
) -> Picture:
    """Return the picture that a figure shows.

    Args:
        frame: the runs.
        wish: what was asked for.
        home: has the files of runs.
        also: other homes, whose rows stand beside.
        published: whether published numbers are drawn beside them, in a scatter plot.

    Raises:
        InputError: it can't be drawn, or nothing would be seen.
    """
    if published and wish.kind is not FigureKind.SCATTER:
        raise InputError("published numbers are drawn by scatter alone", "published")
    with declared_units(frame.units):
        return _picture(frame, wish, home, also, published=published)


def _picture(frame: Frame, wish: Wish, home: Home, also: Sequence[Beside], *, published: bool) -> Picture:
    if wish.kind.is_of_files:
        # Readers of folders and ground truth: only some figures need them.
        from slamhive.figures.paths import paths  # noqa: PLC0415

        return paths(frame, wish, home, also).settled()
    from slamhive.figures import groups, robustness, singles  # noqa: PLC0415

    if wish.robustness is not None:
        return robustness.reaches(frame, wish.robustness).settled()

    if wish.kind is FigureKind.SCATTER:
        return singles.scatter(frame, wish, _published(frame, home) if published else ()).settled()
    if wish.kind is FigureKind.SEARCH:
        raise InputError(
            "the figure of a search is made of its sweep by `slamhive figure search NAME`", "kind"
        )
    makers = {
        FigureKind.LINES: groups.lines,
        FigureKind.BOX: groups.box,
        FigureKind.HEAT: groups.heat,
        FigureKind.PARETO: groups.front,
        FigureKind.ECDF: singles.ecdf,
        FigureKind.REPETITIONS: singles.repetitions,
    }
    return makers[wish.kind](frame, wish).settled()


def _published(frame: Frame, home: Home) -> Sequence[Published]:
    """Return the published numbers on datasets of the runs; few figures need them and their reader."""
    from slamhive.tables.published import load_published, published_on  # noqa: PLC0415

    return [one for one in published_on(frame, load_published(home.path)) if one.is_drawn]


def form_of(path: Path) -> str:
    """Return the form of a file by its name.

    Raises:
        InputError: figures have no such form.
    """
    form = path.suffix.lower().removeprefix(".")
    if form not in FORMS:
        found = f"not in {path.suffix!r}" if path.suffix else "and this name has no ending"
        raise InputError(
            f"{path}: a figure's name ends in {', '.join(f'.{one}' for one in FORMS)}, {found}", "output"
        )
    return form


def numbers_file(path: Path) -> Path:
    """Return the path of a figure's numbers: ``fig.pdf`` has ``fig.data.csv`` beside it."""
    return path.with_name(f"{path.stem}.data.csv")


def save(made: Picture, path: Path, paper: Paper, *, command: str, revision: str, caption: str) -> None:
    """Write a figure, and its numbers beside it.

    Args:
        made: what it shows.
        path: the file.
        paper: what it is drawn on.
        command: what made it, kept in the file.
        revision: of the data, kept in the file.
        caption: what it shows, kept in the file.

    Raises:
        InputError: a file can't be written, or matplotlib isn't installed.
    """
    from slamhive.figures.rendering import rendered  # noqa: PLC0415 - half a second of matplotlib

    form = form_of(path)
    content = rendered(made, paper, form, _told(form, command, revision, caption))
    numbers = csv_text(made.columns).encode("utf-8", "replace")
    # Both are written before either has its name: a figure never stands beside the numbers of another one.
    with output_whole(path) as figure, output_whole(numbers_file(path)) as data:
        figure.write_bytes(content)
        data.write_bytes(numbers)


def _told(form: str, command: str, revision: str, caption: str) -> dict[str, Any]:
    """Return a file's words on itself; no date, so that the same data give the same file."""
    by, what, data = (
        _CONTROL.sub(" ", text) for text in (f"slamhive {__version__}", command, f"data revision {revision}")
    )
    caption = _CONTROL.sub(" ", caption)
    match form:
        case "pdf":
            return {"Creator": by, "Title": what, "Subject": caption, "Keywords": data, "CreationDate": None}
        case "svg":
            return {"Creator": by, "Title": what, "Description": f"{caption} {data}", "Date": None}
        case _:
            return {"Software": by, "Title": what, "Description": f"{caption} {data}"}
