# SPDX-License-Identifier: Apache-2.0
"""The command ``slamhive fetch``: copies finished runs from a cluster and prints what came."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import typer
from rich.markup import escape

from slamhive.cli.parts.console import bytes_text, command_name, complain, open_archive, out, remark
from slamhive.cli.parts.exits import FAILED, INTERRUPTED
from slamhive.cli.parts.waiting import Work
from slamhive.kube.api.kinds import Kind
from slamhive.kube.user.fetching import Fetched, Fetcher, put_folder, remarks
from slamhive.kube.user.queries import find
from slamhive.kube.user.run_files import Filed, Filing, WantedRun
from slamhive.kube.user.submitting import read_catalog
from slamhive.local.home.folder import Home, lock
from slamhive.model.base import plural
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.archive import Archive
    from slamhive.cli.cluster.work import ClusterPlace
    from slamhive.kube.user.connecting import ConnectedCluster

_SHOWN = 10


@dataclass(frozen=True)
class Copied:
    """Sweeps and runs copied from a cluster into the archive, and those of the runs whose files are not here.

    Attributes:
        fetched: what came of each Sweep or run.
        absent: runs whose files are not here.
    """

    fetched: list[Fetched]
    absent: list[WantedRun]


def fetch(names: Sequence[str], place: ClusterPlace, *, files: bool) -> None:
    """Copy finished runs into the archive here, with their files if asked for, and print what was copied."""
    home = Home.from_environment()
    home.folder(".")
    filed = Filed()

    async def work() -> None:
        nonlocal filed
        async with place.connect() as cluster:
            with open_archive(home) as archive:
                copied = await fetch_into(archive, cluster, names)
                for one in copied.fetched:
                    told = f"{escape(one.name)}: {plural(one.runs, 'run')} in {escape(archive.location)}"
                    out.print(told, soft_wrap=True)
                if files:
                    filed = await _fetch_files(home, archive, cluster, copied.absent)
        for name in dict.fromkeys(one.stored for one in copied.fetched if one.runs):
            out.print(f"Next:  {command_name()} results table --sweep {escape(name)}", soft_wrap=True)

    try:
        asyncio.run(work())
    except KeyboardInterrupt:
        if files:
            remark("interrupted; the same command goes on from here")
        raise typer.Exit(INTERRUPTED) from None
    if filed.problems:
        for sentence in filed.problems[:_SHOWN]:
            complain(sentence)
        if len(filed.problems) > _SHOWN:
            complain(f"and {len(filed.problems) - _SHOWN} more")
        raise typer.Exit(FAILED)


async def fetch_into(archive: Archive, cluster: ConnectedCluster, names: Sequence[str]) -> Copied:
    """Copy finished runs of Sweeps and runs into an archive, and show how far that is."""
    objects = await find(cluster, names, (Kind.SWEEP, Kind.MAPPING_RUN))
    catalog = await read_catalog(cluster)
    copied = Copied([], [])
    with Work("fetching") as work:
        for kind, body in objects:
            work.at(f"fetching {body['metadata']['name']}")
            fetcher = Fetcher(cluster, catalog, archive, work.count)
            copied.fetched.append(await fetcher.sweep(body) if kind is Kind.SWEEP else fetcher.run(body))
            copied.absent.extend(fetcher.absent)
    for one in copied.fetched:
        for sentence in remarks(one):
            remark(sentence)
    return copied


async def _fetch_files(
    home: Home, archive: Archive, cluster: ConnectedCluster, wanted: Sequence[WantedRun]
) -> Filed:
    """Fetch the files of runs that have none here.

    Raises:
        InputError: another command is at it.
    """
    runs = home.folder("runs")
    with lock(home.path / "fetch.lock", wait=False) as held:
        if held is None:
            raise InputError(f"another slamhive fetch --files is at work in {home.path}; wait for it")
        with Work("fetching files") as work:

            def step(done: int, total: int, size: int) -> None:
                work.count(done, total, bytes_text(size))

            keep = partial(put_folder, archive)
            filed = await Filing(cluster, runs, keep=keep, step=step, tell=remark).fetch(wanted)
    for sentence in filed.remarks[:_SHOWN]:
        remark(sentence)
    if len(filed.remarks) > _SHOWN:
        remark(f"left out, too: {plural(len(filed.remarks) - _SHOWN, 'more file')}")
    done = f"files of {plural(filed.runs, 'run')}, {bytes_text(filed.size)}, in {runs}"
    out.print(
        done if filed.runs or filed.problems else f"all files are in {runs}", markup=False, soft_wrap=True
    )
    return filed
