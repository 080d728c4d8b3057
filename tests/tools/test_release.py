# SPDX-License-Identifier: Apache-2.0
"""Refusals of make release; charts and lists of packages that are equal whenever they are made."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tarfile
import zipfile
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import release
import release_checks as checks
import yaml

from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
COPIED = (
    "CITATION.cff",
    "CHANGELOG.md",
    "helm",
    "crds",
    "evaluator/slamhive_eval/__init__.py",
    "tests/upgrade",
)


def git(root: Path, *words: str) -> None:
    names = {f"GIT_{who}_{what}": "a@b" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    command = ["git", "-C", root, *words]
    subprocess.run(command, check=True, capture_output=True, env=os.environ | names)


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small copy of the tree, committed."""
    root = tmp_path / "tree"
    for name in COPIED:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        copy: Callable[..., object] = shutil.copytree if (ROOT / name).is_dir() else shutil.copyfile
        copy(ROOT / name, root / name)
    for path in root.rglob("__pycache__"):
        shutil.rmtree(path)
    schema = root / "operator" / "slamhive" / "archive" / "schema.py"
    schema.parent.mkdir(parents=True)
    schema.write_text(f"VERSION = {checks.ARCHIVE}\n")
    git(root, "init", "-q")
    commit(root)
    return root


def commit(root: Path) -> None:
    git(root, "add", "-A")
    git(root, "commit", "-q", "-m", "All", "--allow-empty")


def test_this_version_stands_everywhere_and_opens_what_earlier_ones_left() -> None:
    found = [checks.versions(ROOT)]
    found += [checks.objects(path, ROOT / "crds") for path in (ROOT / "tests/upgrade/objects").glob("*.xz")]
    found += [checks.home(path) for path in (ROOT / "tests/upgrade/homes").glob("*.xz")]
    assert list(chain(*found)) == []


@pytest.mark.parametrize(
    ("name", "old", "new", "told"),
    [
        ("CHANGELOG.md", "# Changelog", "# Changes", "the tree isn't clean: M CHANGELOG.md"),
        ("CITATION.cff", "version: 0.1.0", "version: 0.2.0", "CITATION.cff: version is 0.2.0"),
        ("helm/slamhive/Chart.yaml", "appVersion: 0.1.0", "appVersion: 9", "appVersion is 9"),
        ("CHANGELOG.md", "## Unreleased", "## Later", "CHANGELOG.md: nothing stands under 0.1.0"),
        (
            "CHANGELOG.md",
            "## Unreleased",
            "## 0.1.0 - 2026-12-24",
            "CITATION.cff: date-released is None, CHANGELOG.md says 2026-12-24",
        ),
        (
            "CHANGELOG.md",
            "## Unreleased",
            "## [0.1.0] - 2026-12-24",
            "tests/upgrade/homes/0.1.0.tar.xz is missing, which later versions are tested with",
        ),
    ],
)
def test_what_does_not_agree_is_refused(tree: Path, name: str, old: str, new: str, told: str) -> None:
    def found() -> list[str]:
        return [*checks.tree(tree), *checks.versions(tree)]

    assert found() == []
    change(tree / name, old, new)
    assert told in "\n".join(found())


def test_kinds_and_archives_of_earlier_versions_must_be_kept(tree: Path) -> None:
    git(tree, "tag", "v0.0.9")
    assert list(checks.earlier_versions(tree)) == []
    schema = tree / "operator" / "slamhive" / "archive" / "schema.py"
    change(schema, f"VERSION = {checks.ARCHIVE}", "VERSION = 1")
    change(tree / "crds" / "slamhive.io_sweeps.yaml", "storage: true", "storage: true ")
    commit(tree)
    git(tree, "tag", "v0.0.10")
    found = list(checks.earlier_versions(tree))
    assert [re.findall(r"v[\d.]+\d|tests/\S+xz", one) for one in found] == [
        ["v0.0.10", "tests/upgrade/homes/0.0.10.tar.xz"],
        ["v0.0.9", "tests/upgrade/objects/0.0.9.tar.xz"],
    ]
    for kind, name in (("homes", "0.0.10"), ("objects", "0.0.9")):
        shutil.copyfile(
            ROOT / f"tests/upgrade/{kind}/c1046b6.tar.xz", tree / f"tests/upgrade/{kind}/{name}.tar.xz"
        )
    assert list(checks.earlier_versions(tree)) == []


