# SPDX-License-Identifier: Apache-2.0
"""``slamhive results``: what is in the archive, as lists, tables and files."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from slamhive.analysis.columns import ColumnKind
from slamhive.analysis.derived import PACE
from slamhive.analysis.frame import Frame
from slamhive.analysis.grouping import SEARCHED, Outcomes, aggregate, late_notes, varies, varying
from slamhive.analysis.measures import CAUSAL, LATE_SECONDS
from slamhive.analysis.metrics import Metric, declared_units
from slamhive.analysis.selection import Chosen, Selection, choose, order_rows
from slamhive.bridges.targets import BridgeTarget
from slamhive.cli.forgetting import prune
from slamhive.cli.onerun import note_runs, show_run
from slamhive.cli.parts.choosing import Also, EvaluationName, Output, Superseded, Where, choose_runs
from slamhive.cli.parts.console import complain, listing, open_workbench, out, remark
from slamhive.cli.parts.exits import FAILED
from slamhive.cli.parts.nodes import show_nodes
from slamhive.cli.parts.robustness import show_robustness
from slamhive.cli.parts.tables import PrintFormat, show, show_columns, write_json, write_markdown
from slamhive.cli.parts.waiting import Work
from slamhive.cli.suspecting import show_suspects
from slamhive.contract.lines import printable
from slamhive.data.files.outputs import output_whole
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.tables.homes import COLUMN, homes_beside, read_homes
from slamhive.tables.queries import split_names
from slamhive.tables.reading import read_archive
from slamhive.tables.text import (
    constants,
    flat_cells,
    implied,
    key_text,
    key_title,
    spare_settings,
    table_columns,
    time_text,
    value_text,
)
from slamhive.tables.timeliness import DROPPED, FACTOR, LATENCIES, any_dropped, by_clock
from slamhive.tables.uncollected import uncollected
from slamhive.tables.words import disproportion_notes, meanings, spread_notes
from slamhive_eval.formats.csv_writing import csv_blocks, write_csv

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import TextIO

    from slamhive.analysis.grouping import Aggregate
    from slamhive.tables.published import Published

    Row = dict[str, Any]

app = typer.Typer(no_args_is_help=True, help="Finished runs: lists, tables, files.")

_BLOCK = 2000
"""Rows written at a time: what an export needs memory for."""

LIST_COLUMNS = (
    *("run", "sweep", SEARCHED, "algorithm", "sensors", "dataset", "repetition"),
    *("phase", "evaluation", "outcome"),
    *("ate.rmse", f"{CAUSAL}ate.rmse", "rpe[0].rmse", "coverage"),
    *("usage.cpu.secondsPerDataSecond", "usage.cpu.meanCores", "usage.memory.peakBytes"),
    *(LATE_SECONDS, FACTOR, DROPPED, "finished"),
)
NEWEST = ("-finished",)
TABLE_METRICS = (
    *("ate.rmse", f"{CAUSAL}ate.rmse", "rpe[0].rmse"),
    *("relations.translation.mean", "relations.rotationDeg.mean"),
    *("usage.cpu.secondsPerDataSecond", "usage.cpu.meanCores", "usage.memory.peakBytes"),
    *(*LATENCIES, FACTOR, DROPPED),
)
_WHERE_ANY = {SEARCHED, f"{CAUSAL}ate.rmse", LATE_SECONDS, FACTOR}
_SAID_ONCE = ("sweep", "algorithm", "sensors", "dataset", "phase", "evaluation")
_MOST_SETTINGS = 6
_MOST_READ = 20
"""Columns of a table that a wide screen shows side by side."""

_MOST_PROBLEMS = 15
_MOST_NOTE = 60

SweepName = Annotated[str | None, typer.Option(metavar="NAME", help="Only runs of this sweep.")]
Sort = Annotated[
    str | None, typer.Option(metavar="COLUMN,…", help="Order by columns; a dash before one reverses it.")
]
Columns = Annotated[
    str | None, typer.Option(metavar="COLUMN,…", help="What to show, each as COLUMN[:UNIT][:.3f].")
]


@app.command("list")
def list_results(
    *,
    where: Where = None,
    sweep: SweepName = None,
    evaluation: EvaluationName = None,
    sort: Sort = None,
    columns: Columns = None,
    superseded: Superseded = False,
    also: Also = None,
    form: Annotated[PrintFormat, typer.Option("--format", help="How to print.")] = PrintFormat.TABLE,
) -> None:
    """List runs with their results, one line a run and evaluation, the latest first.

    Example: slamhive results list --where "outcome != 'Tracked'" --sort=-coverage
    """
    found = _select(Selection(_sweeps(sweep), evaluation, where, superseded=superseded, each=True), also)
    frame = found.frame
    wanted = _columns(columns, frame, "columns")
    same: dict[str, Any] = {}
    if wanted is None and form not in (PrintFormat.JSON, PrintFormat.CSV):
        wanted, same = _telling(frame)
    usual = wanted or _usual(frame)
    shown = [Metric.parse(name) for name in usual]
    names = [metric.column for metric in shown]
    frame.require(names)
    rows = _sorted(frame, sort, NEWEST).records(names)
    match form:
        case PrintFormat.JSON:
            write_json(sys.stdout, rows)
        case PrintFormat.CSV:
            write_csv(sys.stdout, names, ([row[name] for name in names] for row in rows))
        case _:
            if same:
                _print_shared(same)
            texts = [
                time_text if frame.column(one.column).kind is ColumnKind.TIME else partial(_short, one)
                for one in shown
            ]
            lines = [[text(row[name]) for text, name in zip(texts, names, strict=True)] for row in rows]
            with declared_units(frame.units):
                titles = [
                    key_title(one.column, names)
                    if one.column.startswith("parameters.")
                    else one.title_among(names)
                    for one in shown
                ]
            _print(form, titles, lines)
            hidden = [name for name in varying(frame) if name not in names] if columns is None else []
            if hidden:
                remark(f"{plural(len(hidden), 'more setting')} varied: --columns shows them")
            for note in (*meanings(frame, names), *late_notes(frame, names), *disproportion_notes(frame)):
                remark(note)
            _remark(found)


app.command("show")(show_run)
app.command("note")(note_runs)


@app.command("table")
def show_table(
    *,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            "--metric", "-m", metavar="COLUMN[:UNIT][:.3f]", help="What to average; may be repeated."
        ),
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
    superseded: Superseded = False,
    also: Also = None,
    published: Annotated[
        bool,
        typer.Option(
            "--published", help="Add published numbers on the same datasets, in a table of their own."
        ),
    ] = False,
    form: Annotated[PrintFormat, typer.Option("--format", help="How to print.")] = PrintFormat.TABLE,
) -> None:
    """Average over repetitions: mean ± standard deviation (n − 1), coverage, n, and what failed.

    Algorithms, datasets, evaluations, paces and processors are never averaged together.

    Example: slamhive results table --rows parameters.nFeatures -m ate.rmse:cm:.3f -m usage.cpu.meanCores
    """
    chosen = _select(Selection(_sweeps(sweep), evaluation, where, superseded=superseded), also)
    frame = chosen.frame
    metrics = [Metric.parse(text) for text in metric or usual_columns(TABLE_METRICS, frame, filled=True)]
    by, across = _keys(rows, frame, "rows"), _keys(columns, frame, "columns") or []
    frame.require([*(one.column for one in metrics), *(by or ()), *across])
    with uncollected():
        found = aggregate(frame, [one.column for one in metrics], by, outcomes, across)
    if not metric:
        figures = found.cells.columns.figures
        metrics = [one for one in metrics if figures[one.column].summaries.n.any()]
    found = replace(found, cells=found.cells.sorted(_order(found, sort)))
    beside: list[Published] = []
    if published:
        from slamhive.cli.published import found_for, print_published

        beside = found_for(frame)
    others = [one.flat() for one in beside]
    match form:
        case PrintFormat.JSON:
            write_json(sys.stdout, chain(flat_cells(found), others))
        case PrintFormat.CSV:
            first = islice(flat_cells(found), 1)  # the others have the same names
            names = list(dict.fromkeys(name for row in (*first, *others) for name in row))
            flat = chain(flat_cells(found), others)
            write_csv(sys.stdout, names, ([row.get(name) for name in names] for row in flat))
        case _:
            shared = {name: value for name, value in constants(found, by or ()).items() if name not in across}
            if shared:
                _print_shared(shared)
            with declared_units(frame.units), uncollected():
                left_out = {*shared, *implied(found, by or ())}
                spare = () if by else spare_settings(found, _MOST_SETTINGS, left_out)
                written = table_columns(found, across, metrics, {*left_out, *spare})
                _print_columns(form, *written)
            if spare:
                what = f"{plural(len(spare), 'setting')} left out, as rows are told apart without"
                remark(f"{what}: --rows NAME,… shows some; --format csv has all")
            if len(written[0]) > _MOST_READ:
                remark(f"{len(written[0])} columns: --rows NAME,… chooses among them; --format csv has all")
            shown = [*(one.column for one in metrics), "coverage"]
            said = meanings(frame, shown) if found.cells else []
            for note in (*said, *spread_notes(found), *found.notes, *disproportion_notes(frame)):
                remark(note)
            _remark(chosen, found)
            if published:
                print_published(beside, metrics, lambda heads, lines: _print(form, heads, lines))


@app.command("export")
def export(
    *,
    form: Annotated[
        PrintFormat | None, typer.Option("--format", help="csv, json or markdown; default: csv.")
    ] = None,
    to: Annotated[
        BridgeTarget | None,
        typer.Option(
            help="Write the runs for another program into the folder that -o names; nothing is sent."
        ),
    ] = None,
    output: Output = None,
    where: Where = None,
    sweep: SweepName = None,
    evaluation: EvaluationName = None,
    sort: Sort = None,
    columns: Annotated[
        str | None, typer.Option(metavar="COLUMN,…", help="What to write; default: everything.")
    ] = None,
    superseded: Superseded = False,
    reused: Annotated[
        bool, typer.Option("--reused", help="Include runs that took over an equal run's result.")
    ] = False,
    also: Also = None,
) -> None:
    """Write every run and evaluation as a row, numbers with all their digits.

    Example: slamhive results export --format json --sweep demo -o demo.json
    """
    selection = Selection(_sweeps(sweep), evaluation, where, superseded=superseded, each=reused)
    if to is not None:
        unused = {"--format": form, "--sort": sort, "--columns": columns, "--also": also}
        _hand_over(to, output, selection, unused)
        return
    if form is PrintFormat.TABLE:
        raise InputError("--format: export writes csv, json or markdown; results list prints a table")
    chosen = _select(selection, also)
    frame = chosen.frame
    wanted = _columns(columns, frame, "columns") or frame.names
    frame.require(wanted)
    ordered = _sorted(frame, sort)
    with _stream(output) as stream:
        match form or PrintFormat.CSV:
            case PrintFormat.JSON:
                write_json(stream, _records(ordered, wanted))
            case PrintFormat.CSV:
                stream.writelines(csv_blocks(wanted, _blocks(ordered, wanted)))
            case _:
                rows = _records(ordered, wanted)
                write_markdown(stream, wanted, ([key_text(row[name]) for name in wanted] for row in rows))
    for note in chosen.notes:
        remark(note)


def _blocks(frame: Frame, names: Sequence[str]) -> Iterator[list[list[Any]]]:
    """Go through a table some rows at a time, column by column."""
    for part in _parts(frame):
        yield [part.column(name).tolist() for name in names]


def _records(frame: Frame, names: Sequence[str]) -> Iterator[Row]:
    """Go through a table row by row, without holding all of them."""
    for part in _parts(frame):
        yield from part.records(names)


def _parts(frame: Frame) -> Iterator[Frame]:
    for start in range(0, len(frame), _BLOCK):
        yield frame.select(np.arange(start, min(start + _BLOCK, len(frame))))


def _hand_over(to: BridgeTarget, output: Path | None, selection: Selection, unused: dict[str, Any]) -> None:
    """Write runs for another program."""
    from slamhive.bridges.exporting import export, next_step
    from slamhive.bridges.places import Here

    for option, value in unused.items():
        if value is not None:
            raise InputError(f"{option}: is for rows; --to {to} writes whole runs")
    if output is None:
        raise InputError(f"--output: --to {to} writes a folder: name it by -o DIR")
    if output.exists() and not output.is_dir():
        raise InputError(f"--output: {output} is there and no folder")
    chosen = _select(selection)
    home = Home.from_environment()
    total = len(set(chosen.frame.column("uid").tolist()))
    with Work(f"writing for {to}") as work:
        done = lambda count: work.count(count, total)  # noqa: E731
        if total:
            with Here.open(home.archive_url, home.path) as here:
                new, same, renamed, missing = export(chosen.frame, to, output, here, done)
        else:
            new, same, renamed, missing = 0, 0, {}, {}
    out.print(f"{output}: {plural(new, 'run')} written, {same} there already", soft_wrap=True, markup=False)
    if renamed:
        names = [f"{new_name} for {name}" for name, new_name in renamed.items()]
        remark(f"{to} takes no such names, which are in tags: {listing(names)}")
    for note, count in missing.items():
        remark(f"{plural(count, 'run')}: {note}")
    _remark(chosen)
    if total:
        out.print(f"Next:  {next_step(to, output)}", soft_wrap=True, markup=False)


@app.command("measure")
def measure(*, where: Where = None, sweep: SweepName = None) -> None:
    """Measure finished runs again whose results an earlier version of the evaluation made.

    Their trajectories must still be on this machine. Nothing is run again. Ends with 1 if the machine or a
    file was in the way.

    Example: slamhive results measure --sweep demo
    """
    selection = Selection(_sweeps(sweep), None, where, superseded=True, each=True)
    frame, _ = choose_runs(selection, "there is nothing to measure")
    from slamhive.local.running.evaluations import measure_outdated

    home = Home.from_environment()
    with home.sharing(), (bench := open_workbench(home)).archive:
        done, problems = measure_outdated(bench, set(frame.column("uid").tolist()))
    for problem in problems[:_MOST_PROBLEMS]:
        complain(problem.sentence)
    if len(problems) > _MOST_PROBLEMS:
        complain(f"{len(problems) - _MOST_PROBLEMS} more could not be measured")
    is_current = not (done or problems)
    out.print("all results are up to date" if is_current else f"{plural(done, 'run')} measured again")
    if any(problem.is_fault for problem in problems):
        raise typer.Exit(FAILED)


app.command("suspects")(show_suspects)
app.command("nodes")(show_nodes)
app.command("robustness")(show_robustness)
app.command("prune")(prune)


def _with_home(names: Sequence[str], frame: Frame) -> Sequence[str]:
    """Return names of columns, with that of the home where there are several."""
    return (names[0], COLUMN, *names[1:]) if COLUMN in frame.stored else names


def _select(selection: Selection, also: Sequence[str] | None = ()) -> Chosen:
    """Return the rows asked for; an archive that isn't there yet is an empty one.

    Args:
        selection: what is meant.
        also: other homes; None for those of the environment.
    """
    home = Home.from_environment()
    if others := homes_beside(home, also):
        return choose(read_homes(home, others), selection)
    found = Frame({}, 0) if home.missing_archive else read_archive(home.archive_url, home.path / "cache")
    return choose(found, selection)


def _sweeps(name: str | None) -> tuple[str, ...]:
    return () if name is None else (name,)


def _telling(frame: Frame) -> tuple[list[str], dict[str, Any]]:
    """Return the columns of a list for people: settings that vary, and not what is the same in all runs.

    Returns:
        The columns, and what all runs share, by name.
    """
    names = _usual(frame)
    same: dict[str, Any] = {}
    if len(frame) > 1:
        for name in _SAID_ONCE:
            _, values = frame.column(name).factorized()
            if len(values) == 1 and frame.column(name).present.all():
                same[name] = values[0]
    if not frame.column("reason").is_empty:  # why a run failed, where others have an outcome
        names = ["status" if name == "outcome" else name for name in names if name != "phase"]
    names.remove("finished")
    if not frame.column("finished").is_empty:
        names.insert(names.index("run") + 1, "finished")
    at = names.index("repetition")
    paces = [PACE] if varies(frame, PACE) else []
    names[at:at] = [name for name in [*paces, *varying(frame)][:_MOST_SETTINGS] if name not in names]
    return [name for name in names if name not in same], same


def _short(metric: Metric, value: Any) -> str:
    """Return a value's text, the beginning of a long note."""
    text = value_text(metric, value)
    return f"{text[:_MOST_NOTE]}…" if metric.column == "note" and len(text) > _MOST_NOTE else text


