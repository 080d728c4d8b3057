# SPDX-License-Identifier: Apache-2.0
"""``slamhive results prune``: forgetting runs, for it and for ``slamhive sweep remove``."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from slamhive.analysis.derived import SweepVersion, with_derived
from slamhive.analysis.frame import DERIVED
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.selection import Selection, choose, first_rows
from slamhive.cli.parts.asking import DryRun, Yes, agreed, progress, require_archive
from slamhive.cli.parts.console import bytes_text, open_archive, out, remark
from slamhive.cli.parts.tables import show
from slamhive.local.home.folder import Home
from slamhive.local.housekeeping.forgetting import ArchivedRun, alone, forget, plan_forgetting
from slamhive.model.base import plural, quantity
from slamhive.model.errors import InputError
from slamhive.model.results import Phase
from slamhive.tables.reading import read_table

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from slamhive.analysis.frame import Frame
    from slamhive.archive import Archive
    from slamhive.local.housekeeping.forgetting import Forgetting
    from slamhive.model.leftout import LeftOut
    from slamhive.tables.snapshots import Loaded

_DAYS = {"d": 1.0, "w": 7.0, "h": 1 / 24, "m": 1 / 1440}
_SHOWN = 15


def prune(
    *,
    superseded: Annotated[
        bool, typer.Option("--superseded", help="Runs of earlier versions: of an edited algorithm, …")
    ] = False,
    failed: Annotated[bool, typer.Option("--failed", help="Runs that failed.")] = False,
    older: Annotated[
        str | None,
        typer.Option("--older-than", metavar="AGE", help="Runs that ended longer ago, such as 30d or 12h."),
    ] = None,
    larger: Annotated[
        str | None,
        typer.Option("--larger-than", metavar="SIZE", help="Runs whose files take more, such as 100Mi."),
    ] = None,
    where: Annotated[
        str | None,
        typer.Option(metavar="EXPR", help="Runs that meet a condition, as in results table --where."),
    ] = None,
    sweep: Annotated[str | None, typer.Option(metavar="NAME", help="Runs of this sweep.")] = None,
    records: Annotated[
        bool, typer.Option("--records", help="Remove the records too: then the numbers are gone.")
    ] = False,
    yes: Yes = False,
    dry_run: DryRun = False,
) -> None:
    """Remove files of runs: maps, logs, trajectories. Their records stay, and with them all numbers.

    What is chosen must meet all that is asked for. Files that a run refers to which was not chosen stay.

    Example: slamhive results prune --superseded --dry-run
    """
    if not (superseded or failed or where or sweep or older or larger):
        raise InputError(
            "say which runs: --superseded, --failed, --older-than, --larger-than, --sweep or --where; what "
            "is given must all hold"
        )
    before = None if older is None else datetime.now(UTC).timestamp() - _age(older)
    size = None if larger is None else _size(larger)

    def chosen(frame: Frame) -> set[str]:
        selection = Selection((sweep,) if sweep else (), None, where, superseded=True, each=True)
        found = choose(frame, selection).frame
        mask = np.ones(len(found), dtype=bool)
        if superseded:
            mask &= found.column("superseded").present
        if failed:
            mask &= where_equal(found, "phase", Phase.FAILED.value)
        if before is not None:
            finished, created = (found.column(name).floats() for name in ("finished", "created"))
            mask &= np.where(np.isnan(finished), created, finished) < before
        return set(uids_of(found.select(mask)))

    prune_chosen(Home.from_environment(), chosen, records=records, larger=size, yes=yes, dry_run=dry_run)


def prune_chosen(
    home: Home,
    chosen: Callable[[Frame], Collection[str]],
    *,
    records: bool,
    larger: float | None = None,
    yes: bool,
    dry_run: bool,
    then: Callable[[Archive], None] = lambda _: None,
) -> None:
    """Forget runs: say what goes, ask, and remove it.

    Args:
        home: the home.
        chosen: returns the UIDs of the runs in a table of all runs.
        records: whether the records go too.
        larger: only runs whose files take more bytes.
        yes: don't ask.
        dry_run: remove nothing.
        then: called in the end with the archive, while the home is still held.
    """
    require_archive(home)
    with open_archive(home) as archive:
        table = read_table(home.archive_url)
        frame = table.frame
        plan = _plan(home, table, chosen(frame), records=records, larger=larger)
        _tell(plan)
        if records and plan.going:
            _tell_of_current(archive, frame, {one.run.uid for one in plan.going})
        if not plan.going:
            out.print("no run has anything to remove")
            if not dry_run and records:
                with alone(home, "a removal of runs"):
                    then(archive)
            return
        what = "files and records" if records else "files"
        if not agreed(f"Remove {what} of {plural(len(plan.going), 'run')}?", yes=yes, dry_run=dry_run):
            return
        shown = {one.run.uid for one in plan.going}
        with alone(home, "a removal of runs"):
            # Looked at again, as nobody was kept from anything while the user thought about it; what has
            # come since was not shown and stays.
            table = read_table(home.archive_url)
            plan = _plan(home, table, chosen(table.frame), records=records, larger=larger).restricted(shown)
            with progress("removing", len(plan.going)) as step:
                forget(home, archive, plan, step)
            then(archive)
    extent = plan.extent
    out.print(f"removed: {_counted(plan)}, {bytes_text(extent.size)} in {plural(extent.files, 'file')}")


def uids_of(frame: Frame) -> list[str]:
    """Return the UIDs of the runs of some rows."""
    return [str(row["uid"]) for row in frame.select(first_rows(frame)).records(["uid"])]


def known_runs(frame: Frame, left_out: Iterable[LeftOut] = ()) -> list[ArchivedRun]:
    """Return all runs of a table, and those that can't be read: their files are not nobody's."""
    names = ("uid", "name", "sweep", "folder", "label.source")
    rows = frame.select(first_rows(frame)).records(names)
    runs = [ArchivedRun(*(row[name] and str(row[name]) for name in names)) for row in rows]
    return [*runs, *(ArchivedRun(one.what, one.what, None, one.folder) for one in left_out)]


def _plan(
    home: Home, table: Loaded, chosen: Collection[str], *, records: bool, larger: float | None
) -> Forgetting:
    known = known_runs(table.frame, table.left_out)
    return plan_forgetting(home.path, known, chosen, records=records, larger=larger)


def _counted(plan: Forgetting) -> str:
    what = "files and records" if plan.records else "files"
    return f"{what} of {plural(len(plan.going), 'run')}"


def _tell(plan: Forgetting) -> None:
    if plan.going:
        lines = [
            [sweep or "–", f"{count:,}", bytes_text(extent.size), f"{extent.files:,}"]
            for sweep, (count, extent) in plan.by_sweep.items()
        ]
        rest = lines[_SHOWN:]
        show(out, ["sweep", "runs", "size", "files"], lines[:_SHOWN])
        if rest:
            out.print(f"… and {plural(len(rest), 'more sweep')}")
        extent = plan.extent
        out.print(f"to remove: {_counted(plan)}, {bytes_text(extent.size)} in {plural(extent.files, 'file')}")
        if not plan.records:
            remark("their records stay: tables, pages and reports show the same numbers")
    if plan.shared:
        size = bytes_text(sum(one.size for one in plan.shared))
        remark(
            f"files of {plural(len(plan.shared), 'run')} stay ({size}): runs that were not chosen took their "
            "results from them"
        )
    if plan.busy:
        remark(
            f"{plural(plan.busy, 'run')} left alone: a killed slamhive may have left programs at work there; "
            "the next slamhive run ends them"
        )
    if plan.imported:
        remark(f"{plural(plan.imported, 'imported run')}: the files are where they came from, and stay")


def _tell_of_current(archive: Archive, frame: Frame, uids: set[str]) -> None:
    """Say which runs of earlier versions are the current ones again when records go."""
    column = frame.column("uid").tolist()
    stay = frame.select(np.array([uid not in uids for uid in column], dtype=bool))
    columns = {name: stay.column(name) for name in stay.stored if name not in DERIVED}
    sweeps = []
    for one in archive.sweeps():
        created = one.created.timestamp() if one.created else None
        sweeps.append(SweepVersion(one.uid, one.name, one.cluster, one.namespace, created))
    now = with_derived(columns, len(stay), sweeps)
    back = stay.column("superseded").present & ~now.column("superseded").present
    count = len(uids_of(stay.select(back)))
    if count:
        remark(
            f"{plural(count, 'run')} of earlier versions will count as current again, as those that "
            "superseded them go"
        )


def _age(text: str) -> float:
    """Return an age in s."""
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)([dwhm])", text.strip())
    if found is None:
        raise InputError(f"--older-than: expected an age such as 30d, 2w, 12h or 90m, found {text!r}")
    return float(found[1]) * _DAYS[found[2]] * 86400


def _size(text: str) -> float:
    try:
        return quantity(text)
    except ValueError:
        raise InputError(f"--larger-than: expected a size such as 100Mi or 2Gi, found {text!r}") from None
