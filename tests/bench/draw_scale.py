# SPDX-License-Identifier: Apache-2.0
"""Figures of docs/scale.md: ``python tests/bench/draw_scale.py FOLDER``, after ``make bench-scale``.

Each archive's folder gets ``scale.svg``, the curves over the course of the Sweep; the table of all of them is
printed as Markdown.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("svg")

from matplotlib import pyplot as plt

Figures = dict[str, Any]


POINTS = 100
"""Points of a curve at most: the figures of ten seconds alone are as much noise as course."""


def steps(samples: list[Figures]) -> list[tuple[Figures, Figures]]:
    """Return pairs of samples between which many runs ended and nothing was suspended or started anew."""
    least = samples[-1]["ended"] / POINTS
    kept: list[Figures] = []
    for sample in samples:
        # The loops of Jobs run while the Sweep is suspended: what they take is not its own.
        if not kept or not sample["running"] or sample["ended"] - kept[-1]["ended"] >= least:
            kept.append(sample)
    return [
        (one, other)
        for one, other in pairwise(kept)
        if other["ended"] - one["ended"] >= least
        and one["running"]
        and other["running"]
        and other["seconds"] > one["seconds"]
        and other["operator_cpu"] >= one["operator_cpu"]
    ]


def a_run(one: Figures, other: Figures, *names: str) -> float:
    """Return the CPU time of some programs for each run that ended between two samples, ms."""
    used = sum(other[name] - one[name] for name in names)
    return float(1000 * used / (other["ended"] - one["ended"]))


def draw(figures: Figures, path: Path) -> None:
    """Draw the curves of a Sweep over its runs that have ended."""
    samples = figures["samples"]
    between = steps(samples)
    ended = [other["ended"] for _, other in between]
    all_ended = [sample["ended"] for sample in samples]
    figure, axes = plt.subplots(2, 2, figsize=(9, 6), layout="constrained")
    rates = [(other["ended"] - one["ended"]) / (other["seconds"] - one["seconds"]) for one, other in between]
    curves = (
        (axes[0, 0], "runs/s", [("runs", ended, rates)]),
        (
            axes[0, 1],
            "CPU a run in ms",
            [
                ("operator", ended, [a_run(*pair, "operator_cpu") for pair in between]),
                ("API server, etcd", ended, [a_run(*pair, "apiserver_cpu", "etcd_cpu") for pair in between]),
            ],
        ),
        (
            axes[1, 0],
            "MiB",
            [
                ("operator", all_ended, [sample["operator_mib"] for sample in samples]),
                ("etcd", all_ended, [sample["etcd_mib"] for sample in samples]),
            ],
        ),
        (
            axes[1, 1],
            "objects",
            [
                (label, ended, [other[name] for _, other in between])
                for label, name in (("MappingRuns", "mappingruns"), ("pods", "pods"))
            ],
        ),
    )
    for panel, label, lines in curves:
        for name, across, up in lines:
            panel.plot(across, up, label=name, linewidth=1)
        panel.set(xlabel="runs that have ended", ylabel=label)
        panel.set_ylim(bottom=0)
        panel.xaxis.set_major_formatter("{x:,.0f}")
        if len(lines) > 1:
            panel.legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def table(all_figures: dict[str, Figures]) -> str:
    """Return the figures of each archive and stage as a table in Markdown."""
    lines = [
        (
            "| archive | stage | runs/s | of plain Jobs | of Jobs with a run's own pod | operator, ms a run "
            "| API server and etcd, ms a run | of a Job with a run's own pod |"
        ),
        "|---|---|---|---|---|---|---|---|",
    ]
    for archive, figures in all_figures.items():
        for stage, ours in figures["parts"].items():
            peers = figures["peers"].get(stage)
            shares = ("–", "–", "–")
            if peers:
                plain, copies = peers["plain"], peers["copies"]
                shares = (
                    f"{ours['rate'] / plain['rate']:.2f}",
                    f"{ours['rate'] / copies['rate']:.2f}",
                    f"{ours['server'] / copies['server']:.2f}",
                )
            cells = (archive, stage, f"{ours['rate']:.1f}", *shares[:2])
            cells += (f"{1000 * ours['operator']:.1f}", f"{1000 * ours['server']:.1f}", shares[2])
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> int:
    """Draw and print; the exit code is 2 where there is nothing to draw."""
    parser = argparse.ArgumentParser(description="Figures of docs/scale.md.")
    parser.add_argument("folder", type=Path, help="what make bench-scale wrote")
    folder = parser.parse_args().folder
    found = sorted(folder.glob("*/scale.json"))
    if not found:
        sys.stderr.write(f"error: {folder}: no */scale.json in it, which make bench-scale writes\n")
        return 2
    all_figures = {path.parent.name: json.loads(path.read_text(encoding="utf-8")) for path in found}
    for path in found:
        draw(all_figures[path.parent.name], path.with_name("scale.svg"))
        print(f"{path.with_name('scale.svg')}", file=sys.stderr)
    print(table(all_figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
