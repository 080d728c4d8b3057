# SPDX-License-Identifier: Apache-2.0
"""Examples and algorithms that every clone has: they load, and they are complete."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from slamhive.local.home.catalog import bundled, load_workshop
from slamhive.model.loading import load_file
from slamhive.model.run import MappingRun
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, plan_problems

ROOT = Path(__file__).parents[1]
ALGORITHM_FILES = ("algorithm.yaml", "adapter.py", "requirements.txt", "Dockerfile")


@pytest.mark.parametrize("path", sorted((ROOT / "examples").rglob("*.yaml")), ids=lambda path: path.name)
def test_every_example_loads_and_plans(path: Path) -> None:
    workshop = load_workshop()
    objects = load_file(path)
    workshop.add(objects, path.parent)
    assert objects
    for item in objects:
        if isinstance(item, Sweep):
            points = Plan(item, workshop, strict=False)
            assert points.point(len(points) - 1).spec_hash
            named = {*points.algorithm_names()} <= set(workshop.algorithms)
            assert not named or plan_problems(Plan(item, workshop)) == []
        else:
            assert not isinstance(item, MappingRun) or item.spec.algorithm_ref.name in workshop.algorithms


@pytest.mark.parametrize(
    "folder",
    sorted({path.parent for path in bundled("algorithms").glob("*/algorithm.yaml")}),
    ids=lambda f: f.name,
)
def test_every_algorithm_is_complete(folder: Path) -> None:
    loaded = load_file(folder / "algorithm.yaml")
    # A lab's own image has all that runs; nothing of it is ours.
    own = [item.metadata.labels.get("slamhive.io/image") == "own" for item in loaded]
    files = ALGORITHM_FILES[:1] if all(own) else ALGORITHM_FILES
    assert [name for name in files if not (folder / name).is_file()] == []
    for item in loaded:
        if all(own):
            assert item.spec.image.startswith("localhost/")
            assert {path.name for path in folder.iterdir()} == {"algorithm.yaml"}
        for asset in item.spec.assets:
            assert asset.url or (folder / asset.path).is_file()
        for name, parameter in item.spec.parameters.items():
            assert parameter.description, f"{item.name}: {name} says nothing of itself"
    if not all(own):
        docker = (folder / "Dockerfile").read_text()
        assert re.search(r"^ARG BASE", docker, re.MULTILINE)


def test_folders_of_algorithms_are_algorithms() -> None:
    folders = [path for path in bundled("algorithms").iterdir() if path.is_dir() and path.name[0] not in "._"]
    assert [path.name for path in folders if not (path / "algorithm.yaml").is_file()] == []
