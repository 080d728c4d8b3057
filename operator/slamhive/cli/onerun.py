# SPDX-License-Identifier: Apache-2.0
"""``slamhive results show`` and ``note``: runs by their names; ``view`` finds its run here too."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamhive.analysis.flattening import Results, columns_of_runs
from slamhive.analysis.frame import Frame
from slamhive.analysis.measuring import outdated_note
from slamhive.analysis.metrics import Metric
from slamhive.analysis.selection import Selection
from slamhive.cli.parts.asking import require_archive
from slamhive.cli.parts.choosing import Also, Superseded, Where, choose_runs
from slamhive.cli.parts.console import listing, open_archive, out, remark
from slamhive.cli.parts.tables import show, write_json
from slamhive.local.home.changes import current_uid
from slamhive.local.home.folder import Home
from slamhive.local.home.removed import absence
from slamhive.model.base import plural
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.tables.homes import COLUMN, OWN, homes_beside, uid_in
from slamhive.tables.text import value_text
from slamhive.tables.timeliness import causal_result, late_note
from slamhive.tables.words import disproportion

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from slamhive.archive import Archive
    from slamhive.archive.remarks import Remarks
    from slamhive.model.results import Result, RunRecord

    Row = dict[str, Any]

_BY_TIME = "relations.byTime["
_ELSEWHERE = ("transform", "id", _BY_TIME, "healthLosses", "healthWarnings")
"""Beginnings of the columns that the table of a run leaves out."""
_SHOWN = 10


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
        rows = rows_of(record)
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


def note_runs(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RUN… [TEXT]",
            help="Names, UIDs or labels run of runs; then the note, if it is of several words.",
        ),
    ] = None,
    *,
    text: Annotated[
        str | None, typer.Option("--text", metavar="TEXT", help="The note, also one of a single word.")
    ] = None,
    tag: Annotated[
        list[str] | None, typer.Option("--tag", metavar="TAG", help="Add a tag; may be repeated.")
    ] = None,
    remove_tag: Annotated[
        list[str] | None, typer.Option("--remove-tag", metavar="TAG", help="Remove a tag; may be repeated.")
    ] = None,
    clear: Annotated[
        bool, typer.Option("--clear", help="Remove the note and all tags, before any are added.")
    ] = False,
    where: Where = None,
    sweep: Annotated[str | None, typer.Option(metavar="NAME", help="Runs of this sweep.")] = None,
    superseded: Superseded = False,
) -> None:
    """Put a note and tags on runs; a note replaces an earlier one. Without any, show those there are.

    Example: slamhive results note demo-3f2a "tried robust kernel" --tag robust
    """
    from slamhive.archive import Archive
    from slamhive.archive.remarks import checked_note, checked_tags

    names = list(words or [])
    if text is None and names and len(names[-1].split()) != 1:
        text = names.pop()
    note = None if text is None else checked_note(text)
    add, remove = checked_tags(tag or (), "tag"), checked_tags(remove_tag or (), "remove-tag")
    if bool(names) == bool(where or sweep):
        raise InputError("say which runs: either by RUN, or by --where and --sweep")
    home = Home.from_environment()
    selection = Selection((sweep,) if sweep else (), None, where, superseded=superseded, each=True)
    if note is None and not (add or remove or clear):
        with Archive.open(home.archive_url, read_only=True) as archive:
            for name, remarks in _meant(archive, names, selection).values():
                out.print(f"{name}: {remarks.sentence}", soft_wrap=True, markup=False)
        return
    require_archive(home, ": there is no run to put a note on")
    with home.sharing("slamhive results note"), open_archive(home) as archive:
        runs = _meant(archive, names, selection)
        found = archive.annotate(runs, lambda had: had.changed(note, add, remove, clear=clear))
    _tell_of_notes({uid: name for uid, (name, _) in runs.items()}, found)


def _tell_of_notes(names: Mapping[str, str], found: Mapping[str, tuple[Remarks, Remarks]]) -> None:
    """Say which notes and tags runs have now, and which notes are gone.

    Args:
        names: of the runs that were meant, by UID.
        found: what each had and has, by UID.
    """
    replaced = [uid for uid, (had, has) in found.items() if had.note and had.note != has.note]
    for uid, (had, has) in list(found.items())[:_SHOWN]:
        out.print(f"{names[uid]}: {has.sentence}", soft_wrap=True, markup=False)
        if uid in replaced:
            remark(f"{names[uid]}: its note was “{had.note}”")
    if len(found) > 1:
        changed = sum(not has.says_same(had) for had, has in found.values())
        more = f", of which {len(replaced):,} had another note" if replaced else ""
        out.print(f"{changed:,} of {plural(len(found), 'run')} changed{more}")


def _meant(archive: Archive, names: Sequence[str], selection: Selection) -> dict[str, tuple[str, Remarks]]:
    """Return the names, notes and tags of the runs that a command means, by UID.

    Args:
        archive: one's own.
        names: of runs; none where they are selected.
        selection: what is meant then.

    Raises:
        InputError: no run is meant, one of another home, or several by one name.
    """
    from slamhive.archive.remarks import Remarks, split

    if names:
        records = [_own_run(archive, name) for name in names]
        return {record.uid: (record.name, Remarks.of(record)) for record in records}
    frame, notes = choose_runs(selection, "there is nothing to put a note on")
    for note in notes:
        remark(note)
    return {
        row["uid"]: (row["name"], Remarks(row["note"], tuple(split(row["tags"]))))
        for row in frame.records(["uid", "name", "note", "tags"])
    }


def _own_run(archive: Archive, name: str) -> RunRecord:
    """Return the run of one's own home that a name means.

    Raises:
        InputError: there is none, one of another home, or several.
    """
    try:
        return find_run(archive, name, "RUN")
    except UnknownNameError as unknown:
        try:
            label = _found(name, None)[0][1]
        except UnknownNameError:
            raise InputError(f"RUN: {unknown} (a note of one word is given by --text)") from None
    raise InputError(
        f"RUN: {name} is a run of another home, {label}: notes are written in one's own alone. With "
        "SLAMHIVE_HOME set to it they are written there; `slamhive archive merge` brings them"
    )


def rows_of(record: RunRecord) -> list[Row]:
    """Return all that is known of a run, one row an evaluation."""
    from slamhive.archive.records import run_row

    row = run_row(record) | {"id": 0}
    found = Results.of((0, causal_result(record, result)) for result in record.results)
    columns, length = columns_of_runs({name: [value] for name, value in row.items()}, found, frozenset())
    frame = Frame(columns, length)
    return frame.records([name for name in frame.names if not frame.column(name).is_empty])


def find_runs(archive: Archive, run: str) -> list[RunRecord]:
    """Return the runs that a UID, a name or a label `run` means: of versions of a run the current one.

    Others of the name are told in a line.

    Raises:
        UnknownNameError: there is none.
    """
    record = archive.get(run)
    if record is not None:
        return [record]
    if named := archive.by_names([run]):
        return _current(named, run)
    names: list[str] = []
    matching = []
    for candidate in archive.runs():
        label = candidate.labels.get("run")
        if label == run:
            matching.append(candidate)
        names.append(candidate.name)
    if not matching:
        raise UnknownNameError("run", run, names)
    return _current(matching, run)


def find_run(archive: Archive, run: str, field: str) -> RunRecord:
    """Return the one run that a UID, a name or a label `run` means.

    Raises:
        InputError: several current ones are called so.
        UnknownNameError: there is none.
    """
    found = find_runs(archive, run)
    if len(found) > 1:
        uids = listing([record.uid for record in found])
        raise InputError(f"{field}: {len(found)} runs are called {run!r}: name one by its UID: {uids}")
    return found[0]


def _current(records: Sequence[RunRecord], run: str) -> list[RunRecord]:
    """Return runs without those that were set aside for one of them, and say how these are called."""
    uids = {record.uid for record in records}
    meant = [one for one in records if (uid := current_uid(one.uid)) == one.uid or uid not in uids]
    if len(meant) == 1 < len(records):
        others = listing([record.uid for record in records if record not in meant])
        remark(f"{len(records)} runs are called {run}: {meant[0].uid} is the current one; by UID: {others}")
    return meant


def _show_record(record: RunRecord, rows: Sequence[Row], gone: str | None) -> None:
    names = [name for name in rows[0] if not name.startswith(_ELSEWHERE)]
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
    if note := late_note(record):
        remark(note)
    for result in record.results:
        for note in (outdated_note(result.values), disproportion(result)):
            if note is not None:
                remark(f"{result.evaluation}: {note}")
        _show_relations(result)
        _show_points(result)
        _show_losses(result)
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


def _show_losses(result: Result) -> None:
    """Show when a run with health was lost, and how long before it warned."""
    losses = result.values.get("healthLosses") or []
    if not losses:
        return
    warns = "warning" in (result.values.get("health") or {})
    lines = [
        [
            f"{one['begin']:.3f}",
            f"{one['end'] - one['begin']:.3f}",
            "–" if not warns else "missed" if one["lead"] is None else f"{one['lead']:.3f}",
        ]
        for one in losses[:_SHOWN]
    ]
    show(out, [f"losses, {result.evaluation}: begin [s]", "for [s]", "warned before [s]"], lines)
    if len(losses) > _SHOWN:
        out.print(f"and {len(losses) - _SHOWN} more")