def _usual(frame: Frame) -> list[str]:
    """Return the columns of a list: words of people too, where there are any."""
    said = [name for name in ("tags", "note") if not frame.column(name).is_empty]
    return [*usual_columns(_with_home(LIST_COLUMNS, frame), frame), *said]


def usual_columns(names: Sequence[str], frame: Frame, *, filled: bool = False) -> list[str]:
    """Return the columns that are shown unless told: mean cores only where the clock alone set the pace.

    What players note of nodes is shown where there is any (causal errors, latency, whether they kept up), and
    so are frames that were dropped, and by which method a search chose a run.

    Args:
        names: what is shown otherwise.
        frame: the rows.
        filled: whether columns without a value are left out.
    """
    timed = by_clock(frame).any()
    hidden = set() if timed else {"usage.cpu.meanCores"}
    if not any_dropped(frame):
        hidden.add(DROPPED)
    shown = [name for name in names if name not in hidden]
    return [name for name in shown if not ((filled or name in _WHERE_ANY) and frame.column(name).is_empty)]


def _names(text: str | None) -> list[str] | None:
    return split_names(text) if text else None


def _columns(text: str | None, frame: Frame, argument: str) -> list[str] | None:
    """Return the columns that an option names, each in whole or by its last part where that is clear."""
    names = _names(text)
    return None if names is None else [frame.resolve(name, argument) for name in names]


