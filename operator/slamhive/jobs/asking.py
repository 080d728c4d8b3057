# SPDX-License-Identifier: Apache-2.0
"""Questions of collector and offloader to the Kubernetes API, and what they tell their CronJobs there."""

from __future__ import annotations

import asyncio
import os
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from slamhive.jobs.known import NamesInUse, known_to
from slamhive.kube.api.client import Api
from slamhive.kube.api.errors import Forbidden
from slamhive.kube.api.kinds import Kind
from slamhive.kube.api.transport import Request
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from pathlib import Path

_TRIES = 3
_EVENT_LENGTH = 1024

T = TypeVar("T")


def known_to_api(namespace: str, kubeconfig: Path | None = None) -> NamesInUse:
    """Return all that a namespace and its objects refer to.

    Args:
        namespace: the namespace.
        kubeconfig: a file that says how to reach the API; None inside a pod.

    Raises:
        SystemFault: the API doesn't answer, or not whole.
    """
    return _asked(f"namespace {namespace} can't be read", kubeconfig, partial(all_known, namespace))


async def all_known(namespace: str, api: Api) -> NamesInUse:
    """Return all that a namespace and its objects refer to, as the API says.

    Raises:
        ApiError: it doesn't answer, or not whole.
    """
    path = f"/api/v1/namespaces/{namespace}"
    body = await api.json(Request("get", "namespaces", namespace, "GET", path))
    algorithms = None
    with suppress(Forbidden):
        algorithms, _ = await api.list(Kind.ALGORITHM, namespace)
    datasets, _ = await api.list(Kind.DATASET, namespace)
    runs, _ = await api.list(Kind.MAPPING_RUN, namespace)
    return replace(known_to(algorithms, datasets, runs), namespace_uid=body["metadata"]["uid"])


def tell_cronjob(
    namespace: str, name: str, message: str, kubeconfig: Path | None = None, *, reason: str
) -> None:
    """Attach an Event to a CronJob, for who asks why it fails.

    Args:
        namespace: the namespace.
        name: the CronJob.
        message: a sentence.
        reason: what happened, in one word.
        kubeconfig: as for `known_to_api`.

    Raises:
        SystemFault: it can't be.
    """

    async def tell(api: Api) -> None:
        path = f"/apis/batch/v1/namespaces/{namespace}/cronjobs/{name}"
        job = await api.json(Request("get", "cronjobs.batch", f"{namespace}/{name}", "GET", path))
        now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        body = {
            "metadata": {"generateName": f"{name}.", "namespace": namespace},
            "involvedObject": {
                "apiVersion": "batch/v1",
                "kind": "CronJob",
                "name": name,
                "namespace": namespace,
                "uid": job["metadata"]["uid"],
            },
            "type": "Warning",
            "reason": reason,
            "message": message[:_EVENT_LENGTH],
            "source": {"component": name},
            "firstTimestamp": now,
            "lastTimestamp": now,
            "count": 1,
        }
        path = f"/api/v1/namespaces/{namespace}/events"
        await api.json(Request("create", "events", f"{namespace}/{name}", "POST", path, body=body))

    _asked(f"cronjob {name} can't be told", kubeconfig, tell)


def _asked(trouble: str, kubeconfig: Path | None, ask: Callable[[Api], Awaitable[T]]) -> T:
    """Return the answer of the API.

    Raises:
        SystemFault: there is no answer; the sentence begins with the trouble.
    """

    async def connected() -> T:
        api = await Api.connect(kubeconfig, attempts=_TRIES)
        try:
            return await ask(api)
        finally:
            await api.close()

    # Who runs it by hand says which cluster's: what another one doesn't know would be deleted.
    if kubeconfig is None and "KUBERNETES_SERVICE_HOST" not in os.environ:
        raise SystemFault(f"{trouble}: this is no pod of a cluster, and --kubeconfig names no file")
    try:
        return asyncio.run(connected())
    except Exception as error:
        raise SystemFault(f"{trouble}: {' '.join(str(error).split())}") from error
