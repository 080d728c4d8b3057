# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError
from slamhive.plan import algorithm_hash, content_hash, resolve, spec_hash

if TYPE_CHECKING:
    from slamhive.plan import FixedCatalog


def _spec(**more: Any) -> dict[str, Any]:
    return {"algorithmRef": {"name": "scan-match"}, "datasetRef": {"name": "hall"}} | more


def test_equal_runs_have_equal_hashes_however_they_are_written(catalog: FixedCatalog) -> None:
    algorithm, dataset = catalog.algorithms["scan-match"], catalog.datasets["hall"]
    short = resolve(_spec(), algorithm, dataset)
    full = resolve(
        _spec(
            sensors="lidar",
            parameters={"voxelSize": None, "maxRange": 60.0, "deskew": True, "ICP.iterations": 30},
            input={"pace": "Lockstep", "lidar": {}, "frameRate": None},
            resources={"memory": "4Gi", "cpu": 1},
            seed=1,
            timeout="5m",
            retries=0,
            evaluate=False,
            cancel=True,
        ),
        algorithm,
        dataset,
    )
    assert spec_hash(short) == spec_hash(full)


@pytest.mark.parametrize(
    "more",
    [
        {"parameters": {"maxRange": 61}},
        {"seed": 2},
        {"repetition": 1},
        {"input": {"frameRate": 5}},
        {"input": {"remap": {"lidar": "lidar"}}},
        {"resources": {"cpu": "2"}},
    ],
)
def test_what_changes_a_run_changes_its_hash(catalog: FixedCatalog, more: dict[str, Any]) -> None:
    algorithm, dataset = catalog.algorithms["scan-match"], catalog.datasets["hall"]
    assert spec_hash(resolve(_spec(**more), algorithm, dataset)) != spec_hash(
        resolve(_spec(), algorithm, dataset)
    )


def test_a_dataset_without_sensors_serves_no_mode(catalog: FixedCatalog) -> None:
    dataset = Dataset.model_validate(
        {"metadata": {"name": "poses"}, "spec": {"recording": {"files": [{"path": "poses.bag"}]}}}
    )
    with pytest.raises(
        InputError, match="a sensor for the role 'lidar', and poses has none; it has: no sens"
    ):
        resolve(_spec(datasetRef={"name": "poses"}), catalog.algorithms["scan-match"], dataset)


def test_all_mistakes_of_a_run_are_told_with_their_fields(catalog: FixedCatalog) -> None:
    spec = _spec(parameters={"maxRange": 0, "speed": 3}, input={"pace": "Realtime"})
    with pytest.raises(InputError) as error:
        resolve(spec, catalog.algorithms["scan-match"], catalog.datasets["street"])
    assert [line.split(": ")[0] for line in str(error.value).splitlines()] == [
        "spec.parameters.maxRange",
        "spec.parameters.speed",
        "spec.input.pace",
        "spec.sensors",
    ]


def test_a_field_that_does_not_exist_is_told(catalog: FixedCatalog) -> None:
    with pytest.raises(InputError, match=r"spec\.colour: Extra inputs are not permitted"):
        resolve(_spec(colour=1), catalog.algorithms["scan-match"], None)


def test_stand_ins_fill_a_role(catalog: FixedCatalog) -> None:
    spec = _spec(algorithmRef={"name": "features"}, sensors="mono")
    assert resolve(spec, catalog.algorithms["features"], catalog.datasets["street"])["sensors"] == "mono"


def test_content_hash_follows_from_everything_but_prose(catalog: FixedCatalog) -> None:
    algorithm = catalog.algorithms["scan-match"].spec
    arguments = ("0" * 64, algorithm_hash(algorithm), "1" * 64, "1", "image")
    base = content_hash(*arguments)
    assert algorithm_hash(algorithm.replace(description="new")) == algorithm_hash(algorithm)
    for number, other in (
        (0, "f" * 64),
        (1, algorithm_hash(algorithm.replace(seed="Used"))),
        (2, "f"),
        (3, "2"),
        (4, "venv"),
    ):
        changed = [*arguments[:number], other, *arguments[number + 1 :]]
        assert content_hash(*changed) != base
