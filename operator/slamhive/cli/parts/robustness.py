# SPDX-License-Identifier: Apache-2.0
"""``slamhive results robustness``, and the options that it shares with the figure."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Annotated

import typer

from slamhive.analysis.metrics import label_of
from slamhive.analysis.searches.robustness import RobustnessWish, robustness, searches_of
from slamhive.cli.parts.choosing import Also, EvaluationName, Superseded, Sweeps, Where, choose_runs, select
from slamhive.cli.parts.console import out, remark
from slamhive.cli.parts.tables import PrintFormat, show, write_json, write_markdown
from slamhive.local.home.folder import Home
from slamhive.reporting.titles import keys_text
from slamhive.tables.homes import homes_beside
from slamhive.tables.queries import split_names
from slamhive_eval.formats.csv_writing import write_csv

FailingRule = Annotated[
    str | None,
    typer.Option(
        metavar="EXPR", help="Runs that failed, for robustness [as sought, or outcome != 'Tracked']."
    ),
]
Quantile = Annotated[
    float | None,
    typer.Option(
        min=0.01, max=1.0, help="Share of runs that must fail for a value to fail [as sought, or 0.5]."
    ),
]


def card_wish(axes: str | None, failing: str | None, quantile: float | None) -> RobustnessWish:
    """Return a card as options ask for it, with what the Sweeps of the archive sought."""
    from slamhive.archive import Archive

    with Archive.open(Home.from_environment().archive_url, read_only=True) as archive:
        searches = searches_of({one.uid: one.spec for one in archive.sweeps()})
    return RobustnessWish(tuple(split_names(axes)) if axes else (), failing, quantile, searches)


def show_robustness(
    *,
    x: Annotated[
        str | None,
        typer.Option("--x", "-x", metavar="COLUMN,…", help="Axes [those sought, or what was varied]."),
    ] = None,
    failing: FailingRule = None,
    quantile: Quantile = None,
    where: Where = None,
    sweep: Sweeps = None,
    evaluation: EvaluationName = None,
    superseded: Superseded = False,
    also: Also = None,
    form: Annotated[PrintFormat, typer.Option("--format", help="How to print.")] = PrintFormat.TABLE,
) -> None:
    """Say up to where on each axis each system still works, from searches for thresholds and from grids.

    Example: slamhive results robustness --sweep points --sweep noise --format csv
    """
    wish = card_wish(x, failing, quantile)
    home = Home.from_environment()
    # A run that two searches share is counted by the rules of both: the card counts equal content once each.
    selection = replace(select(sweep, evaluation, where, superseded=superseded), each=True)
    frame, notes = choose_runs(selection, "there is nothing to say", homes_beside(home, also))
    card = robustness(frame, wish)
    columns = card.columns()
    match form:
        case PrintFormat.JSON:
            write_json(
                sys.stdout,
                (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)),
            )
        case PrintFormat.CSV:
            write_csv(sys.stdout, list(columns), zip(*columns.values(), strict=True))
        case _:
            headings = ["system", "axis", "threshold", "runs"]
            lines = [
                [keys_text(key), label_of(axis), cell.sentence, str(cell.runs)]
                for key, cells in zip(card.rows, card.cells, strict=True)
                for axis, cell in zip(card.axes, cells, strict=True)
                if cell is not None
            ]
            if form is PrintFormat.MARKDOWN:
                write_markdown(sys.stdout, headings, lines)
            else:
                show(out, headings, lines)
            for note in (*card.notes[:-1], *notes):
                remark(note)
