# SPDX-License-Identifier: Apache-2.0
"""``slamhive results show``: all that is known of one run; ``view`` finds its run here too."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamhive.analysis.flattening import Results, columns_of_runs
from slamhive.analysis.frame import Frame
from slamhive.analysis.metrics import Metric
from slamhive.cli.parts.choosing import Also
from slamhive.cli.parts.console import out, plural
from slamhive.cli.parts.tables import show, write_json
from slamhive.local.home.folder import Home
from slamhive.local.home.removed import absence
from slamhive.model.errors import UnknownNameError
from slamhive.tables.homes import COLUMN, OWN, homes_beside, uid_in
from slamhive.tables.text import value_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from slamhive.archive import Archive
    from slamhive.model.results import Result, RunRecord

    Row = dict[str, Any]

_BY_TIME = "relations.byTime["


def show_run(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Name, UID or label run of a run.")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    also: Also = None,
) -> None:
    """Show all that is known of a run.

    Example: slamhive results show demo-3f2a
    """
    for record, label, folder in _found(run, also):
        rows = _rows_of(record)
        gone = absence(folder, record.folder)
        if label is not None:
            rows = [{COLUMN: label} | row for row in rows]
        if as_json:
            rows = [row | {"files.absence": gone} for row in rows] if gone else rows
            write_json(sys.stdout, rows)
            continue
        _show_record(record, rows, gone)


def _found(run: str, also: Sequence[str] | None) -> list[tuple[RunRecord, str | None, Path | None]]:
    """Return the runs that a name means in all homes that are read, with label and folder of each home.

    Raises:
        UnknownNameError: there is none.
    """
    from slamhive.archive import Archive

    home = Home.from_environment()
    others = homes_beside(home, also)
    places: list[tuple[str, str, Path | None]] = [(OWN, home.archive_url, home.path)]
    places += [(one.label, one.url, one.path) for one in others]
    plain, meant = uid_in(run, [label for label, _, _ in places])
    found: list[tuple[RunRecord, str | None, Path | None]] = []
    unknown: UnknownNameError | None = None
    for label, url, folder in places:
        if meant not in {None, label}:
            continue
        with Archive.open(url, read_only=True) as archive:
            try:
                records = find_runs(archive, plain)
            except UnknownNameError as error:
                unknown = unknown or error
                continue
        found += [(record, label if others else None, folder) for record in records]
    if unknown is not None and not found:
        raise unknown
    return found


def _rows_of(record: RunRecord) -> list[Row]:
    """Return all that is known of a run, one row an evaluation."""
    from slamhive.archive.records import run_row

    row = run_row(record) | {"id": 0}
    found = Results.of((0, result) for result in record.results)
    columns, length = columns_of_runs({name: [value] for name, value in row.items()}, found, frozenset())
    frame = Frame(columns, length)
    return frame.records([name for name in frame.names if not frame.column(name).is_empty])


def find_runs(archive: Archive, run: str) -> list[RunRecord]:
    """Return the runs that a UID, a name or a label `run` means.

    Raises:
        UnknownNameError: there is none.
    """
    record = archive.get(run)
    if record is not None:
        return [record]
    if named := archive.by_names([run]):
        return named
    names: list[str] = []
    matching = []
    for candidate in archive.runs():
        label = candidate.labels.get("run")
        if label == run:
            matching.append(candidate)
        names.append(candidate.name)
    if not matching:
        raise UnknownNameError("run", run, names)
    return matching


def _show_record(record: RunRecord, rows: Sequence[Row], gone: str | None) -> None:
    names = [name for name in rows[0] if not name.startswith(("transform", "id", _BY_TIME))]
    common = [name for name in names if all(name in row and row[name] == rows[0][name] for row in rows)]
    out.print(record.name, style="bold", markup=False)
    plain = {name: Metric.parse(name) for name in names}
    show(
        out,
        ["of the run", ""],
        [[plain[name].heading, value_text(plain[name], rows[0][name])] for name in common],
    )
    results = [name for name in names if name not in common]
    if results:
        lines = [
            [plain[name].heading, *(value_text(plain[name], row.get(name)) for row in rows)]
            for name in results
        ]
        show(out, ["by evaluation", *(str(row["evaluation"]) for row in rows)], lines)
    for result in record.results:
        _show_relations(result)
        _show_points(result)
    if gone:
        out.print(f"{gone}: only the record is left", style="bold", markup=False)
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


def _show_points(result: Result) -> None:
    """Show the errors at control points, one by one, and what such points can't say."""
    errors = result.values.get("pointErrors") or []
    if not errors:
        return
    counts = result.values.get("points") or {}
    lines = [[f"{one['time']:.3f}", f"{one['error']:.4g}"] for one in errors]
    show(out, [f"control points, {result.evaluation}: time [s]", "error [m]"], lines)
    left_out = int(counts.get("met", len(errors))) - len(errors)
    if left_out > 0:
        out.print(f"and {plural(left_out, 'point')} with smaller errors")
    for note in result.values.get("notes") or []:
        out.print(f"note: {note}", markup=False)
