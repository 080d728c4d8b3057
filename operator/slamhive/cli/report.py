# SPDX-License-Identifier: Apache-2.0
"""The commands ``slamhive report`` and ``slamhive paper-table``: a page beside a paper, and tables for it."""

from __future__ import annotations

import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from slamhive import __version__
from slamhive.analysis import Metric, Outcomes
from slamhive.analysis.boards import COMPETITORS
from slamhive.analysis.metrics import declared_units
from slamhive.cli.parts.choosing import (
    Also,
    EvaluationName,
    Output,
    Superseded,
    Sweeps,
    Where,
    choose_runs,
    select,
)
from slamhive.cli.parts.console import bytes_text, remark
from slamhive.data.files.outputs import output_whole
from slamhive.local.home.folder import Home
from slamhive.model.base import Choice, plural
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.reporting.latex import Rules, latex
from slamhive.reporting.overview import runs_of
from slamhive.reporting.page import ReportContents, report_html
from slamhive.reporting.papermarkdown import markdown
from slamhive.reporting.papertables import Best, Overall, Statistic, TableLayout, flat, make_table
from slamhive.reporting.presets import preset
from slamhive.reporting.questions import parse_question, usual_metric, usual_questions
from slamhive.tables.homes import homes_beside
from slamhive.tables.queries import split_names
from slamhive.tables.reading import revision
from slamhive_eval.formats.csv_writing import csv_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.frame import Frame

DEFAULT_METRICS = ("ate.rmse",)


class TableStyle(Choice):
    """Formats in which a table for a paper is written: two styles of LaTeX, Markdown or CSV."""

    BOOKTABS = "booktabs"
    IEEE = "ieee"
    MARKDOWN = "markdown"
    CSV = "csv"


class EarlierStyle(Choice):
    """Earlier names of styles."""

    LATEX = "latex"
    CSV = "csv"


def report(
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="File to write; - for standard output.")
    ] = Path("report.html"),
    run: Annotated[
        str | None,
        typer.Option(metavar="RUN", help="One run alone: settings, path over the truth, errors, load."),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Heading of the page [SLAM comparison].")] = None,
    metric: Annotated[
        str | None, typer.Option("--metric", "-m", metavar="COLUMN", help="Column to rank by [ate.rmse].")
    ] = None,
    by: Annotated[
        str | None, typer.Option(metavar="COLUMN,…", help="What tells competitors apart [algorithm,sensors].")
    ] = None,
    cost: Annotated[
        list[str] | None,
        typer.Option(metavar="COLUMN", help="What accuracy is drawn against [CPU, memory]; may be repeated."),
    ] = None,
    analysis: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X:Y",
            help="One column over another, as X:Y[:COLOUR] or the address of the dashboard's explore page; "
            "several times. Default: the metric over what was varied; none for nothing.",
        ),
    ] = None,
    outcomes: Annotated[
        Outcomes, typer.Option(help="Runs in the figures: tracked ones, or all that were evaluated.")
    ] = Outcomes.TRACKED,
    where: Where = None,
    sweep: Sweeps = None,
    evaluation: EvaluationName = None,
    superseded: Superseded = False,
    also: Also = None,
) -> None:
    """Write one self-contained HTML page: leaderboard, comparison, charts, all runs; or one run to share.

    Example: slamhive report --analysis input.frameRate:usage.cpu.meanCores -o report.html
    """
    if run is not None:
        refused = {
            "metric": metric,
            "by": by,
            "cost": cost,
            "analysis": analysis,
            "where": where,
            "sweep": sweep,
            "superseded": superseded,
            "also": also,
        }
        _refuse(refused)
        _of_run(run, evaluation, title, output)
        return
    selection = select(sweep, evaluation, where, superseded=superseded)
    frame, notes = choose_runs(
        selection, "there is nothing to report", homes_beside(Home.from_environment(), also)
    )
    metric = metric or usual_metric(frame)
    for field, names in (("metric", [metric]), ("cost", cost or []), ("by", _names(by, ""))):
        frame.require(names, field)
        if field != "by":
            _check_numbers(frame, names, field)
    asked = [text for text in analysis or () if text != "none"]
    questions = (
        [parse_question(text, frame, outcomes) for text in asked]
        if analysis
        else usual_questions(frame, metric, outcomes)
    )
    contents = ReportContents(
        title=title or ReportContents.title,
        metric=metric,
        by=_names(by, ",".join(COMPETITORS)),
        outcomes=outcomes,
        costs=tuple(cost or ()),
        questions=tuple(questions),
        filters=tuple(selection.sentences),
        notes=notes,
    )
    page = report_html(frame, contents)
    _write(page, None if str(output) == "-" else output)
    if str(output) != "-":
        remark(f"{output}: {plural(runs_of(frame), 'run')}, {bytes_text(len(page.encode()))}")


def _refuse(options: Mapping[str, object]) -> None:
    """Complain of options that choose among runs.

    Raises:
        InputError: one was given.
    """
    given = next((name for name, value in options.items() if value), None)
    if given is not None:
        raise InputError(f"a page of one run takes no --{given}, which is for several", "run")


def _of_run(run: str, evaluation: str | None, title: str | None, output: Path) -> None:
    """Write the page of a run.

    Raises:
        InputError: several have that name, or it has no such evaluation.
    """
    from slamhive.bridges.places import Here
    from slamhive.bridges.runpage import run_page
    from slamhive.cli.onerun import find_run, rows_of

    home = Home.from_environment()
    with Here.open(home.archive_url, home.path) as here:
        record = find_run(here.archive, run, "--run")
        names = [result.evaluation for result in record.results]
        if evaluation is not None and evaluation not in names:
            raise UnknownNameError("evaluation", evaluation, names, "--evaluation")
        page = run_page(record, here, rows_of(record), evaluation, title)
    _write(page, None if str(output) == "-" else output)
    if str(output) != "-":
        remark(f"{output}: run {record.name}, {bytes_text(len(page.encode()))}")


