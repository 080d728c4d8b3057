# SPDX-License-Identifier: Apache-2.0
"""``slamhive home`` and ``slamhive gc``: what takes a home's room, and removal of what nothing refers to."""

from __future__ import annotations

import sys
from collections import defaultdict
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.archive import Archive
from slamhive.archive.connection import shown
from slamhive.cli.parts.asking import DryRun, Yes, agreed, progress, require_archive
from slamhive.cli.parts.console import bytes_text, open_archive, out, remark
from slamhive.cli.parts.tables import show, write_json
from slamhive.local.home.extent import total
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.local.housekeeping.collecting import CollectOptions, HomeFind
    from slamhive.local.housekeeping.occupancy import Room


def home(
    *,
    size: Annotated[bool, typer.Option("--size", help="Show what takes space, the largest first.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say where everything is kept: $SLAMHIVE_HOME. With --size: what takes space, and how to free it.

    Example: slamhive home --size
    """
    place = Home.from_environment()
    _require_readable(place)
    rooms: list[Room] = []
    if size:
        from slamhive.local.housekeeping.occupancy import occupancy

        rooms = occupancy(place.path)
    if as_json:
        kinds = [
            {"kind": room.kind, "items": room.items, "bytes": room.extent.size, "files": room.extent.files}
            | ({"removedBy": room.remedy} if room.remedy else {})
            for room in rooms
        ]
        told = {"home": str(place.path), "archive": shown(place.archive_url)}
        write_json(sys.stdout, [told | ({"size": kinds} if size else {})])
        return
    out.print(f"home:     {place.path}", soft_wrap=True, markup=False)
    out.print(f"archive:  {shown(place.archive_url)}", soft_wrap=True, markup=False)
    if not size:
        remark("what takes its room: slamhive home --size")
        return
    whole = total(room.extent for room in rooms)
    lines = [
        [room.kind, f"{room.items:,}", bytes_text(room.extent.size), f"{room.extent.files:,}", room.remedy]
        for room in rooms
    ]
    show(out, ["what", "items", "size", "files", "what gives it back"], lines)
    out.print(f"together: {bytes_text(whole.size)} in {plural(whole.files, 'file')}")


def gc(
    *,
    made_again: Annotated[
        bool, typer.Option("--all", help="Remove also what can be made again: everything that is not in use.")
    ] = False,
    unrecorded: Annotated[
        bool,
        typer.Option("--unrecorded", help="Remove also folders of runs that have no record in the archive."),
    ] = False,
    yes: Yes = False,
    dry_run: DryRun = False,
) -> None:
    """Remove what nothing refers to: variants, environments, assets, and leftovers of killed commands.

    What is in use or referred to stays, and is said. Files of runs that have a record: results prune.

    Example: slamhive gc --dry-run
    """
    from slamhive.local.housekeeping.collecting import CollectOptions, collect
    from slamhive.local.housekeeping.forgetting import alone

    place = Home.from_environment()
    require_archive(place)
    asked = CollectOptions(made_again, unrecorded)
    finds = _survey(place, asked)
    _tell(finds)
    going = {find.path for find in finds if find.goes}
    if not going:
        out.print("nothing to remove")
        return
    if not agreed("Remove these?", yes=yes, dry_run=dry_run):
        return
    with alone(place, "slamhive gc"):
        # Looked at again, as nobody was kept from anything while the user thought about it.
        finds = [find for find in _survey(place, asked) if find.goes and find.path in going]
        with progress("removing", len(finds)) as step:
            gone, kept = collect(place, finds, step)
    extent = total(find.extent for find in gone)
    out.print(f"removed: {_counted(gone)}, {bytes_text(extent.size)} in {plural(extent.files, 'file')}")
    if kept:
        remark(f"{_counted(kept)} stayed, as somebody works with it")


def _survey(place: Home, asked: CollectOptions) -> list[HomeFind]:
    from slamhive.cli.forgetting import known_runs
    from slamhive.local.home.catalog import load_workshop
    from slamhive.local.housekeeping.collecting import survey
    from slamhive.tables.reading import read_table

    with suppress(SystemFault):  # a full disk is to be freed; what else may be wrong, reading says
        open_archive(place).close()  # brings an earlier version up to date, and refuses a newer one
    table = read_table(place.archive_url)
    datasets = {str(name) for name in table.frame.column("dataset").unique() if name is not None}
    datasets |= {one.dataset for one in table.left_out if one.dataset is not None}
    if asked.unrecorded and table.left_out:
        remark("folders of runs without a record stay: a record that can't be read may be theirs")
        asked = replace(asked, unrecorded=False)
    known = known_runs(table.frame, table.left_out)
    return survey(place, load_workshop(place), known, datasets, asked)


def _require_readable(place: Home) -> None:
    """Refuse a home whose archive a newer slamhive wrote, as its folders may mean other things there."""
    if not place.missing_archive:
        Archive.open(place.archive_url, read_only=True).close()


def _tell(finds: Iterable[HomeFind]) -> None:
    for goes, heading in ((False, "stays because"), (True, "goes because")):
        groups: dict[tuple[str, str], list[HomeFind]] = defaultdict(list)
        for find in finds:
            if find.goes is goes:
                groups[find.kind, find.why].append(find)
        sizes = {key: total(find.extent for find in found) for key, found in groups.items()}
        lines = [
            [kind, f"{len(groups[kind, why]):,}", bytes_text(sizes[kind, why].size), why]
            for kind, why in sorted(groups, key=lambda key: -sizes[key].size)
        ]
        if lines:
            show(out, ["what", "items", "size", heading], lines)
    extent = total(find.extent for find in finds if find.goes)
    if extent.files:
        out.print(f"to remove: {bytes_text(extent.size)} in {plural(extent.files, 'file')}")


def _counted(finds: Iterable[HomeFind]) -> str:
    return plural(len(list(finds)), "thing")
