# SPDX-License-Identifier: Apache-2.0
"""Proposals: equal however often they are asked for, never twice the same, away from what fails."""

from __future__ import annotations

from typing import Any

import pytest

from slamhive.sampling import Sampler

SAMPLED = ["Random", "Sobol", "TPE", "NSGA-II"]


@pytest.mark.parametrize("method", SAMPLED)
def test_all_kinds_of_axes_are_searched_without_trying_a_setting_twice(
    method: str, played: Any, sampler: Sampler
) -> None:
    plan = played({"method": method}).go(sampler).plan
    assert len({plan.space.key(trial.values) for trial in plan.trials}) == len(plan.trials) == 30
    for number, axis in enumerate(plan.space.axes):
        assert len({str(trial.values[number]) for trial in plan.trials}) >= min(axis.size or 20, 6)


@pytest.mark.parametrize("method", SAMPLED)
def test_a_proposal_follows_from_what_was_told(method: str, played: Any, sampler: Sampler) -> None:
    search = played({"method": method}).go(sampler)
    with Sampler() as another:
        for number in (29, 3, 17):
            assert search.propose(another, *search.asked[number]) == search.plan.trials[number]
    other = played({"method": method, "seed": 1}).go(sampler)
    assert other.plan.trials[20] != search.plan.trials[20]
