# SPDX-License-Identifier: Apache-2.0
"""Each mistake ends in one sentence that names the field and what would be right."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.model.errors import InputError
from slamhive.plan import plan_problems

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.plan import Plan

BASE = "template: {spec: {algorithmRef: {name: scan-match}, datasetRef: {name: hall}}}\n"
MANY = "matrix: [{path: seed, range: {from: 1, to: 400, step: 1}}, {path: retries, values: [1, 2, 3]}]\n"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("template: {spec: {algoritmRef: {name: a}}}", "spec.template.spec.algoritmRef: unknown field"),
        ("template: {spec: {algorithm: a}}", "did you mean 'algorithmRef'?"),
        ("template: {spec: {mode: stereo}}", "did you mean 'sensors'?"),
        (
            "template: {spec: {sensors: {mode: stereo}}}",
            "sensors: takes one word, such as 'stereo', found {'mode'",
        ),
        ("template: {spec: {sensors: [left, right]}}", "sensors: takes one word: 'mono', "),
        ("template: {spec: {input: {framerate: 3}}}", "did you mean 'input.frameRate'?"),
        (
            "template: {spec: {input: {pace: Lockstepp}}}",
            "input.pace: unknown value 'Lockstepp'; did you mean",
        ),
        ("template: {spec: {timeout: 5 minutes}}", "spec.template.spec.timeout: expected a duration such as"),
        ("template: {spec: {resources: {memory: 4 GB}}}", "expected a quantity such as 2, 500m or 4Gi"),
        (
            "template: {spec: {resources: {exclusiveNodes: 2}}}",
            "spec.template.spec.resources.exclusiveNodes: must be true or false",
        ),
        (
            "exclusiveNodes: true",
            "spec.exclusiveNodes: unknown field 'exclusiveNodes'; did you mean 'template'?",
        ),
        ("template: {spec: {exclusiveNodes: true}}", "did you mean 'resources'?"),
        ("template: {spec: {input: fast}}", "input takes a mapping of fields, found 'fast'"),
        ("matrix: [{path: parameter.x, values: [1]}]", "spec.matrix[0].path: 'parameter.x' is no field"),
        ("matrix: [{path: input.framRate, values: [1]}]", "did you mean 'input.frameRate'?"),
        ("matrix: [{path: input.remap.lft, values: [a]}]", "unknown role 'lft'; did you mean 'left'?"),
        ("matrix: [{path: repetition, values: [1]}]", "use spec.repetitions"),
        (
            "matrix: [{path: priorityClassName, values: [low, high]}]",
            "spec.matrix[0].values[0]: results don't depend on it, so combinations can't differ in it; use",
        ),
        ("include: [{seed: 2, priorityClassName: high}]", "spec.include[0].priorityClassName: results don't"),
        ("matrix: [{path: cancel, values: [false, true]}]", "leave them out by spec.exclude"),
        (
            "matrix: [{path: input.frameRate, values: ['20']}]",
            "spec.matrix[0].values[0]: must be",
        ),
        (
            "matrix: [{path: input.frameRate, values: [5, -1]}]",
            "spec.matrix[0].values[1]: must be greater",
        ),
        ("matrix: [{path: seed, values: [1, true]}]", "whole number, found True"),
        (
            "matrix: [{path: parameters.a, values: [[1, 2]]}]",
            "a parameter is a number, a text, true, false or null",
        ),
        ("matrix: [{path: seed, values: [1, 2, 1.0]}]", "spec.matrix[0].values[2]: the value 1 stands twice"),
        (
            "matrix: [{path: seed, values: [1]}, {path: seed, values: [2]}]",
            "spec.matrix[0] has the label 'seed'",
        ),
        (
            "matrix: [{path: seed, values: [1]}, {name: x, points: {a: {seed: 1}}}]",
            "spec.matrix[1]: sets seed, which spec.matrix[0] sets already",
        ),
        (
            "matrix: [{path: algorithm, values: [a]}, {path: algorithmRef.name, values: [b]}]",
            "spec.matrix[1]: sets algorithmRef.name, which spec.matrix[0] sets already",
        ),
        ("matrix: [{name: x, points: {a: {sed: 1}}}]", "spec.matrix[0].points.a.sed: 'sed' is no field"),
        (
            "matrix: [{name: x, points: {a: {seed: 1, parameters.b: 1, parameters: {b: 2}}}}]",
            "sets parameters.b a second time",
        ),
        ("matrix: [{path: seed, range: {from: 0, to: 1, step: 1.0e-9}}]", "at most 100000 are allowed"),
        (
            "matrix: [{path: seed, range: {from: 0, to: 3, count: 1}}]",
            "count 1 needs from and to to be equal",
        ),
        (
            "matrix: [{path: dataset, selector: {matchLabels: {place: moon}}}]",
            "spec.matrix[0].selector: no dataset has the labels place: moon",
        ),
        ("matrix: [{path: seed, selector: {matchLabels: {a: b}}}]", "selects algorithms or datasets"),
        (MANY + "repetitions: 100", "expands to 1200 combinations × 100 repetitions = 120000 runs"),
        (
            "matrix: [{path: seed, values: [1, 2]}, {path: input.rate, range: {from: 1, to: 7, step: 1e-4}}]",
            "spec.matrix: 2 × 60001 = 120002 combinations, at most 100000 are allowed",
        ),
        (MANY + "exclude: [{retries: 1}, {retries: 2}, {retries: 3}]", "nothing is left to run"),
        (MANY + "exclude: [{retry: 1}]", "spec.exclude[0].retry: 'retry' is no field"),
        (MANY + "exclude: [{timeout: 1h}]", "spec.exclude[0].timeout: no axis sets timeout"),
        (MANY + "exclude: [{}]", "spec.exclude[0]: names no axis"),
        (MANY + "include: [{}]", "spec.include[0]: sets nothing"),
        (MANY + "include: [{sede: 5}]", "spec.include[0].sede: 'sede' is no field"),
        (
            MANY + "include: [{seed: 900}, {seed: 900}]",
            "spec.include[1]: makes the same combination as spec.include[0]",
        ),
        (
            "matrix: [{name: x, points: {small: {seed: 1}}}]\ninclude: [{x: smal}]",
            "spec.include[0].x: unknown point 'smal'; did you mean 'small'?",
        ),
        (
            "template: {spec: {seed: 2147483647}}\nrepetitions: 2",
            "the last seed would be 2147483648, at most 2147483647",
        ),
    ],
)
def test_a_sweep_that_cannot_be_expanded(plan: Callable[..., Plan], spec: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        plan(spec, strict=False)
    assert message in str(error.value)


def test_all_mistakes_are_told_at_once(plan: Callable[..., Plan]) -> None:
    with pytest.raises(InputError) as error:
        plan("template: {spec: {a: 1, b: 2}}\nmatrix: [{path: c, values: [1]}, {path: seed, values: [x, y]}]")
    assert len(str(error.value).splitlines()) == 5


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (
            "matrix: [{path: algorithm, values: [scan-match, scan-mach]}]",
            "spec.matrix[0].values[1]: algorithmRef.name: unknown algorithm 'scan-mach'; did you mean",
        ),
        (
            "matrix: [{path: dataset, values: [hal]}]",
            "spec.matrix[0].values[0]: datasetRef.name: unknown dataset 'hal'; did you mean 'hall'?",
        ),
        (
            "matrix: [{path: parameters.maxRang, values: [10]}]",
            "spec.matrix[0].values[0]: parameters.maxRang: scan-match has no parameter 'maxRang'; did",
        ),
        (
            "matrix: [{path: parameters.maxRange, values: [10, 500]}]",
            "spec.matrix[0].values[1]: parameters.maxRange: 500 is above the maximum, allowed: a",
        ),
        (
            "matrix: [{path: parameters.maxRange, range: {from: 150, to: 250, step: 50}}]",
            "spec.matrix[0].range: parameters.maxRange: 250 is above",
        ),
        (
            "matrix: [{name: x, points: {a: {parameters.deskew: 1}}}]",
            "spec.matrix[0].points.a: parameters.deskew: 1 is not allowed, only true or false",
        ),
        (
            "include: [{parameters.ICP.iterations: 1.5}]",
            "spec.include[0]: parameters.ICP.iterations: 1.5 is not allowed, only an integer of at least 1",
        ),
        (
            "matrix: [{path: sensors, values: [lidar, mono]}]",
            "spec.matrix[0].values[1]: sensors: scan-match does not support mono, allowed: lidar",
        ),
        (
            "matrix: [{path: input.pace, values: [Realtime]}]",
            "input.pace: scan-match does not run in Realtime",
        ),
        (
            "matrix: [{path: dataset, values: [hall, street]}]",
            "needs a sensor for the role 'lidar', and street has none",
        ),
        (
            "matrix: [{path: input.remap.lidar, values: [imu]}]",
            "input.remap.lidar: the role 'lidar' takes a Lidar, and 'imu' of hall is a Imu",
        ),
        (
            "matrix: [{path: input.remap.lidar, values: [lydar]}]",
            "unknown sensor 'lydar'; did you mean 'lidar'?",
        ),
        (
            "matrix: [{path: algorithm, values: [features]}, {path: dataset, values: [street]}]",
            "sensors: features has several modes, name one of stereo, mono",
        ),
        (
            "matrix: [{path: input.lidar.minRange, values: [9]}, {path: input.lidar.maxRange, values: [5]}]",
            "minRange 9 must be below maxRange 5",
        ),
    ],
)
def test_check_tells_what_the_catalog_does_not_allow(
    plan: Callable[..., Plan], spec: str, message: str
) -> None:
    head = "" if spec.startswith("include") else BASE
    points = plan(head + spec) if head else plan(BASE + "matrix: [{path: seed, values: [1]}]\n" + spec)
    found = plan_problems(points)
    assert len(found) == 1
    assert message in found[0]


def test_a_mistake_in_the_template_is_told_once(plan: Callable[..., Plan]) -> None:
    points = plan(BASE.replace("datasetRef", "parameters: {maxRange: 0}, datasetRef") + "repetitions: 50")
    assert plan_problems(points) == [
        "spec.template.spec: parameters.maxRange: 0 is below the minimum, allowed: a number from 1 to 200 (m)"
    ]


def test_the_list_of_what_cannot_be_expanded_is_bounded(plan: Callable[..., Plan]) -> None:
    with pytest.raises(InputError) as error:
        plan("matrix: [{path: seed, range: {from: -5000, to: -1, step: 1}}]")
    assert str(error.value).splitlines()[20:] == ["… and 4980 more"]


def test_missing_names_are_told(plan: Callable[..., Plan]) -> None:
    assert [problem.split(": ")[1] for problem in plan_problems(plan("repetitions: 2"))] == [
        "algorithmRef.name",
        "datasetRef.name",
    ]


def test_names_outside_the_catalog_are_allowed_when_asked(plan: Callable[..., Plan]) -> None:
    spec = "matrix: [{path: algorithm, values: [a, b]}, {path: dataset, values: [c]}]"
    assert plan_problems(plan(spec, strict=False)) == []
    assert len(plan_problems(plan(spec, strict=True))) == 3


def test_the_list_of_mistakes_is_bounded(plan: Callable[..., Plan]) -> None:
    points = plan(BASE + "matrix: [{path: parameters.maxRange, range: {from: 1000, to: 1099, step: 1}}]")
    found = plan_problems(points, 5)
    assert len(found) == 6
    assert found[-1] == "… and 95 more"
