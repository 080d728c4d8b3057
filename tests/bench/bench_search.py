# SPDX-License-Identifier: Apache-2.0
"""Searches over grids of which every point is known: how near to the best one, by how many runs.

search_grid.csv was recorded once, by `slamhive run` of the Sweep that stands in it: kiss-icp, 200 settings on
synthetic datasets. The played grid of 80,000 runs is a formula, `played_error` below.

Ours is `decide_search` with the sampler, as drivers use them. "Alone" is Optuna's TPE by its own study with
as many trials, each of them run on all datasets. CPU seconds are those of the runs, as recorded.
"""

from __future__ import annotations

import csv
import math
import random
import statistics
import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optuna

from slamhive.engine import RunSeen, TrialStanding, best_of, decide_search
from slamhive.engine.searching import Score
from slamhive.model.search import Trial
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, SearchPlan
from slamhive.sampling import Sampler

if TYPE_CHECKING:
    from collections.abc import Callable

RECORDED = Path(__file__).with_name("search_grid.csv")
SEEDS = range(20)
NEAR = 1.02
"""A setting is as good as the best one when its error is at most so many times that of the best."""
METHODS = ("Random", "Sobol", "TPE", "NSGA-II")


@dataclass
class KnownGrid:
    """A grid of which all is known.

    Attributes:
        axes: path and values of each searched axis.
        datasets: what each setting is run on.
        look: error, None where the run failed, and CPU seconds, by values and dataset.
    """

    axes: dict[str, list[Any]]
    datasets: list[str]
    look: Callable[[tuple[Any, ...], str], tuple[float | None, float]]

    @property
    def runs(self) -> int:
        """Return the number of runs of all of it."""
        return math.prod(map(len, self.axes.values())) * len(self.datasets)

    def error(self, values: tuple[Any, ...]) -> float:
        """Return the mean error of a setting, infinite where a run of it fails."""
        seen = [self.look(values, dataset)[0] for dataset in self.datasets]
        return math.inf if None in seen else statistics.fmean(one for one in seen if one is not None)

    @cached_property
    def best(self) -> float:
        """Return the least error of all settings."""
        places = [()]
        for values in self.axes.values():
            places = [(*one, value) for one in places for value in values]
        return min(map(self.error, places))


@dataclass
class Course:
    """Course of a search: error of the best setting with all its runs, after so many runs and CPU seconds."""

    runs: int = 0
    cpu_seconds: float = 0.0
    best: float = math.inf
    steps: list[tuple[int, float, float]] = field(default_factory=list)

    def add(self, error: float) -> None:
        """Add a setting that has all its runs."""
        if error < self.best:
            self.best = error
            self.steps.append((self.runs, self.cpu_seconds, error))

    def until(self, error: float) -> float:
        """Return the CPU seconds that it took to be so good; infinite where it never was."""
        return next((cpu for _, cpu, found in self.steps if found <= error), math.inf)


def planned(grid: KnownGrid, method: str, seed: int, trials: int, **fields: Any) -> SearchPlan:
    """Return the plan of a search over a grid."""
    matrix: list[dict[str, Any]] = [{"path": path, "values": values} for path, values in grid.axes.items()]
    asked = {"method": method, "objectives": [{"metric": "ate.rmse"}], "trials": trials, "seed": seed}
    spec = {
        "template": {"spec": {"algorithmRef": {"name": "kiss-icp"}}},
        "matrix": [{"path": "dataset", "values": grid.datasets}, *matrix],
        "search": asked | fields,
    }
    head = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Sweep", "metadata": {"name": "known"}}
    return SearchPlan(Sweep.model_validate(head | {"spec": spec}), FixedCatalog(), strict=False)


