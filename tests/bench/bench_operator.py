# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the operator: runs a second and CPU seconds, with played pods on a real control plane.

Beside it the same number of plain Jobs, made by a loop with as many in flight: of one container, and of a
run's own pod with monitor and volumes. All ways in turns, on the same control plane. CPU seconds depend less
on what else the machine does than rates do.
"""

from __future__ import annotations

import asyncio
import statistics
import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import operating
from job_loops import LONGEST_SECONDS, Cost, JobLoops, measured
from testcluster.kwok import Kwok, Play
from testcluster.lab import sweep

from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind

if TYPE_CHECKING:
    from collections import Counter

    from testcluster.access import Cluster
    from testcluster.kwok import Pool

RUNS = 400
ROUNDS = 2
WINDOWS = (32, 64)
LIVE = 1000
IDLE_SECONDS = 60.0
SECOND_LIST_SECONDS = 15.0


class Bench:
    """A control plane, its played nodes, and a namespace for runs and for Jobs.

    Args:
        access: the cluster.
        pool: played nodes on which pods end at once.
    """

    def __init__(self, access: Cluster, pool: Pool) -> None:
        self.access = access
        self._number = 0
        self.where = operating.namespace(access, "bench-runs")
        self.loops = JobLoops(access, pool.name, "bench-jobs", self.where)

    def run_sweep(self, count: int, window: int, labels: dict[str, str] | None = None) -> None:
        """Bring a Sweep to its end."""
        self._number += 1
        name = f"study-{self._number}"
        body = sweep(name, sizes=count, parallelism=window, cachePolicy="Rerun")
        body["metadata"]["labels"] = labels or {}
        asyncio.run(self._sweep(name, body, count))

    async def _sweep(self, name: str, body: dict[str, Any], count: int) -> None:
        api = await Api.connect(self.access.kubeconfig)
        deadline = time.monotonic() + LONGEST_SECONDS
        try:
            await api.create(Kind.SWEEP, body, self.where)
            while time.monotonic() < deadline:
                found = (await api.get(Key(Kind.SWEEP, self.where, name))).get("status") or {}
                if found.get("completionTime"):
                    break
                await asyncio.sleep(0.3)
            if found.get("succeeded") != count:
                raise SystemExit(f"of {count} runs {found.get('succeeded')} succeeded: {found}")
        finally:
            await api.close()


def bench_rates(access: Cluster, pool: Pool) -> None:
    """Report runs and Jobs per second."""
    bench = Bench(access, pool)
    with operating.operator(access, bench.where, operating.played_pods(pool.name)) as process:
        time.sleep(operating.NEW_KINDS_SECONDS)
        bench.run_sweep(8, 8)
        loops = bench.loops
        loops.run_plain(8, 8)
        for window in WINDOWS:
            runs, jobs, copies = [], [], []
            calls, looks = process.calls(), process.reconciled()
            for _ in range(ROUNDS):
                for costs, client, work in (
                    (runs, lambda: process.cpu, bench.run_sweep),
                    (jobs, time.process_time, loops.run_plain),
                    (copies, time.process_time, loops.run_copies),
                ):
                    costs.append(measured(access, RUNS, client, partial(work, RUNS, window)))
            _tell_rates(window, runs, jobs, copies)
            _tell_counts(process.calls() - calls, process.reconciled() - looks, RUNS * ROUNDS)


def _tell_rates(window: int, runs: list[Cost], jobs: list[Cost], copies: list[Cost]) -> None:
    def median(field: str) -> list[float]:
        return [statistics.median(getattr(cost, field) for cost in costs) for costs in (runs, jobs, copies)]

    ours, plain, copied = median("rate")
    operating.report(
        f"{RUNS} runs of a Sweep, {window} in flight",
        f"{ours:.1f} runs/s",
        f"{plain:.1f} plain Jobs/s: {ours / plain:.2f} of that, limit 0.5; "
        f"{copied:.1f}/s with a run's own pods: {ours / copied:.2f}; {operating.load()}",
    )
    for what, field in (
        ("the control plane and the played node", "cluster"),
        ("the API server and etcd", "server"),
        ("the operator (the loop)", "client"),
    ):
        ours, plain, copied = (1000 * value for value in median(field))
        peer = f"{plain:.1f} ms a plain Job, {copied:.1f} ms with a run's own pod"
        operating.report(f"CPU of {what} for each run", f"{ours:.1f} ms", peer)


def _tell_counts(calls: Counter[str], looks: Counter[str], count: int) -> None:
    told = ", ".join(f"{what} {number / count:.2f}" for what, number in calls.most_common(6))
    writes = sum(number for what, number in calls.items() if what.split()[0] in {"create", "patch", "delete"})
    operating.report("API writes of the operator for each run", f"{writes / count:.2f}", f"limit 5 ({told})")
    told = ", ".join(f"{kind} {number / count:.2f}" for kind, number in looks.most_common())
    operating.report("objects looked at for each run", f"{looks.total() / count:.2f}", told)


def bench_live(access: Cluster, pool: Pool) -> None:
    """Report the operator's memory and idle CPU while many runs live."""
    where = operating.namespace(access, "bench-live")
    pods = operating.played_pods(pool.name)
    with operating.operator(access, where, pods) as process:
        access.apply(sweep("study", sizes=LIVE, parallelism=LIVE), namespace=where)

        def running() -> int:
            return int(access.get("sweep", "study", "-n", where).get("status", {}).get("running") or 0)

        operating.until(lambda: running() == LIVE, f"{LIVE} runs", LONGEST_SECONDS, 1.0)
        started = operating.until(lambda: _all_started(access, where), "their status", LONGEST_SECONDS, 2.0)
        operating.settled(lambda: process.reconciled().total())
        time.sleep(SECOND_LIST_SECONDS)
        began, cpu = time.monotonic(), process.cpu
        time.sleep(IDLE_SECONDS)
        share = (process.cpu - cpu) / (time.monotonic() - began)
        most = operating.memory_mib(process.pid, "Rss")
        operating.report(
            f"the operator's memory with {started} live runs",
            f"{operating.memory_mib(process.pid, 'Pss'):.0f} MiB (resident {most:.0f} MiB)",
            f"limit {operating.MEMORY_LIMIT_MIB} MiB",
        )
        operating.report(
            "its share of a core while nothing happens", f"{share:.2%}", f"limit 1%; {operating.load()}"
        )


def _all_started(access: Cluster, where: str) -> int:
    phases = access.kubectl("get", "mappingruns", "-n", where, "-o", "jsonpath={.items[*].status.phase}")
    count = phases.split().count("Running")
    return count if count == LIVE else 0


def main() -> None:
    """Run all benchmarks, or those named: rates, live."""
    if why := operating.lacking():
        print(why)
        return
    wanted = sys.argv[1:] or ["rates", "live"]
    with operating.cluster("bench", node=False) as access:
        kwok = Kwok(access)
        if "rates" in wanted:
            with kwok.play(Play(), pool="ended", nodes=4) as pool:
                bench_rates(access, pool)
        if "live" in wanted:
            with kwok.play(Play(hold=True), pool="held", nodes=4) as pool:
                bench_live(access, pool)


if __name__ == "__main__":
    main()
