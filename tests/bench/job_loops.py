# SPDX-License-Identifier: Apache-2.0
"""The operator's peer in benchmarks: a loop that makes Jobs, with as many in flight as a Sweep has runs."""

from __future__ import annotations

import asyncio
import json
import statistics
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import operating

from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.api.transport import Request

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from testcluster.access import Cluster

LONGEST_SECONDS = 900.0


@dataclass(frozen=True)
class Cost:
    """Cost of bringing runs or Jobs to their end: how many a second, and CPU seconds for each.

    Attributes:
        rate: how many a second.
        server: CPU seconds of API server and etcd.
        cluster: CPU seconds of all programs of the control plane and of what plays the nodes.
        client: CPU seconds of who makes them.
    """

    rate: float
    server: float
    cluster: float
    client: float


def mean_cost(costs: Sequence[Cost]) -> Cost:
    """Return the mean cost of loops that made as many Jobs each."""
    return Cost(
        rate=statistics.harmonic_mean([cost.rate for cost in costs]),
        server=statistics.fmean(cost.server for cost in costs),
        cluster=statistics.fmean(cost.cluster for cost in costs),
        client=statistics.fmean(cost.client for cost in costs),
    )


def measured(access: Cluster, count: int, client: Callable[[], float], work: Callable[[], None]) -> Cost:
    """Return the cost of bringing a number of runs or Jobs to their end."""
    times = operating.ProgramTimes(access)
    before, own, started = times.read(), client(), time.perf_counter()
    work()
    elapsed, own = time.perf_counter() - started, client() - own
    used = times.read() - before
    server = used["kube-apiserver"] + used["etcd"]
    return Cost(count / elapsed, server / count, used.total() / count, own / count)


class JobLoops:
    """Makes Jobs of a namespace of their own and waits for their ends.

    Args:
        access: the cluster.
        pool: name of the played nodes on which pods end at once.
        where: namespace of the Jobs.
        runs: namespace of the operator's runs, of which one's Job is copied.
        removes: whether each Job is deleted at its end, as who makes very many has to.
    """

    def __init__(self, access: Cluster, pool: str, where: str, runs: str, *, removes: bool = False) -> None:
        self._access = access
        self._pods = operating.played_pods(pool)
        self._where = operating.namespace(access, where)
        self._runs = runs
        self._removes = removes
        self._number = 0
        self._copied: dict[str, Any] | None = None

    def run_plain(self, count: int, window: int) -> None:
        """Bring Jobs of one container to their end."""
        self._number += 1
        asyncio.run(self._loop(f"plain-{self._number}", count, window, self._plain()))

    def run_copies(self, count: int, window: int) -> None:
        """Bring Jobs to their end that are like those of runs."""
        self._number += 1
        asyncio.run(self._loop(f"copy-{self._number}", count, window, self._copy()))

    async def _loop(self, stem: str, count: int, window: int, body: dict[str, Any]) -> None:
        api = await Api.connect(self._access.kubeconfig)
        ends = {f"{stem}-{number}": asyncio.Event() for number in range(count)}
        room = asyncio.Semaphore(window)
        watching = asyncio.create_task(self._watch(api, ends))

        async def one(name: str) -> None:
            async with room:
                await api.create(Kind.JOB, body | {"metadata": {"name": name}}, self._where)
                await ends[name].wait()
                if self._removes:
                    await api.delete(Key(Kind.JOB, self._where, name))

        try:
            async with asyncio.timeout(LONGEST_SECONDS):
                await asyncio.gather(*map(one, ends))
        finally:
            watching.cancel()
            await api.close()

    async def _watch(self, api: Api, ends: dict[str, asyncio.Event]) -> None:
        path = Kind.JOB.path(self._where)
        listed = await api.json(Request("list", "jobs", self._where, "GET", path, query={"limit": 1}))
        version = listed["metadata"]["resourceVersion"]
        address = f"{api._client.configuration.host}{path}?watch=true&resourceVersion={version}"
        async with api.session.get(address, timeout=None) as answer:
            async for line in answer.content:
                job = json.loads(line)["object"]
                told = job["status"].get("conditions") or ()
                name = job["metadata"]["name"]
                if name in ends and any(item["type"] == "Complete" for item in told):
                    ends[name].set()

    def _copy(self) -> dict[str, Any]:
        # Kept, as the run that it was copied of may be archived and deleted meanwhile.
        self._copied = self._copied or self._copy_anew()
        return self._copied

    def _copy_anew(self) -> dict[str, Any]:
        labels = "slamhive.io/role=run"
        spec = self._access.get("jobs", "-n", self._runs, "-l", labels)["items"][0]["spec"]
        del spec["selector"]
        template = spec["template"]["metadata"]
        generated = ("batch.kubernetes.io/", "controller-uid", "job-name")
        template["labels"] = {
            name: value for name, value in template["labels"].items() if not name.startswith(generated)
        }
        return {"spec": spec}

    def _plain(self) -> dict[str, Any]:
        safe = {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}
        container = {
            "name": "main",
            "image": "example.test/icp:1",
            "command": ["true"],
            "securityContext": safe,
            "resources": {"requests": {"cpu": "1", "memory": "1Gi"}},
        }
        pod = self._pods | {
            "restartPolicy": "Never",
            "securityContext": {
                "runAsNonRoot": True,
                "runAsUser": 65532,
                "seccompProfile": {"type": "RuntimeDefault"},
            },
            "containers": [container],
        }
        return {"spec": {"backoffLimit": 0, "template": {"spec": pod}}}
