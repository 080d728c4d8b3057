# SPDX-License-Identifier: Apache-2.0
"""docs/evaluation.ipynb runs and says what stands in it; ``SLAMHIVE_UPDATE=1`` writes its outputs anew.

Its cells are run here one after another as Jupyter would, without Jupyter: a kernel and its messages are
thirty packages that the notebook doesn't need.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import pprint
import re
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "evaluation.ipynb"
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")

Output = dict[str, Any]


def words(text: str) -> list[str]:
    """Return the printed words but for numbers: how many digits they have decides where lines break."""
    return NUMBER.sub("#", text).split()


def run(source: str, count: int, names: dict[str, Any]) -> list[Output]:
    """The outputs of a cell: what it prints, and the value of its last line."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    value = None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, f"cell {count}", "exec"), names)  # noqa: S102 - it is ours
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"cell {count}", "eval"), names)  # noqa: S307
    outputs: list[Output] = []
    if printed.getvalue():
        text = printed.getvalue().splitlines(keepends=True)
        outputs.append({"name": "stdout", "output_type": "stream", "text": text})
    if value is not None:
        data: dict[str, Any] = {
            "text/plain": pprint.pformat(value, sort_dicts=False).splitlines(keepends=True)
        }
        if hasattr(value, "savefig"):  # a figure of matplotlib's
            image = io.BytesIO()
            value.savefig(image, format="png", metadata={"Software": None})
            data["image/png"] = base64.b64encode(image.getvalue()).decode()
        outputs.append(
            {"data": data, "execution_count": count, "metadata": {}, "output_type": "execute_result"}
        )
    return outputs


def texts(outputs: list[Output]) -> str:
    return "\n".join("".join(one.get("text") or one["data"]["text/plain"]) for one in outputs)


def test_its_outputs_are_those_in_the_file() -> None:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    written = [cell["outputs"] for cell in cells]
    for count, cell in enumerate(cells, start=1):
        cell["outputs"] = run("".join(cell["source"]), count, names)
        cell["execution_count"] = count
    if os.environ.get("SLAMHIVE_UPDATE"):
        NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        return
    for cell, before in zip(cells, written, strict=True):
        found, expected = texts(cell["outputs"]), texts(before)
        assert words(found) == words(expected)
        numbers = [[float(word) for word in NUMBER.findall(text)] for text in (found, expected)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.02, abs=0.002)
        assert [one.get("data", {}).keys() for one in cell["outputs"]] == [
            one.get("data", {}).keys() for one in before
        ]
    assert any("image/png" in one.get("data", {}) for outputs in written for one in outputs)
    assert all(before for before in written[1:])
