# SPDX-License-Identifier: Apache-2.0
"""``slamhive submit``, ``status``, ``logs``, ``cancel`` and ``fetch``: a cluster without kubectl.

What they do is in ``cluster_work``, ``cluster_fetch`` and ``cluster_status``, imported when it is needed: the
client for Kubernetes takes a second to import, and is an extra.
"""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slamhive.model.base import Choice
from slamhive.model.errors import SlamHiveError
from slamhive.model.extras import how_to_install

if TYPE_CHECKING:
    from collections.abc import Iterator

Files = Annotated[
    list[Path],
    typer.Argument(metavar="FILE…", help="Manifests: sweeps, runs, datasets …; - reads standard input."),
]
Namespace = Annotated[
    str | None, typer.Option("-n", "--namespace", metavar="NAME", help="Namespace; default: the context's.")
]
Context = Annotated[
    str | None,
    typer.Option("--context", metavar="NAME", help="Context of the kubeconfig; default: the current one."),
]


class PodContainer(Choice):
    """A container of a run's pod."""

    ALGORITHM = "algorithm"
    MONITOR = "monitor"
    PLAYER = "player"


@contextmanager
def cluster_client() -> Iterator[None]:
    """Import what needs the client for Kubernetes.

    Raises:
        SlamHiveError: it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in {"kubernetes", "aiohttp"}:
            raise
        raise SlamHiveError(
            f"clusters need the client for Kubernetes, which is not installed: {how_to_install('cluster')}"
        ) from None


def submit(
    files: Files,
    *,
    namespace: Namespace = None,
    context: Context = None,
    with_catalog: Annotated[
        bool,
        typer.Option(
            "--with-catalog/--no-catalog",
            help="Whether Algorithms and Datasets that the cluster lacks are taken from the catalog here.",
        ),
    ] = True,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check everything, the cluster included; make nothing.")
    ] = False,
) -> None:
    """Send sweeps, runs and what they need to a cluster, which runs them.

    All is checked first; where anything is wrong, nothing is made. What is there already and equal is left
    alone.

    Example: slamhive submit sweep.yaml
    """
    with cluster_client():
        from slamhive.cli.cluster import work
    place = work.ClusterPlace(context, namespace)
    work.submit(files, place, with_catalog=with_catalog, dry_run=dry_run)


def status(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME…]", help="Sweeps, runs or evaluations; default: all.")
    ] = None,
    *,
    namespace: Namespace = None,
    context: Context = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Keep showing what changes until everything named is done.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON; with --watch a line a change.")
    ] = False,
) -> None:
    """Show progress and problems of sweeps, runs and evaluations on a cluster.

    Example: slamhive status demo --watch
    """
    with cluster_client():
        from slamhive.cli.cluster import status, work
    place = work.ClusterPlace(context, namespace)
    status.status(names or [], place, watch=watch, as_json=as_json)


def logs(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Name of a run.")],
    *,
    namespace: Namespace = None,
    context: Context = None,
    follow: Annotated[
        bool, typer.Option("-f", "--follow", help="Go on until the run is over, through all its attempts.")
    ] = False,
    container: Annotated[
        PodContainer, typer.Option("--container", "-c", help="Whose log.")
    ] = PodContainer.ALGORITHM,
    tail: Annotated[
        int | None, typer.Option("--tail", min=0, metavar="N", help="Only the last N lines.")
    ] = None,
) -> None:
    """Print the log of a run on a cluster; if its pod is gone, the last lines.

    Example: slamhive logs demo-3f2a -f
    """
    with cluster_client():
        from slamhive.cli.cluster import work
    place = work.ClusterPlace(context, namespace)
    work.logs(run, place, container.value, follow=follow, tail=tail)


def cancel(
    names: Annotated[list[str], typer.Argument(metavar="NAME…", help="Sweeps or runs.")],
    *,
    namespace: Namespace = None,
    context: Context = None,
    delete: Annotated[
        bool, typer.Option("--delete", help="Delete the objects too, with results that nobody has fetched.")
    ] = False,
) -> None:
    """End runs on a cluster. A sweep is suspended and its runs in flight are cancelled.

    Submitting a suspended sweep's file again lets it go on; cancelled runs count as failed.

    Example: slamhive cancel demo
    """
    with cluster_client():
        from slamhive.cli.cluster import work
    work.cancel(names, work.ClusterPlace(context, namespace), delete=delete)


def fetch(
    names: Annotated[list[str], typer.Argument(metavar="NAME…", help="Sweeps or runs.")],
    *,
    namespace: Namespace = None,
    context: Context = None,
    files: Annotated[
        bool, typer.Option("--files", help="Fetch the runs' files too: trajectories, maps, usage, logs.")
    ] = False,
) -> None:
    """Copy finished runs of a cluster into the archive here, for slamhive results.

    Doing it again brings the copies up to date, and goes on where fetching files was interrupted.

    Example: slamhive fetch demo --files
    """
    with cluster_client():
        from slamhive.cli.cluster import fetch, work
    fetch.fetch(names, work.ClusterPlace(context, namespace), files=files)
