# SPDX-License-Identifier: Apache-2.0
"""docs/results.ipynb runs and says what stands in it; ``SLAMHIVE_UPDATE=1`` writes its outputs anew."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from types import ModuleType

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "results.ipynb"


@pytest.fixture
def cells(records: Any) -> ModuleType:
    """Module that runs cells without Jupyter: the tests of the other notebook."""
    return records.of_file("evaluator_notebook", ROOT / "tests" / "evaluator" / "test_notebook.py")


def test_its_outputs_are_those_in_the_file(
    published: Path, cells: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    mpl.use("agg")
    monkeypatch.setenv("SLAMHIVE_HOME", str(published))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    written = [cell["outputs"] for cell in code]
    for count, cell in enumerate(code, start=1):
        cell["outputs"] = cells.run("".join(cell["source"]), count, names)
        cell["execution_count"] = count
    plt.close("all")
    if os.environ.get("SLAMHIVE_UPDATE"):
        NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        return
    for cell, before in zip(code, written, strict=True):
        found, expected = cells.texts(cell["outputs"]), cells.texts(before)
        assert cells.words(found) == cells.words(expected)
        numbers = [[float(word) for word in cells.NUMBER.findall(text)] for text in (found, expected)]
        assert numbers[0] == pytest.approx(numbers[1], rel=1e-3, abs=1e-4)
    assert "image/png" in written[0][0]["data"]
    assert all(written)


def test_the_figure_takes_five_lines() -> None:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    first = next(cell for cell in notebook["cells"] if cell["cell_type"] == "code")
    lines = [line for line in first["source"] if line.strip()]
    assert len(lines) == 5
