# SPDX-License-Identifier: Apache-2.0
"""The check of the tree finds each kind of mistake, and names its place."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def check() -> Any:
    spec = importlib.util.spec_from_file_location("check_of_the_tree", Path(__file__).parent / "check.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "first",
    [
        "What is left.",
        "Return what is left.",
        "Returns how many.",
        "Yield, if any.",
        "As above.",
        "return when.",
    ],
)
def test_a_docstring_that_begins_with_a_question_is_found(check: Any, first: str) -> None:
    text = f'"""Rest."""\n\n\ndef rest():\n    """{first}"""\n'
    (found,) = check.riddles("a.py", text)
    assert found.startswith(f'a.py:5: """{first}"""')


@pytest.mark.parametrize(
    "first", ["Rest of it.", "Return the rest.", "Return as many.", "Tell whether it is left.", "Whatever."]
)
def test_a_noun_or_a_verb_is_none(check: Any, first: str) -> None:
    assert list(check.riddles("a.py", f'class A:\n    """{first}"""\n    text = """\nWhat?"""\n')) == []


def test_names_of_several_classes_are_listed_where_there_are_too_many(check: Any) -> None:
    classes = [("Kind", "a.py:1"), ("_Kind", "b.py:2"), ("Key", "a.py:9")]
    assert list(check.shared_names(classes, most=1)) == []
    first, second = check.shared_names(classes, most=0)
    assert first.startswith("1 class names stand for several things, at most 0 may")
    assert second == "  Kind: a.py:1, b.py:2"


def test_a_full_folder_is_found(check: Any) -> None:
    names = [*(f"operator/slamhive/cli/{k}.py" for k in range(31)), "operator/slamhive/cli/parts/a.py"]
    (found,) = check.full_folders(names)
    assert found.startswith("operator/slamhive/cli/: 31 files")
    assert list(check.full_folders([*names[1:], *(f"tests/cli/{k}.py" for k in range(40))])) == []


@pytest.mark.parametrize(
    ("kind", "name", "content", "told"),
    [
        ("licences", "a.py", b'"""No licence."""\n', "a.py: its first line"),
        ("licences", "run.sh", b"#!/bin/sh\n# nothing\n", "run.sh: its first line"),
        ("places", "a.md", b"\nsee /home/" + b"ada/slam\n", "a.md:2: a place of one machine"),
    ],
)
def test_a_file_is_told_of(check: Any, kind: str, name: str, content: bytes, told: str) -> None:
    (found,) = getattr(check, kind)(name, content)
    assert found.startswith(told)


def test_sound_files_are_not(check: Any) -> None:
    sound = b"#!/bin/sh\n# SPDX-License-Identifier: Apache-2.0\n"
    assert list(check.licences("run.sh", sound)) == []
    assert list(check.licences("crds/a.yaml", b"kind: A\n")) == []
    assert list(check.places("a.md", b"/usr/bin/env, /tmp, ~/slam\n")) == []


def test_packages_where_none_may_be_are_found(check: Any) -> None:
    names = ["operator/__init__.py", "tests/cli/__init__.py", "operator/slamhive/__init__.py"]
    assert [one.split(":")[0] for one in check.packages(names)] == names[:2]


def test_what_nothing_uses_is_found(check: Any) -> None:
    uses = "def used(): ...\n\n\nclass _Gone:\n    @property\n    def gone(self): ...\n"
    uses += "    def told(self): ...\n\n@app.command\ndef command(): ...\n\ndef left(): ...\n"
    texts = {
        "operator/slamhive/a.py": f"\n{uses}",
        "operator/slamhive/b.js": "a.used, told",
        "images/pin": "def lone(): left",
    }
    found = list(check.dead_code(texts))
    assert [one.rpartition(":")[0] for one in found] == [
        "operator/slamhive/a.py:5: _Gone",
        "operator/slamhive/a.py:7: gone",
        "operator/slamhive/a.py:13: left",
    ]


def test_a_word_that_the_glossary_lacks_is_found(check: Any) -> None:
    rows = "".join(f"| {word} | … |\n" for word in check.GLOSSARY if word != "slot")
    assert list(check.missing_words(rows)) == ["docs/glossary.md: no row for 'slot'"]
