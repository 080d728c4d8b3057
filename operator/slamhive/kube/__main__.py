# SPDX-License-Identifier: Apache-2.0
"""``python3 -P -m slamhive.kube --settings FILE``: the operator's process.

Exit codes: 0 after SIGTERM, 1 when it cannot work here (the sentence says what is missing), 2 when the
settings are wrong.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import logging
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.archive import Archive
from slamhive.archive.upgrading import upgrade
from slamhive.contract.heap import keep_memory
from slamhive.kube import handlers
from slamhive.kube.api.client import Api
from slamhive.kube.api.errors import StartError
from slamhive.kube.cluster import Cluster
from slamhive.kube.ending import end_tasks
from slamhive.kube.health import HealthServer
from slamhive.kube.logs import set_up_logs
from slamhive.kube.operator import Operator
from slamhive.kube.reconciling import reconcilers
from slamhive.kube.settings import Settings, load
from slamhive.model.errors import InputError, SlamHiveError, SystemFault
from slamhive.sampling import Sampler

if TYPE_CHECKING:
    from collections.abc import Sequence

_LONGEST_END_SECONDS = 5.0
_OBJECTS_BETWEEN_COLLECTIONS = 20_000

_KEPT_BYTES, _LARGE_BYTES = 16 << 20, 128 << 10
"""Of memory: an operator works for months, and the API's long lists would leave holes among its objects."""

_log = logging.getLogger("slamhive.operator")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the operator until it is told to end; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python3 -P -m slamhive.kube", description="The operator.")
    parser.add_argument("--settings", type=Path, required=True, help="the operator's settings (YAML)")
    parser.add_argument("--kubeconfig", type=Path, help="kubeconfig to use, even inside a cluster")
    options = parser.parse_args(arguments)
    try:
        settings = load(options.settings)
        archive = open_archive(settings)
    except InputError as error:
        return _say(error, 2)
    except SlamHiveError as error:
        return _say(error, 1)
    set_up_logs(settings)
    keep_memory(_KEPT_BYTES, _LARGE_BYTES)
    try:
        asyncio.run(run(settings, archive, options.kubeconfig))
    except SlamHiveError as error:
        return _say(error, 1)
    except KeyboardInterrupt:
        pass
    return 0


async def run(settings: Settings, archive: Archive | None = None, kubeconfig: Path | None = None) -> None:
    """Work until a signal comes.

    Raises:
        StartError: the operator cannot work here.
        SystemFault: a part of it ended that never should.
    """
    api = await Api.connect(kubeconfig)
    cluster = Cluster(api, settings)
    sampler = Sampler()
    op = Operator(cluster, reconcilers(archive, sampler))
    health = HealthServer(op, settings.health.port)
    try:
        await _listen(cluster, health)
        await op.start()
        if archive is not None and cluster.identity is not None:
            with suppress(SystemFault):  # those Sweeps that need the archive say so
                await asyncio.to_thread(archive.settle, cluster.identity, settings.namespaces)
        _collect_seldom()
        _log.info("watching %s", ", ".join(settings.namespaces))
        await _watch(op)
        _log.info("ending")
    finally:
        # What kopf leaves half-read when its watches are cancelled is of no interest any more.
        logging.getLogger("asyncio").setLevel(logging.CRITICAL)
        await op.stop()
        sampler.close()
        await health.stop()
        await api.close()
        if archive is not None:
            archive.close()


def _collect_seldom() -> None:
    """Keep Python's search for cycles from walking all modules again for each few events."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS, 20, 20)


async def _watch(op: Operator) -> None:
    """Watch until a signal comes.

    kopf takes 7 s to end by its own signal handlers, but ends at once when cancelled: they are replaced.
    """
    signalled, ready = asyncio.Event(), asyncio.Event()
    watching = asyncio.create_task(handlers.watch(op, ready), name="watches")
    flags = [asyncio.create_task(flag.wait()) for flag in (signalled, op.broken)]
    begun = asyncio.create_task(ready.wait())
    try:
        await asyncio.wait([watching, begun, *flags], return_when=asyncio.FIRST_COMPLETED)
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, signalled.set)
        await asyncio.wait([watching, *flags], return_when=asyncio.FIRST_COMPLETED)
        if op.broken.is_set():
            raise SystemFault(f"the operator broke off: {', '.join(op.failed_tasks)} ended")
        if watching.done() and (error := watching.exception()) is not None:
            raise SystemFault(f"the watches broke off: {error}") from error
    finally:
        # kopf, cancelled while it is ending, would leave its watches behind: it gets the time it takes.
        await end_tasks([watching, begun, *flags], again_seconds=_LONGEST_END_SECONDS)


def open_archive(settings: Settings) -> Archive | None:
    """Open the archive whose database URL is in the mounted file, brought to this version, if there is one.

    Raises:
        InputError: the file or the URL in it cannot be used.
        SystemFault: the database doesn't answer.
    """
    if settings.archive_url_file is None:
        return None
    try:
        url = settings.archive_url_file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"archiveUrlFile: {settings.archive_url_file} cannot be read: {type(error).__name__}"
        ) from None
    if not url:
        raise InputError(f"archiveUrlFile: {settings.archive_url_file} is empty: expected a database URL")
    upgrade(url)
    return Archive.open(url)


async def _listen(cluster: Cluster, health: HealthServer) -> None:
    try:
        await health.start()
    except OSError as error:
        raise StartError(f"health.port: cannot listen on port {health.port}: {error.strerror}") from None
    try:
        cluster.metrics.serve(cluster.settings.metrics.port)
    except OSError as error:
        port = cluster.settings.metrics.port
        raise StartError(f"metrics.port: cannot listen on port {port}: {error.strerror}") from None


def _say(error: SlamHiveError, code: int) -> int:
    print(error, file=sys.stderr)  # noqa: T201 - the last word of a process that ends
    return code


if __name__ == "__main__":
    sys.exit(main())