def _check_numbers(frame: Frame, names: Sequence[str], field: str) -> None:
    for name in names:
        column = frame.column(name)
        if not column.is_empty and np.isnan(column.floats()).all():
            raise InputError(f"{name}: a column of numbers is needed, this one holds none", field)


def paper_table(
    *,
    rows: Annotated[
        str | None, typer.Option(metavar="COLUMN,…", help="What tells rows apart [algorithm,sensors].")
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(metavar="COLUMN,…", help="What is laid out side by side [dataset]; '' for nothing."),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            "--metric", "-m", metavar="COLUMN[:UNIT][:.3f]", help="What is shown [ate.rmse]; may be repeated."
        ),
    ] = None,
    named: Annotated[
        str | None,
        typer.Option("--preset", metavar="III|IV", help="A table of the ICRA 2023 paper, as published."),
    ] = None,
    outcomes: Annotated[
        Outcomes | None, typer.Option(help="Runs in the figures: tracked ones, or all that were evaluated.")
    ] = None,
    statistic: Annotated[Statistic, typer.Option(help="What stands for several runs.")] = Statistic.MEAN,
    spread: Annotated[
        bool, typer.Option("--spread", help="Show the standard deviation, or with medians the range.")
    ] = False,
    best: Annotated[
        Best, typer.Option(help="Best bold, second underlined: of each column, or within each first row key.")
    ] = Best.COLUMN,
    overall: Annotated[
        str | None,
        typer.Option(
            metavar="rank,ratio", help="Over all datasets: mean rank, geometric mean of ratios to the best."
        ),
    ] = None,
    published: Annotated[
        bool, typer.Option("--published", help="Add published numbers that own ones are comparable with.")
    ] = False,
    caption: Annotated[
        str | None, typer.Option(help="What the table shows; n and the rest are added.")
    ] = None,
    label: Annotated[str, typer.Option(help="Name for \\ref in LaTeX.")] = "",
    where: Where = None,
    sweep: Sweeps = None,
    evaluation: EvaluationName = None,
    superseded: Superseded = False,
    style: Annotated[
        TableStyle, typer.Option(help="LaTeX with booktabs or in IEEE style, Markdown, or CSV.")
    ] = TableStyle.BOOKTABS,
    form: Annotated[EarlierStyle | None, typer.Option("--format", hidden=True)] = None,
    output: Output = None,
    also: Also = None,
) -> None:
    """Write a table for a paper: LaTeX, Markdown or CSV, best in bold, failures shown.

    Example: slamhive paper-table --columns dataset -m ate.rmse:cm:.1f --spread -o table.tex
    """
    given = preset(named) if named is not None else None
    layout = TableLayout(
        rows=_names(rows, given.rows if given else "algorithm,sensors"),
        columns=_names(columns, given.columns if given else "dataset"),
        metrics=tuple(map(Metric.parse, metric or (given.metrics if given else DEFAULT_METRICS))),
        outcomes=outcomes or (Outcomes.ALL if given else Outcomes.TRACKED),
        statistic=statistic,
        spread=spread,
        best=best,
        overall=_overall(overall),
    )
    selection = select(sweep, evaluation, where, given, superseded=superseded)
    frame, left_out = choose_runs(
        selection, "there is nothing to make a table of", homes_beside(Home.from_environment(), also)
    )
    layout = replace(
        layout,
        rows=tuple(frame.resolve_key(name, "rows") for name in layout.rows),
        columns=tuple(frame.resolve_key(name, "columns") for name in layout.columns),
    )
    names = [one.column for one in layout.metrics]
    frame.require(names, "metric")
    _check_numbers(frame, names, "metric")
    table = make_table(frame, layout)
    if published:
        # Few tables need them and their reader.
        from slamhive.reporting.publishednumbers import with_published
        from slamhive.tables.published import load_published

        table, remarks = with_published(table, frame, load_published(Home.from_environment().path))
        for sentence in remarks:
            remark(sentence)
    asides = (*left_out, *table.asides)
    if EarlierStyle.CSV is form or style is TableStyle.CSV:
        _write(csv_text(flat(table)), output)
        return
    origin = (
        f"slamhive {__version__}, {datetime.now(UTC):%Y-%m-%d}, data revision {revision(frame)}.",
        *(f"Of the archive: {sentence}." for sentence in selection.sentences),
    )
    words = caption if caption is not None else given.caption if given else ""
    with declared_units(frame.units):
        if style is TableStyle.MARKDOWN:
            text = markdown(table, told=words, origin=origin)
        else:
            # For whoever writes the paper, in comments: its readers ask for none of it.
            told = (*origin, *(f"{note[:1].upper()}{note[1:]}." for note in asides))
            text = latex(table, caption=words, label=label, origin=told, rules=Rules(style.value))
    _write(text, output)
    for note in asides:
        remark(note)


def _overall(text: str | None) -> tuple[Overall, ...]:
    """Read what stands for each row over all datasets.

    Raises:
        InputError: it is no such thing.
    """
    names = _names(text, "")
    known = {kind.value: kind for kind in Overall}
    for name in names:
        if name not in known:
            raise UnknownNameError("figure over datasets", name, known, "--overall")
    return tuple(known[name] for name in names)


def _names(text: str | None, default: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(split_names(default if text is None else text)))


def _write(text: str, output: Path | None) -> None:
    if output is None:
        sys.stdout.write(text)
        return
    with output_whole(output) as aside:
        aside.write_text(text, encoding="utf-8", errors="replace")
