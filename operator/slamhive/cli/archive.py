# SPDX-License-Identifier: Apache-2.0
"""``slamhive archive``: looking after the archive: whether it is sound, copies, and new versions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.archive import Archive, keeping
from slamhive.archive.connection import shown
from slamhive.archive.upgrading import upgrade
from slamhive.cli.parts.console import bytes_text, complain, open_archive, out, remark
from slamhive.cli.parts.exits import FAILED
from slamhive.cli.parts.waiting import Work
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from slamhive.local.housekeeping.merging import Merge

app = typer.Typer(
    help="Look after the archive: $SLAMHIVE_HOME/archive.sqlite, or the database in $SLAMHIVE_ARCHIVE.",
    no_args_is_help=True,
)
_SHOWN = 50


@app.command()
def check() -> None:
    """Check the archive: the file, each record, and whether they agree.

    Example: slamhive archive check
    """
    url = Home.from_environment().archive_url
    with Work("checking the archive") as work:
        found = keeping.check(url, _telling(work))
    for note in found.notes:
        remark(note)
    for fault in found.faults[:_SHOWN]:
        complain(fault)
    if len(found.faults) > _SHOWN:
        complain(f"and {len(found.faults) - _SHOWN} more")
    if found.faults:
        remark("`slamhive archive restore` puts a backup in its place")
        raise typer.Exit(FAILED)
    out.print(f"{shown(url)}: {_counted(found.counts)}: sound", markup=False)


@app.command()
def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write; must not exist.")],
) -> None:
    """Copy the archive to an SQLite file, as it is at one moment, and check the copy; runs may go on.

    Example: slamhive archive backup archive-monday.sqlite
    """
    url = Home.from_environment().archive_url
    with Work("copying the archive") as work:
        counts = keeping.backup(url, file, _telling(work))
    out.print(f"{shown(url)} copied to {file}: {_counted(counts)}: sound", markup=False)


@app.command()
def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A backup.")],
    *,
    force: Annotated[bool, typer.Option("--force", help="Replace what the archive holds.")] = False,
) -> None:
    """Replace the archive by a backup, completely or not at all; the backup is not changed.

    Example: slamhive archive restore archive-monday.sqlite
    """
    home = Home.from_environment()
    url = home.archive_url
    with home.exclusive("slamhive archive restore"), Work("restoring the archive") as work:
        counts = keeping.restore(url, file, force=force, tell=_telling(work))
    out.print(f"{shown(url)}: {_counted(counts)} restored from {file}", markup=False)


@app.command("upgrade")
def upgrade_archive() -> None:
    """Upgrade the archive of an earlier slamhive; an archive file is copied first.

    Example: slamhive archive upgrade
    """
    home = Home.from_environment()
    url = home.archive_url
    with home.exclusive("slamhive archive upgrade"), Work("opening the archive") as work:
        done = upgrade(url, work.at)
    if done is None:
        out.print(f"{shown(url)}: nothing to do", markup=False)
        return
    kept = f"; as it was: {done.copy}" if done.copy is not None else ""
    out.print(f"{shown(url)}: brought from schema {done.before} to {done.after}{kept}", markup=False)


@app.command()
def merge(
    other: Annotated[
        str,
        typer.Argument(metavar="[LABEL=]OTHER", help="Another home, an archive's file or a database URL."),
    ],
    *,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would come, and change nothing.")
    ] = False,
) -> None:
    """Take the runs of another home into this one, with their files; the other one is not changed.

    A run that stands in both is there once, with the tags of both and the newer note; nothing else here is
    replaced. A merge that was stopped goes on.

    Example: slamhive archive merge /data/anna/slamhive --dry-run
    """
    from slamhive.cli.parts.asking import progress
    from slamhive.local.housekeeping import merging
    from slamhive.local.housekeeping.forgetting import alone
    from slamhive.tables.homes import homes_beside

    home = Home.from_environment()
    found = homes_beside(home, [other], "")
    if not found:
        raise InputError(f"{other}: is this home itself")
    (beside,) = found
    nothing = dry_run and home.missing_archive is not None
    with (
        alone(home, "slamhive archive merge"),
        Archive.open("sqlite:///:memory:") if nothing else open_archive(home) as archive,
    ):
        merging.clear(home)
        with merging.opened(beside.label, beside.url, beside.path, home) as theirs:
            plan = merging.plan_merge(home, archive, theirs)
            _tell_of_merge(plan)
            if dry_run:
                merging.clear(home)
                remark("a dry run: nothing was changed")
                return
            with progress("merging", len(plan.coming) or 1) as step:
                merging.merge(home, archive, theirs, plan, step)
    for path in plan.unread[:_SHOWN]:
        complain(f"{path}: can't be read, and was not copied")
    said = f", notes or tags of {plural(len(plan.remarks), 'run')}" if plan.remarks else ""
    out.print(
        f"merged: {plural(len(plan.coming), 'run')}, {plural(len(plan.results), 'result')} of runs that were "
        f"here{said}; {bytes_text(plan.extent.size)} in {plural(plan.extent.files, 'file')}"
    )
    if plan.unread:
        raise typer.Exit(FAILED)


def _tell_of_merge(plan: Merge) -> None:
    extent = plan.extent
    out.print(
        f"to merge: {plural(len(plan.coming), 'run')} ({bytes_text(extent.size)} in "
        f"{plural(extent.files, 'file')}); {plural(plan.known, 'run')} here already, "
        f"{plural(len(plan.results), 'result')} to add to them"
    )
    if plan.remarks:
        out.print(f"notes or tags come for {plural(len(plan.remarks), 'run')} that are here already")
    for sentence in plan.aside[:_SHOWN]:
        remark(sentence)
    if len(plan.aside) > _SHOWN:
        remark(f"and {len(plan.aside) - _SHOWN:,} more are kept beside")
    for sentence in plan.left_out[:_SHOWN]:
        remark(sentence)
    if len(plan.left_out) > _SHOWN:
        remark(f"not copied, too: {plural(len(plan.left_out) - _SHOWN, 'more file')}")
    if plan.without:
        remark(f"{plural(plan.without, 'run')} without files there: only the records come")


def _telling(work: Work) -> keeping.Tell:
    """Return a function that shows each step of some work as one of its own."""
    last = ""

    def tell(what: str, share: float) -> None:
        nonlocal last
        if what != last:
            work.at(what)
            last = what
        work.share(share)

    return tell


def _counted(counts: dict[str, int]) -> str:
    names = ("run", "result", "sweep")
    return ", ".join(plural(counts.get(f"{name}s", 0), name) for name in names)
