# SPDX-License-Identifier: Apache-2.0
"""Checks before a release: a clean tree, one version, and data of earlier versions that can still be read.

Of each earlier version ``tests/upgrade`` keeps what it left. Where its kinds or its archive differ from
today's and nothing is kept, nobody can test that an upgrade works, so nothing is released.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import sqlite3
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "tests" / "cluster")]

from fakeapi import schema  # noqa: E402

from slamhive.archive.schema import VERSION as ARCHIVE  # noqa: E402
from slamhive.archive.upgrading import upgrade  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Iterator

CHARTS = ("slamhive", "slamhive-crds")
_VERSION = "evaluator/slamhive_eval/__init__.py"
_TAG = re.compile(r"v(\d+\.\d+\.\d+)")


class Changes(NamedTuple):
    """Part of the changelog that is about a version.

    Attributes:
        text: its Markdown.
        released: the day; None where it is still "Unreleased".
    """

    text: str
    released: str | None


def git(root: Path, *words: str) -> str:
    """Return what git says about a tree."""
    command = ["git", "-c", "safe.directory=*", "-C", str(root), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def version(root: Path) -> str:
    """Return the version of a tree."""
    found = re.search(r'^__version__ = "(.+)"$', (root / _VERSION).read_text(), re.MULTILINE)
    if found is None:
        sys.exit(f'{_VERSION}: no line __version__ = "…" in it')
    return found[1]


def changes(root: Path) -> Changes:
    """Return what the changelog says of the tree's version; of what is unreleased where it has no section."""
    sections: dict[str, tuple[str, str]] = {}
    for part in re.split(r"^## ", (root / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[1:]:
        head, _, text = part.partition("\n")
        name, _, day = head.strip().partition(" - ")
        sections[name.strip("[]")] = (text.strip() + "\n", day)
    text, day = sections.get(version(root)) or sections.get("Unreleased") or ("", "")
    return Changes(text, day if version(root) in sections else None)


def problems(root: Path = ROOT) -> Iterator[str]:
    """Yield what keeps a tree from being released, a sentence each."""
    yield from tree(root)
    yield from versions(root)
    yield from earlier_versions(root)
    for path in sorted((root / "tests/upgrade/objects").glob("*.tar.xz")):
        yield from objects(path, root / "crds")
    for path in sorted((root / "tests/upgrade/homes").glob("*.tar.xz")):
        yield from home(path)


def tree(root: Path) -> Iterator[str]:
    """Yield what is in the folder but not in its commit: what is released is the commit."""
    changed = git(root, "status", "--porcelain").splitlines()
    if changed:
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        yield f"the tree isn't clean: {changed[0].strip()}{more}; commit or remove it"


def versions(root: Path) -> Iterator[str]:
    """Yield places that name another version than the code, and a changelog and citation that disagree."""
    expected = version(root)
    places: dict[str, Any] = {}
    for chart in CHARTS:
        described = yaml.safe_load((root / "helm" / chart / "Chart.yaml").read_text())
        for name in ("version", "appVersion"):
            places[f"helm/{chart}/Chart.yaml: {name}"] = described.get(name)
    citation = yaml.safe_load((root / "CITATION.cff").read_text())
    places["CITATION.cff: version"] = citation.get("version")
    for place, found in places.items():
        if found != expected:
            yield f"{place} is {found}, {_VERSION} says {expected}"
    found = changes(root)
    if not found.text.strip():
        yield f"CHANGELOG.md: nothing stands under {expected} or Unreleased"
    if found.released is not None:
        if str(citation.get("date-released")) != found.released:
            day = citation.get("date-released")
            yield f"CITATION.cff: date-released is {day}, CHANGELOG.md says {found.released}"
        for kind in ("homes", "objects"):
            kept = f"tests/upgrade/{kind}/{expected}.tar.xz"
            if not (root / kept).exists():
                yield f"{kept} is missing, which later versions are tested with"


def earlier_versions(root: Path) -> Iterator[str]:
    """Yield earlier versions whose kinds or archive were others, and of which nothing is kept."""
    today = {path.name: path.read_text() for path in (root / "crds").glob("*.yaml")}
    for tag in git(root, "tag", "--merged", "HEAD").split():
        named = _TAG.fullmatch(tag)
        if named is None or named[1] == version(root):
            continue
        names = git(root, "ls-tree", "--name-only", f"{tag}:crds").split()
        then = {name: git(root, "show", f"{tag}:crds/{name}") for name in names}
        kept = f"tests/upgrade/objects/{named[1]}.tar.xz"
        if then != today and not (root / kept).exists():
            yield f"the CRDs are others than those of {tag}, whose objects are not kept: {kept} is missing"
        kept = f"tests/upgrade/homes/{named[1]}.tar.xz"
        if _archive_of(root, tag) != ARCHIVE and not (root / kept).exists():
            yield f"the archive has another schema than in {tag}, of which no home is kept: {kept} is missing"


def _archive_of(root: Path, tag: str) -> int | None:
    """Return the version of the archive's schema at a tag; None where it stood elsewhere."""
    with contextlib.suppress(subprocess.CalledProcessError):
        text = git(root, "show", f"{tag}:operator/slamhive/archive/schema.py")
        found = re.search(r"^VERSION = (\d+)$", text, re.MULTILINE)
        return int(found[1]) if found else None
    return None


def objects(path: Path, crds: Path) -> Iterator[str]:
    """Yield objects of an earlier version that today's kinds refuse, or of which they would drop a field."""
    kinds: dict[tuple[str, str], Any] = {}
    for crd in crds.glob("*.yaml"):
        spec = yaml.load(crd.read_bytes(), getattr(yaml, "CSafeLoader", yaml.SafeLoader))["spec"]  # noqa: S506
        for served in spec["versions"]:
            name = f"{spec['group']}/{served['name']}"
            kinds[name, spec["names"]["kind"]] = served["schema"]["openAPIV3Schema"]
    for item in json.loads(_member(path, "objects.json")):
        where = f"{path.stem.removesuffix('.tar')}: {item['kind']} {item['metadata']['name']}"
        known = kinds.get((item["apiVersion"], item["kind"]))
        if known is None:
            yield f"{where}: {item['apiVersion']} is served no more"
            continue
        for name, _, sentence in schema.problems(known, schema.settled(known, item)):
            yield f"{where}: {name}: {sentence}"
        yield from (f"{where}: {lost} would be dropped" for lost in _lost(item, schema.settled(known, item)))


def _lost(before: Any, after: Any, path: str = "") -> Iterator[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        for name, value in before.items():
            inner = f"{path}.{name}".lstrip(".")
            yield from _lost(value, after[name], inner) if name in after else [inner]
    elif isinstance(before, list) and isinstance(after, list):
        for number, value in enumerate(before):
            yield from _lost(value, after[number], f"{path}[{number}]")


def home(path: Path) -> Iterator[str]:
    """Yield the reason that the archive in a home of an earlier version can't be brought to today's."""
    name = path.name.removesuffix(".tar.xz")
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "archive.sqlite"
        archive.write_bytes(_member(path, "archive.sqlite"))
        before = _count(archive)
        try:
            upgrade(f"sqlite:///{archive}")
        except Exception as error:  # noqa: BLE001 - whatever is in the way is said
            yield f"{name}: its archive can't be upgraded: {error}"
            return
        if _count(archive) != before:
            yield f"{name}: of {before} runs {_count(archive)} are left in its archive"


def _count(archive: Path) -> int:
    with contextlib.closing(sqlite3.connect(archive)) as database:
        return int(database.execute("SELECT count(*) FROM runs").fetchone()[0])


def _member(path: Path, name: str) -> bytes:
    with tarfile.open(path) as packed:
        file = packed.extractfile(name)
        return (file or io.BytesIO()).read()
