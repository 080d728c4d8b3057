# SPDX-License-Identifier: Apache-2.0
"""The tree as a whole: what would break every clone of it, wherever the mistake was made."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from slamhive.local.home.catalog import bundled, load_workshop
from slamhive.model.loading import load_file
from slamhive.model.run import MappingRun
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, plan_problems

ROOT = Path(__file__).parents[1]
SPDX = "SPDX-License-Identifier: Apache-2.0"
SOURCES = {".py", ".yaml", ".yml", ".toml", ".sh", ".js", ".css"}
NOT_OURS = {"crds", "tests/kube/golden", "tests/plan/golden"}
SKIPPED = {"__pycache__", "build", "dist", "node_modules"}
PLACES = re.compile(rb"(?<![\w.>])/(?:root|work|home/[a-z]\w*|Users/\w+|tmp/[a-z]\w*)/[\w.-]+")
ALGORITHM_FILES = ("algorithm.yaml", "adapter.py", "requirements.txt", "Dockerfile")


@cache
def tracked() -> list[Path]:
    """Return the files that belong to the tree: those that git knows, or all where there is no git."""
    git = shutil.which("git")
    if git and (ROOT / ".git").exists():
        command = [git, "-c", "safe.directory=*", "ls-files", "-z"]
        output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
        files = [ROOT / name for name in output.split("\0") if name]
    else:
        files = [path for path in ROOT.rglob("*") if not _skipped(path.relative_to(ROOT))]
    return [path for path in files if path.is_file()]


def _skipped(path: Path) -> bool:
    return any(part in SKIPPED or part.startswith(".") or part.endswith(".egg-info") for part in path.parts)


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_pythons_own_operator_module_is_not_shadowed() -> None:
    assert not (ROOT / "operator" / "__init__.py").exists()
    code = "import operator; assert operator.add(1, 2) == 3; import collections"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


def test_every_source_file_begins_with_its_licence() -> None:
    without = []
    for path in tracked():
        name = relative(path)
        if path.suffix in SOURCES and not any(name.startswith(f"{folder}/") for folder in NOT_OURS):
            lines = path.read_text(encoding="utf-8").splitlines()
            first = lines[1] if lines and lines[0].startswith("#!") else next(iter(lines), "")
            if SPDX not in first:
                without.append(name)
    assert without == []


def test_no_file_names_a_place_of_one_machine() -> None:
    found = []
    for path in tracked():
        for number, line in enumerate(path.read_bytes().splitlines(), 1):
            if PLACES.search(line) and path != Path(__file__):
                found.append(f"{relative(path)}:{number}: {line.decode(errors='replace').strip()[:100]}")
    assert found == []


def test_no_package_of_tests_is_importable_by_accident() -> None:
    assert [
        relative(path) for path in tracked() if path.name == "__init__.py" and "tests" in path.parts
    ] == []


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
