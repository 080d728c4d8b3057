# SPDX-License-Identifier: Apache-2.0
"""Bisection for thresholds: where it ends, how few runs it takes, and that it follows from results alone."""

import math
import random
from collections.abc import Callable
from typing import Any

import pytest

from slamhive.analysis.searches.thresholds import ThresholdStatus, estimate, thresholds
from slamhive.engine import RunSeen, ValueTally, decide
from slamhive.model.errors import InputError
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, SearchPlan

RINGS, DROP = "input.lidar.rings", "input.perturb.lidar.dropPoints"
SIXTY = {"path": RINGS, "range": {"from": 1, "to": 60, "step": 1}}


def planned(axis: dict[str, Any], *others: dict[str, Any], repetitions: int = 5, **fields: Any) -> SearchPlan:
    """Return the plan of a search for a threshold."""
    spec = {
        "template": {"spec": {"algorithmRef": {"name": "kiss-icp"}, "datasetRef": {"name": "hall"}}},
        "matrix": [*others, axis],
        "repetitions": repetitions,
        "search": {"method": "Threshold", "axis": axis["path"]} | fields.pop("search", {}),
    }
    whole = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Sweep", "metadata": {"name": "s"}}
    return SearchPlan(Sweep.model_validate(whole | {"spec": spec | fields}), FixedCatalog(), strict=False)


def sought(plan: SearchPlan, run: Callable[[Any], RunSeen], order: random.Random | None = None) -> Any:
    """Run a search to its end, results coming in some order; returns the runs by index."""
    runs: dict[int, RunSeen] = {}
    while True:
        decision = decide(plan, runs)
        if decision.is_over:
            return runs
        for trial in decision.draws:
            plan.draw(trial)
        if not decision.draws:
            index = order.choice(decision.wanted) if order else decision.wanted[0]
            runs[index] = run(plan.point(index))


def above(limit: float, axis: str = RINGS) -> Callable[[Any], RunSeen]:
    """Return the runs that fail at values above a limit."""
    return lambda point: RunSeen(has_failed=point.coordinates[axis] > limit, values=())


def found(plan: SearchPlan, runs: Any) -> Any:
    return thresholds(plan.sweep.spec.search, plan, plan.trials, runs)


@pytest.mark.parametrize(
    ("fails", "status", "passing", "failing"),
    [
        (lambda v: v > 22, "found", 22, 23),
        (lambda v: v < 13, "found", 13, 12),
        (lambda v: v == 60, "found", 59, 60),
        (lambda v: v > 60, "never fails", 60, None),
        (lambda v: v > 0, "always fails", None, 1),
        (lambda v: 20 < v < 40, "not monotone", 1, 30),
        (lambda v: v > 22 and not 38 < v < 48, "not monotone", 22, 23),
    ],
)
def test_a_threshold_is_found_or_it_is_said_why_not(
    fails: Callable[[float], bool], status: str, passing: float, failing: float
) -> None:
    plan = planned(SIXTY)
    runs = sought(plan, lambda point: RunSeen(has_failed=fails(point.coordinates[RINGS]), values=()))
    (one,) = found(plan, runs)
    assert (str(one.status), one.passing, one.failing) == (status, passing, failing)
    assert len(runs) <= 30  # of 300
    if status == "not monotone":
        assert "30: 3/3" in one.sentence


def test_an_interval_that_few_runs_can_not_give_is_said_to_be_unknown() -> None:
    plan = planned({"path": RINGS, "values": [8, 16, 32]}, repetitions=1)
    (one,) = found(plan, sought(plan, above(20)))
    assert one.sentence.endswith("fails at 32 (1/1); 95 %: not known from so few runs")


@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_tried_follows_from_results_not_from_their_order(seed: int) -> None:
    limits = {"a": 0.3, "b": 0.5, "c": 0.02}
    axis = {"path": DROP, "range": {"from": 0.01, "to": 0.9, "scale": "Log"}}

    def tried(order: random.Random | None) -> Any:
        plan = planned(
            axis, {"path": "algorithm", "values": [*limits]}, repetitions=3, search={"tolerance": 0.05}
        )
        runs = sought(plan, lambda point: above(limits[point.coordinates["algorithm"]], DROP)(point), order)
        return [trial.values for trial in plan.trials], runs, plan

    values, runs, plan = tried(None)
    assert tried(random.Random(seed))[:2] == (values, runs)
    for one, limit in zip(found(plan, runs), limits.values(), strict=True):
        assert one.low <= limit < one.high <= one.low * 1.05


