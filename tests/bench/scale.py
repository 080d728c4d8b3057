# SPDX-License-Identifier: Apache-2.0
"""Benchmark of one large Sweep: ``make bench-scale``, or ``python tests/bench/scale.py --help``.

Its runs are played on a real control plane, evaluated in batches, archived and deleted. Beside it loops make
Jobs, plain ones and some with a run's own pod, before it, every few thousand runs while it is suspended, and
after it. With ``--kills`` parts are killed at random meanwhile. At the end a checker compares what archive
and cluster hold with what there should be: no run twice, none lost, every figure by its definition.

Its curve goes into a folder, as CSV and JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

sys.path.extend(
    str(Path(__file__).parents[1] / place)
    for place in ("archive", "bench", "cluster", "honest", "kube/faults")
)

import operating
from job_loops import JobLoops, mean_cost, measured
from scaling import beside, checking, former, killing, sampling, storing
from scaling.points import large_sweep
from servers import postgresql
from testcluster.access import until
from testcluster.kwok import Kwok, Play
from testcluster.local import Local

if TYPE_CHECKING:
    from collections.abc import Callable

    from job_loops import Cost
    from servers import PostgreSQL
    from testcluster.access import Cluster

RUNS = 80_000
WINDOW = 64
PEERS = 2000
RETAINED = 200
SWEEP = "large"
CLUSTER = "scale"
SAMPLE_SECONDS = 10.0
LONGEST_PAUSE = 900.0
STAGES = ("beginning", "middle", "end")
RUNS_A_TURN = 3000
"""Between these loops make Jobs: what else the machine does changes over minutes, and is to be in both."""


class Course:
    """One large Sweep from its beginning to its end.

    Args:
        options: the command's.
        access: the cluster.
        process: the operator.
        loops: what makes Jobs beside it; None: nothing does.
        sampler: what takes samples.
        killer: what kills parts.
    """

    def __init__(  # noqa: PLR0917 - one each
        self,
        options: argparse.Namespace,
        access: Cluster,
        process: operating.OperatorProcess,
        loops: JobLoops | None,
        sampler: sampling.Sampler,
        killer: killing.Killer | None,
    ) -> None:
        self._options = options
        self._access = access
        self._process = process
        self._loops = loops
        self._sampler = sampler
        self._killer = killer
        self._clock = sampling.Clock()
        self._turns = max(1, options.runs // len(STAGES) // RUNS_A_TURN)
        self._costs: list[dict[str, Cost]] = []
        self._spent: dict[str, defaultdict[str, float]] = {stage: defaultdict(float) for stage in STAGES}
        self.steps: dict[str, float] = {}
        self.problems: list[str] = []

    def run(self, where: str) -> dict[str, Any]:
        """Bring the Sweep to its end and return it as it is then."""
        count = self._options.runs
        self._beside()
        body = large_sweep(SWEEP, count, self._options.window, retained=self._options.retained)
        self._access.apply(body, namespace=where)
        self._clock = sampling.Clock()
        for number in range(len(STAGES) * self._turns):
            stage = STAGES[number // self._turns]
            if stage == "middle" and self._options.beside and not self.steps:
                self._have_another(where)
            ended = (number + 1) * count // (len(STAGES) * self._turns)
            self._advance(stage, ended)
            if ended < count:
                self._pause(where)
        sweep = self._until(lambda body: bool((body.get("status") or {}).get("completionTime")), "its end")
        self._until(self._is_tidy, "what is archived to be deleted")
        self._beside()
        for stage in set(STAGES) - self.parts.keys():
            print(f"{stage}: too few runs ended meanwhile for figures", flush=True)
        return sweep

    @property
    def parts(self) -> dict[str, dict[str, float]]:
        """Return the cost of a run in each stage, and the number of those that ended a second."""
        found: dict[str, dict[str, float]] = {}
        for stage, spent in self._spent.items():
            done = spent["runs"]
            if 10 * done < self._options.runs // len(STAGES):
                continue  # most ended while another Sweep was looked at
            costs = {name: spent[name] / done for name in ("operator", "server", "cluster")}
            found[stage] = {"runs": done, "rate": done / spent["seconds"]} | costs
        return found

    @property
    def peers(self) -> dict[str, dict[str, Cost]]:
        """Return the cost of loops before, between and after the turns of each stage."""
        if not self._costs:
            return {}
        return {
            stage: {
                name: mean_cost([costs[name] for costs in self._costs[first : first + self._turns + 1]])
                for name in self._costs[0]
            }
            for first, stage in zip(range(0, len(self._costs), self._turns), STAGES, strict=False)
        }

    def _have_another(self, where: str) -> None:
        """Have another Sweep edited, suspended, resumed, cancelled and deleted beside the large one."""
        other = beside.Beside(self._access, where, self._options.beside, self._options.runs + 1)
        self.problems += other.run()
        self.steps = other.seconds

    def _is_tidy(self, body: dict[str, Any]) -> bool:
        sample = self._sampler.take(body, self._clock.seconds)
        return sample is not None and sample.mappingruns <= self._options.retained + self._options.warm

    def _advance(self, stage: str, ended: int) -> None:
        """Wait until so many runs have ended and note what these cost."""
        times = self._sampler.times
        began, cpu, own = self._clock.seconds, times.read(), self._process.cpu
        first = self._ended()
        last = self._until(lambda body: _ended(body) >= ended, f"{ended} runs")
        used = times.read() - cpu
        for name, spent in (
            ("runs", _ended(last) - first),
            ("seconds", self._clock.seconds - began),
            ("operator", self._process.cpu - own),
            ("server", used["kube-apiserver"] + used["etcd"]),
            ("cluster", used.total()),
        ):
            self._spent[stage][name] += spent

    def _ended(self) -> int:
        return _ended(self._sampler.sweep(SWEEP) or {})

    def _until(self, is_so: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        """Take samples and kill what is due until something is so of the Sweep, which has to go on."""
        last, moved, sampled = -1, time.monotonic(), 0.0
        while True:
            body = self._sampler.sweep(SWEEP)
            if body is not None:
                if time.monotonic() - sampled >= self._options.every:
                    sampled = time.monotonic()
                    self._judge(self._sampler.take(body, self._clock.seconds))
                if self._killer is not None:
                    self._killer.look(_ended(body))
                if is_so(body):
                    return body
                standing = _ended(body) + ((body.get("status") or {}).get("evaluated") or 0)
                if standing != last:
                    last, moved = standing, time.monotonic()
            if time.monotonic() - moved > LONGEST_PAUSE:
                told = json.dumps((body or {}).get("status"), indent=1)[:3000]
                raise SystemExit(f"nothing went on for {LONGEST_PAUSE:g} s before {what}: {told}")
            time.sleep(1.0)

    def _judge(self, sample: sampling.Sample | None) -> None:
        """Note what has outgrown its bound."""
        if sample is None:
            return
        window, retained = self._options.window, self._options.retained
        # Beside those that run: a window and two rounds of batches, which wait to be measured.
        most = retained + self._options.warm + 3 * window + 2 * 2 * 200
        for what, found, limit in (
            ("runs in flight", sample.running, window),
            ("MappingRuns", sample.mappingruns, most),
            ("keys in the operator's queue", sample.queued + sample.delayed, 2 * most),
            ("bytes of the Sweep's status", sample.status_bytes, 8192 + self._options.runs // 2),
        ):
            if found > limit:
                self.problems.append(
                    f"{found} {what} after {sample.ended} runs, at most {limit} are expected"
                )

    def _pause(self, where: str) -> None:
        """Suspend the Sweep, let the loops of Jobs run, and resume it."""
        if self._loops is None:
            return
        self._access.patch("sweep", SWEEP, {"spec": {"suspend": True}}, where)
        self._until(lambda body: (body.get("status") or {}).get("running") == 0, "it to be suspended")
        began = time.monotonic()
        self._beside()
        self._clock.leave_out(time.monotonic() - began)
        self._access.patch("sweep", SWEEP, {"spec": {"suspend": False}}, where)

    def _beside(self) -> None:
        if self._loops is None:
            return
        count, window = max(1, self._options.peers // self._turns), self._options.window
        self._costs.append(
            {
                name: measured(self._access, count, time.process_time, partial(loop, count, window))
                for name, loop in (("plain", self._loops.run_plain), ("copies", self._loops.run_copies))
            }
        )


def _ended(sweep: dict[str, Any]) -> int:
    status = sweep.get("status") or {}
    return int((status.get("succeeded") or 0) + (status.get("failed") or 0))


def run(options: argparse.Namespace, access: Cluster, url: str, database: PostgreSQL | None) -> list[str]:
    """Run the benchmark on an archive, print its figures, and return what is wrong."""
    with ExitStack() as stack:
        pool = stack.enter_context(Kwok(access).play(Play(), pool=options.archive, nodes=4))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        where = operating.namespace(access, f"scale-{options.archive}")
        (folder / "url").write_text(url)
        watches = (
            stack.enter_context(killing.watches_through(access, folder / "kubeconfig"))
            if options.kills
            else None
        )
        process = stack.enter_context(
            operating.operator(
                *(access, where, operating.played_pods(pool.name)),
                program="scaling.played_operator",
                kubeconfig=folder / "kubeconfig" if watches else None,
                archiveUrlFile=str(folder / "url"),
            )
        )
        sampler = sampling.Sampler(access, process, where, url, options.out / options.archive)
        stack.callback(sampler.close)
        time.sleep(operating.NEW_KINDS_SECONDS)
        access.apply(large_sweep("warm", options.warm, options.warm, retained=options.warm), namespace=where)
        until(
            lambda: ((sampler.sweep("warm") or {}).get("status") or {}).get("completionTime"),
            "first runs",
            600,
            1,
        )
        loops = None
        if options.peers:
            loops = JobLoops(access, pool.name, f"jobs-{options.archive}", where, removes=True)
        killer = None
        if watches is not None:
            random = Random(options.seed)
            # None comes late: while a part is away for long, many runs end.
            latest = max(4 * options.runs // 5, options.kills + 1)
            due = sorted(random.sample(range(1, latest), options.kills))
            killable = killing.parts(Local.named(CLUSTER), access, process, watches, database)
            killer = killing.Killer(due, killable, random)
        course = Course(options, access, process, loops, sampler, killer)
        sweep = course.run(where)
        uid = sweep["metadata"]["uid"]
        live = sampler.live(uid)
        wrong = [*course.problems, *checking.problems(url, sweep, live, options.runs, options.retained)]
        figures = {
            "options": {name: str(value) for name, value in vars(options).items()},
            "cores": len(os.sched_getaffinity(0)),
            "load": os.getloadavg(),
            "parts": course.parts,
            "beside": course.steps,
            "peers": {
                stage: {name: vars(cost) for name, cost in told.items()}
                for stage, told in course.peers.items()
            },
            "calls": dict(process.calls()),
            "looks": dict(process.reconciled()),
            "kills": killer.done if killer else [],
            "sums": checking.figures(url, uid, live),
            "problems": wrong,
            "archive": _storing(url),
        }
        sampling.write(sampler.taken, figures, options.out / options.archive)
        tell(options, course, sampler.taken, figures)
    return wrong


def _storing(url: str) -> dict[str, float]:
    ours, copied, count = storing.speeds(url)
    return {"runs": count, "rate": ours, "copied": copied, "bytesARun": storing.size(url) / max(count, 1)}


def tell(
    options: argparse.Namespace, course: Course, samples: list[sampling.Sample], figures: dict[str, Any]
) -> None:
    """Print the table of figures."""
    parts, peers, store = course.parts, course.peers, figures["archive"]
    what = f"{options.runs} runs, {options.window} in flight, archive in {options.archive}"
    for stage in parts:
        ours = parts[stage]
        loops = "no loop of Jobs beside it"
        if stage in peers:
            plain, copies = peers[stage]["plain"], peers[stage]["copies"]
            loops = (
                f"{plain.rate:.1f} plain Jobs/s: {ours['rate'] / plain.rate:.2f}, goal 0.6; "
                f"{copies.rate:.1f}/s with a run's own pod: {ours['rate'] / copies.rate:.2f}, goal 0.9"
            )
        operating.report(f"{what}, {stage}", f"{ours['rate']:.1f} runs/s", f"{loops}; {operating.load()}")
    if {STAGES[0], STAGES[-1]} <= parts.keys():
        share = parts[STAGES[-1]]["rate"] / parts[STAGES[0]]["rate"]
        operating.report("rate at the end", f"{share:.2f} of the beginning's", "goal 0.9")
    for stage, ours in parts.items():
        limit = "goal 1.15 times a Job with a run's own pod"
        if stage in peers:
            copied = peers[stage]["copies"].server
            limit = (
                f"{1000 * copied:.1f} ms a Job with a run's own pod: {ours['server'] / copied:.2f}, goal 1.15"
            )
        operating.report(
            f"CPU of the operator a run, {stage}", f"{1000 * ours['operator']:.1f} ms", "goal 8 ms"
        )
        operating.report(
            f"CPU of API server and etcd a run, {stage}", f"{1000 * ours['server']:.1f} ms", limit
        )
    for name, text in (
        ("operator_mib", f"MiB of the operator, limit {operating.MEMORY_LIMIT_MIB}"),
        ("etcd_mib", "MiB of etcd"),
        ("mappingruns", "MappingRuns"),
        ("queued", "keys in the operator's queue"),
        ("status_bytes", "bytes of the Sweep's status"),
    ):
        values = [getattr(sample, name) for sample in samples] or [0]
        operating.report(text, f"{max(values):g} at most", f"{values[0]:g} first, {values[-1]:g} last")
    operating.report(
        f"rows into {options.archive}, as the operator writes them",
        f"{store['rate']:.0f} runs/s",
        f"{store['copied']:.0f}/s by the database's own copy; goal 500; "
        f"{store['bytesARun']:.0f} bytes a run, goal 2000",
    )
    for step, seconds in course.steps.items():
        operating.report(f"a Sweep of {options.beside} beside, {step}", f"{seconds:g} s", "limit 60 s")
    for problem in figures["problems"] or ["none"]:
        operating.report("problems", problem, f"{len(figures['kills'])} of {options.kills} kills")


def main() -> int:
    """Run the benchmark; the exit code is 1 where something is wrong."""
    parser = argparse.ArgumentParser(description="Benchmark of one large Sweep.")
    parser.add_argument("runs", type=int, nargs="?", default=RUNS, help=f"number of runs, default {RUNS}")
    parser.add_argument("--window", type=int, default=WINDOW, help="runs in flight")
    parser.add_argument("--archive", choices=("postgresql", "sqlite", "both"), default="both")
    parser.add_argument(
        "--peers", type=int, help="Jobs of each loop; default: 2000, less beside few runs; 0: none"
    )
    parser.add_argument(
        "--beside", type=int, help="points of another Sweep that is edited; default: as --peers"
    )
    parser.add_argument("--kills", type=int, default=0, help="how often a part is killed")
    parser.add_argument("--seed", type=int, default=0, help="of the kills")
    parser.add_argument(
        "--retained", type=int, default=RETAINED, help="finished runs that keep their objects"
    )
    parser.add_argument(
        "--former", default=former.COMMIT, help="commit whose benchmark is run beside; none: without"
    )
    parser.add_argument("--every", type=float, default=SAMPLE_SECONDS, help="seconds between samples")
    parser.add_argument("--out", type=Path, default=Path("bench-scale"), help="folder for the curve")
    options = parser.parse_args()
    options.peers = min(PEERS, max(options.runs // 5, 1)) if options.peers is None else options.peers
    options.beside = options.peers if options.beside is None else options.beside
    options.warm = 8
    if why := operating.lacking():
        print(why)
        return 0
    os.environ["PYTHONPATH"] = os.pathsep.join([*sys.path[-5:], os.environ.get("PYTHONPATH", "")])
    wrong: list[str] = []
    wanted = ("postgresql", "sqlite") if options.archive == "both" else (options.archive,)
    for archive in wanted:
        options.archive = archive
        with operating.cluster(CLUSTER, node=False) as access:
            wrong += measure(options, access)
        if options.former != "none":
            folder = options.out / archive
            figures = json.loads((folder / "scale.json").read_text(encoding="utf-8"))
            former.beside(options.former, options.runs, archive, figures | {"memory": former.peak(folder)})
    return 1 if wrong else 0


def measure(options: argparse.Namespace, access: Cluster) -> list[str]:
    """Run the benchmark on an archive of the kind that the options name."""
    if options.archive == "sqlite":
        with tempfile.TemporaryDirectory() as folder:
            return run(options, access, f"sqlite:///{folder}/archive.sqlite", None)
    with postgresql(durable=True) as database:
        if database is None:
            print("PostgreSQL · not installed · apt-get install postgresql", flush=True)
            return []
        return run(options, access, database.url, database)


if __name__ == "__main__":
    sys.exit(main())
