# SPDX-License-Identifier: Apache-2.0
"""Questions of commands that remove something: they say what goes, and ask."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.cli.parts.console import err, remark
from slamhive.cli.parts.exits import FAILED
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive.local.home.folder import Home

Yes = Annotated[bool, typer.Option("--yes", "-y", help="Remove without being asked.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what would go, and remove nothing.")]


def require_archive(home: Home, why: str = ": nothing is known of any run, so nothing is removed") -> None:
    """Refuse a home without an archive: its runs are unknown, not forgotten.

    Args:
        home: the home.
        why: end of the sentence.

    Raises:
        InputError: there is none.
    """
    if file := home.missing_archive:
        raise InputError(f"no archive at {file}{why}")


def agreed(question: str, *, yes: bool, dry_run: bool) -> bool:
    """Ask whether to remove what was shown; tells whether to.

    Raises:
        InputError: nobody can be asked.
    """
    if dry_run:
        remark("a dry run: nothing was removed")
        return False
    if yes:
        return True
    if not sys.stdin.isatty():
        raise InputError("nobody can be asked here: --yes removes this, --dry-run only shows it")
    if not typer.confirm(question, err=True):
        remark("nothing was removed")
        raise typer.Exit(FAILED)
    return True


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar on a terminal; yields what is told how much is done."""
    from rich.progress import Progress

    with Progress(console=err, disable=not err.is_terminal, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)
