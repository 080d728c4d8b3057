# SPDX-License-Identifier: Apache-2.0
"""Names and hashes that users' archives hold: they may never change.

A change of golden/points.json means that every result computed before is lost to reuse and resume.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from slamhive.model.loading import load_file, parse
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, Plan, algorithm_hash, content_hash, spec_hash

FOLDER = Path(__file__).parent / "golden"


@pytest.fixture(scope="module")
def points() -> Plan:
    objects = load_file(FOLDER / "study.yaml")
    sweep = objects[1]
    assert isinstance(sweep, Sweep)
    return Plan(sweep, FixedCatalog.of(objects))


@pytest.fixture(scope="module")
def golden() -> Any:
    return json.loads((FOLDER / "points.json").read_text(encoding="utf-8"))


def test_the_plan_is_what_it_always_was(points: Plan, golden: Any) -> None:
    assert {"uid": points.uid, "runs": len(points)} == {"uid": golden["uid"], "runs": golden["runs"]}
    for expected in golden["points"]:
        point = points.point(expected["index"])
        found = {
            "index": point.index,
            "name": point.name,
            "specHash": point.spec_hash,
            "coordinates": point.coordinates,
        }
        assert found == expected
    assert points.point(0).spec == golden["spec"]
    assert spec_hash(golden["spec"]) == golden["points"][0]["specHash"]


def test_the_content_hash_is_what_it_always_was(points: Plan, golden: Any) -> None:
    algorithm = algorithm_hash(points.algorithms["golden-odometry"].spec)
    assert content_hash(points.point(0).spec_hash, algorithm, "1" * 64, "1", "env") == golden["contentHash"]


def test_an_object_read_back_from_a_server_gives_the_same(points: Plan) -> None:
    """A server sorts keys and writes 10.0 as 10; defaults may be filled in."""
    document = parse((FOLDER / "study.yaml").read_text(encoding="utf-8"), "study.yaml")[1].value
    document["spec"] |= {"suspend": False, "cachePolicy": "Reuse", "search": {"method": "Grid"}}
    back = Sweep.model_validate_json(json.dumps(document, sort_keys=True), strict=True)
    again = Plan(back, FixedCatalog(points.algorithms, points.datasets))
    assert again.uid == points.uid
    assert [point.spec_hash for point in again] == [point.spec_hash for point in points]


@pytest.mark.parametrize(
    "perturb",
    [
        {},
        {"seed": 9},
        {"lidar": {"rangeNoise": 0.0}},
        {"seed": 9, "images": {"gamma": 1, "blur": 0}, "timeOffset": {"imu": 0}, "jitter": {}},
    ],
)
def test_what_perturbs_nothing_has_the_hash_of_a_run_without(golden: Any, perturb: Any) -> None:
    spec = golden["spec"] | {"input": golden["spec"]["input"] | {"perturb": perturb}}
    assert spec_hash(spec) == golden["points"][0]["specHash"]


def test_perturbations_have_hashes_of_their_own(golden: Any) -> None:
    noise: Any = {"lidar": {"rangeNoise": 0.1}}
    perturbations: list[Any] = [
        noise,
        noise | {"seed": 2},
        {"lidar": {"rangeNoise": 0.2}},
        {"timeOffset": {"imu": 0.1}},
        {"timeOffset": {"lidar": 0.1}},
        {"images": {"gamma": 0.5}},
        {"imu": {"rate": 100}},
    ]
    specs = [golden["spec"] | {"input": golden["spec"]["input"] | {"perturb": one}} for one in perturbations]
    hashes = [spec_hash(spec) for spec in specs]
    assert len({golden["points"][0]["specHash"], *hashes}) == len(perturbations) + 1
    assert (
        spec_hash(golden["spec"] | {"input": golden["spec"]["input"] | {"perturb": noise | {"seed": 1}}})
        == hashes[0]
    )
