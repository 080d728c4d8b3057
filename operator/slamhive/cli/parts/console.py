# SPDX-License-Identifier: Apache-2.0
"""Printing of all commands: results go to standard output, everything else to standard error."""

from __future__ import annotations

import json
import shutil
import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from slamhive.contract.lines import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.archive import Archive
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import ContainerChoice
    from slamhive.local.running.workbench import Workbench

out = Console(highlight=False, soft_wrap=not sys.stdout.isatty())
err = Console(stderr=True, highlight=False, soft_wrap=not sys.stderr.isatty())


_json_lines = False


def speak_json(*, wanted: bool = True) -> None:
    """Have everything said as lines of JSON on standard output from now on, and nothing else there."""
    global _json_lines  # noqa: PLW0603 - the process has one standard output
    _json_lines = wanted


def speaks_json() -> bool:
    """Tell whether everything is said as lines of JSON."""
    return _json_lines


def emit(event: str, **fields: Any) -> None:
    """Print a line of JSON: an event, when it was, and what is to say of it."""
    line = {"event": event, "time": datetime.now(UTC).isoformat(timespec="milliseconds"), **fields}
    # One write a line: runs' threads say something at the same time.
    sys.stdout.write(json.dumps(line, ensure_ascii=False, default=str) + "\n")
    sys.stdout.flush()


def complain(message: str) -> None:
    """Print an error; each line is a sentence of its own, or goes on when it starts with a space."""
    if _json_lines:
        emit("error", message=message)
        return
    for line in message.splitlines():
        told = escape(printable(line))
        err.print(told if line.startswith(" ") else f"[bold red]error:[/] {told}")


def remark(message: str) -> None:
    """Print a sentence about what is going on."""
    if _json_lines:
        emit("note", message=message)
        return
    err.print(f"[dim]{escape(printable(message))}[/]")


def warn(message: str) -> None:
    """Print a sentence about what won't be as it was asked for."""
    if _json_lines:
        remark(message)
    else:
        err.print(f"[yellow]{escape(printable(message))}[/]", soft_wrap=True)


def command_name() -> str:
    """Return the words to call this command again: its name when that is on the PATH."""
    return "slamhive" if shutil.which("slamhive") else sys.argv[0]


def open_workbench(
    home: Home, workshop: Workshop | None = None, container: ContainerChoice | None = None
) -> Workbench:
    """Return a workbench on a home with its archive open."""
    # Readers of recordings: a second of imports that only some commands need.
    from slamhive.local.home.catalog import load_workshop
    from slamhive.local.running.workbench import Workbench

    home.folder(".")
    return Workbench(home, workshop or load_workshop(home), open_archive(home), remark, container)


def open_archive(home: Home) -> Archive:
    """Open a home's archive to write to it, made where it isn't there yet.

    A file is its owner's and is brought to this version; a server is a team's and is not.
    """
    from slamhive.archive import Archive
    from slamhive.archive.connection import file_of
    from slamhive.archive.upgrading import upgrade

    done = upgrade(home.archive_url, remark) if file_of(home.archive_url) is not None else None
    if done is not None:
        remark(f"the archive was brought from schema {done.before} to {done.after}; as it was: {done.copy}")
    return Archive.open(home.archive_url)


def bytes_text(count: float | None) -> str:
    """Return a size as people read it.

    >>> bytes_text(82_000_000)
    '78 MiB'
    """
    if count is None:
        return "–"
    for unit in ("B", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.0f} {unit}"
        count /= 1024
    return f"{count:.1f} GiB"


def listing(names: Sequence[str], most: int = 6) -> str:
    """Return the first few names of a list."""
    return ", ".join(names[:most]) + (", …" if len(names) > most else "")
