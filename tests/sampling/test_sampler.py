# SPDX-License-Identifier: Apache-2.0
"""Proposals: equal however often they are asked for, never twice the same, away from what fails."""

from __future__ import annotations

import json
import os
import signal
import statistics
from typing import Any

import pytest

from slamhive.engine import RunSeen
from slamhive.model.errors import InputError, SystemFault
from slamhive.sampling import Sampler
from slamhive.sampling.suggesting import suggest
from slamhive.sampling.telling import TrialsTold

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
def test_a_proposal_follows_from_what_was_told(
    method: str, played: Any, sampler: Sampler, another: Sampler
) -> None:
    search = played({"method": method}).go(sampler)
    for number in (29, 3, 17):
        assert search.propose(another, *search.asked[number]) == search.plan.trials[number]
    search.search = search.search.replace(seed=1)
    assert search.propose(sampler, *search.asked[20]) != search.plan.trials[20]


def test_the_process_that_was_killed_is_begun_anew_and_proposes_the_same(played: Any) -> None:
    search = played({"method": "Random"})
    with Sampler() as sampler:
        first = search.propose(sampler, [], search.decide())
        process = sampler._process
        assert process is not None
        os.kill(process.pid, signal.SIGKILL)
        assert search.propose(sampler, [], search.decide()) == first
        assert sampler._process is not process
    assert sampler._process is None


def test_a_process_that_ends_twice_is_a_fault_of_the_machine(
    played: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.executable", "/bin/false")
    search = played()
    with (
        Sampler() as sampler,
        pytest.raises(SystemFault, match=r"the sampler TPE: no proposal for trial 0: .*ended"),
    ):
        search.propose(sampler, [], search.decide())


def test_a_missing_library_is_named_with_the_line_that_installs_it(
    played: Any, sampler: Sampler, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    search = played()
    with pytest.raises(
        InputError, match=r"spec.search.method: TPE needs the package optuna, .*\[search\]|install"
    ):
        search.propose(sampler, [], search.decide())


def test_nothing_is_written_on_the_terminal(played: Any, capfd: pytest.CaptureFixture[str]) -> None:
    with Sampler() as sampler:
        played({"trials": 12, "atATime": 1}).go(sampler)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("method", ["TPE", "NSGA-II"])
def test_a_region_that_always_fails_is_avoided(method: str, played: Any, sampler: Sampler) -> None:
    def fails(values: dict[str, Any]) -> bool:
        return values["parameters.voxelSize"] < 0.7

    def play(values: dict[str, Any], _: int) -> RunSeen:
        return (
            RunSeen(has_failed=True) if fails(values) else RunSeen(values=(values["parameters.voxelSize"],))
        )

    plan = played({"method": method, "trials": 80}, play=play).go(sampler).plan
    failed = [fails(plan.point(index).coordinates) for index in range(80)]
    assert sum(failed[60:]) < 0.8 * 20 * statistics.fmean(failed[:20])


def test_all_settings_of_a_small_space_are_tried_and_then_none(played: Any, sampler: Sampler) -> None:
    axes = [
        {"path": "parameters.a", "values": [1, 2, 3]},
        {"path": "parameters.b", "values": ["x", "y"]},
        {"path": "retries", "range": {"from": 1, "to": 3}},
    ]
    search = played({"trials": 100}, axes, play=lambda values, _: RunSeen(values=(values["parameters.a"],)))
    assert len(search.go(sampler).plan.trials) == 18
    assert search.propose(sampler, search.plan.trials, search.decide()) is None


def test_runs_of_which_nothing_is_known_are_not_told(played: Any, sampler: Sampler) -> None:
    search = played(
        {"trials": 3, "atATime": 1}, play=lambda _, index: RunSeen(values=(1.0,) if index else None)
    )
    search.go(sampler)
    told = TrialsTold(search.plan.space)
    assert len(told.keys(search.plan.trials)) == 3
    before = json.loads(told.told(search.decide().standings, 2))
    assert [one["state"] for one in before] == ["unknown", "known", "running"]


def test_a_grid_is_improved_on_one_axis_at_a_time_from_the_best_settings() -> None:
    axis = {"kind": "integer", "low": 0, "high": 4, "log": False}
    known = {"state": "known", "failed": 0.0, "told": 0}
    trials = [
        known | {"values": [step, step], "figures": [0.1 * step], "lacking": float(step == 0)}
        for step in range(5)
    ]
    asked = {"method": "TPE", "seed": 1, "number": 5, "objectives": 1, "conditional": False, "begin": 0}
    found = suggest(asked | {"tries": 1, "axes": [axis, axis], "trials": trials})
    assert found[0] == [1, 1]  # which has all its runs, while the one with the least error was dropped
    assert sorted(found[1:5]) == [[0, 1], [1, 0], [1, 2], [2, 1]]
    assert all(1 in setting for setting in found[:9])
