# SPDX-License-Identifier: Apache-2.0
"""``slamhive sweep``: the sweeps that the archive knows, their names, and forgetting them."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from slamhive.analysis.frame import Frame
from slamhive.analysis.grouping import where_equal
from slamhive.cli.forgetting import known_runs, prune_chosen, uids_of
from slamhive.cli.parts.asking import DryRun, Yes, require_archive
from slamhive.cli.parts.console import bytes_text, open_archive, out, remark
from slamhive.cli.parts.tables import show, write_json
from slamhive.local.home.extent import DiskTally
from slamhive.local.home.folder import Home
from slamhive.local.home.removed import run_parts
from slamhive.local.home.sweeping import named_sweeps, rename_sweep, sweeps_meant
from slamhive.local.housekeeping.forgetting import alone
from slamhive.model.base import plural
from slamhive.model.results import Phase
from slamhive.tables.reading import read_table

if TYPE_CHECKING:
    from slamhive.local.home.sweeping import Named

app = typer.Typer(no_args_is_help=True, help="Sweeps in the archive: list, rename and remove them.")

Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name, NAMESPACE/NAME, or 8 digits of its identity.")
]


@app.command("list")
def list_sweeps(
    *,
    size: Annotated[bool, typer.Option("--size", help="Show also the size of each sweep's files.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the sweeps that were asked for, the latest last.

    Example: slamhive sweep list --size
    """
    place = Home.from_environment()
    require_archive(place, "")
    table = read_table(place.archive_url, place.path / "cache")
    tally = DiskTally()
    rows = [
        _row(one, table.frame, place, tally if size else None) for one in named_sweeps(table.sweeps or ())
    ]
    if as_json:
        write_json(sys.stdout, rows)
        return
    headings = ["sweep", "asked for", "versions", "runs", "succeeded", "failed", "superseded"]
    lines = []
    for row in rows:
        where = f"{row['namespace']}/" if row["namespace"] else ""
        when = str(row["asked"] or "–")[:16].replace("T", " ")
        counts = [f"{row[name]:,}" for name in ("versions", "runs", "succeeded", "failed", "superseded")]
        lines.append([f"{where}{row['sweep']}", when, *counts, *([bytes_text(row["bytes"])] if size else [])])
    show(out, [*headings, *(["files"] if size else [])], lines)


@app.command("rename")
def rename(name: Name, new: Annotated[str, typer.Argument(metavar="NEW", help="New name.")]) -> None:
    """Give a sweep another name. It keeps its identity, and its runs theirs, with names and folders.

    Change the name in its file too: a file with the old name is refused.

    Example: slamhive sweep rename test7 icra-final
    """
    home = Home.from_environment()
    require_archive(home, "")
    with open_archive(home) as archive, alone(home, "slamhive sweep rename"):
        count = rename_sweep(archive, name, new)
    out.print(f"{name} is {new} now, with {plural(count, 'run')}", markup=False, soft_wrap=True)
    remark(f"in its file: metadata.name: {new}. The folders of its runs stay where they are")


@app.command("remove")
def remove(name: Name, *, yes: Yes = False, dry_run: DryRun = False) -> None:
    """Forget a sweep: its runs with files and records. To keep the numbers: results prune --sweep NAME.

    Example: slamhive sweep remove test7 --dry-run
    """
    home = Home.from_environment()
    require_archive(home)
    with open_archive(home) as archive:
        uids = {one.uid for one in sweeps_meant(archive.sweeps(), name)}

    def chosen(frame: Frame) -> set[str]:
        return set(uids_of(frame.select(_of(frame, uids))))

    prune_chosen(
        home, chosen, records=True, yes=yes, dry_run=dry_run, then=lambda archive: archive.remove_sweeps(uids)
    )
    if not dry_run:
        out.print(f"forgotten: sweep {name}", markup=False)


def _of(frame: Frame, uids: set[str]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    mask = np.zeros(len(frame), dtype=bool)
    for uid in uids:
        mask |= where_equal(frame, "sweep.uid", uid)
    return mask


def _row(sweep: Named, frame: Frame, place: Home, tally: DiskTally | None) -> dict[str, Any]:
    own = frame.select(_of(frame, set(sweep.uids)))
    latest = sweep.versions[-1].created
    row: dict[str, Any] = {
        "sweep": sweep.name,
        "namespace": sweep.namespace,
        "cluster": sweep.cluster,
        "asked": datetime.fromtimestamp(latest, UTC).isoformat() if latest else None,
        "versions": len(sweep.versions),
        "runs": len(uids_of(own)),
        "succeeded": len(uids_of(own.select(where_equal(own, "phase", Phase.SUCCEEDED.value)))),
        "failed": len(uids_of(own.select(where_equal(own, "phase", Phase.FAILED.value)))),
        "superseded": len(uids_of(own.select(own.column("superseded").present))),
    }
    if tally is not None:
        folders = {parts for run in known_runs(own) if (parts := run_parts(run.folder))}
        row["bytes"] = tally.of(*(place.path.joinpath("runs", *parts) for parts in sorted(folders))).size
    return row
