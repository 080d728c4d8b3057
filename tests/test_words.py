# SPDX-License-Identifier: Apache-2.0
"""Tests of the words that people read: docstrings and the glossary."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
FOLDERS = ("operator", "evaluator", "images", "helm", "tests")
QUESTIONS = "what|whether|where|who|whom|whose|which|how|when|why|that|if"
RIDDLES = re.compile(rf"((Return|Yield|Give)s?,? )?({QUESTIONS})\b|As\b", re.IGNORECASE)


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_docstring_begins_with_a_noun_or_a_verb(folder: str) -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, text in docstrings(ast.parse(path.read_text(encoding="utf-8")))
        if RIDDLES.match(text)
    ]
    assert not wrong, (
        "say what it is, as in 'Queue of objects to handle: …', or what it does, with its noun: "
        "'Return the token of the next page.'"
    )


def docstrings(module: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the docstrings of a module, its constants, classes and functions, each with its line."""
    for node in ast.walk(module):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and (
            text := ast.get_docstring(node)
        ):
            yield node.lineno, text
    for node in module.body:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield node.lineno, str(node.value.value)


@pytest.mark.parametrize("word", ["variant", "point", "slot", "attempt", "twin", "board", "common support"])
def test_a_word_of_the_house_is_in_the_glossary(word: str) -> None:
    rows = re.findall(
        r"^\| (.+?) \|", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert word in [name for row in rows for name in row.split(", ")]
