# SPDX-License-Identifier: Apache-2.0
"""Benchmark of shares and forecasts: two namespaces, a Sweep each with weights 3 to 1, one operator.

Runs are played on a real control plane, evaluated and archived; first with ``sharing.slots``, then without,
on nodes of limited room. Each second is noted which namespace has how many runs in flight, and what its Sweep
says of its end. ``python tests/bench/bench_sharing.py 2000`` has as many runs in each Sweep.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.extend(str(Path(__file__).parents[1] / place) for place in ("cluster", "kube/faults"))

import operating
from scaling.points import large_sweep
from testcluster.kwok import Kwok, Play

if TYPE_CHECKING:
    from testcluster.access import Cluster
    from testcluster.kwok import Pool

RUNS = 500
SLOTS = 32
WEIGHTS = {"three": 3, "one": 1}
"""Of the Sweep in each namespace."""
RUN_SECONDS = 4.0
NODES = 4
WARM_SECONDS = 60.0
"""The first minute: what comes after it counts."""
LONGEST_SECONDS = 3600.0
GOAL = 1 / 3
"""Error of a forecast that is good enough."""
FORECASTS = (0.10, 0.25, 0.50, 0.75)
"""Parts of a Sweep at which its forecast is compared with what came."""
_PATHS = (
    "/api/v1/pods?labelSelector=slamhive.io/role%3Drun&fieldSelector=status.phase%3DPending",
    "/apis/slamhive.io/v1alpha1/sweeps",
)
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "days": 86400.0, "day": 86400.0}


@dataclass
class Sampled:
    """Series of what is seen of a namespace, a value each second.

    Attributes:
        seconds: since the Sweeps were applied.
        runs: runs in flight, by its status, without those that wait.
        waiting: runs whose pods have no node.
        done: part of the Sweep's runs that have ended.
        forecast: what its status said of its end.
        over: when nothing of it was left to start; None: not yet.
        ended: when its last run had ended; None: not yet.
    """

    seconds: list[float] = field(default_factory=list)
    runs: list[int] = field(default_factory=list)
    waiting: list[int] = field(default_factory=list)
    done: list[float] = field(default_factory=list)
    forecast: list[str | None] = field(default_factory=list)
    over: float | None = None
    ended: float | None = None

    def take(self, seconds: float, runs: int, waiting: int, status: dict[str, Any], count: int) -> None:
        """Take a sample."""
        ended = (status.get("succeeded") or 0) + (status.get("failed") or 0)
        self.seconds.append(seconds)
        self.runs.append(runs)
        self.waiting.append(waiting)
        self.done.append(ended / count)
        self.forecast.append((status.get("share") or {}).get("end"))
        if self.over is None and status.get("pending") == 0:
            self.over = seconds
        if self.ended is None and ended == count:
            self.ended = seconds


def seconds_of(words: str | None) -> float | None:
    """Return the time that a forecast stands for, s.

    >>> seconds_of("in about 1.5 h"), seconds_of("within a minute"), seconds_of(None)
    (5400.0, 60.0, None)
    """
    if words is None:
        return None
    found = re.search(r"([\d.]+) (\w+)$", words)
    return 60.0 if found is None else float(found[1]) * _UNITS[found[2]]


def sample(access: Cluster, began: float, seen: dict[str, Sampled], count: int) -> None:
    """Take a sample of each namespace."""
    pods, sweeps = (json.loads(access.kubectl("get", "--raw", path))["items"] for path in _PATHS)
    statuses = {body["metadata"]["namespace"]: body.get("status") or {} for body in sweeps}
    now = time.monotonic() - began
    waiting = Counter(pod["metadata"]["namespace"] for pod in pods if not pod["spec"].get("nodeName"))
    for space, one in seen.items():
        status = statuses.get(space, {})
        # A status may be some seconds older than the pods.
        flying = max(0, (status.get("running") or 0) - waiting[space])
        one.take(now, flying, waiting[space], status, count)


def play(access: Cluster, pool: Pool, count: int, slots: int | None) -> None:
    """Have both Sweeps run to their ends, and report."""
    what = "without slots, 32 pods fit" if slots is None else f"{slots} slots"
    marks = {space: f"{space}-{'nodes' if slots is None else 'slots'}" for space in WEIGHTS}
    for space in marks.values():
        operating.namespace(access, space)
    with (
        tempfile.TemporaryDirectory() as folder,
        operating.operator(
            *(access, marks["one"], operating.played_pods(pool.name)),
            program="scaling.played_operator",
            archiveUrlFile=str(_url(Path(folder))),
            namespaces=[*marks.values()],
            sharing={"slots": slots},
        ) as process,
    ):
        time.sleep(operating.NEW_KINDS_SECONDS)
        seen = {space: Sampled() for space in marks.values()}
        for number, (space, weight) in enumerate(WEIGHTS.items()):
            body = large_sweep(space, count, 64, retained=20, first=1 + number * count, weight=weight)
            access.apply(body, namespace=marks[space])
        began, cpu, before = time.monotonic(), process.cpu, process.reconciled()
        while any(one.ended is None for one in seen.values()):
            due = time.monotonic() + 1.0
            sample(access, began, seen, count)
            if seen[marks["one"]].seconds[-1] > LONGEST_SECONDS:
                print(f"not done after {LONGEST_SECONDS:g} s; figures of what was\n{process.said()}")
                break
            time.sleep(max(0.0, due - time.monotonic()))
        runs = max(1, round(count * sum(one.done[-1] for one in seen.values())))
        looks = process.reconciled() - before
        operating.report(
            f"CPU of the operator a run, {what}",
            f"{1000 * (process.cpu - cpu) / runs:.1f} ms",
            f"{runs} runs in {time.monotonic() - began:.0f} s; {operating.load()}",
        )
        told = ", ".join(f"{kind} {number / runs:.2f}" for kind, number in looks.most_common())
        operating.report(f"objects looked at for each run, {what}", f"{looks.total() / runs:.2f}", told)
    tell_shares(what, seen[marks["three"]], seen[marks["one"]], slots)
    for space, mark in marks.items():
        tell_forecasts(f"{what}, weight {WEIGHTS[space]}", seen[mark])


def _url(folder: Path) -> Path:
    file = folder / "url"
    file.write_text(f"sqlite:///{folder}/archive.sqlite")
    return file


def tell_shares(what: str, three: Sampled, one: Sampled, slots: int | None) -> None:
    """Report the shares from the first minute on, as long as both have runs to start."""
    end = min(each.over or each.seconds[-1] for each in (three, one))
    pairs = [
        (first, other)
        for seconds, first, other in zip(three.seconds, three.runs, one.runs, strict=True)
        if WARM_SECONDS <= seconds < end and first + other
    ]
    if not pairs:
        operating.report(f"share of weight 3, {what}", "none", "the Sweeps ended in the first minute")
        return
    shares = [first / (first + other) for first, other in pairs]
    within = sum(0.675 <= share <= 0.825 for share in shares) / len(shares)
    operating.report(
        f"share of weight 3, {what}",
        f"{statistics.fmean(shares):.3f} ({min(shares):.2f} to {max(shares):.2f})",
        f"0.75 within 10 %: {within:.0%} of {len(shares)} samples",
    )
    whole = [first + other for first, other in pairs]
    waits = [a + b for a, b in zip(three.waiting, one.waiting, strict=True)]
    first = next(
        (
            at
            for at, a, b in zip(three.seconds, three.runs, one.runs, strict=True)
            if a + b >= 0.9 * (slots or max(whole))
        ),
        None,
    )
    operating.report(
        f"runs in flight, {what}",
        f"{statistics.fmean(whole):.1f} ({min(whole)} to {max(whole)})",
        f"nine tenths after {first:.0f} s; {statistics.fmean(waits):.1f} pods waited, {max(waits)} at most",
    )


def tell_forecasts(what: str, one: Sampled) -> None:
    """Report forecasts of the end beside what came."""
    for part in FORECASTS:
        at = next((number for number, done in enumerate(one.done) if done >= part), None)
        if at is None or one.ended is None:
            continue
        came, words = one.ended - one.seconds[at], one.forecast[at]
        told = seconds_of(words)
        ratio = "none" if told is None else f"{told / came:.2f} of what came"
        if words == "within a minute" and came <= 60.0 * (1 + GOAL):
            ratio = "true"
        operating.report(f"forecast at {part:.0%}, {what}", f"{words}: {ratio}", f"{came:.0f} s came")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description="Benchmark of shares and forecasts.")
    parser.add_argument("runs", type=int, nargs="?", default=RUNS, help=f"of each Sweep, default {RUNS}")
    parser.add_argument("--seconds", type=float, default=RUN_SECONDS, help="how long a run takes")
    parser.add_argument("--only", choices=("slots", "nodes"), help="one of both parts")
    options = parser.parse_args()
    if why := operating.lacking():
        print(why)
        return
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [str(Path(__file__).parent), *sys.path[-2:], os.environ.get("PYTHONPATH", "")]
    )
    with (
        operating.cluster("bench-sharing", node=False) as access,
        Kwok(access).play(
            Play(delay_milliseconds=int(1000 * options.seconds)), pool="shared", nodes=NODES
        ) as pool,
    ):
        if options.only != "nodes":
            play(access, pool, options.runs, SLOTS)
        if options.only != "slots":
            for node in pool.nodes:
                room = {"status": {"allocatable": {"pods": str(SLOTS // NODES)}}}
                access.patch("node", node, room, "default", "status")
            play(access, pool, options.runs, None)


if __name__ == "__main__":
    main()
