# SPDX-License-Identifier: Apache-2.0
"""Tests of the documents on clusters: values that they name exist, and their installations render.

A ``bash`` block is run as a whole, in the order of the document, with the cluster's programs; here helm's
installations are rendered and kubectl's targets looked up in what they make.
"""

from __future__ import annotations

import re
import shlex
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
BY_HAND = ROOT / "docs" / "develop" / "testing.md"
DOCUMENTS = [ROOT / "docs" / "kubernetes.md", ROOT / "docs" / "kind.md", BY_HAND]
BLOCK = re.compile(r"^```bash\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HEREDOC = re.compile(r"^cat > (\S+) <<'END'\n(.*?)^END\n", re.MULTILINE | re.DOTALL)
PROGRAMS = {"helm", "kubectl", "kind", "docker", "mkdir", "make", "images/build", "export"}
OPTIONS = {"--set", "--values"}


def blocks(document: Path) -> str:
    return "".join(BLOCK.findall(document.read_text()))


def commands(document: Path) -> Iterator[list[str]]:
    text = HEREDOC.sub("", blocks(document)).replace("\\\n", " ")
    for line in text.splitlines():
        if words := shlex.split(line, comments=True):
            yield words


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_are_of_programs_that_the_reader_has(document: Path) -> None:
    found = [words[0] for words in commands(document)]
    assert len(found) >= 10
    assert {*found} <= PROGRAMS


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_installations_render(helm: Any, document: Path, tmp_path: Path) -> None:
    for name, text in HEREDOC.findall(blocks(document)):
        (tmp_path / name).write_text(text)
    rendered = 0
    for words in commands(document):
        if words[:2] not in (["helm", "install"], ["helm", "upgrade"]):
            continue
        options = [
            str(tmp_path / one) if before == "--values" else one.replace("$PWD", "/checkout")
            for before, one in pairwise(words)
            if before in OPTIONS or one in OPTIONS
        ]
        assert helm.objects(*options, chart=ROOT / words[3])
        rendered += 1
    assert rendered >= 2


def test_by_hand_images_and_targets_are_there() -> None:
    rules = re.findall(r"^([\w -]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    targets = {target for rule in rules for target in rule.split()}
    loaded = set()
    for program, *words in commands(BY_HAND):
        if program == "make":
            assert set(words) <= targets
        if program == "images/build":
            loaded |= {word for word in words if not word.startswith("-")}
    (sweep,) = re.findall(r"^```yaml\n(.*?)^```$", BY_HAND.read_text(), re.MULTILINE | re.DOTALL)
    algorithms = yaml.safe_load(sweep)["spec"]["matrix"][0]["values"]
    assert loaded == {"slamhive", "evaluator", *algorithms}
    assert all(list((ROOT / "images").rglob(f"{name}/Dockerfile")) for name in loaded)


def test_values_that_are_named_exist() -> None:
    values = yaml.safe_load((ROOT / "helm" / "slamhive" / "values.yaml").read_text())
    text = "".join(document.read_text() for document in DOCUMENTS)
    named = re.findall(rf"`((?:{'|'.join(values)})\.[A-Za-z.*]+)[`:]", text)
    assert len(named) > 15
    for path in named:
        node: Any = values
        for part in path.split("."):
            node = node["results" if part == "*" else part]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_targets_of_kubectl_are_made(helm: Any, document: Path) -> None:
    objects = helm.objects("--set", "archive.sqlite.enabled=true")
    made = {(one["kind"].lower(), one["metadata"]["name"]) for one in objects}
    text = document.read_text()
    for kind, name in re.findall(r"\b(deployment|service)s?[/ ](slamhive-[a-z]+)", text):
        assert (kind, name) in made