def search(grid: KnownGrid, sampler: Sampler, method: str, seed: int, trials: int, **fields: Any) -> Course:
    """Return the course of a search of ours."""
    plan = planned(grid, method, seed, trials, **fields)
    sweep = plan.sweep
    course, seen, done = Course(), dict[int, RunSeen](), set[int]()
    while True:
        decision = decide_search(sweep.spec.search, plan.space, plan.trials, seen, plan.most_trials)
        for standing in decision.standings:
            if standing.is_complete and standing.number not in done:
                done.add(standing.number)
                course.add(grid.error(tuple(plan.trials[standing.number].values)))
        if decision.is_over:
            break
        if decision.told is None:
            index = decision.wanted[0]
            values = tuple(plan.trials[index // plan.space.block].values)
            context = index % plan.space.block // plan.space.repetitions
            error, cpu = grid.look(values, plan.space.contexts[context].coordinates["dataset"])
            seen[index] = RunSeen(has_failed=error is None, values=None if error is None else (error,))
            course.runs += 1
            course.cpu_seconds += cpu
            continue
        trial = sampler.propose(sweep.spec.search, plan.space, plan.trials, decision.standings, decision.told)
        if trial is None:
            break
        plan.draw(trial)
    best = best_of(decision.standings)
    course.best = grid.error(tuple(plan.trials[best[0].number].values)) if best else math.inf
    return course


def alone(grid: KnownGrid, seed: int, trials: int) -> Course:
    """Return the course of Optuna's TPE, each of whose trials is run on all datasets."""
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    whole = optuna.distributions.IntDistribution
    space = {path: whole(0, len(values) - 1) for path, values in grid.axes.items()}
    course = Course()
    for _ in range(trials):
        trial = study.ask(space)
        values = tuple(of[trial.params[path]] for path, of in grid.axes.items())
        for dataset in grid.datasets:
            course.runs += 1
            course.cpu_seconds += grid.look(values, dataset)[1]
        course.add(grid.error(values))
        study.tell(trial, grid.error(values))
    return course


def recorded() -> KnownGrid:
    """Return the grid that was recorded."""
    lines = [line for line in RECORDED.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    paths = [name for name in rows[0] if name not in {"dataset", "outcome", "ate.rmse", "cpuSeconds"}]
    axes = {path: sorted({float(row[path]) for row in rows}) for path in paths}
    table = {
        (*(float(row[path]) for path in paths), row["dataset"]): (
            float(row["ate.rmse"]) if row["outcome"] == "Tracked" else None,
            float(row["cpuSeconds"]),
        )
        for row in rows
    }
    return KnownGrid(axes, sorted({row["dataset"] for row in rows}), lambda values, on: table[*values, on])


PLAYED_DATASETS = ["a", "b", "c", "d"]


def played() -> KnownGrid:
    """Return the grid of 20,000 settings on four datasets that is a formula."""
    axes = {
        "parameters.voxelSize": [round(0.05 * 1.25**step, 4) for step in range(20)],
        "parameters.maxRange": [float(10 * (step + 1)) for step in range(10)],
        "parameters.fixedThreshold": [round(0.1 * 1.6**step, 4) for step in range(10)],
        "parameters.maxIterations": [5.0 * (step + 1) for step in range(10)],
    }
    return KnownGrid(axes, PLAYED_DATASETS, lambda values, on: (played_error(values, on), 1.0))


def played_error(values: tuple[Any, ...], on: str) -> float | None:
    """Return the error in metres, a bowl of logarithms that is elsewhere on each dataset; None: it failed.

    A run fails where the threshold is less than a quarter of the voxels, or these are more than 1/20 of the
    range. Each run has 1 % of noise of its own.
    """
    voxel, reach, threshold, iterations = values
    place = PLAYED_DATASETS.index(on)
    if threshold < voxel / 4 or voxel > reach / 20:
        return None
    noise = random.Random(f"{values} {on}").gauss(1, 0.01)
    bowl = (
        0.5 * math.log(voxel / (0.4 + 0.05 * place)) ** 2
        + 0.3 * math.log(threshold / (1.0 + 0.1 * place)) ** 2
        + 0.4 * math.log(reach / 60) ** 2
        + 0.5 / iterations
    )
    return (0.05 + 0.03 * place) * (1 + bowl) * noise


def row(what: str, ours: str, limit: str) -> None:
    """Print a line of the table."""
    print(f"{what} · {ours} · {limit}", flush=True)


def near(grid: KnownGrid, courses: list[Course]) -> str:
    """Return the nearness of searches to the best setting, in words."""
    ratios = [course.best / grid.best for course in courses]
    found = sum(ratio <= NEAR for ratio in ratios)
    runs = [course.runs for course in courses]
    return (
        f"{found} of {len(ratios)} seeds within 2 %; median {statistics.median(ratios):.3f} × the best; "
        f"{statistics.fmean(runs):.0f} runs, at most {max(runs)}"
    )


def compare(grid: KnownGrid, name: str, trials: int, seeds: range) -> None:
    """Print how all methods do on a grid, with as many trials as make a tenth of its runs at most."""
    with Sampler() as sampler:
        for method in METHODS:
            courses = [search(grid, sampler, method, seed, trials, atATime=1) for seed in seeds]
            row(
                f"{name}, {grid.runs} runs: {method}",
                near(grid, courses),
                f"{grid.runs // 10} runs, 95 % of seeds",
            )
            if method == "TPE":
                ours = courses
    theirs = [alone(grid, seed, trials) for seed in seeds]
    row(f"{name}: Optuna's TPE alone, as many trials", near(grid, theirs), "")
    # To the quality that Optuna alone has at its end with more than half of the seeds.
    quality = statistics.median_high(course.best for course in theirs)
    took = [statistics.median_low(course.until(quality) for course in courses) for courses in (ours, theirs)]
    row(
        f"{name}: CPU seconds of runs to {quality / grid.best:.3f} × the best, median of seeds",
        f"{took[0]:.0f} s, alone {took[1]:.0f} s",
        "1/2 of alone",
    )


def asking(trials: int) -> None:
    """Print what a proposal takes after so many trials."""
    grid = played()
    rng = random.Random(1)
    seen = [tuple(rng.choice(values) for values in grid.axes.values()) for _ in range(trials)]
    space = planned(grid, "TPE", 0, 5_000).space
    known = [Trial(values=list(values), told=max(0, number - 3)) for number, values in enumerate(seen)]
    standings = [
        TrialStanding(number, [Score(0.0, (rng.random(),))], 1, 0.5, None if number % 4 == 0 else "worse")
        for number in range(trials)
    ]
    for standing in standings:
        standing.is_complete = standing.dropped is None
    asked = planned(grid, "TPE", 0, 5_000).sweep.spec.search
    with Sampler() as sampler:
        sampler.propose(asked, space, known, standings, trials)
        before = time.process_time(), time.perf_counter()
        for number in range(1, 6):
            sampler.propose(asked.replace(seed=number), space, known, standings, trials)
        own, took = (
            (now - then) / 5
            for now, then in zip((time.process_time(), time.perf_counter()), before, strict=True)
        )
    row(f"a proposal after {trials} trials", f"{own * 1000:.0f} ms CPU of who asks, {took:.2f} s wall", "")


def main() -> None:
    """Print the table."""
    grid = recorded()
    # Halving makes 1.8 runs of a setting on its three datasets, and with no seed more than 2.1.
    compare(grid, "recorded grid", 27, SEEDS)
    compare(played(), "played grid", 120, range(5))
    asking(1_000)


if __name__ == "__main__":
    main()
