# SPDX-License-Identifier: Apache-2.0
"""Tests of the words that people read: docstrings and the glossary."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("operator", "evaluator", "images", "helm", "tests")
RIDDLES = re.compile(r"(What|Whether|Where|Who|Whom|Whose|Which|How|When|Why|That|If|As)\b")


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_modules_docstring_begins_with_a_noun(folder: str) -> None:
    wrong = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        if text and RIDDLES.match(text):
            wrong.append(f"{path.relative_to(ROOT)}: {text.splitlines()[0]}")
    assert not wrong, "say what the module is, then what it does, as in 'Queue of objects to handle: …'"


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_docstring_begins_with_a_riddle(folder: str) -> None:
    wrong = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            text = ast.get_docstring(node)
            if text and RIDDLES.match(text):
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}: {text.splitlines()[0]}")
    assert not wrong, "name what it is, as in 'Figures of a run: …', or what it does, as in 'Return …'"


@pytest.mark.parametrize("word", ["variant", "point", "slot", "attempt", "twin", "board", "common support"])
def test_a_word_of_the_house_is_in_the_glossary(word: str) -> None:
    rows = re.findall(
        r"^\| (.+?) \|", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert word in [name for row in rows for name in row.split(", ")]
