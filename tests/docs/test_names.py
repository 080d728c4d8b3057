# SPDX-License-Identifier: Apache-2.0
"""Names in the documents are those of the code: files and folders, modules, what is in them, tests."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING

import pytest
from documents import ALL, PACKAGE, ROOT, blocks, code_file, name_of, prose

if TYPE_CHECKING:
    from pathlib import Path

MAINTAINERS = [path for path in ALL if re.match(r"docs/(develop|architecture)\b", name_of(path))]
SPAN = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"(?=.*[a-z])(?:[\w.-]+/)+[\w.-]*|[\w-]+\.(?:py|m?js|css)")
SOURCE = re.compile(r".*\.(?:py|m?js|css)")
PLACEHOLDER = re.compile(r"(?:^|/)[A-Z][A-Z0-9-]*(?:\.(?!md\b)|/|$)|versionN")
"""Parts of a path that stand for what a reader puts there, such as NAME."""
NAMED = re.compile(r"((?:`[\w.]+`(?:, | and )?)+) (?:in |of |\()`([\w.-]+/[\w./-]+\.\w+)`")
MODULE = re.compile(r"\bslamhive(?:_eval)?\.(?!io\b)\w+(?:\.\w+)*")
TEST = re.compile(r"`(?:[\w/]+\.py::)?(test_\w+)`")
PROMISED = re.compile(r"`([\w/]+\.py)::(test_\w+)`")
DIFF = re.compile(r"^--- a/(\S+)$", re.MULTILINE)
HUNK = re.compile(r"^@@ -\d+,(\d+) \+\d+,(\d+) @@\n", re.MULTILINE)
MADE = {
    *("output", "runs", "dist", "site", ".venv", "velodyne", "assets", "cache", "datasets", "downloads"),
    *("environments", "evaluations", "generated", "groundtruth", "leases", "truths", "variants", "versions"),
    *("slamhive.io", "text"),
}
"""First words of what maintainers' documents name: folders that are made by running something, no paths."""
ELSEWHERE = {
    "my-icp/odometry.py": "of an algorithm that the reader begins",
    "lamaria/utils/metrics.py": "of another project",
}
"""Source files that are not ours, and whose they are."""
NEW = re.compile(r"new module `([\w.]+)`")
CODE = re.compile(r'"((?:points|imu|stamps|clock|frames|images|camera|stereo|depth|truth|gnss)\.[a-z.-]+)"')
"""Codes of findings as the doctor's modules write them."""


@cache
def file_names() -> frozenset[str]:
    """Return the names of all source files of the repository."""
    ours = (ROOT / name for name in folders() if not name.startswith("."))
    paths = (path for folder in ours for path in folder.rglob("*.*"))
    return frozenset(path.name for path in paths if SOURCE.fullmatch(path.name))


@cache
def folders(root: Path = ROOT) -> frozenset[str]:
    """Return the names of the folders of the repository, or of another folder."""
    return frozenset(path.name for path in root.iterdir() if path.is_dir()) - MADE


def is_there(name: str, document: Path) -> bool:
    """Tell whether a path that a document names is in the repository, the package, or beside the document."""
    found = code_file(name.rstrip("/")) or (document.parent / name).exists()
    return bool(found) or ("/" not in name and name in file_names())


def is_ours(name: str) -> bool:
    first = name.split("/", maxsplit=1)[0]
    return SOURCE.fullmatch(name) is not None or first in folders() | folders(PACKAGE)


def made_by(document: Path) -> set[str]:
    """Return the files that a document has its reader write."""
    return {block.file for block in blocks(document) if block.file} | {*NEW.findall(prose(document))}


def paths_in(text: str) -> set[str]:
    words = {word.strip("`,;:()\"'|$").rstrip(".").split("::")[0].removeprefix("./") for word in text.split()}
    return {word for word in words if PATH.fullmatch(word) and not PLACEHOLDER.search(word)}


@pytest.mark.parametrize("document", ALL, ids=name_of)
def test_files_of_ours_that_are_named_are_there(document: Path) -> None:
    spans = " ".join(SPAN.findall(prose(document)))
    named = {name for name in paths_in(spans) if is_ours(name)} - made_by(document) - {*ELSEWHERE}
    for block in blocks(document):
        in_repository = (name for name in paths_in(block.text) if name.split("/")[0] in folders())
        named |= {name for name in in_repository if "/" in name}
    assert [name for name in sorted(named) if not is_there(name, document)] == []


