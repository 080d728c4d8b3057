# SPDX-License-Identifier: Apache-2.0
"""File server pod: the user's own, with the results volume mounted, for as long as files are fetched."""

from __future__ import annotations

import asyncio
import uuid
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.jobs.send import COMMAND
from slamhive.kube.api.errors import ApiError, Forbidden, NotFound
from slamhive.kube.api.kinds import Key, Kind, Object
from slamhive.kube.api.transport import Request
from slamhive.kube.builders.common import label
from slamhive.kube.builders.restoring import store_words
from slamhive.kube.builders.run import job_name
from slamhive.kube.builders.sending import SEND, sender_job
from slamhive.kube.settings import StoreReference
from slamhive.kube.user.connecting import ClusterError
from slamhive.kube.user.queries import name_of, status_of

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence

    from slamhive.kube.user.api import PodSession
    from slamhive.kube.user.connecting import ConnectedCluster


_LOOK_SECONDS = 0.5
_TELL_SECONDS = 10.0
_PATIENCE_SECONDS = 300.0
_AWAY_SECONDS = 15.0
_TRIED = 5
_STORE_ANNOTATION = label("store")
_SECRET_ANNOTATION = label("store-secret")
_RIGHTS = (
    "fetching files needs the rights to create and delete jobs, to list pods, and to create and get "
    "pods/exec in this namespace; without --files results alone are copied"
)


@dataclass(frozen=True)
class SenderPod:
    """A pod that hands out files.

    Attributes:
        cluster: where it is.
        name: its name.
    """

    cluster: ConnectedCluster
    name: str
    store: StoreReference | None = None

    @asynccontextmanager
    async def session(self) -> AsyncIterator[PodSession]:
        """Open an exec session to the file server pod, in the protocol of ``slamhive.jobs.send``.

        Raises:
            ClusterError: the user may not.
            ServerFault: it does not answer.
        """
        with _explained():
            command = [*COMMAND, *(store_words(self.store) if self.store else [])]
            found = self.cluster.api.executing(self.cluster.namespace, self.name, SEND, command)
            async with found as session:
                yield session


@asynccontextmanager
async def sender(
    cluster: ConnectedCluster, runs: Sequence[Mapping[str, Any]], tell: Callable[[str], None]
) -> AsyncIterator[SenderPod]:
    """Have a pod that hands out files; it goes with the context.

    Args:
        cluster: where.
        runs: runs whose files are wanted, by whose Jobs is known how pods have to be here.
        tell: told what is waited for.

    Raises:
        ClusterError: there can be none: the sentence says why.
    """
    name = f"fetch-{uuid.uuid4().hex[:12]}"
    with _explained():
        store = await _store(cluster)
        body = sender_job(cluster.namespace, name, await _like(cluster, runs), store)
    try:
        with _explained():
            await cluster.api.create(Kind.JOB, body)
            pod = await _started(cluster, name, tell)
        yield SenderPod(cluster, pod, store)
    finally:
        # It ends by itself where even this fails.
        with suppress(ApiError, TimeoutError):
            async with asyncio.timeout(_AWAY_SECONDS):
                await cluster.api.delete(cluster.key(Kind.JOB, name))


@contextmanager
def _explained() -> Iterator[None]:
    """Say which rights are needed where one is missing."""
    try:
        yield
    except Forbidden as error:
        raise ClusterError(f"{error}; {_RIGHTS}") from None


async def _like(cluster: ConnectedCluster, runs: Iterable[Mapping[str, Any]]) -> Object:
    """Return the spec of a pod that the operator or its chart made in this namespace."""
    # The last ones first: their Jobs are the likeliest to be there still.
    tried = [run for run in runs if status_of(run).get("attempts")][-_TRIED:]
    for run in reversed(tried):
        name = job_name(name_of(run), status_of(run)["attempts"])
        with suppress(NotFound):
            job = await cluster.api.get(Key(Kind.JOB, cluster.namespace, name))
            spec: Object = job["spec"]["template"]["spec"]
            return spec
    for item in await _cronjobs(cluster, "collector"):
        spec = dict(item["spec"]["jobTemplate"]["spec"]["template"]["spec"])
        spec.pop("serviceAccountName", None)  # the collector's has rights
        return spec
    raise ClusterError(
        f"the results volume of namespace {cluster.namespace} can't be found: the Jobs of these runs are "
        "gone, and there is no collector"
    )


async def _store(cluster: ConnectedCluster) -> StoreReference | None:
    """Return the object storage that folders are moved to, as the offloader's CronJob says."""
    try:
        found = await _cronjobs(cluster, "offloader")
    except Forbidden:
        return None  # what is on the volume can still be had
    for item in found:
        told = item["metadata"].get("annotations") or {}
        if config_map := told.get(_STORE_ANNOTATION):
            return StoreReference(config_map=config_map, secret=told.get(_SECRET_ANNOTATION) or "")
    return None


async def _cronjobs(cluster: ConnectedCluster, component: str) -> list[Object]:
    """Return the CronJobs of a component of the chart."""
    path = f"/apis/batch/v1/namespaces/{cluster.namespace}/cronjobs"
    selector = f"app.kubernetes.io/component={component},app.kubernetes.io/name=slamhive"
    asked = Request(
        "list", "cronjobs.batch", cluster.namespace, "GET", path, query={"labelSelector": selector}
    )
    return list((await cluster.api.json(asked)).get("items") or ())


async def _started(cluster: ConnectedCluster, job: str, tell: Callable[[str], None]) -> str:
    """Wait until a Job's pod runs and return its name."""
    loop = asyncio.get_running_loop()
    begun, told = loop.time(), 0.0
    while True:
        pods, _ = await cluster.api.list(Kind.POD, cluster.namespace, labels=f"job-name={job}")
        why = "its pod was not made yet"
        for pod in pods:
            state, why = _state(pod)
            if state == "running":
                return name_of(pod)
            if state == "terminated":
                raise ClusterError(f"the pod that was to send the files ended: {why}")
        waited = loop.time() - begun
        if waited > _PATIENCE_SECONDS:
            raise ClusterError(
                f"the pod that is to send the files did not begin within {_PATIENCE_SECONDS:.0f} s: {why}"
            )
        if waited - told > _TELL_SECONDS:
            told = waited
            tell(f"waiting for a pod that sends the files: {why}")
        await asyncio.sleep(_LOOK_SECONDS)


def _state(pod: Object) -> tuple[str, str]:
    """Return the state of a sender's pod, and why it is no better one."""
    status = status_of(pod)
    shown: Object = next(iter(status.get("containerStatuses") or ()), {})
    states: dict[str, Object] = shown.get("state") or {}
    state, detail = next(iter(states.items()), ("waiting", {}))
    if status.get("phase") == "Failed" and state != "terminated":
        state, detail = "terminated", dict(status)
    why = str(detail.get("message") or detail.get("reason") or "")
    if state == "terminated" and "slamhive.jobs.send" in why:
        image = pod["spec"]["containers"][0]["image"]
        return state, f"image {image} is older than this command; upgrade the release there"
    unmet = [item for item in status.get("conditions") or () if item["status"] == "False"]
    return state, why or next(
        (item["message"] for item in unmet if item.get("message")), "it is being started"
    )
