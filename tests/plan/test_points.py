# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.model.base import ObjectMeta
from slamhive.model.sweep import Axis, Sweep, SweepSpec
from slamhive.plan import FixedCatalog, Plan, resolve, run_name, spec_hash

if TYPE_CHECKING:
    from collections.abc import Callable

MIXED = """
template: {spec: {algorithmRef: {name: scan-match}, resources: {cpu: 2}, seed: 7, input: {lidar: {}}}}
matrix:
- {path: dataset, values: [hall, yard]}
- {path: parameters.maxRange, values: [20, 1e1, 12.5]}
- {path: parameters.voxelSize, values: [null, 0.5]}
- {path: input.frameRate, values: [null, 5]}
include: [{parameters.deskew: false, dataset: yard}, {dataset: street, algorithm: features, sensors: mono}]
repetitions: 3
"""


def test_the_first_axis_is_slowest_and_repetitions_fastest(plan: Callable[..., Plan]) -> None:
    points = plan(MIXED)
    assert len(points) == (2 * 3 * 2 * 2 + 1) * 3
    expected = itertools.product(["hall", "yard"], [20, 10, 12.5], [None, 0.5], [None, 5], range(3))
    labels = ("dataset", "parameters.maxRange", "parameters.voxelSize", "input.frameRate")
    found = [(*map(point.coordinates.get, labels), point.repetition) for point in points][:72]
    assert found == list(expected)


def test_a_point_is_the_same_alone_and_in_its_turn(plan: Callable[..., Plan]) -> None:
    turn = list(plan(MIXED))
    for index in (0, 1, 40, 71, 74):
        alone = plan(MIXED).point(index)
        assert (alone.name, alone.spec_hash, alone.spec) == (
            turn[index].name,
            turn[index].spec_hash,
            turn[index].spec,
        )


def test_the_quick_hash_is_that_of_the_resolved_spec(
    plan: Callable[..., Plan], catalog: FixedCatalog
) -> None:
    points = plan(MIXED)
    for point in points:
        algorithm = catalog.algorithms[point.spec["algorithmRef"]["name"]]
        assert point.spec_hash == spec_hash(point.spec) == spec_hash(resolve(point.spec, algorithm, None))
    assert len({point.spec_hash for point in points}) == len(points)


def test_defaults_are_filled_in(plan: Callable[..., Plan]) -> None:
    assert plan(MIXED).point(0).spec == {
        "algorithmRef": {"name": "scan-match"},
        "datasetRef": {"name": "hall"},
        "sensors": "lidar",
        "parameters": {"ICP.iterations": 30, "deskew": True, "maxRange": 20, "voxelSize": None},
        "input": {"remap": {}, "resolution": 1, "pace": "Lockstep"},
        "repetition": 0,
        "seed": 7,
        "resources": {"cpu": "2", "memory": "4Gi"},
        "timeout": "1h",
        "retries": 2,
        "evaluate": True,
        "cancel": False,
    }


def test_a_repetition_has_its_own_seed(plan: Callable[..., Plan]) -> None:
    points = plan("matrix: [{path: seed, values: [10, 20]}]\nrepetitions: 2", strict=False)
    assert [(p.repetition, p.seed, p.spec["seed"]) for p in points] == [
        (0, 10, 10),
        (1, 11, 11),
        (0, 20, 20),
        (1, 21, 21),
    ]


_scalar = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**53) + 1, 2**53 - 1),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(codec="utf-8"), max_size=8),
)


@given(
    values=st.lists(_scalar, min_size=1, max_size=4, unique_by=lambda v: (isinstance(v, bool), v)),
    names=st.lists(
        st.text(st.characters(codec="utf-8"), min_size=1, max_size=6), min_size=1, max_size=3, unique=True
    ),
    rates=st.lists(st.floats(1e-9, 1e9), min_size=1, max_size=3, unique=True),
)
def test_the_quick_hash_holds_for_any_value_and_name(values: Any, names: Any, rates: Any) -> None:
    matrix = [Axis(path=f"parameters.{name}", values=values) for name in names]
    matrix.append(Axis(path="input.frameRate", values=list(rates)))
    made = Sweep(metadata=ObjectMeta(name="s"), spec=SweepSpec(matrix=matrix))
    points = Plan(made, FixedCatalog(), strict=False)
    for point in points:
        assert point.spec_hash == spec_hash(point.spec)
        assert list(point.coordinates) == [f"parameters.{name}" for name in names] + ["input.frameRate"]


def test_few_variants_are_alive(plan: Callable[..., Plan]) -> None:
    points = plan(
        """
template: {spec: {sensors: stereo}}
matrix:
- {path: parameters.a, values: [1, 2]}
- {path: input.frameRate, values: [20, 10]}
- {path: input.pace, values: [Lockstep, Realtime]}
- {path: dataset, values: [d1, d2]}
repetitions: 2
""",
        strict=False,
    )
    order = points.start_order()
    assert sorted(order) == list(range(len(points)))
    keys = [
        (points.point(k).coordinates["dataset"], points.point(k).coordinates["input.frameRate"])
        for k in order
    ]
    assert len([key for key, _ in itertools.groupby(keys)]) == 4
    assert [points.point(k).repetition for k in order[:8]] == [0, 0, 0, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("name", ["a", "a.b-c", "x" * 253, "3d", "a" * 38 + "-b"])
def test_names_are_dns_labels(name: str) -> None:
    made = run_name(name, "uid", 99_999)
    assert re.fullmatch(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?", made)
    assert len(made) <= 52


def test_the_uid_follows_from_what_the_runs_follow_from(plan: Callable[..., Plan]) -> None:
    first = plan(MIXED)
    assert plan(MIXED + "parallelism: 9\nmaxFailures: 3").uid == first.uid
    assert plan(MIXED, name="other").uid != first.uid
    assert plan(MIXED.replace("12.5", "12.6")).uid != first.uid


def test_the_servers_uid_comes_first(sweep: Callable[..., Sweep], catalog: FixedCatalog) -> None:
    made = sweep(MIXED)
    made = made.replace(metadata=made.metadata.replace(uid="1234"))
    assert Plan(made, catalog).point(5).name == run_name("study", "1234", 5)


def test_an_index_beyond_the_end_is_an_error(plan: Callable[..., Plan]) -> None:
    points = plan(MIXED)
    for index in (-1, len(points)):
        with pytest.raises(IndexError):
            points.point(index)
