# SPDX-License-Identifier: Apache-2.0
"""Settings that a search may try: conditions, scales, and sentences on those that it can't."""

from __future__ import annotations

from typing import Any

import pytest

from slamhive.model.algorithm import AlgorithmSpec
from slamhive.model.errors import InputError
from slamhive.model.loading import parse, to_object
from slamhive.model.search import Trial
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, SearchPlan, plan_problems

CATALOG = """
apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: matcher}
spec:
  image: none
  modes: [{name: lidar}]
  output: {frame: lidar}
  parameters:
    loops: {type: Boolean, default: false}
    method: {type: String, default: scan, values: [scan, bow]}
    radius:
      {type: Number, default: 5, minimum: 1, maximum: 100, scale: Log, when: {loops: [true], method: [scan]}}
    range: {type: Number, default: 60, minimum: 1, maximum: 200}
---
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: hall}
spec: {recording: {synthetic: {}}}
"""
LOOPS = {"path": "parameters.loops", "values": [False, True]}
RADIUS = {"path": "parameters.radius", "range": {"from": 1, "to": 100}}
RANGE = {"path": "parameters.range", "values": [10, 20]}


def planned(*axes: dict[str, Any], template: dict[str, Any] | None = None, **search: Any) -> SearchPlan:
    sweep = {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Sweep",
        "metadata": {"name": "s"},
        "spec": {
            "template": {
                "spec": {"algorithmRef": {"name": "matcher"}, "datasetRef": {"name": "hall"}}
                | (template or {})
            },
            "matrix": list(axes),
            "search": {"method": "TPE", "objectives": [{"metric": "ate.rmse"}], "trials": 10} | search,
        },
    }
    objects = [to_object(entry) for entry in parse(CATALOG, "catalog.yaml")]
    return SearchPlan(Sweep.model_validate(sweep), FixedCatalog.of(objects))


def test_a_parameter_whose_condition_is_not_met_is_not_part_of_a_setting() -> None:
    plan = planned(LOOPS, RADIUS)
    for values in ([False, 3.0], [False, 4.0], [True, 4.0]):
        plan.draw(Trial(values=values))
    assert [plan.point(index).coordinates for index in range(3)] == [
        {"parameters.loops": False},
        {"parameters.loops": False},
        {"parameters.loops": True, "parameters.radius": 4.0},
    ]
    assert plan.point(0).spec_hash == plan.point(1).spec_hash
    assert plan.space.key([False, 3.0]) == plan.space.key([False, 4.0]) != plan.space.key([True, 4.0])


@pytest.mark.parametrize(
    ("template", "has_effect"),
    [
        ({}, False),
        ({"parameters": {"loops": True}}, True),
        ({"parameters": {"loops": True, "method": "bow"}}, False),
    ],
)
def test_conditions_count_defaults_and_the_template(template: dict[str, Any], has_effect: bool) -> None:
    assert planned(RADIUS, RANGE, template=template).space.in_effect([2.0, 10]) == [has_effect, True]


def test_a_condition_on_what_a_search_goes_across_leaves_the_axis_in() -> None:
    assert planned(LOOPS, RADIUS, RANGE, across=["parameters.loops"]).space.in_effect([2.0, 10]) == [
        True,
        True,
    ]


def test_a_parameter_of_the_scale_log_is_searched_by_ratios() -> None:
    assert [axis.is_log for axis in planned(RADIUS, RANGE).space.axes] == [True, False]


@pytest.mark.parametrize(
    ("axis", "sentence"),
    [
        (
            RADIUS | {"range": {"from": 0.5, "to": 1000}},
            "spec.matrix[0].range: parameters.radius: 0.5 is below the minimum",
        ),
        (
            RADIUS | {"range": {"from": 2, "to": 1000}},
            "spec.matrix[0].range: parameters.radius: 1000 is above the maximum",
        ),
        (
            {"path": "parameters.rnage", "values": [1, 2]},
            "spec.matrix[0].values[0]: parameters.rnage: matcher has no parameter 'rnage'",
        ),
    ],
)
def test_values_outside_of_bounds_are_found_before_anything_runs(axis: dict[str, Any], sentence: str) -> None:
    found = plan_problems(planned(axis, LOOPS).probing())
    assert any(one.startswith(sentence) for one in found)


@pytest.mark.parametrize(
    ("axis", "sentence"),
    [
        (RADIUS | {"range": {"from": 0, "to": 9, "scale": "Log"}}, "the scale Log needs ends above zero"),
        (RADIUS | {"range": {"from": -1, "to": 9, "scale": "Log"}}, "the scale Log needs ends above zero"),
        (
            {"path": "parameters.range", "values": [10]},
            r"spec.matrix\[0\]: has one value, so nothing to search; set it in the template",
        ),
        (RADIUS | {"range": {"from": 3, "to": 3}}, r"spec.matrix\[0\]: has one value, so nothing to search"),
    ],
)
def test_axes_that_cannot_be_searched(axis: dict[str, Any], sentence: str) -> None:
    with pytest.raises((InputError, ValueError), match=sentence):
        planned(axis, LOOPS)


def test_more_trials_than_settings_are_all_settings_and_said_so() -> None:
    plan = planned(LOOPS, RANGE, trials=10)
    assert plan.most_trials == 4
    assert plan.remarks() == [
        "spec.search.trials: 10 are asked for, the matrix has 4 settings: all are tried"
    ]
    assert planned(LOOPS, RADIUS, trials=10).remarks() == []


def test_fewer_trials_than_were_tried_are_those_and_said_so() -> None:
    plan = planned(LOOPS, RANGE, trials=1)
    plan.draw(Trial(values=plan.space.probes()[0].values))
    assert (plan.most_trials, plan.surplus) == (1, None)
    plan.draw(Trial(values=plan.space.probes()[1].values))
    assert plan.most_trials == 2
    assert plan.surplus == "2 settings are tried already, trials: 1 asks for fewer: none is added"


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"a": {"type": "Boolean", "when": {"b": [1]}}}, "parameters.a.when.b: unknown parameter 'b'"),
        (
            {"a": {"type": "Boolean", "when": {"b": [7]}}, "b": {"type": "Boolean", "default": True}},
            "parameters.a.when.b: 7 is not allowed, only true or false",
        ),
        (
            {
                "a": {"type": "Boolean", "when": {"b": [True]}},
                "b": {"type": "Boolean", "when": {"a": [True]}},
            },
            "parameters.a.when: depends on a itself",
        ),
        ({"a": {"type": "Boolean", "scale": "Log"}}, "scale: means nothing to the type Boolean"),
    ],
)
def test_conditions_and_scales_that_mean_nothing(parameters: dict[str, Any], sentence: str) -> None:
    for one in parameters.values():
        one.setdefault("default", True)
    with pytest.raises(ValueError, match=sentence):
        AlgorithmSpec.model_validate(
            {
                "image": "a",
                "modes": [{"name": "lidar"}],
                "output": {"frame": "lidar"},
                "parameters": parameters,
            }
        )
