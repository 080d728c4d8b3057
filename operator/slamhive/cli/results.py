# SPDX-License-Identifier: Apache-2.0
"""``slamhive results``: what is in the archive, as lists, tables and files."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamhive.analysis import Metric, Outcomes, columns_of, compile_where, flatten, order_by, table
from slamhive.archive import Archive
from slamhive.cli.console import out, remark
from slamhive.cli.tables import (
    Format,
    cell,
    constants,
    implied,
    key_text,
    pivot_lines,
    pivot_rows,
    show,
    write_csv,
    write_json,
    write_markdown,
)
from slamhive.local.home import Home
from slamhive.model.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import TextIO

    from slamhive.analysis import Group, PivotTable
    from slamhive.model.results import Result, RunRecord

    Row = dict[str, Any]

app = typer.Typer(no_args_is_help=True, help="Finished runs: lists, tables, files.")

LIST_COLUMNS = (
    *("run", "sweep", "algorithm", "sensors", "dataset", "repetition", "phase", "evaluation", "outcome"),
    *("ate.rmse", "rpe[0].rmse", "coverage", "usage.cpu.meanCores", "usage.memory.peakBytes"),
)
TABLE_METRICS = (
    *("ate.rmse", "rpe[0].rmse", "relations.translation.mean", "relations.rotationDeg.mean"),
    *("usage.cpu.secondsPerDataSecond", "usage.cpu.meanCores", "usage.memory.peakBytes"),
)
_BY_TIME = "relations.byTime["

Where = Annotated[
    str | None,
    typer.Option(metavar="EXPR", help='Only rows that meet it, as in "run in (126, 141) and scale < 1".'),
]
SweepName = Annotated[str | None, typer.Option(metavar="NAME", help="Only runs of this sweep.")]
EvaluationName = Annotated[
    str | None, typer.Option(metavar="NAME", help="Only this evaluation, such as default or sim3.")
]
Sort = Annotated[
    str | None, typer.Option(metavar="COLUMN,…", help="Order by columns; a dash before one turns it round.")
]
Columns = Annotated[
    str | None, typer.Option(metavar="COLUMN,…", help="What to show, each as COLUMN[:UNIT][:.3f].")
]
Output = Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write to a file.")]


@app.command("list")
def list_results(
    *,
    where: Where = None,
    sweep: SweepName = None,
    evaluation: EvaluationName = None,
    sort: Sort = None,
    columns: Columns = None,
    form: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
) -> None:
    """List runs with their results, one line a run and evaluation.

    Example: slamhive results list --where "outcome != 'Tracked'" --sort=-coverage
    """
    with _archive() as archive:
        rows, known = _select(archive, sweep, evaluation, where)
        location = archive.location
    shown = [Metric.parse(name) for name in _names(columns) or LIST_COLUMNS]
    _check_columns([metric.column for metric in shown], known)
    rows = _sorted(rows, sort, known)
    names = [metric.column for metric in shown]
    match form:
        case Format.JSON:
            write_json(sys.stdout, ({name: row.get(name) for name in names} for row in rows))
        case Format.CSV:
            write_csv(sys.stdout, names, rows)
        case _:
            lines = [[cell(metric, row.get(metric.column)) for metric in shown] for row in rows]
            _print(form, [metric.title for metric in shown], lines)
            _remark_empty(rows, location)


@app.command("show")
def show_run(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Name, UID or label run of a run.")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show all that is known of a run.

    Example: slamhive results show demo-3f2a
    """
    with _archive() as archive:
        records = _find(archive, run)
    for record in records:
        rows = flatten(record)
        if as_json:
            write_json(sys.stdout, rows)
            continue
        _show_record(record, rows)


