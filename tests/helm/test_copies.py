# SPDX-License-Identifier: Apache-2.0
"""Tests that the charts' copies equal the tree's files: a chart can't reach files outside of itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.programs.starting import EDITOR_LINE

if TYPE_CHECKING:
    from collections.abc import Callable

    Read = Callable[[Path], dict[str, Any]]

ROOT = Path(__file__).parents[2]
CRDS = ROOT / "helm" / "slamhive-crds"
CATALOG = ROOT / "helm" / "slamhive" / "files" / "catalog"
OWN = {"slamhive.io/image": "own"}
LICENCE = "# SPDX-License-Identifier: Apache-2.0\n"


def sources() -> dict[Path, Path]:
    """Every copy with what it is a copy of."""
    kinds = {CRDS / "files" / path.name: path for path in (ROOT / "crds").glob("*.yaml")}
    algorithms = {
        CATALOG / "algorithms" / f"{path.parent.name}.yaml": path
        for path in (ROOT / "images" / "algorithms").glob("*/algorithm.yaml")
    }
    datasets = {
        CATALOG / "datasets" / path.name: path for path in (ROOT / "examples" / "datasets").glob("*.yaml")
    }
    return kinds | algorithms | datasets


@pytest.mark.parametrize("copy", sorted(sources()), ids=lambda path: f"{path.parent.name}/{path.name}")
def test_copies_are_equal(copy: Path, kept: Callable[[Path, str], None]) -> None:
    # The line for editors leads to a file beside the source.
    text = EDITOR_LINE.sub("", sources()[copy].read_text(encoding="utf-8"))
    kept(copy, text if text.startswith(LICENCE) else LICENCE + text)


def test_nothing_else_is_carried() -> None:
    carried = {*(CRDS / "files").iterdir(), *CATALOG.glob("*/*")}
    assert carried == {*sources()}


def test_rendered_kinds_are_the_generated_ones(helm: Any, read: Read) -> None:
    rendered = {
        one["metadata"]["name"]: one
        for one in helm.objects(chart=CRDS)
        if one["kind"] == "CustomResourceDefinition"
    }
    generated = [read(path) for path in (ROOT / "crds").glob("*.yaml")]
    assert {one["metadata"]["name"] for one in generated} == {*rendered}
    for one in generated:
        assert rendered[one["metadata"]["name"]]["spec"] == one["spec"]


@pytest.mark.parametrize(("settings", "policy"), [("keep=true", "keep"), ("keep=false", None)])
def test_kinds_are_kept_unless_told(helm: Any, settings: str, policy: str | None) -> None:
    for one in helm.objects("--set", settings, "--set", "labels.team=x,annotations.a=b", chart=CRDS):
        if one["kind"] == "CustomResourceDefinition":
            assert one["metadata"]["annotations"].get("helm.sh/resource-policy") == policy
            assert one["metadata"]["annotations"]["a"] == "b"
            assert one["metadata"]["labels"]["team"] == "x"


def catalog(helm: Any, *words: str) -> list[dict[str, Any]]:
    objects = helm.objects("--set", "catalog.enabled=true", *words)
    return [one for one in objects if one["kind"] in {"Algorithm", "Dataset"}]


def test_the_catalog_is_the_tree_s(helm: Any, read: Read) -> None:
    rendered = {(one["kind"], one["metadata"]["name"]): one for one in catalog(helm)}
    files = [read(path) for path in sources().values() if path.parent.name != "crds"]
    files = [one for one in files if OWN.items() - one["metadata"].get("labels", {}).items()]
    assert {(one["kind"], one["metadata"]["name"]) for one in files} == {*rendered}
    for one in files:
        found = rendered[one["kind"], one["metadata"]["name"]]
        assert found["spec"] == one["spec"]
        assert found["metadata"]["labels"].items() >= one["metadata"].get("labels", {}).items()
        assert found["metadata"]["annotations"] == {"helm.sh/resource-policy": "keep"}


def test_the_catalog_can_be_chosen(helm: Any) -> None:
    chosen = catalog(
        helm,
        "--set",
        "catalog.algorithms={kiss-icp,loam},catalog.datasets={synthetic-lidar},workspaces={other}",
        "--set",
        "catalog.imageRegistry=registry.example.org/team/",
    )
    assert {(one["metadata"]["namespace"], one["metadata"]["name"]) for one in chosen} == {
        (namespace, name)
        for namespace in ("lab", "other")
        for name in ("kiss-icp", "loam", "synthetic-lidar")
    }
    images = {one["spec"]["image"] for one in chosen if one["kind"] == "Algorithm"}
    assert all(image.startswith("registry.example.org/team/slamhive/") for image in images)
    assert not [one for one in helm.objects() if one["kind"] in {"Algorithm", "Dataset"}]


def test_an_image_of_one_s_own_is_asked_for_by_name(helm: Any) -> None:
    words = ("--set", "catalog.algorithms={vins-mono},catalog.datasets={synthetic-lidar}")
    images = [one["spec"].get("image") for one in catalog(helm, *words)]
    assert images == ["localhost/vins-mono:noetic", None]
    words += ("--set", "catalog.imageRegistry=registry.example.org/team")
    assert catalog(helm, *words)[0]["spec"]["image"] == "registry.example.org/team/vins-mono:noetic"
