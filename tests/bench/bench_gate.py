# SPDX-License-Identifier: Apache-2.0
"""Decisions of the gate on simulated changes, with the spread of the paper's repetitions.

Cells are ORB-SLAM2's nine settings on fr2/desk, five to seven runs each, of the paper on SLAM Hive. What a
run deviates from its setting's mean, all figures of it together, is drawn from all 47 of them, and so is
whether it was tracked: four were not. Baselines too are drawn anew for each decision, ten runs a setting. A
change multiplies errors or CPU time, or makes runs fail.

The peer does five runs of each setting and looks once, by the same tests.
"""

from __future__ import annotations

import json
import math
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.gating.cells import GateCell, GateRuns
from slamhive.analysis.gating.deciding import Gate, GateAnswer
from slamhive.analysis.gating.figures import COVERAGE, FAILURES, MARGINS, MEMORY, GateFigure
from slamhive.analysis.gating.ordering import next_runs

if TYPE_CHECKING:
    import numpy.typing as npt

PAPER = Path(__file__).parents[3] / "shared" / "data" / "icra2023" / "reference.json"
ERRORS, CPU = ("ate.rmse", "rpe[0].rmse"), "usage.cpu.secondsPerDataSecond"
LOGARITHMIC = (*ERRORS, CPU, MEMORY)
NAMES = (*LOGARITHMIC, COVERAGE)
TRACKED = 0.9
"""Coverage from which a run counts as tracked, the evaluator's default."""

FIGURES = [GateFigure(name, MARGINS[name]) for name in (*NAMES, FAILURES)]
DECISIONS = 200
RECORDED, MOST, FIXED = 10, 10, 5


@dataclass(frozen=True)
class Change:
    """A change of an algorithm: factors of figures, and how many of its runs fail more."""

    name: str
    factors: dict[str, float]
    failures: float = 0.0


def _worse(share: float) -> dict[str, float]:
    return dict.fromkeys(ERRORS, 1 + share)


CHANGES = (
    Change("none", {}),
    Change("errors 2 % worse", _worse(0.02)),
    Change("errors 5 % worse", _worse(0.05)),
    Change("errors 20 % worse", _worse(0.20)),
    Change("CPU 20 % worse", {CPU: 1.20}),
    Change("a third of runs fail", {}, 1 / 3),
)


_OTHER = 124
"""A run whose settings aren't those of the others: another scale of depth."""


def real_runs() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return means of the settings' logarithms, (9, 4), 47 runs' distances from those, and their coverage."""
    groups: dict[int, list[list[float]]] = defaultdict(list)
    for run in json.loads(PAPER.read_text())["runs"]:
        if run["algorithm"] == "orb-slam2-ros-rgbd" and run["id"] != _OTHER:
            errors = [math.log(run[name]["rmse"]) for name in ("ate_sim3", "rpe_1m_all_pairs_sim3")]
            load = [math.log(run[name]) for name in ("cpu_mean_cores", "memory_max_mib")]
            groups[run["nFeatures"]].append([*errors, *load, run["coverage"]])
    kept = [np.array(group) for group in groups.values()]
    means = np.array([group[:, :-1].mean(axis=0) for group in kept])
    spread = [(len(group) / (len(group) - 1)) ** 0.5 for group in kept]
    away = [(group[:, :-1] - mean) * wider for group, mean, wider in zip(kept, means, spread, strict=True)]
    return means, np.concatenate(away), np.concatenate([group[:, -1] for group in kept])


class Laboratory:
    """Source of runs that deviate as real ones do."""

    def __init__(self, seed: int) -> None:
        self.means, self._away, self._coverage = real_runs()
        self._random = np.random.default_rng(seed)

    def runs(self, cell: int, count: int, change: Change | None = None) -> GateRuns:
        """Return runs of a cell, before a change or with it."""
        drawn = self._random.integers(0, len(self._away), count)
        coverage = self._coverage[drawn]
        tracked = coverage >= TRACKED
        if change is not None and change.failures:
            tracked &= self._random.random(count) >= change.failures
        numbers = np.exp(self._away[drawn] + self.means[cell])
        factors = change.factors if change is not None else {}
        values = {
            name: np.where(tracked, numbers[:, column] * factors.get(name, 1.0), np.nan).tolist()
            for column, name in enumerate(LOGARITHMIC)
        }
        return GateRuns(tracked.tolist(), values | {COVERAGE: coverage.tolist()})


def joined(first: GateRuns, second: GateRuns) -> GateRuns:
    """Return the runs of both."""
    return GateRuns(
        [*first.tracked, *second.tracked],
        {name: [*first.values.get(name, ()), *second.values[name]] for name in NAMES},
    )


def decide(lab: Laboratory, change: Change, *, fixed: bool) -> tuple[Gate, int]:
    """Return a gate at its end, and the runs that it took."""
    cells = [GateCell(str(k), lab.runs(k, RECORDED), GateRuns()) for k in range(len(lab.means))]
    gate = Gate(FIGURES)
    while (
        wanted := dict.fromkeys(range(len(cells)), FIXED) if fixed else next_runs(cells, gate.findings, MOST)
    ):
        for number, count in wanted.items():
            cell = cells[number]
            cells[number] = GateCell(
                cell.name, cell.before, joined(cell.now, lab.runs(number, count, change))
            )
        gate.look(cells, last=fixed or all(cell.now.count >= MOST for cell in cells))
        if fixed or gate.is_sure:
            break
    return gate, sum(cell.now.count for cell in cells)


def main() -> None:
    """Print, for each change, what was decided and by how many runs."""
    if not PAPER.is_file():
        print("the paper's runs are not there (../shared/data/icra2023) · – · –")
        return
    decisions = int(sys.argv[1]) if len(sys.argv) > 1 else DECISIONS
    for change in CHANGES:
        told: dict[bool, Any] = {}
        for fixed in (False, True):
            lab = Laboratory(2023)
            ends = [decide(lab, change, fixed=fixed) for _ in range(decisions)]
            answers = [gate.answer for gate, _ in ends]
            shares = {one: answers.count(one) / decisions for one in GateAnswer}
            runs = [count for _, count in ends]
            passed = shares[GateAnswer.NO_WORSE] + shares[GateAnswer.BETTER]
            unknown = shares[GateAnswer.UNKNOWN]
            words = f"worse {shares[GateAnswer.WORSE]:.1%}, passed {passed:.1%}, can't tell {unknown:.1%}"
            told[fixed] = f"{words}; {np.mean(runs):.1f} runs (most {max(runs)})"
        print(f"{change.name} · {told[False]} · five fixed: {told[True]}")


if __name__ == "__main__":
    main()
