# SPDX-License-Identifier: Apache-2.0
"""``slamhive status``: what there is on a cluster, once or as it changes."""

from __future__ import annotations

import asyncio
import json
import time
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.live import Live

from slamhive.cli.cluster_tables import details, render
from slamhive.cli.cluster_work import Place
from slamhive.cli.console import out, plural, remark
from slamhive.kube.errors import ApiError
from slamhive.kube.kinds import Kind
from slamhive.kube.status import phase_of
from slamhive.kube.user.looking import (
    Picture,
    labels_of,
    look_around,
    look_at,
    name_of,
    status_of,
    troubles,
)
from slamhive.model.errors import SlamHiveError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.kube.user.connecting import Cluster

    Object = Mapping[str, Any]

LOOK_SECONDS = 2.0
_WIDEST = 10_000


def status(names: Sequence[str], place: Place, *, watch: bool, as_json: bool) -> None:
    """Show what is known by some names, or all that there is; stay as long as that changes if asked."""

    async def work() -> None:
        async with place.connect() as cluster:
            picture = await _look(cluster, names, None)
            if not watch:
                _print(cluster, picture, as_json=as_json, named=bool(names))
            elif as_json or not out.is_terminal:
                await _lines(cluster, names, picture, as_json=as_json)
            else:
                await _live(cluster, names, picture)

    try:
        asyncio.run(work())
    except KeyboardInterrupt:
        raise typer.Exit from None


async def _look(cluster: Cluster, names: Sequence[str], before: Picture | None) -> Picture:
    return await look_at(cluster, names, before) if names else await look_around(cluster)


async def _next(cluster: Cluster, names: Sequence[str], before: Picture) -> Picture:
    """Look again after a while; faults that pass leave the picture as it was."""
    await asyncio.sleep(LOOK_SECONDS)
    try:
        return await _look(cluster, names, before)
    except UnknownNameError:
        raise SlamHiveError("what is watched was deleted meanwhile") from None
    except ApiError as error:
        if not error.retryable:
            raise
        return before


async def _live(cluster: Cluster, names: Sequence[str], picture: Picture) -> None:
    with Live(render(cluster, picture, width=out.width), console=out, auto_refresh=False) as live:
        while not (names and picture.is_over):
            picture = await _next(cluster, names, picture)
            live.update(render(cluster, picture, width=out.width), refresh=True)


async def _lines(cluster: Cluster, names: Sequence[str], picture: Picture, *, as_json: bool) -> None:
    """Print a line of what changes where no terminal can show it in place."""
    shown: dict[str, str] = {}
    while True:
        if as_json:
            lines = {"": json.dumps(as_plain(picture), ensure_ascii=False)}
        else:
            lines = {f"{kind} {name_of(body)}": _line(kind, body) for kind, body in picture.objects}
        for key, line in lines.items():
            if shown.get(key) != line:
                typer.echo(line)
        shown = lines
        if names and picture.is_over:
            return
        picture = await _next(cluster, names, picture)


def _line(kind: Kind, body: Object) -> str:
    found, name = status_of(body), f"{kind} {name_of(body)}"
    bad = troubles(kind, body, time.time())
    if kind is Kind.MAPPING_RUN:
        text = f"{phase_of(found)} {found.get('message') or ''}".strip()
    elif kind is Kind.SWEEP:
        text = f"{found.get('phase', 'Pending')} {found.get('progress', '')}, {found.get('failed', 0)} failed"
    else:
        text = f"{found.get('evaluated', 0)} of {plural(found.get('runs', 0), 'run')} evaluated"
    return "; ".join([f"{name}: {text}", *(sentence.splitlines()[0] for sentence in bad)])


def _print(cluster: Cluster, picture: Picture, *, as_json: bool, named: bool) -> None:
    if as_json:
        typer.echo(json.dumps(as_plain(picture), indent=2, ensure_ascii=False))
        return
    # A name or number is better wrapped by the terminal than cut.
    terminal = out.is_terminal or None
    wide = Console(file=out.file, width=_WIDEST, highlight=False, force_terminal=terminal)
    if named:
        for number, part in enumerate(details(picture)):
            if number:
                wide.print()
            wide.print(part)
    elif picture.objects:
        wide.print(render(cluster, picture, most=None))
    else:
        remark(f"nothing in namespace {cluster.namespace}; slamhive submit sends something there")


def as_plain(picture: Picture) -> dict[str, Any]:
    """Return a picture as plain JSON values."""

    def plain(body: Object) -> dict[str, Any]:
        meta = body["metadata"]
        shown = {key: value for key, value in status_of(body).items() if key != "points"}
        return {
            "name": meta["name"],
            "namespace": meta.get("namespace"),
            "uid": meta["uid"],
            "created": meta.get("creationTimestamp"),
            "labels": dict(labels_of(body)),
            "status": shown,
        }

    return {
        "sweeps": [
            plain(body) | {"failedRuns": [plain(run) for run in picture.failed.get(name_of(body), [])]}
            for body in picture.sweeps
        ],
        "runs": [plain(body) for body in picture.runs],
        "evaluations": [plain(body) for body in picture.evaluations],
    }
