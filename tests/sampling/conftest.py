# SPDX-License-Identifier: Apache-2.0
"""Searches over spaces of all kinds of axes, played by a function instead of an algorithm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.engine import RunSeen, SearchDecision, decide_search
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, SearchPlan
from slamhive.sampling import Sampler

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.search import Search, Trial

AXES = [
    {"path": "parameters.voxelSize", "range": {"from": 0.1, "to": 2, "scale": "Log"}},
    {"path": "parameters.maxRange", "values": [40, 10, 20]},
    {"path": "parameters.deskew", "values": [True, False]},
    {"path": "retries", "range": {"from": 0, "to": 5}},
    {"path": "input.frameRate", "range": {"from": 2, "to": 10}},
]


def error(values: dict[str, Any]) -> float:
    """Return the error of a setting, whose best is 0."""
    return (
        abs(values["parameters.voxelSize"] - 0.5)
        + (values["parameters.maxRange"] != 20)
        + (not values["parameters.deskew"])
        + 0.1 * abs(values["retries"] - 4)
        + 0.1 * abs(values["input.frameRate"] - 7)
    )


def _played(values: dict[str, Any], _index: int) -> RunSeen:
    return RunSeen(values=(error(values),))


@dataclass
class PlayedSearch:
    """A search whose runs end at once, by a function of coordinates and number of the run."""

    fields: dict[str, Any] = field(default_factory=dict)
    axes: list[dict[str, Any]] = field(default_factory=lambda: AXES)
    play: Callable[[dict[str, Any], int], RunSeen] = _played

    def __post_init__(self) -> None:
        """Plan it."""
        search = {"method": "TPE", "objectives": [{"metric": "ate.rmse"}], "trials": 30, "keep": 1}
        sweep = Sweep.model_validate(
            {
                "apiVersion": "slamhive.io/v1alpha1",
                "kind": "Sweep",
                "metadata": {"name": "played"},
                "spec": {
                    "template": {"spec": {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "d"}}},
                    "matrix": self.axes,
                    "search": search | self.fields,
                },
            }
        )
        self.search: Search = sweep.spec.search
        self.plan = SearchPlan(sweep, FixedCatalog(), strict=False)
        self.runs: dict[int, RunSeen] = {}
        self.asked: list[tuple[list[Trial], SearchDecision]] = []

    def decide(self) -> SearchDecision:
        """Return the decision on the next steps."""
        plan = self.plan
        return decide_search(self.search, plan.space, plan.trials, self.runs, plan.most_trials)

    def go(self, sampler: Sampler) -> PlayedSearch:
        """Go through all of it."""
        while not (decision := self.decide()).is_over:
            if decision.told is None:
                for index in decision.wanted:
                    self.runs[index] = self.play(self.plan.point(index).coordinates, index)
                continue
            self.asked.append((list(self.plan.trials), decision))
            trial = self.propose(sampler, *self.asked[-1])
            if trial is None:
                break
            self.plan.draw(trial)
        return self

    def propose(self, sampler: Sampler, trials: list[Trial], decision: SearchDecision) -> Trial | None:
        """Ask for a trial."""
        return sampler.propose(self.search, self.plan.space, trials, decision.standings, decision.told or 0)


@pytest.fixture(scope="session")
def sampler() -> Any:
    """A sampler whose process all tests share: it keeps nothing of what it was asked."""
    with Sampler() as one:
        yield one


@pytest.fixture(scope="session")
def another() -> Any:
    """Another sampler, which has been asked for nothing yet."""
    with Sampler() as one:
        yield one


@pytest.fixture(scope="session")
def played() -> type[PlayedSearch]:
    """The class of searches that end at once."""
    return PlayedSearch
