# SPDX-License-Identifier: Apache-2.0
"""`make bench`: all benchmarks one after another, their figures as one table at the end."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

SEPARATOR = "·"
WIDTH = 160


def run(script: Path) -> tuple[list[str], int]:
    """Run one benchmark, showing its lines as they come; return them and its exit code."""
    lines = []
    environment = os.environ | {"PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        for line in process.stdout or ():
            print(f"  {line}", end="", flush=True)
            lines.append(line.rstrip())
    return lines, process.returncode


def main() -> int:
    """Run all, print the table; the exit code is 1 when one of them crashed."""
    table = Table("benchmark", "what", "ours", "limit or peer", title="slamhive", title_justify="left")
    crashed = []
    for script in sorted(Path(__file__).parent.glob("bench_*.py")):
        name = script.stem.removeprefix("bench_")
        print(f"{name}:", flush=True)
        started = time.perf_counter()
        lines, code = run(script)
        print(f"  ({time.perf_counter() - started:.0f} s)", flush=True)
        if code:
            crashed.append(f"{script.name}: exit code {code}")
        for line in lines:
            what, *figures = map(str.strip, line.split(SEPARATOR, 2))
            table.add_row(name, escape(what), *map(escape, figures))
        table.add_section()
    load, cores = os.getloadavg()[1], len(os.sched_getaffinity(0))
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=WIDTH)
    console.print(table)
    print(f"{cores} cores; load over the last 5 minutes {load:.1f}, these benchmarks included")
    for problem in crashed:
        sys.stderr.write(f"error: {problem}\n")
    return 1 if crashed else 0


if __name__ == "__main__":
    sys.exit(main())
