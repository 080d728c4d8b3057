# SPDX-License-Identifier: Apache-2.0
"""The pages on architecture: what is made of the code in them, and pages short enough to be read."""

from __future__ import annotations

import ast
import math
import os
import re
import tomllib
from typing import TYPE_CHECKING, Any

import pytest
from documents import PACKAGE, ROOT, name_of, prose

if TYPE_CHECKING:
    from pathlib import Path

OVERVIEW = ROOT / "docs" / "architecture.md"
PAGES = sorted((ROOT / "docs" / "architecture").glob("*.md"))
EVALUATOR = ROOT / "evaluator" / "slamhive_eval"
PART = re.compile(r"(<!-- (\w+): SLAMHIVE_UPDATE=1 [^\n]+ -->\n)(.*?)(<!-- end -->)", re.DOTALL)
MOST_WORDS, MOST_IN_A_PARAGRAPH = 390, 60


def layers() -> list[list[str]]:
    """Return the packages, layer by layer, as the contract of imports has them."""
    linter: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (contract,) = (one for one in linter["contracts"] if one["type"] == "layers")
    found = [re.findall(r"slamhive\.(\w+)", layer) for layer in contract["layers"]]
    return [*found, [name for name in linter["root_packages"] if name != "slamhive"]]


def picture() -> str:
    """Return the layers as a wall: a package is as wide as its row leaves it."""
    rows = layers()
    width = math.lcm(*map(len, rows))
    lines = [" ".join(f"{name}:{width // len(names)}" for name in names) for names in rows]
    return "\n".join(
        [
            "",
            "```mermaid",
            "block-beta",
            f"    columns {width}",
            *(f"    {line}" for line in lines),
            "```",
            "",
            "",
        ]
    )


def tree() -> str:
    """Return the table of packages and their own packages: modules in each, and what its docstring says."""
    rows = ["| package | modules | |", "|---|---|---|"]
    tops = [path.parent for path in PACKAGE.glob("*/__init__.py")]
    for top in [*sorted(tops), EVALUATOR]:
        for folder in [top, *sorted(path.parent for path in top.glob("**/*/__init__.py"))]:
            name = folder.relative_to(top.parent).as_posix()
            count = sum(path.name != "__init__.py" for path in folder.glob("*.py"))
            docstring = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
            said = docstring.split("\n\n")[0].replace("\n", " ").replace("``", "`")
            title = f"[{name}]({page_of(name)})" if folder == top else f"&emsp;{name}"
            rows.append(f"| {title} | {count or ''} | {said} |")
    return "\n".join(["", *rows, "", ""])


def page_of(name: str) -> str:
    """Return the place of a package in the pages: the page, and the heading if it has others before."""
    for page in PAGES:
        headings = re.findall(r"^(#+) (\w+)$", prose(page), re.MULTILINE)
        if ("#", name) in headings:
            return f"architecture/{page.name}"
        if ("##", name) in headings:
            return f"architecture/{page.name}#{name}"
    raise AssertionError(f"no page of docs/architecture has the heading {name}")


def test_what_is_made_of_the_code_is_as_the_code_is() -> None:
    made = {"layers": picture, "tree": tree}
    text = OVERVIEW.read_text()
    assert [name for _, name, *_ in PART.findall(text)] == list(made)
    now = PART.sub(lambda found: found[1] + made[found[2]]() + found[4], text)
    if os.environ.get("SLAMHIVE_UPDATE"):
        OVERVIEW.write_text(now)
    assert OVERVIEW.read_text() == now, (
        "SLAMHIVE_UPDATE=1 .venv/bin/python -m pytest tests/docs/test_architecture.py"
    )


def test_every_page_is_among_the_links() -> None:
    told = OVERVIEW.read_text()
    assert [page.name for page in PAGES if f"](architecture/{page.name}" not in told] == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_is_short_enough_to_be_read(page: Path) -> None:
    assert len(prose(page).split()) <= MOST_WORDS


@pytest.mark.parametrize("page", [OVERVIEW, *PAGES], ids=name_of)
def test_paragraphs_are_short_enough_to_be_read(page: Path) -> None:
    texts = re.split(r"\n\n|\n(?=[-*|] )", prose(page))
    assert [text for text in texts if len(text.split()) > MOST_IN_A_PARAGRAPH] == []
