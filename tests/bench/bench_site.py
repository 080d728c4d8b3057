# SPDX-License-Identifier: Apache-2.0
"""Benchmark of a site: building it beside exporting a CSV and drawing the same charts, its size, first view.

Runs are those of bench_dashboard.py, without files. The peer is what is done today: ``results export`` to
CSV, then pandas and matplotlib as a notebook has them: a picture for each figure over each group that a site
has. ``--runs 80000`` takes some minutes.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "bench"), str(TESTS / "archive")]

from bench_dashboard import fill, make_record, report  # noqa: E402

from browsers import Browser, find_browser  # type: ignore[import-not-found]  # noqa: E402
from slamhive.archive import Archive  # noqa: E402

COMMAND = [sys.executable, "-c", "from slamhive.cli.main import main; main()"]
MORE = 10
"""Runs by which the archive grows before the site is brought up to date."""

NOTEBOOK = """
import sys, pandas as pd, matplotlib
matplotlib.use("Agg")
from matplotlib import pyplot as plt
runs = pd.read_csv(sys.argv[1], low_memory=False)
figures = ["ate.rmse", "rpe[0].rmse", "coverage", "usage.cpu.meanCores", "usage.memory.peakBytes"]
settings = [name for name in runs if name.startswith("parameters.") and 1 < runs[name].nunique() <= 40][:10]
for figure in figures:
    for by in [["algorithm"], ["dataset"], ["sensors"], ["algorithm", "dataset"],
               *([one, *more] for one in settings for more in ([], ["algorithm"], ["dataset"]))]:
        groups = runs.groupby(by)[figure]
        table = groups.agg(["count", "mean", "std", "median", "min", "max"])
        chart, axes = plt.subplots()
        axes.errorbar(range(len(table)), table["mean"], 1.96 * table["std"] / table["count"] ** 0.5)
        chart.savefig(sys.argv[2])
        plt.close(chart)
for figure in figures[1:]:
    chart, axes = plt.subplots()
    for name, group in runs.groupby("algorithm"):
        axes.scatter(group[figure], group["ate.rmse"], s=4, label=name)
    chart.savefig(sys.argv[2])
    plt.close(chart)
"""


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


def took(command: list[str], home: Path) -> float:
    """Run a command, and return its seconds."""
    begun = time.perf_counter()
    environment = {**os.environ, "SLAMHIVE_HOME": str(home)}
    subprocess.run(command, check=True, env=environment, stdout=sys.stderr)
    return time.perf_counter() - begun


def first_view(site: Path) -> dict[str, float]:
    """Return the times until pages show all, and a brushed selection, in ms."""
    program = find_browser()
    if program is None:
        return {}
    handler = functools.partial(_Quiet, directory=site.parent)
    with (
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server,
        tempfile.TemporaryDirectory() as at,
        Browser(program, Path(at)) as browser,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/{site.name}/"
        times = {}
        for what, page in (
            ("first view, overview", "/"),
            ("leaderboard", "/leaderboard"),
            ("points of all", "/explore"),
            ("points brushed by two figures", "/explore?ate.rmse%3E=0.05&ate.rmse%3C=0.2&coverage%3E=0.9"),
            ("first page of the table of runs", "/runs"),
        ):
            browser.call("Page.navigate", url="about:blank")
            browser.call("Network.enable")
            browser.call("Network.clearBrowserCache")
            begun = time.perf_counter()
            browser.open(f"{address}#{page}")
            times[what] = (time.perf_counter() - begun) * 1e3
        server.shutdown()
        return times


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--keep", type=Path, help="home to keep the runs in, or to find them in")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = options.keep or Path(folder) / "home"
        home.mkdir(parents=True, exist_ok=True)
        if not (home / "archive.sqlite").exists():
            fill(f"sqlite:///{home / 'archive.sqlite'}", options.runs)
        name = f"{options.runs:,} runs"
        site, table = Path(folder) / "site", Path(folder) / "runs.csv"
        built = took([*COMMAND, "site", str(site)], home)
        exported = took([*COMMAND, "results", "export", "-o", str(table)], home)
        drawn = took([sys.executable, "-c", NOTEBOOK, str(table), f"{folder}/chart.png"], home)
        report(f"{name}: building a site", built, "s", (exported + drawn) / 3)
        print(
            f"{name}: exporting a CSV, and a notebook · {exported:.1f} + {drawn:.1f} s · the peer", flush=True
        )
        size = sum(one.stat().st_size for one in site.rglob("*") if one.is_file())
        report(f"{name}: size", size / 1e6, "MB", 20 * max(1, options.runs / 10_000))
        for what, milliseconds in first_view(site).items():
            report(f"{name}: {what}", milliseconds, "ms", 1000)
        again = took([*COMMAND, "site", str(site)], home)
        print(f"{name}: the same again · {again:.1f} s · nothing is new", flush=True)
        more = [make_record(number) for number in range(options.runs, options.runs + MORE)]
        with Archive.open(f"sqlite:///{home / 'archive.sqlite'}") as archive:
            archive.put_runs(more)
            again = took([*COMMAND, "site", str(site)], home)
            archive.remove_runs([record.uid for record in more])
        print(f"{name}: with {MORE} runs more · {again:.1f} s · answers are all computed again", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
