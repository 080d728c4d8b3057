# SPDX-License-Identifier: Apache-2.0
"""Include and exclude against a literal reading of the rules of GitHub Actions."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.model.base import ObjectMeta
from slamhive.model.errors import InputError
from slamhive.model.sweep import Axis, Sweep, SweepSpec
from slamhive.plan import FixedCatalog, Plan

if TYPE_CHECKING:
    from collections.abc import Callable

AXES = ("parameters.fruit", "parameters.animal", "parameters.size")
EXTRA = ("parameters.color", "parameters.shape")


def naive(axes: Any, include: Any, exclude: Any) -> Any:
    """Combine as the documentation of GitHub Actions says, one combination after another."""
    names = list(axes)
    original = [dict(zip(names, values, strict=True)) for values in itertools.product(*axes.values())]
    if not names:
        original = [] if include else [{}]
    original = [c for c in original if not any(e.items() <= c.items() for e in exclude)]
    result = [dict(c) for c in original]
    new = []
    for entry in include:
        fits = [n for n, c in enumerate(original) if all(c.get(k, v) == v for k, v in entry.items())]
        for number in fits:
            result[number].update(entry)
        if not fits:
            new.append(dict(entry))
    return result, new


def expand(axes: Any, include: Any, exclude: Any) -> Any:
    matrix = [Axis(path=path, values=list(values)) for path, values in axes.items()]
    spec = SweepSpec(matrix=matrix, include=include, exclude=exclude)
    made = Sweep(metadata=ObjectMeta(name="study"), spec=spec)
    return [point.coordinates for point in Plan(made, FixedCatalog(), strict=False)]


def test_the_example_of_the_documentation() -> None:
    axes = {"parameters.fruit": ["apple", "pear"], "parameters.animal": ["cat", "dog"]}
    entries = [
        {"color": "green"},
        {"color": "pink", "animal": "cat"},
        {"fruit": "apple", "shape": "circle"},
        {"fruit": "banana"},
        {"fruit": "banana", "animal": "cat"},
    ]
    include = [{f"parameters.{key}": value for key, value in entry.items()} for entry in entries]
    expected = [
        {"fruit": "apple", "animal": "cat", "color": "pink", "shape": "circle"},
        {"fruit": "apple", "animal": "dog", "color": "green", "shape": "circle"},
        {"fruit": "pear", "animal": "cat", "color": "pink"},
        {"fruit": "pear", "animal": "dog", "color": "green"},
        {"fruit": "banana"},
        {"fruit": "banana", "animal": "cat"},
    ]
    assert expand(axes, include, []) == [
        {f"parameters.{key}": value for key, value in entry.items()} for entry in expected
    ]


_values = st.integers(0, 3)
_axes = st.dictionaries(st.sampled_from(AXES), st.lists(_values, min_size=1, max_size=3, unique=True))
_includes = st.lists(st.dictionaries(st.sampled_from(AXES + EXTRA), _values, min_size=1), max_size=6)
_excludes = st.lists(st.dictionaries(st.sampled_from(AXES), _values, min_size=1), max_size=4)


@given(axes=_axes, include=_includes, exclude=_excludes)
def test_agrees_with_the_naive_way(axes: Any, include: Any, exclude: Any) -> None:
    exclude = [{k: v for k, v in entry.items() if k in axes} for entry in exclude]
    exclude = [entry for entry in exclude if entry]
    combined, new = naive(axes, include, exclude)
    if not combined + new:
        with pytest.raises(InputError, match="nothing is left"):
            expand(axes, include, exclude)
    elif any(new.count(entry) > 1 for entry in new):
        with pytest.raises(InputError, match="makes the same combination"):
            expand(axes, include, exclude)
    else:
        assert expand(axes, include, exclude) == combined + new


def test_true_is_not_one() -> None:
    axes = {"parameters.fruit": [1, True, 0, False, 1.5]}
    assert expand(axes, [], [{"parameters.fruit": 1}, {"parameters.fruit": False}]) == [
        {"parameters.fruit": value} for value in (True, 0, 1.5)
    ]


POINTS = """
template: {spec: {parameters: {c: 9}}}
matrix:
- {path: dataset, values: [d1, d2]}
- {name: mode, points: {a: {parameters.a: 1}, b: {parameters.b: 2}, c: {parameters.c: 3}}}
"""


@pytest.mark.parametrize(
    ("more", "left"),
    [
        ("exclude: [{mode: a}]", ["b", "c", "b", "c"]),
        ("exclude: [{mode: a, dataset: d1}]", ["b", "c", "a", "b", "c"]),
        ("exclude: [{parameters.a: 1}]", ["b", "c", "b", "c"]),
        ("exclude: [{parameters.a: 2}]", ["a", "b", "c", "a", "b", "c"]),
        ("exclude: [{parameters.c: 9}]", ["c", "c"]),
        ("exclude: [{algorithmRef: {name: x}}]", None),
    ],
)
def test_exclude_matches_points_by_name_or_by_what_they_set(
    plan: Callable[..., Plan], more: str, left: Any
) -> None:
    if left is None:
        with pytest.raises(InputError, match=r"no axis sets algorithmRef.name"):
            plan(POINTS + more, strict=False)
    else:
        assert [point.coordinates["mode"] for point in plan(POINTS + more, strict=False)] == left


def test_include_extends_points_that_leave_a_field_alone(plan: Callable[..., Plan]) -> None:
    points = plan(POINTS + "include: [{parameters.a: 5, dataset: d2}]", strict=False)
    assert [point.spec["parameters"].get("a") for point in points] == [1, None, None, 1, 5, 5]


def test_include_makes_a_point_from_the_name_of_one(plan: Callable[..., Plan]) -> None:
    points = plan(POINTS + "include: [{mode: b, dataset: d9, input: {frameRate: 5}}]", strict=False)
    last = points.point(len(points) - 1)
    assert last.spec["parameters"] == {"b": 2, "c": 9}
    assert last.coordinates == {"mode": "b", "dataset": "d9", "input.frameRate": 5}
    assert last.spec["datasetRef"] == {"name": "d9"}


def test_a_grid_beyond_the_limit_is_fine_when_exclude_makes_it_small(plan: Callable[..., Plan]) -> None:
    axis = "- {path: parameters.%s, range: {from: 1, to: 180, step: 1}}\n"
    matrix = "matrix:\n" + "".join(axis % name for name in "abc")
    drop = ", ".join(f"{{parameters.a: {number}}}" for number in range(3, 181))
    points = plan(f"{matrix}exclude: [{drop}]", strict=False)
    assert len(points) == 2 * 180 * 180
    assert points.point(len(points) - 1).coordinates == {
        "parameters.a": 2,
        "parameters.b": 180,
        "parameters.c": 180,
    }
