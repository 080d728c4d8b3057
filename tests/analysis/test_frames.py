# SPDX-License-Identifier: Apache-2.0
"""Groups over columns are those of ``table`` over rows, number for number."""

from __future__ import annotations

import random
from typing import Any

import pytest

from slamhive.analysis import Outcomes, table
from slamhive.analysis.columns import Column
from slamhive.analysis.frame import Frame, spread, with_derived
from slamhive.analysis.grouping import aggregate
from slamhive.analysis.pivot import status

METRICS = ("ate.rmse", "usage.cpu.meanCores", "usage.wallSeconds")


def make_rows(count: int, seed: int, evaluations: int = 1) -> list[dict[str, Any]]:
    """Return rows of a small study in which some runs failed, were disturbed or lack a figure."""
    chance = random.Random(seed)
    rows = []
    for number in range(count):
        outcome = chance.choice(["Tracked", "Tracked", "Tracked", "Partial", "Lost", None])
        base = {
            "algorithm": chance.choice("ab"),
            "sensors": "mono",
            "dataset": chance.choice("xy"),
            "phase": "Succeeded" if outcome or chance.random() < 0.5 else "Failed",
            "input.pace": "Lockstep",
            "parameters.n": chance.choice([1, 2, None]),
            "usage.cpu.meanCores": chance.random(),
            "usage.wallSeconds": 10.0,
            "usage.contendedSeconds": chance.choice([0.0, 0.0, 5.0]),
        }
        base["reason"] = "OutOfMemory" if base["phase"] == "Failed" else None
        for evaluation in range(evaluations if outcome else 1):
            row = {"id": number, **base}
            if outcome:
                row |= {
                    "outcome": outcome,
                    "evaluation": f"e{evaluation}",
                    "alignment": "se3" if base["algorithm"] == "a" else "sim3",
                    "coverage": chance.random(),
                    "ate.rmse": chance.choice([chance.random(), None]),
                }
            rows.append(row)
    return rows


def frame_of(rows: list[dict[str, Any]]) -> Frame:
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: Column.of([row.get(name) for row in rows]) for name in names}
    return with_derived(columns, len(rows))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("evaluations", [1, 2])
@pytest.mark.parametrize("by", [None, ["algorithm"], ["parameters.n", "dataset"]])
@pytest.mark.parametrize("outcomes", list(Outcomes))
def test_groups_are_those_of_the_table(
    seed: int, evaluations: int, by: list[str] | None, outcomes: Outcomes
) -> None:
    rows = make_rows(80, seed, evaluations)
    expected = table(rows, METRICS, by, (), outcomes)
    found = aggregate(frame_of(rows), METRICS, by, outcomes)
    assert (found.keys, found.notes) == (expected.rows, expected.notes)
    assert [(cell.keys, cell.runs, cell.n, cell.failures, cell.coverage) for cell in found.cells] == [
        (group.keys, group.runs, group.n, group.failures, group.coverage) for group in expected.groups
    ]
    for cell, group in zip(found.cells, expected.groups, strict=True):
        assert {name: figure.summary for name, figure in cell.figures.items()} == group.metrics


def test_status_is_that_of_rows() -> None:
    rows = make_rows(60, 7)
    assert frame_of(rows).column("status").tolist() == [status(row) for row in rows]


def test_a_median_may_be_a_failure() -> None:
    rows = [
        {"algorithm": "a", "dataset": "x", "phase": "Succeeded", "outcome": word, "ate.rmse": error}
        for word, error in (("Tracked", 0.1), ("Lost", 0.01), ("Partial", 0.2))
    ]
    (cell,) = aggregate(frame_of(rows), ["ate.rmse"], ["algorithm"]).cells
    figure = cell.figures["ate.rmse"]
    assert (figure.censored, figure.censored_median, figure.points) == (2, float("inf"), (0.1,))
    assert (cell.n, cell.runs, cell.failures) == (1, 3, {"Lost": 1, "Partial": 1})


@pytest.mark.parametrize("count", [9, 10])
def test_intervals_begin_with_ten(count: int) -> None:
    rows = [
        {"algorithm": "a", "phase": "Succeeded", "outcome": "Tracked", "ate.rmse": float(number)}
        for number in range(count)
    ]
    figure = aggregate(frame_of(rows), ["ate.rmse"], ["algorithm"]).cells[0].figures["ate.rmse"]
    assert (figure.mean_interval is None, figure.median_interval is None) == (count < 10, count < 10)
    assert len(figure.points) == (count if count < 10 else 0)


def test_the_extended_error_grows_as_coverage_falls() -> None:
    rows = [
        {"phase": "Succeeded", "coverage": share, "ate.rmse": 1.0} for share in (0.8, 0.75, 0.6, 0.3, 0.1)
    ]
    assert frame_of(rows).column("ate.extended").tolist() == [1.0, 1.0, 2.0, 5.0, 10.0]


def test_documents_spread_as_flatten_joins_names() -> None:
    found: dict[str, Any] = {}
    documents = [
        {"a": {"b": 1}, "c": [{"d": 1}, {"d": 2}], "e": [1, 2]},
        None,
        {"a": 5, "c": [], "f": "x"},
        {"a": {"b": 2, "g": None}},
    ]
    spread(found, "p", documents)
    assert {name: list(values) for name, values in found.items()} == {
        "p.a": [None, None, 5, None],
        "p.a.b": [1, None, None, 2],
        "p.c[0].d": [1, None, None, None],
        "p.c[1].d": [2, None, None, None],
        "p.e": [[1, 2], None, None, None],
        "p.f": [None, None, "x", None],
    }


def test_names_without_end_fill_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.analysis.frame.MAX_COLUMNS", 10)
    found: dict[str, Any] = {}
    spread(found, "", [{f"name{number}": 1} for number in range(50)])
    assert len(found) == 10
