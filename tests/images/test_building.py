# SPDX-License-Identifier: Apache-2.0
"""images/build: builds what has changed, says what is missing, and goes on after a failure."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pytest
from building import command, loading, tools
from building.base import STAND_IN, Bases
from building.errors import BuildError
from building.recipes import Recipe
from building.tools import Image

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@dataclass
class FakeTool:
    """Builds in memory."""

    images: dict[str, Image] = field(default_factory=dict)
    built: list[tuple[str, str]] = field(default_factory=list)
    name: str = "fake"

    def find(self, reference: str) -> Image | None:
        return self.images.get(reference)

    def pull(self, reference: str) -> bool:
        return False

    def build(self, recipe: Recipe, base: str, labels: dict[str, str]) -> None:
        if recipe.name == "broken":
            raise BuildError("step 3 failed")
        self.built.append((recipe.name, base))
        self.images[recipe.reference] = Image(f"sha256:{len(self.built):064x}", 1000, labels)

    def archive(self, reference: str, path: Path) -> None:
        path.write_text(reference)

    def files(self, reference: str, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
        yield "usr/lib/os-release", b"ID=debian\n"


@pytest.fixture
def recipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Recipe:
    folder = tmp_path / "thing"
    (folder / "part").mkdir(parents=True)
    (folder / "Dockerfile").write_text(
        "# a\n# A thing.\nARG BASE=debian:1\nFROM ${BASE}\nCOPY one part \\\n /opt/\n"
    )
    (folder / "one").write_text("1")
    (folder / "part" / "two").write_text("2")
    monkeypatch.setattr("building.recipes.ROOT", tmp_path)
    return Recipe("thing", "slamhive/thing:1.0", folder / "Dockerfile", folder, "A thing.", "MIT")


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, recipe: Recipe) -> FakeTool:
    made = FakeTool({"debian:1": Image("sha256:" + "0" * 64, 1, {})})
    monkeypatch.setattr(command, "choose", lambda *_: made)
    monkeypatch.setattr(command, "recipes", lambda: {"thing": recipe})
    monkeypatch.setattr(command, "PLACE", tmp_path / "dist")
    monkeypatch.setattr(command, "ROOT", tmp_path)
    return made


@pytest.fixture
def no_cluster(fake: FakeTool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SLAMHIVE_CLUSTER_HOME", str(tmp_path))
    monkeypatch.setattr(loading, "_kind_clusters", list)


def test_an_unchanged_image_is_kept(fake: FakeTool, recipe: Recipe, tmp_path: Path) -> None:
    assert command.main([]) == 0
    (recipe.context / "part" / "__pycache__").mkdir()
    (recipe.context / "part" / "__pycache__" / "two.pyc").write_text("compiled")
    assert command.main(["thing"]) == 0
    assert fake.built == [("thing", "debian:1")]
    assert (tmp_path / "dist" / "thing-1.0.cdx.json").exists()


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: (folder / "part" / "two").write_text("3"),
        lambda folder: (folder / "part" / "three").write_text(""),
        lambda folder: (folder / "one").chmod(0o755),
        lambda folder: (folder / "Dockerfile").write_text((folder / "Dockerfile").read_text() + "USER 1\n"),
    ],
    ids=["content", "new file", "mode", "Dockerfile"],
)
def test_a_changed_image_is_built_again(
    fake: FakeTool, recipe: Recipe, change: Callable[[Path], None]
) -> None:
    command.main([])
    change(recipe.context)
    command.main([])
    assert len(fake.built) == 2


def test_an_image_on_a_changed_base_is_built_again(fake: FakeTool, recipe: Recipe) -> None:
    command.main([])
    fake.images["debian:1"] = Image("sha256:" + "1" * 64, 1, {})
    command.main([])
    assert len(fake.built) == 2


def test_one_that_fails_stops_no_other(
    fake: FakeTool, recipe: Recipe, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = Recipe("broken", "slamhive/broken:1", recipe.dockerfile, recipe.context, "B.", "MIT")
    monkeypatch.setattr(command, "recipes", lambda: {"broken": broken, "thing": recipe})
    assert command.main([]) == 1
    assert fake.built == [("thing", "debian:1")]
    assert "slamhive/broken:1" in (told := capsys.readouterr().err)
    assert "step 3 failed" in told


def test_the_tests_own_images_are_built_by_name_or_tag_alone(
    fake: FakeTool, recipe: Recipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    extra = Recipe("extra", "slamhive/extra:1", recipe.dockerfile, recipe.context, "E.", "MIT", extra=True)
    monkeypatch.setattr(command, "recipes", lambda: {"thing": recipe, "extra": extra})
    command.main([])
    command.main(["slamhive/extra:1"])
    assert [name for name, _ in fake.built] == ["thing", "extra"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["kiss"], "no image 'kiss', only thing"),
        (["--base", "nobody/nothing:1"], "the base nobody/nothing:1 is not there and no registry has it"),
        (["--load"], "no cluster to load images into"),
    ],
)
def test_what_is_missing_is_said_in_a_sentence(
    no_cluster: None, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    assert command.main(arguments) == 1
    assert sentence in capsys.readouterr().err


def test_without_a_tool_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(BuildError, match="apt-get install buildah"):
        tools.choose(None, tmp_path)
    with pytest.raises(BuildError, match="docker doesn't work here"):
        tools.choose("docker", tmp_path)


def test_without_a_registry_the_stand_in_is_the_base(recipe: Recipe) -> None:
    stand_in = Image("sha256:" + "2" * 64, 1, {})
    assert Bases(FakeTool({STAND_IN: stand_in}), None).of(recipe) == (STAND_IN, stand_in.identity)
    with pytest.raises(BuildError, match="debootstrap"):
        Bases(FakeTool(), None).of(recipe)


def test_a_missing_source_is_named(recipe: Recipe) -> None:
    (recipe.context / "one").unlink()
    with pytest.raises(BuildError, match=r"copies .*/one, which is not there"):
        recipe.sources()


def test_a_loaded_image_is_known_by_its_identity() -> None:
    listing = (
        "REF TYPE DIGEST SIZE\n"
        "docker.io/slamhive/a:1 manifest sha256:aaa 1\n"
        "docker.io/slamhive/b:1 manifest sha256:bbb 1\n"
        "sha256:1111 manifest sha256:aaa 1\n"
    )
    assert loading._same(listing, "docker.io/slamhive/a:1", "sha256:1111")
    assert not loading._same(listing, "docker.io/slamhive/b:1", "sha256:1111")
    assert not loading._same(listing, "docker.io/slamhive/b:1", "sha256:2222")