@app.command("table")
def show_table(
    *,
    metric: Annotated[
        list[str] | None,
        typer.Option("--metric", "-m", metavar="COLUMN[:UNIT][:.3f]", help="What to average; several times."),
    ] = None,
    rows: Annotated[
        str | None, typer.Option(metavar="COLUMN,…", help="What tells rows apart; default: what varies.")
    ] = None,
    columns: Annotated[
        str | None, typer.Option(metavar="COLUMN,…", help="What to lay out side by side.")
    ] = None,
    outcomes: Annotated[
        Outcomes, typer.Option(help="Runs in the means: tracked ones, or all that were evaluated.")
    ] = Outcomes.TRACKED,
    where: Where = None,
    sweep: SweepName = None,
    evaluation: EvaluationName = None,
    sort: Sort = None,
    form: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
) -> None:
    """Average over repetitions: mean ± standard deviation (n − 1), coverage, n, and what failed.

    Algorithms, datasets, evaluations, paces and processors are never averaged together.

    Example: slamhive results table --rows parameters.nFeatures -m ate.rmse:cm:.3f -m usage.cpu.meanCores
    """
    with _archive() as archive:
        selected, known = _select(archive, sweep, evaluation, where)
        location = archive.location
    metrics = [Metric.parse(text) for text in metric or _usual_metrics(selected, known)]
    by, across = _names(rows), _names(columns)
    _check_columns([*(one.column for one in metrics), *(by or ()), *(across or ())], known)
    found = table(selected, [one.column for one in metrics], by, across or (), outcomes)
    if not metric:
        metrics = [one for one in metrics if any(group.metrics[one.column] for group in found.groups)]
    found = _sorted_groups(found, sort)
    flat = pivot_rows(found)
    match form:
        case Format.JSON:
            write_json(sys.stdout, flat)
        case Format.CSV:
            write_csv(sys.stdout, list(flat[0]) if flat else [], flat)
        case _:
            shared = constants(found, by or ())
            if shared:
                out.print(
                    ", ".join(f"{name} {key_text(value)}" for name, value in shared.items()), markup=False
                )
            dropped = {*shared, *implied(found, by or ())}
            kept = tuple(name for name in found.rows if name not in dropped)
            _print(form, *pivot_lines(replace(found, rows=kept), metrics))
            for note in found.notes:
                remark(note)
            _remark_empty(selected, location)


@app.command("export")
def export(
    *,
    form: Annotated[Format, typer.Option("--format", help="csv, json or markdown.")] = Format.CSV,
    output: Output = None,
    where: Where = None,
    sweep: SweepName = None,
    evaluation: EvaluationName = None,
    sort: Sort = None,
    columns: Annotated[
        str | None, typer.Option(metavar="COLUMN,…", help="What to write; default: everything.")
    ] = None,
) -> None:
    """Write every run and evaluation as a row, numbers with all their digits.

    Example: slamhive results export --format json --sweep demo -o demo.json
    """
    if form is Format.TABLE:
        raise InputError("--format: export writes csv, json or markdown; results list prints a table")
    with _archive() as archive:
        rows, known = _select(archive, sweep, evaluation, where)
    rows = _sorted(rows, sort, known)
    asked = _names(columns)
    _check_columns(asked or (), known)
    wanted = asked or known
    with _stream(output) as stream:
        match form:
            case Format.JSON:
                picked = ({name: row.get(name) for name in asked} for row in rows) if asked else rows
                write_json(stream, picked)
            case Format.CSV:
                write_csv(stream, wanted, rows)
            case _:
                plain = Metric("", "", 1.0, "")
                lines = (
                    [
                        repr(row.get(name))
                        if isinstance(row.get(name), float)
                        else cell(plain, row.get(name))
                        for name in wanted
                    ]
                    for row in rows
                )
                write_markdown(stream, wanted, lines)


@contextmanager
def _archive() -> Iterator[Archive]:
    with Archive.open(Home.from_environment().archive_url) as archive:
        yield archive


def _select(
    archive: Archive, sweep: str | None, evaluation: str | None, where: str | None
) -> tuple[list[Row], list[str]]:
    """Return the rows asked for, and the columns that there are."""
    if sweep is not None and not archive.count(sweep=sweep):
        raise UnknownNameError("sweep", sweep, archive.sweep_names(), "--sweep")
    rows: list[Row] = []
    evaluations: set[str] = set()
    for record in archive.runs(sweep=sweep):
        evaluations.update(result.evaluation for result in record.results)
        rows += flatten(record, evaluation)
    if evaluation is not None and evaluation not in evaluations:
        raise UnknownNameError("evaluation", evaluation, evaluations, "--evaluation")
    known = columns_of(rows)
    if where:
        condition = compile_where(where, frozenset(known))
        rows = [row for row in rows if condition(row)]
    return rows, known


