# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.model.sweep import Range
from slamhive.plan import plan_problems
from slamhive.plan.axes import spread

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.plan import Plan


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ({"from": 0.1, "to": 0.5, "step": 0.1}, [0.1, 0.2, 0.3, 0.4, 0.5]),
        ({"from": 0.2, "to": 1, "count": 5}, [0.2, 0.4, 0.6, 0.8, 1.0]),
        ({"from": 1, "to": 1000, "count": 4, "scale": "Log"}, [1, 10, 100, 1000]),
        ({"from": 1e-3, "to": 0.1, "count": 3, "scale": "Log"}, [0.001, 0.01, 0.1]),
        ({"from": 5, "to": 1, "count": 3}, [5, 3, 1]),
        ({"from": 0, "to": 1, "step": 0.3}, [0, 0.3, 0.6, 0.9]),
        ({"from": 7, "to": 7, "count": 1}, [7]),
        ({"from": 2, "to": 8, "count": 2, "scale": "Log"}, [2, 8]),
    ],
)
def test_range_gives_clean_numbers(text: str, expected: Any) -> None:
    assert spread(Range.model_validate(text), "range") == expected


@given(
    first=st.floats(1e-6, 1e6),
    factor=st.floats(1.001, 1e4),
    count=st.integers(2, 60),
    scale=st.sampled_from(["Linear", "Log"]),
)
def test_ends_are_exact_and_numbers_rise(first: Any, factor: Any, count: Any, scale: Any) -> None:
    span = Range.model_validate({"from": first, "to": first * factor, "count": count, "scale": scale})
    numbers = spread(span, "range")
    assert (len(numbers), numbers[0], numbers[-1]) == (count, first, first * factor)
    assert numbers == sorted(numbers)


def test_selector_takes_the_catalog_by_label(plan: Callable[..., Plan]) -> None:
    points = plan("""
template: {spec: {algorithmRef: {name: scan-match}}}
matrix: [{path: dataset, selector: {matchLabels: {place: outdoor}}}]
""")
    assert points.dataset_names() == ["street", "yard"]


def test_whole_numbers_of_a_range_are_integers(plan: Callable[..., Plan]) -> None:
    points = plan("""
template: {spec: {algorithmRef: {name: features}, datasetRef: {name: street}, sensors: stereo}}
matrix: [{path: parameters.nFeatures, range: {from: 500, to: 1500, step: 250}}]
""")
    values = [point.spec["parameters"]["nFeatures"] for point in points]
    assert values == [500, 750, 1000, 1250, 1500]
    assert {type(value) for value in values} == {int}
    assert plan_problems(points) == []


def test_points_set_several_fields_nested_or_flat(plan: Callable[..., Plan]) -> None:
    points = plan("""
template: {spec: {algorithmRef: {name: scan-match}, datasetRef: {name: yard}}}
matrix:
- name: size
  points:
    small: {parameters.maxRange: 10, parameters.ICP.iterations: 5}
    large: {parameters: {maxRange: 80, ICP.iterations: 50}, input: {lidar: {rings: 16}}}
""")
    large, small = points
    assert [large.coordinates, small.coordinates] == [{"size": "large"}, {"size": "small"}]
    assert large.spec["parameters"]["ICP.iterations"] == 50
    assert large.spec["input"]["lidar"] == {"rings": 16}
    assert small.spec["parameters"] == {
        "ICP.iterations": 5,
        "deskew": True,
        "maxRange": 10,
        "voxelSize": None,
    }


def test_points_stand_in_the_order_of_their_names_as_an_api_server_sorts_keys(
    plan: Callable[..., Plan],
) -> None:
    text = "matrix: [{name: size, points: {%s}}]"
    forward = plan(text % "a: {seed: 1}, b: {seed: 2}", strict=False)
    backward = plan(text % "b: {seed: 2}, a: {seed: 1}", strict=False)
    assert [point.coordinates for point in forward] == [point.coordinates for point in backward]
    assert forward.uid == backward.uid
