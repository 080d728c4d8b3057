# SPDX-License-Identifier: Apache-2.0
"""Benchmark of containers on a workstation: `python tests/bench/bench_containers.py`, as root with podman.

Prints one line per figure: what · ours · limit or peer. It needs the image of tests/images/shell-algorithm.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.local.programs.containerwords import limits
from slamhive.local.programs.engines import ContainerChoice, find_engine
from slamhive.local.programs.unavailable import Unavailable
from slamhive.monitor import SupervisorSpec
from slamhive.monitor.spec import ContainedSpec

if TYPE_CHECKING:
    from slamhive.local.programs.engines import Engine

IMAGE = "docker.io/slamhive/shell-algorithm:1.0.0"
REPETITIONS = 7
OPTIONS = (
    *("--pull", "never", "--network", "none", "--read-only", "--read-only-tmpfs=false", "--init"),
    *("--cap-drop", "all", "--security-opt", "no-new-privileges", "--user", "65532:65532"),
    *("--memory", "256m", "--memory-swap", "256m", "--pids-limit", "4096", "--log-driver", "none"),
    *("--cgroups", "no-conmon", "--stop-timeout", "0", "--entrypoint", "sh"),
)
CLOCK = "cat /proc/uptime"
"""The first thing that the program does is to say what time it is, s since boot."""
ACCOUNT = """
for file in /sys/fs/cgroup/cpuacct/cpuacct.usage /sys/fs/cgroup/cpu.stat; do
    [ -r $file ] && break
done
read a before < $file
i=0
while [ $i -lt 4000000 ]; do i=$((i + 1)); done
read b after < $file
echo "$a $before $b $after"
"""
"""Program that prints its control group's account before and after seconds of work: ns, or a name and us."""


def supervise(engine: Engine, script: str) -> dict[str, Any]:
    """Run a script in a container under its supervisor; return the summary."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        pid = folder / "pid"
        words = [*OPTIONS, *limits(), "--pidfile", str(pid), IMAGE, "-c", script]
        identity = engine.call("create", *words).split()[-1]
        contained = ContainedSpec(engine=engine.command, identity=identity, pid_path=str(pid))
        spec = SupervisorSpec(
            argv=("sh",),
            cwd="/",
            env={},
            log_path=str(folder / "log.txt"),
            usage_path=str(folder / "usage.csv"),
            summary_path=str(folder / "summary.json"),
            process_path=str(folder / "process.json"),
            contained=contained.as_json(),
        )
        (folder / "spec.json").write_text(spec.to_json())
        command = [sys.executable, "-P", "-m", "slamhive.monitor", "--spec", str(folder / "spec.json")]
        told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        summary: dict[str, Any] = json.loads(told)
        if summary["reason"] is not None:
            raise SystemExit(summary["message"])
        return summary


def ours(engine: Engine) -> float:
    """Return the seconds from nothing to the program's first act, by our supervisor."""
    began = time.clock_gettime(time.CLOCK_BOOTTIME)
    return float(str(supervise(engine, CLOCK)["logTail"]).split()[0]) - began


def alone(engine: Engine) -> float:
    """Return the same of the engine's own `run`."""
    began = time.clock_gettime(time.CLOCK_BOOTTIME)
    said = engine.call("run", "--rm", *OPTIONS, *limits(), IMAGE, "-c", CLOCK)
    return float(said.split()[0]) - began


def report(what: str, ours: str, limit: str) -> None:
    """Print one figure."""
    print(f"{what} · {ours} · {limit}", flush=True)


def main() -> None:
    """Measure, one after the other in turns, so that other work on the machine meets both."""
    try:
        engine = find_engine(ContainerChoice.PODMAN)
    except Unavailable as error:
        report("containers", "not measured", str(error))
        return
    pairs = [(ours(engine), alone(engine)) for _ in range(REPETITIONS)]
    mine, its = ([pair[place] for pair in pairs] for place in (0, 1))
    more = statistics.median(mine) - statistics.median(its)
    report("start of a container", f"{statistics.median(mine):.2f} s (least {min(mine):.2f} s)", "")
    report("podman run alone", f"{statistics.median(its):.2f} s (least {min(its):.2f} s)", "")
    report(
        "more than podman run alone", f"{more:+.2f} s (of the least {min(mine) - min(its):+.2f} s)", "+0.3 s"
    )
    summary = supervise(engine, ACCOUNT)
    first, before, second, after = [*str(summary["logTail"]).split(), "", ""][:4]
    if second and after:  # version 2: a name and microseconds
        told = (int(after) - int(before)) / 1e6
    else:
        told = (int(before) - int(first)) / 1e9
    found = summary["usage"]["cpu"]["totalSeconds"]
    report(
        "CPU seconds of a container against its control group's own",
        f"{found:.3f} s, {abs(found - told) / told:.2%}",
        f"{told:.3f} s, 1 %",
    )


if __name__ == "__main__":
    main()
