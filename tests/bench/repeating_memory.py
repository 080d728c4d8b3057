# SPDX-License-Identifier: Apache-2.0
"""Benchmark of repeated memory figures: `python tests/bench/repeating_memory.py RUN_FOLDER… -n 10`, as root.

Takes folders of finished runs of a home (`$SLAMHIVE_HOME/runs/SWEEP/RUN`) and does each again, n times with
everything in the page cache and n times after dropping it, below GNU time. Prints a table of means and
spreads; docs/decisions/0001-memory-headline.md has one.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

MEBIBYTE = 1 << 20
FIGURES = ("peak", "samples", "anonymous", "working set", "kernel", "time")


def once(run: Path, *, cold: bool) -> dict[str, float]:
    """Do a run again and return its figures of memory, MiB.

    Raises:
        SystemExit: the algorithm did not end well.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        spec = json.loads((run / "supervisor.json").read_text()) | {"parentPid": None}
        for key in ("logPath", "usagePath", "summaryPath", "processPath"):
            spec[key] = str(folder / Path(spec[key]).name)
        path = folder / "spec.json"
        path.write_text(json.dumps(spec))
        if cold:
            os.sync()
            Path("/proc/sys/vm/drop_caches").write_text("3")
        timed = ["/usr/bin/time", "--format", "%M", "--output", str(folder / "time")]
        subprocess.run([*timed, sys.executable, "-m", "slamhive.monitor", "--spec", str(path)], check=True)
        summary = json.loads(Path(spec["summaryPath"]).read_text())
        if summary["reason"] is not None:
            raise SystemExit(f"{run.name}: {summary['message']}")
        memory = summary["usage"]["memory"]
        rows = list(csv.DictReader(Path(spec["usagePath"]).read_text().splitlines()))
        found = {
            "peak": memory["peakBytes"],
            "samples": max(int(row["resident_bytes"]) for row in rows),
            "anonymous": memory["anonymousPeakBytes"],
            "working set": memory["workingSetPeakBytes"],
            "kernel": memory["kernelPeakBytes"],
            "time": int((folder / "time").read_text()) * 1024,
        }
        return {key: value / MEBIBYTE for key, value in found.items()}


def row(name: str, runs: list[dict[str, float]]) -> str:
    """Return a table's row: for each figure mean, standard deviation and range, both in % of the mean."""
    cells = []
    for figure in FIGURES:
        values = [run[figure] for run in runs]
        mean = statistics.fmean(values)
        deviation, extent = statistics.stdev(values) / mean, (max(values) - min(values)) / mean
        cells.append(f"{mean:.1f} ({deviation:.2%}, {extent:.2%})")
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Do all runs again and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("-n", type=int, default=10)
    asked = parser.parse_args()
    print(f"| | {' | '.join(FIGURES)} |\n|{'---|' * (len(FIGURES) + 1)}", flush=True)
    for run in asked.runs:
        once(run, cold=False)
        warm = [once(run, cold=False) for _ in range(asked.n)]
        cold = [once(run, cold=True) for _ in range(asked.n)]
        for state, runs in (("warm", warm), ("cold", cold), ("both", warm + cold)):
            print(row(f"{run.name}, {state}", runs), flush=True)


if __name__ == "__main__":
    main()
