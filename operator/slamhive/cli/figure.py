# SPDX-License-Identifier: Apache-2.0
"""``slamhive figure``: figures for papers."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.analysis import Outcomes
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.metrics import declared_units
from slamhive.cli.parts.choosing import Also, EvaluationName, Superseded, Sweeps, Where, choose_runs, select
from slamhive.cli.parts.console import remark
from slamhive.cli.parts.robustness import FailingRule, Quantile, card_wish
from slamhive.cli.searches import told
from slamhive.figures.asking import FigureKind, Log, Wish
from slamhive.figures.making import form_of, numbers_file, picture, save
from slamhive.figures.paper import Paper
from slamhive.figures.searches import search
from slamhive.figures.styles import Face
from slamhive.figures.widths import WIDTHS, parse_height, parse_width
from slamhive.local.home.folder import Home
from slamhive.model.base import Choice, plural
from slamhive.model.errors import InputError
from slamhive.reporting.papertables import Statistic
from slamhive.tables.homes import homes_beside
from slamhive.tables.reading import revision
from slamhive.tables.uncollected import uncollected

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.figures.pictures import Picture


class Hold(Choice):
    """Choices of which values the axes of a figure include: the values of ``--limits``."""

    ROBUST = "robust"
    ALL = "all"


@uncollected()
def figure(
    kind: Annotated[FigureKind, typer.Argument(help="What it shows.", show_default=False)],
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Of search: the sweep.", show_default=False)
    ] = None,
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="File to write: .pdf, .svg or .png [KIND.pdf]."),
    ] = None,
    x: Annotated[
        str | None, typer.Option("--x", "-x", metavar="COLUMN[:UNIT]", help="Column along x.")
    ] = None,
    y: Annotated[
        str | None, typer.Option("--y", "-y", metavar="COLUMN[:UNIT]", help="Column along y.")
    ] = None,
    by: Annotated[
        str | None,
        typer.Option(
            "--by",
            "--color",
            metavar="COLUMN,…",
            help="What tells series apart [algorithm,sensors]; of heat, the metric of the colours.",
        ),
    ] = None,
    facet: Annotated[
        str | None, typer.Option(metavar="COLUMN,…", help="A panel for each of its values, axes shared.")
    ] = None,
    width: Annotated[
        str, typer.Option(metavar="WIDTH", help=f"{', '.join(WIDTHS)}, or a measure such as 88mm.")
    ] = "ieee-column",
    height: Annotated[
        str | None, typer.Option(metavar="HEIGHT", help="Height, such as 60mm; default: by the content.")
    ] = None,
    font: Annotated[Face, typer.Option(help="Letters: sans, or serif as most papers have.")] = Face.SANS,
    log: Annotated[Log, typer.Option(help="Logarithmic axes; auto: where numbers span decades.")] = Log.AUTO,
    limits: Annotated[
        Hold,
        typer.Option(
            help="robust: a few extreme values lie outside, marked at the edge; all: every value lies inside."
        ),
    ] = Hold.ROBUST,
    statistic: Annotated[
        Statistic, typer.Option(help="What stands for several runs: median and range, or mean ± std.")
    ] = Statistic.MEDIAN,
    outcomes: Annotated[
        Outcomes, typer.Option(help="Runs that count: tracked ones, or all that were evaluated.")
    ] = Outcomes.TRACKED,
    each: Annotated[
        bool, typer.Option("--each", help="Paths, errors and usage of every run, not one a series.")
    ] = False,
    published: Annotated[
        bool, typer.Option("--published", help="Add published numbers on the same datasets, as hollow marks.")
    ] = False,
    failing: FailingRule = None,
    quantile: Quantile = None,
    where: Where = None,
    sweep: Sweeps = None,
    evaluation: EvaluationName = None,
    superseded: Superseded = False,
    also: Also = None,
) -> None:
    """Draw a figure for a paper, as PDF, SVG or PNG, with its numbers as CSV beside it.

    Example: slamhive figure lines -x nFeatures -y ate.rmse:cm --width ieee-column -o fig.pdf
    """
    path = output if output is not None else Path(f"{kind.value}.pdf")
    form_of(path)
    paper = Paper(parse_width(width), None if height is None else parse_height(height), font)
    if not path.parent.is_dir():
        raise InputError(f"--output: {path}: there is no folder {path.parent}")
    wish = Wish(kind, x, y, by, facet, outcomes, statistic, log, limits is Hold.ROBUST, each)
    if each and not kind.is_of_files:
        raise InputError("--each: every run is drawn by trajectories, error-over-time and usage")
    if kind is FigureKind.SEARCH:
        if name is None:
            raise InputError("NAME: figure search needs the name of the sweep")
        if where or sweep or evaluation or superseded or also or published:
            raise InputError("figure search: NAME says which runs; other choices of runs mean nothing here")
        with told(name) as (record, story, _, whole):
            own = whole.select(where_equal(whole, "sweep.uid", record.uid))
            with declared_units(whole.units):
                made = search(story, wish).settled()
        _write(made, path, paper, revision(own), made.notes)
        return
    if name is not None:
        raise InputError(
            f"NAME: {name!r} means nothing to figure {kind.value}; --sweep chooses runs of a sweep"
        )
    if kind is FigureKind.ROBUSTNESS:
        wish.refuse(y="--y: a robustness card shows axes alone, --x", by="--by: a row is a system already")
        wish = replace(wish, robustness=card_wish(x, failing, quantile))
    elif failing is not None or quantile is not None:
        raise InputError("--failing, --quantile: a rule for robustness alone")
    selection = select(sweep, evaluation, where, superseded=superseded)
    selection = replace(selection, each=kind is FigureKind.ROBUSTNESS)
    home = Home.from_environment()
    others = homes_beside(home, also)
    frame, left_out = choose_runs(selection, "there is nothing to draw", others)
    made = picture(frame, wish, home, others, published=published)
    _write(made, path, paper, revision(frame), (*made.notes, *left_out))


def _write(made: Picture, path: Path, paper: Paper, data: str, notes: Sequence[str]) -> None:
    """Write a figure and say what it shows.

    Args:
        made: what it shows.
        path: where.
        paper: how large.
        data: revision of the data.
        notes: sentences of the caption.
    """
    caption = " ".join(
        f"{note if note.startswith('n = ') else note[:1].upper() + note[1:]}." for note in notes
    )
    from slamhive.figures.rendering import leave_out_documents

    leave_out_documents()
    command = shlex.join(["slamhive", *sys.argv[1:]])
    save(made, path, paper, command=command, revision=data, caption=caption)
    runs = plural(made.runs, "run")
    remark(f"{path}: {paper.width.millimetres:g} mm wide, of {runs}; numbers in {numbers_file(path)}")
    remark(caption)
