# SPDX-License-Identifier: Apache-2.0
"""``slamhive dashboard`` and ``slamhive site``: the archive as web pages, with a server and without one."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.cli.parts.choosing import Also, Sweeps
from slamhive.cli.parts.console import out, remark
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.extras import without
from slamhive.tables.homes import homes_beside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.dashboard.publishing.building import BuiltSite
    from slamhive.dashboard.publishing.state import MarkedSource
    from slamhive.tables.homes import Beside

DEFAULT_PORT = 8323
_SHOWN_BADGES = 5

TruthFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER", help="Ground truth to draw under paths: DATASET.txt (TUM) or DATASET.csv (EuRoC)."
    ),
]


def dashboard(
    *,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")] = DEFAULT_PORT,
    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 lets others in.")] = "127.0.0.1",
    allowed_host: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Another host name by which browsers may call it; may be repeated."
        ),
    ] = None,
    health_port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Separate port for /healthz and /readyz; default: none."),
    ] = None,
    ground_truth: TruthFolder = None,
    also: Also = None,
) -> None:
    """Show the archive in a web browser: leaderboard, charts, runs. It changes nothing; Ctrl-C ends it.

    Example: slamhive dashboard --port 8323
    """
    try:
        from slamhive.dashboard.server.serving import allowed_hosts, lets_others_in, listen, serve
    except ModuleNotFoundError as error:
        raise without("the dashboard", error.name, "dashboard") from None
    home = Home.from_environment()
    others = homes_beside(home, also)
    listening = listen(host, port)
    if lets_others_in(host):
        remark(
            f"--host {host}: the dashboard has no login: whoever reaches this machine sees all results, "
            "logs and trajectories"
        )
    shown = f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{listening.getsockname()[1]}/"

    def announce() -> None:
        out.print(f"dashboard at {address} (Ctrl-C ends it)", markup=False)

    serve(
        _source(home, others, ground_truth),
        listening,
        hosts=allowed_hosts(host, allowed_host or ()),
        health=None if health_port is None else listen(host, health_port, "health-port"),
        announce=announce,
    )


def site(
    folder: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder of the site: a new one, an empty one, or a site.")
    ],
    *,
    sweep: Sweeps = None,
    title: Annotated[str, typer.Option(help="What the pages are called.")] = "SLAM Hive",
    base_url: Annotated[
        str, typer.Option(metavar="URL", help="Address that it will have, for the links of its feed.")
    ] = "",
    ground_truth: TruthFolder = None,
    also: Also = None,
) -> None:
    """Write the dashboard as a site of static files: leaderboard, charts, studies, the page of each run.

    Any web server shows it, at any address. Again into the same folder: what is new is added, addresses stay.

    Example: slamhive site public --title "Our lab's runs" --base-url https://lab.example/slam/
    """
    try:
        from slamhive.dashboard.publishing.building import SiteWish, build
    except ModuleNotFoundError as error:
        raise without("the site", error.name, "dashboard") from None
    wish = SiteWish(sweep or (), title, base_url)
    home = Home.from_environment()
    others = homes_beside(home, also)

    async def made() -> BuiltSite:
        # asyncio holds Ctrl-C back until something is waited for; here, that may take minutes.
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return await build(folder, _source(home, others, ground_truth), wish)

    built = asyncio.run(made())
    done = "nothing is new" if built.same else f"{plural(built.added, 'file')} added or changed"
    out.print(
        f"{folder}: {plural(built.runs, 'run')}, {plural(built.answers, 'answer')}; {done}, "
        f"{plural(built.files, 'file')} and {built.size / 1e6:.1f} MB in all",
        markup=False,
        highlight=False,
    )
    for place in built.badges[:_SHOWN_BADGES]:
        out.print(f"  {place.file}: {place.said}", markup=False, highlight=False)
    if len(built.badges) > _SHOWN_BADGES:
        out.print(f"  … {len(built.badges):,} badges in badges/", markup=False)
    out.print(f"to look at it: python3 -m http.server -d {folder}", markup=False)


def _source(home: Home, others: Sequence[Beside], ground_truth: Path | None) -> MarkedSource:
    """Return the archive of a home as pages read it, with those of others beside it."""
    from slamhive.dashboard.sources.archived import Workstation
    from slamhive.dashboard.sources.homes import Homes

    if others:
        return Homes(home, others, ground_truth)
    return Workstation(home.archive_url, home.path, ground_truth)
