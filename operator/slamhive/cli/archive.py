# SPDX-License-Identifier: Apache-2.0
"""``slamhive archive``: looking after the archive: whether it is sound, copies, and new versions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slamhive.archive import keeping
from slamhive.archive.connection import shown
from slamhive.archive.upgrading import upgrade
from slamhive.cli.console import complain, out, plural, remark
from slamhive.cli.exits import FAILED
from slamhive.cli.waiting import Work
from slamhive.local.home import Home

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
    with Work("checking the archive"):
        found = keeping.check(url)
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
    """Copy the archive to an SQLite file, as it is at one moment; runs may go on meanwhile.

    Example: slamhive archive backup archive-monday.sqlite
    """
    url = Home.from_environment().archive_url
    with Work("copying the archive"):
        keeping.backup(url, file)
    out.print(f"{shown(url)} copied to {file}", markup=False)


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
    with home.exclusive("slamhive archive restore"), Work("restoring the archive"):
        counts = keeping.restore(url, file, force=force)
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


def _counted(counts: dict[str, int]) -> str:
    names = ("run", "result", "sweep")
    return ", ".join(plural(counts.get(f"{name}s", 0), name) for name in names)