def test_a_search_goes_on_from_its_trials_as_if_it_had_not_been_killed() -> None:
    plan = planned(SIXTY)
    runs = sought(plan, above(22))
    for count in range(len(plan.trials)):
        again = planned(SIXTY)
        for trial in plan.trials[:count]:
            again.draw(trial)
        known = {index: run for index, run in runs.items() if index < count * again.space.block}
        draws = decide(again, known).draws
        assert list(draws) == plan.trials[count : count + len(draws)]


def test_within_a_step_of_the_whole_grid_with_a_fifth_of_its_runs() -> None:
    close = cost = 0
    for seed in range(20):
        chance = random.Random(seed)
        middle, width = chance.uniform(3, 56), chance.choice([0.1, 0.3, 0.5, 1.0])
        whole = {
            value: [chance.random() < 1 / (1 + math.exp((middle - value) / width)) for _ in range(5)]
            for value in range(1, 61)
        }
        plan = planned(SIXTY)
        runs = sought(
            plan,
            lambda point, whole=whole: RunSeen(
                has_failed=whole[point.coordinates[RINGS]][point.repetition], values=()
            ),
        )
        (one,) = found(plan, runs)
        full = estimate(RINGS, {}, [ValueTally(value, sum(runs), 5) for value, runs in whole.items()], 0.5)
        close += abs(one.high - full.high) <= 1
        cost += len(runs)
        assert one.sure[0] is None or one.sure[0] < middle + 1
    assert close >= 19
    assert cost <= 20 * 300 / 5


def test_repetitions_stop_when_they_have_decided() -> None:
    def run(point: Any) -> RunSeen:
        return RunSeen(has_failed=point.coordinates[RINGS] > 30 or point.repetition == 0, values=())

    plan = planned({"path": RINGS, "values": [10, 50]})
    assert sorted(sought(plan, run)) == [0, 1, 2, 3, 5, 6, 7]


def test_a_value_of_which_nothing_is_known_is_gone_round() -> None:
    def run(point: Any) -> RunSeen:
        return RunSeen() if point.coordinates[RINGS] == 30 else above(40)(point)

    plan = planned(SIXTY)
    (one,) = found(plan, sought(plan, run))
    assert (one.passing, one.failing) == (40, 41)
    plan = planned(SIXTY)
    (one,) = found(plan, sought(plan, lambda _: RunSeen()))
    assert one.status is ThresholdStatus.UNKNOWN


def test_values_of_other_axes_count_as_repetitions_where_it_goes_across_them() -> None:
    seeds = {"path": "input.perturb.seed", "values": [1, 2, 3]}
    plan = planned(
        SIXTY, seeds, repetitions=1, search={"across": ["input.perturb.seed"], "failing": {"quantile": 1}}
    )
    runs = sought(
        plan,
        lambda point: RunSeen(
            has_failed=point.coordinates[RINGS] > 10 * point.coordinates["input.perturb.seed"], values=()
        ),
    )
    (one,) = found(plan, runs)
    assert (one.passing, one.failing) == (30, 31)


@pytest.mark.parametrize(
    ("axis", "fields", "complaint"),
    [
        (
            {"path": "sensors", "values": ["lidar", "mono"]},
            {},
            "spec.search.axis: a threshold is sought on numbers, sensors has the value 'lidar'",
        ),
        ({"path": RINGS, "values": [4]}, {}, "spec.matrix[0]: has one value, a threshold needs two at least"),
        (
            SIXTY,
            {"search": {"tolerance": 1}},
            "spec.search.tolerance: input.lidar.rings has values of its own; it is for a range without step",
        ),
        (
            SIXTY,
            {"exclude": [{RINGS: 4}]},
            "spec.exclude: names input.lidar.rings, whose threshold is sought; leave values out of the axis",
        ),
        (
            SIXTY,
            {"search": {"across": [RINGS]}},
            "spec.search.axis: input.lidar.rings is one of search.across; name another axis",
        ),
        (
            {"path": DROP, "range": {"from": 0, "to": 0.9}},
            {"search": {"tolerance": 1e-15}},
            "spec.search.tolerance: 1e-15 is too fine",
        ),
    ],
)
def test_bad_input_is_refused(axis: dict[str, Any], fields: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError) as error:
        planned(axis, **fields)
    assert str(error.value).startswith(complaint)


def test_some_series_can_be_left_out() -> None:
    plan = planned(SIXTY, {"path": "algorithm", "values": ["a", "b"]}, exclude=[{"algorithm": "a"}])
    assert plan.space.series == [("b",)]
