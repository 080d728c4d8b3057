# SPDX-License-Identifier: Apache-2.0
"""The folders of algorithms: what they declare is there, and is what their adapters use."""

from __future__ import annotations

import ast
import hashlib
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slamhive.cli.algorithms import app
from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.templates import read_template

ALGORITHMS = Path(__file__).parents[2] / "images" / "algorithms"
FOLDERS = sorted(path.parent for path in ALGORITHMS.glob("*/algorithm.yaml"))
EVALIO = ("ct-icp", "liosam-odometry", "loam", "mad-icp")

OWN_IMAGE = [
    folder for folder in FOLDERS if "slamhive.io/image: own" in (folder / "algorithm.yaml").read_text()
]
"""Folders of those for which a lab brings its image: what runs is none of ours."""
WITH_ADAPTER = [folder for folder in FOLDERS if folder not in OWN_IMAGE]

each = pytest.mark.parametrize("folder", WITH_ADAPTER, ids=lambda folder: folder.name)
each_own = pytest.mark.parametrize("folder", OWN_IMAGE, ids=lambda folder: folder.name)


def declared(folder: Path) -> Algorithm:
    (algorithm,) = load_file(folder / "algorithm.yaml")
    assert isinstance(algorithm, Algorithm)
    return algorithm


def parameters_used(folder: Path) -> set[str]:
    """Names that the adapter asks the run for, written out or in its table PARAMETERS."""
    names = modules_needed(folder, "adapter.py")
    own = [path for name in names for path in (folder / name, ALGORITHMS / name) if path.is_file()]
    used = set()
    for node in (node for path in own for node in ast.walk(ast.parse(path.read_text()))):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr == "parameter"
        ):
            used |= {argument.value for argument in node.args if isinstance(argument, ast.Constant)}
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PARAMETERS":
            used |= set(ast.literal_eval(node.value))
    return used


@each
def test_files_are_there(folder: Path) -> None:
    spec = declared(folder).spec
    assert spec.local is not None
    names = [spec.local.adapter, spec.local.requirements, "Dockerfile"]
    assert [name for name in names if not (folder / name).is_file()] == []
    for asset in spec.assets:
        assert asset.path is not None
        assert hashlib.sha256((folder / asset.path).read_bytes()).hexdigest() == asset.sha256


@each
def test_parameters_are_those_that_the_adapter_uses(folder: Path) -> None:
    assert parameters_used(folder) == set(declared(folder).spec.parameters)


@each_own
def test_parameters_of_an_own_image_are_those_that_its_templates_use(folder: Path) -> None:
    spec = declared(folder).spec
    used: set[str] = set()
    for _, template in spec.templates:
        found = read_template(template, spec.parameters)
        assert not found.takes_all
        used |= found.parameters
    assert used == set(spec.parameters)


@each_own
def test_an_own_image_is_asked_for_and_its_page_says_what_is_in_it(folder: Path) -> None:
    algorithm = declared(folder)
    assert algorithm.spec.description.endswith("needs an image of yours")
    page = (ALGORITHMS.parents[1] / "docs" / "algorithms" / f"{folder.name}.md").read_text()
    assert str(algorithm.spec.image) in page
    missing = [name for name in algorithm.spec.parameters if f"`{name}`" not in page]
    assert missing == []


def test_what_is_shown_says_which_image_is_wanted_and_where_poses_come_from(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path))
    shown = CliRunner().invoke(app, ["show", "lio-sam"]).output
    assert "image: localhost/lio-sam:noetic" in shown
    assert "poses on /lio_sam/mapping/odometry (Odometry)" in shown
    assert "keyframes on /lio_sam/mapping/path (Path)" in shown


@each
def test_requirements_are_pinned(folder: Path) -> None:
    text = (folder / "requirements.txt").read_text()
    assert {"numpy", "rosbags", "pyyaml"} <= set(re.findall(r"^([\w.-]+)==[\w.]+", text, re.MULTILINE))


def test_evalio_s_share_an_environment() -> None:
    assert len({(ALGORITHMS / name / "requirements.txt").read_bytes() for name in EVALIO}) == 1


@each
def test_the_image_runs_as_nobody_and_has_all_that_the_adapter_imports(folder: Path) -> None:
    text = (folder / "Dockerfile").read_text()
    assert re.search(r"^ARG BASE=", text, re.MULTILINE)
    assert re.search(r"^USER 65532", text, re.MULTILINE)
    copied = {
        Path(word).name
        for line in re.findall(r"^COPY (.*) \S+$", text, re.MULTILINE)
        for word in line.split()
    }
    assert modules_needed(folder, "adapter.py") <= copied


def modules_needed(folder: Path, name: str) -> set[str]:
    """The module and those of ours that it imports, of whatever depth."""
    needed = {name}
    path = folder / name if (folder / name).is_file() else ALGORITHMS / name
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            other = f"{node.module}.py"
            if (folder / other).is_file() or (ALGORITHMS / other).is_file():
                needed |= modules_needed(folder, other)
    return needed