def _find(archive: Archive, run: str) -> list[RunRecord]:
    record = archive.get(run)
    if record is not None:
        return [record]
    if named := archive.by_names([run]):
        return named
    names: list[str] = []
    found = []
    for candidate in archive.runs():
        label = candidate.labels.get("run")
        if label == run:
            found.append(candidate)
        names.append(candidate.name)
    if not found:
        raise UnknownNameError("run", run, names)
    return found


def _show_record(record: RunRecord, rows: Sequence[Row]) -> None:
    names = [
        name
        for name in columns_of(rows)
        if name != "transform"
        and not name.startswith(_BY_TIME)
        and any(row.get(name) not in (None, {}, []) for row in rows)
    ]
    common = [name for name in names if all(name in row and row[name] == rows[0][name] for row in rows)]
    out.print(record.name, style="bold", markup=False)
    plain = {name: Metric.parse(name) for name in names}
    show(
        out, ["of the run", ""], [[plain[name].heading, cell(plain[name], rows[0][name])] for name in common]
    )
    results = [name for name in names if name not in common]
    if results:
        lines = [
            [plain[name].heading, *(cell(plain[name], row.get(name)) for row in rows)] for name in results
        ]
        show(out, ["by evaluation", *(str(row["evaluation"]) for row in rows)], lines)
    for result in record.results:
        _show_relations(result)
    if record.log_tail:
        out.print("last lines of its log", style="bold")
        out.print(record.log_tail, markup=False)


def _show_relations(result: Result) -> None:
    """Show the errors over relations by the time between their two poses."""
    groups = (result.values.get("relations") or {}).get("byTime") or []
    if not groups:
        return
    lines = []
    for group in groups:
        until = f"{group['toSeconds']:g}" if group["toSeconds"] is not None else "∞"
        numbers = [
            f"{group[kind][name]:.4g}" if group[kind] else "–"
            for kind in ("translation", "rotationDeg")
            for name in ("mean", "rmse", "max")
        ]
        lines.append([f"{group['fromSeconds']:g} … {until} s", str(group["count"]), *numbers])
    units = [f"{name} [{unit}]" for unit in ("m", "°") for name in ("mean", "rmse", "max")]
    show(out, ["relations by time", "n", *units], lines)


def _usual_metrics(rows: Sequence[Row], known: Sequence[str]) -> list[str]:
    """Return what a table shows unless told: mean cores only where the clock set the pace."""
    realtime = any(row.get("input.pace") == "Realtime" for row in rows)
    left_out = set() if realtime else {"usage.cpu.meanCores"}
    return [name for name in TABLE_METRICS if name in known and name not in left_out]


def _names(text: str | None) -> list[str] | None:
    return [name.strip() for name in text.split(",") if name.strip()] if text else None


def _check_columns(names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise UnknownNameError("column", name, known)


def _sorted(rows: list[Row], sort: str | None, known: Sequence[str]) -> list[Row]:
    asked = _names(sort) or []
    _check_columns([name.removeprefix("-") for name in asked], known)
    return order_by(rows, asked, lambda row, name: row.get(name))


def _sorted_groups(found: PivotTable, sort: str | None) -> PivotTable:
    """Sort a pivot table's groups by keys, means of metrics, coverage or n."""
    asked = _names(sort) or []
    known = [*found.rows, *found.columns, *found.metrics, "coverage", "n"]
    _check_columns([name.removeprefix("-") for name in asked], known)

    def get(group: Group, name: str) -> Any:
        if name in group.keys:
            return group.keys[name]
        if name == "n":
            return group.n
        summary = group.coverage if name == "coverage" else group.metrics[name]
        return summary.mean if summary else None

    return replace(found, groups=order_by(found.groups, asked, get))


def _print(form: Format, headings: Sequence[str], lines: Sequence[Sequence[str]]) -> None:
    if form is Format.MARKDOWN:
        write_markdown(sys.stdout, headings, lines)
    else:
        show(out, headings, lines)


def _remark_empty(rows: Sequence[Row], location: str) -> None:
    if not rows:
        remark(f"no such run in {location}; slamhive demo, run and import bring some")


@contextmanager
def _stream(output: Path | None) -> Iterator[TextIO]:
    if output is None:
        yield sys.stdout
        return
    try:
        with output.open("w", encoding="utf-8", newline="") as stream:
            yield stream
    except OSError as error:
        raise InputError(f"--output: {output}: {error.strerror}") from None