def _keys(text: str | None, frame: Frame, argument: str) -> list[str] | None:
    """Return the columns by which an option tells runs apart."""
    names = _names(text)
    return None if names is None else [frame.resolve_key(name, argument) for name in names]


def _sorted(frame: Frame, sort: str | None, usual: Sequence[str] = ()) -> Frame:
    asked = _names(sort) or []
    frame.require((name.removeprefix("-") for name in asked), "sort")
    order = asked or usual
    return frame.select(order_rows(frame, order)) if order else frame


def _order(found: Aggregate, sort: str | None) -> list[str]:
    """Return the order of a table's groups: keys, means of metrics, coverage or n."""
    asked = _names(sort) or []
    known = [*found.keys, *found.metrics, "coverage", "n"]
    for name in asked:
        if name.removeprefix("-") not in known:
            raise UnknownNameError("column", name.removeprefix("-"), known, "--sort")
    return asked


def _print_shared(keys: Mapping[str, Any]) -> None:
    told = ", ".join(f"{name} {key_text(value)}" for name, value in keys.items())
    out.print(printable(told), markup=False)


def _print(form: PrintFormat, headings: Sequence[str], lines: Sequence[Sequence[str]]) -> None:
    if form is PrintFormat.MARKDOWN:
        write_markdown(sys.stdout, headings, lines)
    else:
        show(out, headings, lines)


def _print_columns(form: PrintFormat, headings: Sequence[str], columns: Sequence[Sequence[str]]) -> None:
    if form is PrintFormat.MARKDOWN:
        write_markdown(sys.stdout, headings, zip(*columns, strict=True))
    else:
        show_columns(out, headings, columns)


def _remark(chosen: Chosen, found: Aggregate | None = None) -> None:
    """Say what was left out, and what a table that shows little lacks."""
    for note in chosen.notes:
        remark(f"{note}; --superseded shows them" if "earlier versions left out" in note else note)
    if not len(chosen.frame) and not chosen.superseded:
        from slamhive.archive.connection import shown

        location = shown(Home.from_environment().archive_url)
        remark(f"no such run in {location}; slamhive demo, run and import add runs")
    elif found is not None and found.cells and not found.cells.columns.n.any():
        remark("no run counts, so nothing is averaged; --outcomes all takes all runs that were evaluated")


@contextmanager
def _stream(output: Path | None) -> Iterator[TextIO]:
    if output is None:
        yield sys.stdout
        return
    with output_whole(output) as aside, aside.open("w", encoding="utf-8", newline="") as stream:
        yield stream
