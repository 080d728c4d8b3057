# SPDX-License-Identifier: Apache-2.0
"""``python3 -P -m slamhive.dashboard --settings FILE``: the dashboard's process in a cluster.

Exit codes: 0 after SIGTERM, 1 when it cannot work here, 2 when the settings are wrong.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.dashboard.server.serving import listen, serve
from slamhive.dashboard.server.settings import load_settings
from slamhive.dashboard.sources.cluster import ClusterSource
from slamhive.kube.api.client import Api
from slamhive.model.errors import InputError, SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until told to end; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python3 -P -m slamhive.dashboard", description="The dashboard.")
    parser.add_argument("--settings", type=Path, required=True, help="the dashboard's settings (YAML)")
    parser.add_argument("--kubeconfig", type=Path, help="kubeconfig to use, even inside a cluster")
    options = parser.parse_args(arguments)
    try:
        settings = load_settings(options.settings)
        source = ClusterSource(
            list(settings.namespaces),
            archive_url=settings.archive_url(),
            results=settings.results,
            ground_truth=settings.ground_truth,
            cache=settings.cache,
            name=settings.cluster_name,
            shelf=settings.shelf(),
            connect=partial(Api.connect, options.kubeconfig),
        )
        asyncio.run(_check(options.kubeconfig))
        port = settings.health_port
        serve(
            source,
            listen(settings.host, settings.port),
            hosts=None,
            health=None if port is None else listen(settings.host, port, "healthPort"),
            connections_per_address=settings.connections_per_address,
        )
    except InputError as error:
        return _say(error, 2)
    except SlamHiveError as error:
        return _say(error, 1)
    return 0


async def _check(kubeconfig: Path | None) -> None:
    """See whether a cluster is known.

    Raises:
        StartError: none is.
    """
    api = await Api.connect(kubeconfig)
    await api.close()


def _say(error: SlamHiveError, code: int) -> int:
    print(error, file=sys.stderr)  # noqa: T201 - the last word of a process that ends
    return code


if __name__ == "__main__":
    sys.exit(main())
