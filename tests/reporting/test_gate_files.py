# SPDX-License-Identifier: Apache-2.0
"""Files of a gate: baselines that are read or refused, and its answers as Markdown and JUnit XML."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import pytest

from slamhive.analysis.gating.cells import GateCell, GateRuns
from slamhive.analysis.gating.deciding import Gate, GateAnswer
from slamhive.analysis.gating.figures import GateFigure
from slamhive.model.errors import InputError
from slamhive.reporting.gate.baseline import Baseline, BaselineCell, read_baseline
from slamhive.reporting.gate.summaries import GateReport, junit, markdown

if TYPE_CHECKING:
    from pathlib import Path

CELL = {
    "sweep": "s",
    "settings": {"dataset": "d", "parameters.voxelSize": 0.5},
    "dataset": "d",
    "tracked": [True, False],
    "values": {"ate.rmse": [0.05, None], "coverage": [1.0, 0.25]},
}
FOREIGN = {
    "schema": "slam-regression-baseline/v2",
    "created_utc": "2026-08-01T00:00:00Z",
    "runs": {"ate_rmse": [0.05, 0.06], "rpe_translation_rmse": [0.01, 0.01]},
    "settings": {"alignment": {"enabled": True, "correct_scale": False}, "rpe_delta": 1},
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = Baseline(processor="P", cells=[BaselineCell.model_validate(CELL)])
    made.write(tmp_path / "base.json")
    return tmp_path / "base.json"


def changed(path: Path, old: str, new: str) -> str:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError) as found:
        read_baseline(path)
    return str(found.value)


def test_a_baseline_is_read_as_it_was_recorded(path: Path) -> None:
    found = read_baseline(path)
    assert found.processor == "P"
    assert found.cells[0].settings == CELL["settings"]
    assert found.cells[0].runs.failed == 1
    assert path.read_text() == (found.write(path) or path.read_text())


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("0.05", "0.06", r"cells[0] (dataset d, parameters.voxelSize 0.5): not as it was recorded"),
        ("[true, false]", "[true, true]", "cells[0]"),
        ('"P"', '"Q"', "sha256 doesn't fit the content"),
        ("0.25]", "NaN]", "NaN is no number"),
        ("0.25]", "0.25, 1]", "values.coverage: 3 numbers, but tracked has 2"),
        ("0.25]", "0.25", "base.json:"),
        ('"tracked"', '"tracking"', "cells[0].tracked: Field required"),
        ("slamhive-baseline/v1", "slamhive-baseline/v9", "found 'slamhive-baseline/v9'"),
    ],
)
def test_a_baseline_that_was_changed_says_where(path: Path, old: str, new: str, told: str) -> None:
    assert told in changed(path, old, new)


def test_what_is_no_baseline_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    for text in ("[]", "3", "{}", "[" * 100_000, '{"baseline": "slamhive-baseline/v1", "cells": []}'):
        path.write_text(text)
        with pytest.raises(InputError, match=r"b\.json"):
            read_baseline(path)
    path.write_bytes(b"\xff")
    with pytest.raises(InputError, match="UTF-8"):
        read_baseline(path)
    with pytest.raises(InputError, match="No such file"):
        read_baseline(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("change", "errors"),
    [({}, [0.05, 0.06]), ({"schema": "slam-regression-baseline/v1", "metrics": {"ate_rmse": 0.05}}, [0.05])],
)
def test_baselines_of_slam_regression_ci_are_read(tmp_path: Path, change: Any, errors: list[float]) -> None:
    path = tmp_path / "theirs.json"
    path.write_text(json.dumps(FOREIGN | change))
    (cell,) = read_baseline(path).cells
    assert (cell.dataset, cell.alignment, cell.values) == (None, "se3", {"ate.rmse": errors})
    path.write_text(json.dumps(FOREIGN | change | {"runs": {}, "metrics": {}}))
    with pytest.raises(InputError, match="ate_rmse: expected errors in m"):
        read_baseline(path)


def report(name: str = "<b>| x") -> GateReport:
    still, worse = (GateRuns([True] * 3, {"ate.rmse": [number] * 3}) for number in (1.0, 2.0))
    cells = [GateCell(name, still, worse)]
    gate = Gate([GateFigure("ate.rmse", 0.1), GateFigure("coverage", 0.1)])
    return GateReport("s", "b.json", GateAnswer.WORSE, gate.look(cells), cells, 3.0, "sure", ["a `note`"])


def test_markdown_says_it_and_takes_no_markup_of_names() -> None:
    text = markdown(report())
    assert text.startswith("### 🔴 s: worse: ATE RMSE (3 runs against b.json; sure)\n")
    assert "| ATE RMSE | worse | +100.0 % |" in text
    assert "&lt;b>\\| x" in text
    assert "<b>" not in text


def test_junit_has_a_case_a_figure() -> None:
    suite = ET.fromstring(junit(report("a\x1b")))  # noqa: S314 - ours
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("2", "1", "1")
    first, second = suite
    assert "stands out" in (first[0].get("message") or "")
    assert (second.get("name"), second[0].tag) == ("coverage", "skipped")