def test_kinds_that_drop_or_refuse_what_is_stored_are_named(tree: Path) -> None:
    path = tree / "crds" / "slamhive.io_sweeps.yaml"
    described = yaml.safe_load(path.read_text())
    schema = described["spec"]["versions"][0]["schema"]["openAPIV3Schema"]["properties"]
    del schema["spec"]["properties"]["parallelism"]
    schema["status"]["properties"]["succeeded"]["maximum"] = 1
    path.write_text(yaml.safe_dump(described))
    (kept,) = (ROOT / "tests/upgrade/objects").glob("c1046b6.tar.xz")
    refused, dropped = checks.objects(kept, tree / "crds")
    assert "Sweep study: status.succeeded" in refused
    assert dropped == "c1046b6: Sweep study: spec.parallelism would be dropped"


def test_a_chart_is_equal_whenever_it_is_packed(tmp_path: Path) -> None:
    made = []
    for moment in (1, 2):
        packed = tmp_path / f"{moment}.tgz"
        with tarfile.open(packed, "w:gz") as archive:
            for name in sorted(("Chart.yaml", "values.yaml"), reverse=moment == 2):
                entry = archive.gettarinfo(ROOT / "helm" / "slamhive" / name, f"slamhive/{name}")
                entry.mtime = moment
                with (ROOT / "helm" / "slamhive" / name).open("rb") as file:
                    archive.addfile(entry, file)
        release.repack(packed, tmp_path / f"{moment}-again.tgz", 1_700_000_000)
        made.append((tmp_path / f"{moment}-again.tgz").read_bytes())
    assert made[0] == made[1]
    with tarfile.open(tmp_path / "1-again.tgz") as archive:
        assert (
            archive.extractfile("slamhive/Chart.yaml").read()
            == (  # type: ignore[union-attr]
                ROOT / "helm" / "slamhive" / "Chart.yaml"
            ).read_bytes()
        )


def test_what_a_wheel_needs_is_listed_with_versions_and_is_equal_each_time(tmp_path: Path) -> None:
    wheel = tmp_path / "slamhive-0.1.0-py3-none-any.whl"
    told = "Name: slamhive\nVersion: 0.1.0\nSummary: S\nLicense-Expression: Apache-2.0\n"
    needs = "Requires-Dist: typer>=0.15\nRequires-Dist: kopf; extra == 'operator'\n"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("slamhive-0.1.0.dist-info/METADATA", told + needs)
    text = release.distribution_listing(wheel)
    assert text == release.distribution_listing(wheel)
    found = json.loads(text)
    names = {part["name"] for part in found["components"]}
    assert {"typer", "rich", "pygments"} <= names
    assert "kopf" not in names
    assert found["metadata"]["component"]["purl"] == "pkg:pypi/slamhive@0.1.0"


def test_files_that_differ_are_named(tmp_path: Path) -> None:
    for folder, text in (("first", "1"), ("second", "2")):
        (tmp_path / folder / "sbom").mkdir(parents=True)
        (tmp_path / folder / "sbom" / "a.json").write_text(text)
        (tmp_path / folder / "same").write_text("same")
    (tmp_path / "second" / "more").touch()
    first, second = (release.sums(tmp_path / folder) for folder in ("first", "second"))
    assert release.differences(first, second) == ["more", "sbom/a.json"]
    assert release.differences(first, dict(first)) == []


def test_charts_say_what_is_in_them(tmp_path: Path) -> None:
    told = yaml.safe_load((ROOT / "helm/slamhive-crds/Chart.yaml").read_text())["annotations"]
    listed = yaml.safe_load(told["artifacthub.io/crds"])
    kinds = [yaml.safe_load(path.read_text()) for path in (ROOT / "crds").glob("*.yaml")]
    expected = {
        (kind["metadata"]["name"], kind["spec"]["names"]["kind"], version["name"])
        for kind in kinds
        for version in kind["spec"]["versions"]
    }
    assert {(one["name"], one["kind"], one["version"]) for one in listed} == expected
    for example in yaml.safe_load(told["artifacthub.io/crdsExamples"]):
        (tmp_path / "example.yaml").write_text(yaml.safe_dump(example))
        assert load_file(tmp_path / "example.yaml")
