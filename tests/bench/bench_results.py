# SPDX-License-Identifier: Apache-2.0
"""Benchmark of `slamhive results` over 80,000 runs: seconds of CPU and memory of each command.

Runs are those of bench_dashboard.py. The table of columns is warm: a command before has kept it.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bench_dashboard import RUNS, fill

COMMAND = [sys.executable, "-c", "from slamhive.cli.main import main; main()", "results"]
ALL = ",".join(f"parameters.p{number}" for number in range(20))
CASES = (
    ("table by algorithm and dataset", ["table", "--rows", "algorithm,dataset"], 2.0, 200),
    ("table by all 20 parameters", ["table", "--rows", ALL], 2.05, 200),
    ("the same as CSV", ["table", "--rows", ALL, "--format", "csv"], 10.0, 200),
    ("export as CSV", ["export"], 5.0, 200),
)
TURNS = 3


def cost(words: list[str], home: Path) -> tuple[float, float]:
    """Return the seconds of CPU that a command takes, and its memory at most in MiB."""
    command = [*COMMAND, *words]
    environment = {**os.environ, "SLAMHIVE_HOME": str(home)}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--keep", type=Path, help="home to keep the runs in, or to find them in")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = options.keep or Path(folder)
        home.mkdir(parents=True, exist_ok=True)
        if not (home / "archive.sqlite").exists():
            fill(f"sqlite:///{home / 'archive.sqlite'}", options.runs)
        cost(["list", "--columns", "run"], home)
        for what, words, seconds, most in CASES:
            costs = [cost(words, home) for _ in range(TURNS)]
            cpu = statistics.median(one[0] for one in costs)
            memory = max(one[1] for one in costs)
            verdict = "" if cpu <= seconds and memory <= most else ", TOO MUCH"
            print(
                f"{options.runs:,} runs: {what} · {cpu:.2f} s of CPU, {memory:.0f} MiB · "
                f"limit {seconds:g} s, {most} MiB{verdict}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
