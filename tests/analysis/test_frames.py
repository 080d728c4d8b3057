# SPDX-License-Identifier: Apache-2.0
"""Figures with failures among them, intervals, and documents as columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import with_derived
from slamhive.analysis.flattening import spread
from slamhive.analysis.grouping import aggregate
from slamhive.model.errors import UnknownNameError

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame


def frame_of(rows: list[dict[str, Any]]) -> Frame:
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: Column.of([row.get(name) for row in rows]) for name in names}
    return with_derived(columns, len(rows))


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


def test_of_columns_that_every_table_has_the_last_part_is_enough_without_a_value_too() -> None:
    frame = frame_of([{"algorithm": "a"}])
    assert frame.resolve("governor") == "provenance.machine.governor"
    assert frame.resolve("node") == "provenance.node"
    with pytest.raises(UnknownNameError, match="unknown column 'governour'"):
        frame.resolve("governour")


def test_the_extended_error_grows_as_coverage_falls() -> None:
    rows = [
        {"phase": "Succeeded", "coverage": share, "ate.rmse": 1.0} for share in (0.8, 0.75, 0.6, 0.3, 0.1)
    ]
    assert frame_of(rows).column("ate.extended").tolist() == [1.0, 1.0, 2.0, 5.0, 10.0]


def test_nested_names_are_joined_by_dots() -> None:
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
    monkeypatch.setattr("slamhive.analysis.flattening.MAX_COLUMNS", 10)
    found: dict[str, Any] = {}
    spread(found, "", [{f"name{number}": 1} for number in range(50)])
    assert len(found) == 10