@pytest.mark.parametrize("document", MAINTAINERS, ids=name_of)
def test_all_that_maintainers_are_told_of_is_there(document: Path) -> None:
    named = paths_in(" ".join(SPAN.findall(prose(document))))
    named |= {path for block in blocks(document, "diff") for path in DIFF.findall(block.text)}
    named = {name for name in named - made_by(document) if name.split("/")[0] not in MADE}
    assert [name for name in sorted(named) if not is_there(name, document)] == []


def test_codes_of_findings_are_explained() -> None:
    page = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
    doctor = (PACKAGE / "data" / "doctor").glob("*.py")
    codes = {code for path in doctor for code in CODE.findall(path.read_text(encoding="utf-8"))}
    assert {"points.duplicate", "stamps.back"} <= codes
    assert not {code for code in codes if f"`{code}`" not in page}


@pytest.mark.parametrize("document", MAINTAINERS, ids=name_of)
def test_names_are_in_the_files_that_are_named_with_them(document: Path) -> None:
    missing = [
        f"{name} in {file}"
        for names, file in NAMED.findall(prose(document))
        for name in re.findall(r"\w+", names.replace(" and ", " "))
        if not re.search(rf"\b{name}\b", text_of(file))
    ]
    assert missing == []


def text_of(name: str) -> str:
    path = code_file(name)
    assert path is not None, f"{name} is not there"
    return path.read_text()


@pytest.mark.parametrize("document", ALL, ids=name_of)
def test_modules_that_are_named_are_there(document: Path) -> None:
    assert [name for name in sorted(set(MODULE.findall(document.read_text()))) if not is_in_code(name)] == []


def is_in_code(name: str) -> bool:
    """Tell whether a dotted name is a module's, or the name of something that a module has."""
    first, *words = name.split(".")
    place = PACKAGE.parent / first if first == "slamhive" else ROOT / "evaluator" / first
    while words and (place / words[0]).is_dir():
        place /= words.pop(0)
    module = place / f"{words[0]}.py" if words else place / "__init__.py"
    if words and module.is_file():
        words.pop(0)
    else:
        module = place / "__init__.py"
    return module.is_file() and all(re.search(rf"\b{word}\b", module.read_text()) for word in words[:1])


@cache
def all_tests() -> frozenset[str]:
    texts = (path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    return frozenset(name for text in texts for name in re.findall(r"\bdef (test_\w+)", text))


@pytest.mark.parametrize("document", ALL, ids=name_of)
def test_tests_that_are_named_are_there(document: Path) -> None:
    assert set(TEST.findall(document.read_text())) - all_tests() == set()


def test_every_promise_of_security_names_its_tests() -> None:
    text = (ROOT / "SECURITY.md").read_text()
    bounded, promises = (
        [row.split(" | ") for row in re.findall(r"^\| (?!of \|)(.+) \|$", part, re.MULTILINE)]
        for part in (text.partition("\n## The promises")[0], text.partition("\n## The promises")[2])
    )
    for of, promise, tests in promises:
        named = PROMISED.findall(tests)
        assert named, f"{of}: {promise}: no test"
        assert PROMISED.sub("", tests).strip(" ,") == ""
        for path, name in named:
            found = re.search(rf"^(?:async )?def {name}\(", (ROOT / path).read_text(), re.MULTILINE)
            assert found, f"{path}::{name} is not there"
    held = {row[0] for row in bounded if len(row) == 3}
    assert held - {row[0] for row in promises} == set()


@pytest.mark.parametrize("document", MAINTAINERS, ids=name_of)
def test_examples_of_changes_can_be_made(document: Path) -> None:
    for block in blocks(document, "diff"):
        _, *files = DIFF.split(block.text)
        for name, change in zip(files[::2], files[1::2], strict=True):
            _, *hunks = HUNK.split(change)
            for old, new, text in zip(hunks[::3], hunks[1::3], hunks[2::3], strict=True):
                lines = [line or " " for line in text.removesuffix("\n").split("\n")]
                before = [line[1:] for line in lines if line[0] in " -"]
                after = [line[1:] for line in lines if line[0] in " +"]
                assert (len(before), len(after)) == (int(old), int(new)), text
                assert "\n".join(["", *before, ""]) in text_of(name), text


def test_the_method_of_the_first_example_is_called_the_same_wherever_it_is_described() -> None:
    folder = ROOT / "examples" / "algorithms" / "lidar-python"
    documents = [folder / "algorithm.yaml", folder / "odometry.py", ROOT / "docs" / "algorithms.md"]
    for document in documents:
        said = set(re.findall(r"point-to-\w+(?= ICP)", document.read_text(encoding="utf-8")))
        assert said == {"point-to-plane"}, document.name
