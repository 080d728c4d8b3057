# SPDX-License-Identifier: Apache-2.0
"""The Dockerfiles as they are written: what a build would only show later, or never."""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING

import pytest
from building.digests import unpinned
from building.recipes import ROOT, Recipe, recipes
from packaging.requirements import Requirement

from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from pathlib import Path

RECIPES = recipes()
each = pytest.mark.parametrize("recipe", RECIPES.values(), ids=lambda recipe: recipe.name)


def instructions(recipe: Recipe) -> list[tuple[str, str]]:
    text = re.sub(r"^#.*\n", "", recipe.dockerfile.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    return [(line.split(" ", 1)[0], line.split(" ", 1)[1]) for line in text.splitlines() if line]


def last_stage(recipe: Recipe) -> list[tuple[str, str]]:
    found = instructions(recipe)
    start = max(index for index, (word, _) in enumerate(found) if word == "FROM")
    return found[start:]


def test_bases_without_digest_are_few_and_used() -> None:
    used = {recipe.default_base for recipe in RECIPES.values()}
    assert set(unpinned()) <= used, "these have a digest, or nobody starts from them"


def test_every_dockerfile_is_known() -> None:
    files = {path for folder in ("images", "tests/images") for path in (ROOT / folder).rglob("Dockerfile")}
    assert {recipe.dockerfile for recipe in RECIPES.values()} == files
    assert {"slamhive", "evaluator", "kiss-icp", "shell-algorithm"} <= set(RECIPES)


@each
def test_it_ends_as_nobody(recipe: Recipe) -> None:
    users = [value for word, value in last_stage(recipe) if word == "USER"]
    assert users == ["65532:65532"]
    words = [word for word, _ in last_stage(recipe)]
    assert words.index("USER") > max(
        [index for index, word in enumerate(words) if word in ("RUN", "COPY", "WORKDIR")]
    )


@each
def test_it_starts_from_a_base_that_can_be_chosen(recipe: Recipe) -> None:
    found = instructions(recipe)
    bases = [value.split()[0] for word, value in found if word == "FROM"]
    stages = {value.split()[2] for word, value in found if word == "FROM" and " AS " in value}
    assert found[0][0] == "ARG"
    assert found[0][1].startswith("BASE=")
    assert bases[0] == "${BASE}"
    assert set(bases[1:]) <= stages
    name, _, digest = recipe.default_base.partition("@")
    assert re.fullmatch(r"[a-z/]+:[\w.-]+", name)
    assert not name.endswith(":latest")
    assert re.fullmatch(r"sha256:[0-9a-f]{64}", digest) or unpinned().get(name), f"{name} has no digest"


@each
def test_it_holds_no_compiler_and_no_pip(recipe: Recipe) -> None:
    text = " ".join(value for word, value in last_stage(recipe) if word == "RUN")
    installed = " ".join(re.findall(r"apt-get install ([^&]*)", text))
    assert not re.search(r"\b(gcc|g\+\+|build-essential|cmake|python3-(dev|pip|venv))\b", installed)
    assert not re.search(r"\bpip\b", text)


@each
def test_it_runs_nothing_straight_from_the_net_and_knows_no_secret(recipe: Recipe) -> None:
    text = " ".join(f"{word} {value}" for word, value in instructions(recipe))
    assert not re.search(r"\b(curl|wget|ADD|SHELL|sudo)\b", text)
    assert not re.search(r"(?i)(password|token|secret|api_?key|-----BEGIN|https?://\S+@)", text)
    assert "--trusted-host" not in text
    assert "--no-check" not in text


@each
def test_it_leaves_no_caches(recipe: Recipe) -> None:
    for word, value in last_stage(recipe):
        if word == "RUN" and "apt-get install" in value:
            assert "--no-install-recommends" in value
            assert re.search(r"rm -rf .*/var/lib/apt/lists/\* /var/cache/\*", value)
    for word, value in instructions(recipe):
        if word == "RUN" and re.search(r"\bpip\b.* (install|wheel)\b", value):
            assert "--no-cache-dir" in value or "--no-index" in value


@each
def test_the_command_in_its_comment_is_the_one_that_builds_it(recipe: Recipe) -> None:
    text = recipe.dockerfile.read_text()
    found = re.search(r"^# Built from (.+): docker build (?:-f (\S+) )?-t (\S+) \.$", text, re.MULTILINE)
    assert found
    places = {ROOT: "the root of the repository", ROOT / "images/algorithms": "the folder above"}
    assert found[1] == places.get(recipe.context, "this folder")
    assert recipe.context / (found[2] or "Dockerfile") == recipe.dockerfile
    assert found[3] == recipe.tag


def manifest(recipe: Recipe) -> Algorithm:
    (algorithm,) = load_file(recipe.dockerfile.parent / "algorithm.yaml")
    assert isinstance(algorithm, Algorithm)
    return algorithm


@pytest.mark.parametrize("name", [name for name in RECIPES if (RECIPES[name].context != ROOT)])
def test_an_algorithm_s_image_is_the_one_that_it_declares(name: str) -> None:
    recipe = RECIPES[name]
    spec = manifest(recipe).spec
    stage = last_stage(recipe)
    assert spec.image == recipe.tag
    copied = {tuple(value.split()) for word, value in stage if word == "COPY"}
    for asset in spec.assets:
        if asset.path:
            source = (recipe.dockerfile.parent / asset.path).relative_to(recipe.context).as_posix()
            assert (source, "/slamhive/assets/") in copied
            assert asset.name == asset.path
    if spec.command:
        command = ", ".join(f'"{word}"' for word in spec.command)
        assert ("CMD", f"[{command}]") in stage


PINNED = [ROOT / "constraints.txt", ROOT / "constraints-demo.txt", ROOT / "images" / "hatchling.txt"]
PINNED += sorted(path for path in (ROOT / "images").rglob("requirements.txt") if not path.is_symlink())
PINNED += [*sorted((ROOT / "operator/slamhive/playback").glob("*.txt")), ROOT / "tests/reporting/rerun.txt"]
HASHES = r"( \\\n    --hash=sha256:[0-9a-f]{64})+"
PIN = re.compile(rf"(?P<name>[\w.-]+)==(?P<version>[\w.]+)( ; [^\\\n]+)?{HASHES}\n")


def pinned(path: Path) -> dict[str, str]:
    """Return the versions of a file in which each package has hashes and nothing else stands."""
    text = re.sub(r"^#.*\n", "", path.read_text(), flags=re.MULTILINE)
    assert PIN.sub("", text) == ""
    return {found["name"]: found["version"] for found in PIN.finditer(text)}


@pytest.mark.parametrize("path", PINNED, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_package_has_its_hashes(path: Path) -> None:
    assert pinned(path)


@each
def test_packages_are_wheels_whose_hashes_are_known(recipe: Recipe) -> None:
    text = " ".join(value for word, value in instructions(recipe) if word == "RUN")
    for command in re.findall(r"/pip/bin/pip [^&;]*\binstall\b[^&;]*", text):
        assert "--no-index" in command or {"--require-hashes", "--only-binary"} <= set(command.split())


def test_the_demo_has_what_it_shows_in_the_versions_that_are_tested() -> None:
    demo, everything = (pinned(ROOT / name) for name in ("constraints-demo.txt", "constraints.txt"))
    assert demo == {name: everything[name] for name in demo}
    own = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wanted = own["tool"]["hatch"]["metadata"]["hooks"]["custom"]["dependencies"]
    wanted += [*own["dependency-groups"]["build"], "matplotlib", "uv", "fastapi", "uvicorn"]
    assert {Requirement(line).name for line in wanted} <= set(demo)
    assert not {"ruff", "mypy", "pytest", "kubernetes", "kopf", "s3fs", "mlflow-skinny", "pyarrow"} & set(
        demo
    )


@pytest.mark.parametrize(
    ("image", "extras", "alone"),
    [
        ("slamhive", ("operator", "dashboard", "postgresql"), None),
        ("evaluator", (), {"numpy", "pydantic", "pyyaml", "rfc8785", "rosbags"}),
    ],
)
def test_the_pins_are_what_the_project_asks_for(
    image: str, extras: tuple[str, ...], alone: set[str] | None
) -> None:
    own = tomllib.loads((ROOT / "pyproject.toml").read_text())
    evaluator = tomllib.loads((ROOT / "evaluator" / "pyproject.toml").read_text())
    optional = own["project"]["optional-dependencies"]
    wanted = own["tool"]["hatch"]["metadata"]["hooks"]["custom"]["dependencies"]
    wanted += evaluator["project"]["dependencies"] + [line for extra in extras for line in optional[extra]]
    versions = pinned(ROOT / "images" / image / "requirements.txt")
    for requirement in map(Requirement, wanted):
        if alone is None or requirement.name in alone:
            assert requirement.specifier.contains(versions[requirement.name]), requirement
    if alone is not None:
        assert not {"opencv-python-headless", "kopf", "sqlalchemy", "kubernetes", "rich"} & set(versions)
