# SPDX-License-Identifier: Apache-2.0
"""Repeating of a sample of a bundle's runs here: how far off they are, in deviations of the repetitions."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.engine import LoadConditions
from slamhive.model.base import plain_name
from slamhive.model.canonical import digest, normalize
from slamhive.model.results import Phase
from slamhive.model.run import MappingRun
from slamhive.tables.manifests import spec_again

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.bridges.bundles.contents import BundledRun
    from slamhive.bridges.bundles.opening import OpenedBundle
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import Result, RunRecord

FIGURES = ("ate.rmse", "rpe[0].rmse", "coverage")
"""Figures of a repeated run that are held against those of the bundle."""
LOAD = "usage.cpu.seconds"
"""The same where it ran on the same model of processor."""


@dataclass(frozen=True)
class RepeatedFigure:
    """A figure of a run that was done again.

    Attributes:
        run: its name in the bundle.
        figure: its name.
        before: mean of the bundle's repetitions of its setting.
        count: how many these are.
        deviation: their standard deviation; NaN of a single one.
        after: as it came out here.
    """

    run: str
    figure: str
    before: float
    count: int
    deviation: float
    after: float

    @property
    def deviations(self) -> float:
        """Difference in standard deviations of the repetitions; NaN where these say nothing of it."""
        difference = self.after - self.before
        if self.deviation > 0:
            return difference / self.deviation
        return 0.0 if math.isclose(difference, 0.0, abs_tol=1e-12) and self.count > 1 else math.nan

    @property
    def sentence(self) -> str:
        """Difference in words."""
        if not math.isnan(self.deviations):
            return f"{self.deviations:+.2f} standard deviations"
        share = (self.after / self.before - 1) if self.before else math.inf
        if self.count < 2:
            return f"{share:+.2%}; one repetition says nothing of the spread"
        return f"{share:+.2%}, where all {self.count} repetitions were equal"


def draw(bundle: OpenedBundle, number: int, seed: int) -> list[BundledRun]:
    """Return a sample of the runs that ended well: equal seeds draw equal ones.

    Args:
        bundle: the bundle.
        number: how many; all where there are fewer.
        seed: of the sample.
    """
    able = [run for run in bundle.runs.values() if run.record.phase is Phase.SUCCEEDED]
    drawn = random.Random(f"{bundle.sha256}/{seed}").sample(able, min(number, len(able)))  # noqa: S311
    return sorted(drawn, key=lambda run: run.record.name)


def manifest_of(run: BundledRun, bundle: OpenedBundle) -> MappingRun:
    """Return the manifest that does a run again, under a name that no own run has.

    Raises:
        ValueError: its spec doesn't follow the language.
    """
    name = plain_name(f"again-{bundle.sha256[:8]}-{run.record.name}")
    return MappingRun.model_validate(
        {"metadata": {"name": name}, "spec": {**spec_again(run.record), "evaluate": True}}
    )


def changed_program(bench: Workbench, run: BundledRun) -> str | None:
    """Return the difference of what would run here from what ran there; None where there is none.

    Raises:
        SlamHiveError: its algorithm isn't known here, or can't run.
    """
    name, told = run.record.spec["algorithmRef"]["name"], run.record.provenance
    here = bench.program(name)
    if told.algorithm_hash is not None and here.algorithm_hash != told.algorithm_hash:
        return f"algorithm {name} is another one here: its manifest says something else"
    if told.environment is not None and here.environment != told.environment:
        changed = bench.versions.changed(told.environment, here.environment)
        return (
            f"algorithm {name} has another environment here{f': {chr(44).join(changed)}' if changed else ''}"
        )
    return None


def compare_repeated(bundle: OpenedBundle, run: BundledRun, again: RunRecord) -> list[RepeatedFigure]:
    """Return the figures of a run that was done again, beside the bundle's.

    Args:
        bundle: the bundle.
        run: the run in it.
        again: the same as it was done here.
    """
    same = [one.record for one in bundle.runs.values() if _setting(one.record) == _setting(run.record)]
    names = [*FIGURES]
    here, there = LoadConditions.of(again.provenance), LoadConditions.of(run.record.provenance)
    if here.processor and there.processor and not here.differences(there):
        names.append(LOAD)
    found = []
    for name in names:
        before = [value for one in same if (value := figure_of(one, name, _evaluation(run))) is not None]
        after = figure_of(again, name, None)
        if before and after is not None:
            deviation = float(np.std(before, ddof=1)) if len(before) > 1 else math.nan
            # Of equal numbers the mean may round: their deviation is none.
            deviation = 0.0 if len(set(before)) == 1 < len(before) else deviation
            mean = before[0] if len(set(before)) == 1 else float(np.mean(before))
            found.append(RepeatedFigure(run.record.name, name, mean, len(before), deviation, after))
    return found


def figure_of(record: RunRecord, name: str, evaluation: str | None) -> float | None:
    """Return a figure of a run; None where it has none.

    Args:
        record: the run.
        name: of the figure.
        evaluation: of which; None for its first.
    """
    if name == LOAD:
        return record.usage.cpu.seconds if record.usage else None
    results: Iterable[Result] = (one for one in record.results if evaluation in {None, one.evaluation})
    result = next(iter(results), None)
    if result is None:
        return None
    if name == "coverage":
        return result.coverage
    part: Any = result.values.get(name.partition(".")[0].partition("[")[0])
    if isinstance(part, list):
        part = part[0] if part else None
    value = part.get("rmse") if isinstance(part, dict) else None
    return float(value) if isinstance(value, int | float) else None


def _evaluation(run: BundledRun) -> str | None:
    return run.record.results[0].evaluation if run.record.results else None


def _setting(record: RunRecord) -> str:
    spec: Mapping[str, Any] = record.spec
    return digest(normalize({name: spec[name] for name in spec if name not in {"repetition", "seed"}}))
