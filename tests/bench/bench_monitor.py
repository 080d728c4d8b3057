# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the monitor's cost and accuracy: `python tests/bench/bench_monitor.py`.

Prints one line per figure: what · ours · limit or peer.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from slamhive.monitor import SupervisorSpec, identify, make_run_cgroup

REPETITIONS = 15
IDLE_SECONDS = 5.0
# Threads, a pool of children and 300 short-lived ones, about 3 CPU seconds together.
WORK = """
import subprocess, threading, multiprocessing, time
def burn(seconds):
    end = time.thread_time() + seconds
    while time.thread_time() < end: sum(range(500))
workers = [threading.Thread(target=burn, args=(0.5,)) for _ in range(2)]
workers += [multiprocessing.Process(target=burn, args=(0.5,)) for _ in range(4)]
for worker in workers: worker.start()
for _ in range(300): subprocess.run(["true"])
for worker in workers: worker.join()
"""


def supervise(folder: Path, argv: list[str], cgroup: str, cpus: tuple[int, ...] = ()) -> dict[str, Any]:
    """Run a program under the supervisor and return its usage, with `own`: the supervisor's CPU seconds."""
    spec = SupervisorSpec(
        argv=tuple(argv),
        cwd=str(folder),
        env={"PATH": os.environ["PATH"]},
        log_path=str(folder / "log.txt"),
        usage_path=str(folder / "usage.csv"),
        summary_path=str(folder / "summary.json"),
        process_path=str(folder / "process.json"),
        cpus=cpus,
        cgroup=cgroup,
    )
    path = folder / "spec.json"
    path.write_text(spec.to_json())
    before = children_cpu()
    started = time.perf_counter()
    subprocess.run([sys.executable, "-m", "slamhive.monitor", "--spec", str(path)], check=True)
    wall = time.perf_counter() - started
    total = children_cpu() - before
    summary = json.loads((folder / "summary.json").read_text())
    if summary["reason"] is not None:
        raise SystemExit(summary["message"])
    usage: dict[str, Any] = summary["usage"]
    return {**usage, "own": total - usage["cpu"]["seconds"], "elapsed": wall, "log": summary["logTail"]}


def children_cpu() -> float:
    """Return the kernel's account of all processes we waited for, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    total: float = used.ru_utime + used.ru_stime
    return total


def report(what: str, ours: str, limit: str) -> None:
    """Print one figure."""
    print(f"{what} · {ours} · {limit}", flush=True)


def spread(seconds: list[float]) -> str:
    """Return fastest and median: what it takes, and what it took on a machine that had other work."""
    return f"{min(seconds) * 1e3:.1f} ms (median {statistics.median(seconds) * 1e3:.1f} ms)"


def bench_start(folder: Path, cgroup: str, name: str) -> float:
    """Report what an empty program takes through the supervisor; return the supervisor's own CPU seconds."""
    runs = [supervise(folder, ["true"], cgroup) for _ in range(REPETITIONS)]
    plain = []
    for _ in range(REPETITIONS):
        started = time.perf_counter()
        subprocess.run(["true"], check=True)
        plain.append(time.perf_counter() - started)
    report(
        f"an empty program through the supervisor ({name})",
        spread([run["elapsed"] for run in runs]),
        f"{spread(plain)} without, limit 300 ms",
    )
    return statistics.median(run["own"] for run in runs)


def bench_share(folder: Path, cgroup: str, name: str, start_cost: float) -> None:
    """Report the supervisor's share of a core while a program with eight threads computes."""
    code = (
        "import threading as t, time\n"
        f"for _ in range(7): t.Thread(target=time.sleep, args=({IDLE_SECONDS},)).start()\n"
        f"end = time.monotonic() + {IDLE_SECONDS}\nwhile time.monotonic() < end: sum(range(500))"
    )
    cpus = (max(os.sched_getaffinity(0)),)
    run = supervise(folder, [sys.executable, "-c", code], cgroup, cpus)
    share = (run["own"] - start_cost) / run["wallSeconds"]
    report(f"the monitor's share of a core at 10 Hz ({name})", f"{share:.2%}", "limit 1%")


def bench_accuracy(folder: Path, cgroup: str, name: str) -> None:
    """Report CPU seconds beside the kernel's account of the same tree, from the other source.

    For a cgroup that is the wait status of the tree's first process with all it waited for; for /proc a
    cgroup that the program enters by itself.
    """
    script = (
        f"{WORK}\nimport resource\ntotal = 0\n"
        "for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):\n"
        "    used = resource.getrusage(who)\n    total += used.ru_utime + used.ru_stime\nprint(total)"
    )
    me = identify(os.getpid())
    group = make_run_cgroup(me) if cgroup == "none" and me else None
    argv = [sys.executable, "-c", script]
    if group is not None:
        enter = " ".join(f"{directory}/cgroup.procs" for directory in group.directories)
        argv = ["sh", "-c", f'for f in {enter}; do echo $$ > $f; done; exec "$@"', "sh", *argv]
    run = supervise(folder, argv, cgroup)
    kernel, peer = float(run["log"].splitlines()[-1]), "getrusage of the tree"
    if group is not None:
        kernel, peer = group.source.read().cpu, group.source.name
        group.remove()
    ours = run["cpu"]["seconds"]
    report(
        f"CPU seconds of threads, children and 300 short-lived ones ({name})",
        f"{ours:.3f} s",
        f"{kernel:.3f} s by {peer}, difference {abs(ours - kernel) / kernel:.2%}, limit 1%",
    )


def main() -> None:
    """Run all benchmarks for each source this machine has."""
    starts = []
    for _ in range(REPETITIONS):
        started = time.perf_counter()
        command = [sys.executable, "-m", "slamhive.monitor", "--help"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        starts.append(time.perf_counter() - started)
    report("start of the monitor's process", spread(starts), "limit 60 ms")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for cgroup in ("auto", "none"):
            source = supervise(folder, ["true"], cgroup)["source"]
            if cgroup == "auto" and source == "proc":
                print("no cgroup can be made here: figures for /proc alone")
                continue
            start_cost = bench_start(folder, cgroup, source)
            bench_share(folder, cgroup, source, start_cost)
            bench_accuracy(folder, cgroup, source)


if __name__ == "__main__":
    main()
