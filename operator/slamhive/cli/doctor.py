# SPDX-License-Identifier: Apache-2.0
"""``slamhive doctor``: what there is to work with, what is missing, what that costs and what helps."""

from __future__ import annotations

import json
import threading
import time
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from slamhive import __version__
from slamhive.cli.cluster.commands import Context, Namespace
from slamhive.cli.parts.console import out
from slamhive.cli.parts.exits import FAILED
from slamhive.model.readiness import ReadinessRow, State

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

PATIENCE_SECONDS = 8.0
_COLOURS = {
    State.THERE: "green",
    State.LIMITED: "yellow",
    State.MISSING: "red",
    State.UNKNOWN: "yellow",
    State.UNNEEDED: "dim",
}
_NEEDED = ("Python", "packages", "disk", "archive")


def doctor(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    namespace: Namespace = None,
    context: Context = None,
) -> None:
    """Check this machine: what is missing, what does not work without it, and how to get it.

    Everything is looked at side by side and takes a few seconds. The exit code is 1 where something is
    missing without which nothing runs.

    Example: slamhive doctor
    """
    from slamhive.cli.parts.waiting import Work

    with Work("looking at this machine"):
        rows = examine(_looks(context, namespace), PATIENCE_SECONDS)
    stopped = [row for row in rows if row.stops]
    if as_json:
        body = {"ready": not stopped, "version": __version__, "rows": [row.as_json() for row in rows]}
        typer.echo(json.dumps(body, indent=2))
    else:
        _show(rows)
    if stopped:
        raise typer.Exit(FAILED)


def examine(
    looks: Mapping[str, Callable[[], ReadinessRow | Iterable[ReadinessRow]]],
    patience: float,
    clock: Callable[[], float] = time.monotonic,
) -> list[ReadinessRow]:
    """Look at all things side by side, and return what was seen in their order.

    Args:
        looks: how to look, by what at.
        patience: time for all of them together, s; what has not answered by then is unknown.
        clock: monotonic time, s.
    """
    seen: dict[str, list[ReadinessRow]] = {}

    def take(check: str, look: Callable[[], ReadinessRow | Iterable[ReadinessRow]]) -> None:
        try:
            found = look()
            seen[check] = [found] if isinstance(found, ReadinessRow) else list(found)
        except Exception as error:  # noqa: BLE001 - one look that fails hides no other
            said = f"{type(error).__name__}: {error}"
            seen[check] = [ReadinessRow(check, State.UNKNOWN, said, needed=check in _NEEDED)]

    # Daemons, which nothing waits for: what they asked may never answer.
    threads = [threading.Thread(target=take, args=item, daemon=True) for item in looks.items()]
    for thread in threads:
        thread.start()
    until = clock() + patience
    for thread in threads:
        thread.join(max(0.0, until - clock()))
    rows = []
    for check in looks:
        late = ReadinessRow(
            *(check, State.UNKNOWN, f"no answer within {patience:g} s"),
            helps="run this again when the machine is less busy",
        )
        rows += seen.get(check, [late])
    return rows


def _looks(
    context: str | None, namespace: str | None
) -> dict[str, Callable[[], ReadinessRow | Iterable[ReadinessRow]]]:
    from slamhive.local.home.catalog import load_workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.programs import readiness, rosreadiness

    home = Home.from_environment()
    workshop = load_workshop(home)
    return {
        "Python": readiness.python,
        "packages": readiness.packages,
        "algorithms": lambda: readiness.algorithms(workshop),
        "ROS 1": lambda: rosreadiness.ros1(workshop),
        "ROS 2": lambda: rosreadiness.ros2(workshop),
        "shared memory": lambda: rosreadiness.shared_memory(workshop),
        "container engines": readiness.engines,
        "cgroup accounting": readiness.accounting,
        "cores": readiness.cores,
        "clock": readiness.clock,
        "load": readiness.load,
        "memory": readiness.memory,
        "disk": lambda: readiness.disk(home),
        "archive": lambda: readiness.archive(home),
        "browser, TeX": readiness.unneeded,
        "cluster": lambda: _cluster(context, namespace),
    }


def _cluster(context: str | None, namespace: str | None) -> list[ReadinessRow]:
    import asyncio

    from slamhive.cli.cluster.commands import cluster_client
    from slamhive.model.errors import SlamHiveError
    from slamhive.model.readiness import missing

    try:
        with cluster_client():
            from slamhive.kube.user.readiness import look
    except SlamHiveError as error:
        found, _, helps = str(error).partition(": ")
        return [missing("cluster", found, "sweeps run on this machine alone", helps)]
    return asyncio.run(look(context, namespace))


def _show(rows: Iterable[ReadinessRow]) -> None:
    """Print a line of each thing, and beneath it what it costs and what helps."""
    rows = list(rows)
    width = max(len(row.check) for row in rows)
    indent = " " * (14 + width)
    for row in rows:
        head = f"[{_COLOURS[row.state]}]{row.state.value:10}[/]  {escape(row.check):{width}}  "
        out.print(head + escape(_wrapped(row.found, indent)), soft_wrap=True)
        for word, text in (("costs", row.costs), ("helps", row.helps)):
            if text:
                out.print(f"{indent}[dim]{escape(_wrapped(f'{word}: {text}', indent))}[/]", soft_wrap=True)
    counts = {state: sum(row.state is state for row in rows) for state in State}
    out.print(", ".join(f"{count} {state.value}" for state, count in counts.items() if count))
    stopped = [row.check for row in rows if row.stops]
    told = (
        f"nothing can be run before this is mended: {', '.join(stopped)}"
        if stopped
        else "sweeps can be run here"
    )
    out.print(f"[{'red' if stopped else 'green'}]{escape(told)}[/]")


def _wrapped(text: str, indent: str) -> str:
    """Return a text that goes on beneath itself where a terminal's line ends; elsewhere in one line."""
    if not out.is_terminal:
        return text
    width = max(40, out.width - len(indent))
    return f"\n{indent}".join(wrap(text, width, break_long_words=False, break_on_hyphens=False))
