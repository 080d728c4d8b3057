# SPDX-License-Identifier: Apache-2.0
"""Benchmark of Kueue's admission: each run's Job as a Workload, beside one Workload for a whole Sweep.

Sweeps with a queue and without one, in turns, on a real control plane with Kueue's own controller and played
pods; then one Workload that holds a Sweep's quota, as a Sweep that is admitted whole would have. Writes are
counted by the API server, of whomever they are.
"""

from __future__ import annotations

import re
import statistics
import time
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any

import operating
from bench_operator import Bench
from job_loops import Cost, measured
from testcluster.kwok import Kwok, Play
from testcluster.local import Local
from testcluster.programs import build, files_of

from slamhive.model.base import QUEUE_NAME

if TYPE_CHECKING:
    from testcluster.access import Cluster

RUNS = 200
ROUNDS = 3
WINDOW = 32
NAME = "bench-kueue"
_API_VERSION = "kueue.x-k8s.io/v1beta2"
_WRITE = re.compile(
    r'^apiserver_request_total\{.*resource="([^"]*)".*subresource="([^"]*)".*verb="(POST|PUT|PATCH|APPLY|DELETE)"'
    r".*\} (\S+)$",
    re.MULTILINE,
)


def writes(access: Cluster) -> Counter[str]:
    """Return the number of writes that the API server took so far, by resource."""
    found: Counter[str] = Counter()
    for resource, part, _, number in _WRITE.findall(access.kubectl("get", "--raw", "/metrics")):
        found[f"{resource}/{part}".rstrip("/")] += int(float(number))
    del found["leases"]
    return found


def start_kueue(access: Cluster, where: str) -> None:
    """Have Kueue at work, with a queue that has room for all."""
    build(("kueue",))
    paths = sorted(files_of("kueue").glob("*.yaml"))
    access.apply_files(paths)
    access.await_kinds(f"{path.stem.partition('_')[2]}.kueue.x-k8s.io" for path in paths)
    Local.named(NAME).start("kueue")
    room = [{"name": name, "nominalQuota": "1000000"} for name in ("cpu", "memory")]
    room[1]["nominalQuota"] = "1000Ti"
    flavors = [{"name": "any", "resources": room}]
    groups = [{"coveredResources": ["cpu", "memory"], "flavors": flavors}]
    access.apply(
        kind("ResourceFlavor", "any"),
        kind("ClusterQueue", "all", spec={"namespaceSelector": {}, "resourceGroups": groups}),
        kind("LocalQueue", "lab", spec={"clusterQueue": "all"}),
        namespace=where,
    )


def kind(word: str, name: str, **more: Any) -> dict[str, Any]:
    """Return an object of Kueue's."""
    return {"apiVersion": _API_VERSION, "kind": word, "metadata": {"name": name}} | more


def count_one_workload(access: Cluster, where: str) -> Counter[str]:
    """Return the writes of one Workload that holds a Sweep's quota, from its making to its end."""
    container = {"name": "run", "image": "any", "resources": {"requests": {"cpu": "1", "memory": "1Gi"}}}
    template = {"spec": {"restartPolicy": "Never", "containers": [container]}}
    sets = [{"name": "main", "count": WINDOW, "template": template}]
    before = writes(access)
    access.apply(kind("Workload", "whole", spec={"queueName": "lab", "podSets": sets}), namespace=where)
    access.kubectl("wait", "workload/whole", "-n", where, "--for=condition=Admitted", "--timeout=60s")
    finished = {"type": "Finished", "status": "True", "reason": "Succeeded", "message": "done"}
    ended = {"status": {"conditions": [finished | {"lastTransitionTime": "2026-01-01T00:00:00Z"}]}}
    access.patch("workload", "whole", ended, where, "status")
    access.kubectl("delete", "workload", "whole", "-n", where)
    time.sleep(2)
    return writes(access) - before


def main() -> None:
    """Measure, and print figures."""
    if why := operating.lacking():
        print(why)
        return
    with (
        operating.cluster(NAME, node=False) as access,
        Kwok(access).play(Play(), pool="ended", nodes=4) as pool,
    ):
        bench = Bench(access, pool)
        start_kueue(access, bench.where)
        with operating.operator(access, bench.where, operating.played_pods(pool.name)) as process:
            time.sleep(operating.NEW_KINDS_SECONDS)
            ways: dict[str, dict[str, str]] = {"without": {}, "with": {QUEUE_NAME: "lab"}}
            for labels in ways.values():
                bench.run_sweep(8, 8, labels)
            costs: dict[str, list[Cost]] = {way: [] for way in ways}
            made: dict[str, Counter[str]] = {way: Counter() for way in ways}
            for _ in range(ROUNDS):
                for way, labels in ways.items():
                    before = writes(access)
                    work = partial(bench.run_sweep, RUNS, WINDOW, labels)
                    costs[way].append(measured(access, RUNS, lambda: process.cpu, work))
                    operating.settled(lambda: writes(access).total())
                    made[way] += writes(access) - before
        for field, what in (
            ("rate", "runs a second"),
            ("server", "CPU of API server and etcd a run, ms"),
            ("cluster", "CPU of the whole control plane a run, ms"),
            ("client", "CPU of the operator a run, ms"),
        ):
            scale = 1 if field == "rate" else 1000
            ours, plain = (
                scale * statistics.median(getattr(cost, field) for cost in costs[way])
                for way in ("with", "without")
            )
            operating.report(
                f"{what}, each run a Workload",
                f"{ours:.1f}",
                f"{plain:.1f} without a queue: {ours / plain:.2f}; {operating.load()}",
            )
        for way, found in made.items():
            told = ", ".join(
                f"{name} {number / (RUNS * ROUNDS):.2f}" for name, number in found.most_common(12)
            )
            operating.report(f"writes a run {way} a queue", f"{found.total() / (RUNS * ROUNDS):.2f}", told)
        whole = count_one_workload(access, bench.where)
        operating.report("writes of one Workload for a whole Sweep", str(whole.total()), str(dict(whole)))


if __name__ == "__main__":
    main()
