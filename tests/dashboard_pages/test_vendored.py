# SPDX-License-Identifier: Apache-2.0
"""Tests of the vendored files: they match the list, have licences, and fetch nothing from outside."""

from __future__ import annotations

import hashlib
import json
import re
from importlib.resources import files
from pathlib import Path

import pytest

STATIC = Path(str(files("slamhive.dashboard") / "static"))
VENDOR = STATIC / "vendor"
PLACES = {"shown": VENDOR, "tests": Path(__file__).parent / "vendor"}
LISTED = {name: json.loads((place / "manifest.json").read_text())["files"] for name, place in PLACES.items()}
OWN = sorted(
    path
    for ending in ("js", "css", "html", "svg")
    for path in STATIC.rglob(f"*.{ending}")
    if VENDOR not in path.parents
)


@pytest.mark.parametrize("name", PLACES)
def test_files_are_those_of_the_list(name: str) -> None:
    place = PLACES[name]
    sums = {entry["file"]: entry["sha256"] for entry in LISTED[name]}
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in place.iterdir()}
    del found["manifest.json"]
    assert found == sums


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_own_files(path: Path) -> None:
    text = path.read_text()
    assert "SPDX-License-Identifier: Apache-2.0" in "".join(text.splitlines(keepends=True)[:2])
    outside = [url for url in re.findall(r"https?://[^\s\"'`)]+", text) if "www.w3.org" not in url]
    assert outside == []
    assert not re.search(r"\sstyle=\"|innerHTML|dangerouslySetInnerHTML|\beval\(|new Function", text)


def test_imports_exist() -> None:
    for path in OWN:
        for found in re.findall(r"(?:from|import)\s*\(?'([./][^']+)'", path.read_text()):
            target = STATIC / found[1:] if found.startswith("/") else path.parent / found
            assert target.resolve().is_file(), f"{path.name}: {found}"
