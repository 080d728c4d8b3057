# SPDX-License-Identifier: Apache-2.0
"""Effects of an edit on errors, failures and load: on runs whose truth is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import with_derived
from slamhive.analysis.edits import NOT_TRACKED, Edit, EditLine, edits

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame

VERSIONS = ("first", "second", "third")


def make_row(version: str, setting: int, repetition: int, error: float | None, **more: Any) -> dict[str, Any]:
    """Return a run; one without an error failed."""
    number = VERSIONS.index(version) * 10_000 + setting * 100 + repetition
    return {
        "id": number,
        "algorithm": "orb",
        "sensors": "mono",
        "dataset": "hall",
        "provenance.algorithmHash": version,
        "created": 1e9 + number,
        "phase": "Succeeded" if error is not None else "Failed",
        "reason": None if error is not None else "AlgorithmFailed",
        "outcome": "Tracked" if error is not None else None,
        "evaluation": "sim3",
        "ate.rmse": error,
        "usage.cpu.seconds": 60.0 + repetition,
        "usage.wallSeconds": 60.0,
        "parameters.nFeatures": 500 * (setting + 1),
    } | more


def frame_of(rows: list[dict[str, Any]]) -> Frame:
    names = dict.fromkeys(name for row in rows for name in row)
    return with_derived({name: Column.of([row.get(name) for row in rows]) for name in names}, len(rows))


def study(version: str, factor: float, settings: int = 3, repetitions: int = 4, **more: Any) -> list[Any]:
    return [
        make_row(version, setting, k, factor * 10.0**setting * (1 + 0.01 * k), **more)
        for setting in range(settings)
        for k in range(repetitions)
    ]


def only(rows: list[dict[str, Any]], metrics: tuple[str, ...] = ("ate.rmse",)) -> Edit:
    (found,) = edits(frame_of(rows), metrics, {"orb", "hall"})[0]
    return found


def line(edit: Edit, metric: str, dataset: str = "hall") -> EditLine:
    (found,) = [one for one in edit.lines if (one.metric, one.keys["dataset"]) == (metric, dataset)]
    return found


def test_a_figure_is_the_geometric_mean_over_settings_and_its_ratio_is_after_over_before() -> None:
    edit = only([*study("first", 1.0), *study("second", 1.5)])
    found = line(edit, "ate.rmse")
    assert found.before == pytest.approx(10.0 * 1.015)
    assert found.after / found.before == pytest.approx(found.ratio) == pytest.approx(1.5)
    assert (found.wins, found.keys["dataset"]) == ((0, 3, 0), "hall")
    assert found.verdict.startswith("more than chance (p = ")


def test_each_dataset_has_lines_of_its_own() -> None:
    rows = [*study("first", 1.0), *study("second", 1.5)]
    rows += [row | {"dataset": "yard", "id": row["id"] + 5000} for row in study("first", 1.0)]
    rows += [row | {"dataset": "yard", "id": row["id"] + 5000} for row in study("second", 0.5)]
    edit = only(rows)
    assert line(edit, "ate.rmse").ratio == pytest.approx(1.5)
    assert line(edit, "ate.rmse", "yard").ratio == pytest.approx(0.5)
    assert edit.settings == 6


def test_failures_are_counted_on_both_sides_and_tested_within_settings() -> None:
    good = study("first", 1.0, settings=2)
    bad = [make_row("second", setting, k, None) for setting in range(2) for k in range(4)]
    found = line(only([*good, *bad]), NOT_TRACKED)
    assert (found.before, found.after, found.of) == (0, 8, (8, 8))
    assert found.wins == (0, 2, 0)
    # All runs of a setting that fail are one result, as with its error: one of five, in both settings.
    assert found.p == pytest.approx(1 / 5**2)


def test_the_version_with_most_settings_in_common_is_the_one_before() -> None:
    rows = [*study("first", 1.0), *study("second", 9.0, settings=1, repetitions=1), *study("third", 2.0)]
    found = only(rows)
    assert found.unpaired == 0
    assert line(found, "ate.rmse").ratio == pytest.approx(2.0)
    assert "correction" not in line(found, "ate.rmse").verdict


def test_of_equally_complete_versions_the_latest_is_the_one_before() -> None:
    found = only([*study("first", 1.0), *study("second", 4.0), *study("third", 2.0)])
    assert line(found, "ate.rmse").ratio == pytest.approx(0.5)


def test_what_was_not_edited_now_is_not_told_of() -> None:
    frame = frame_of([*study("first", 1.0), *study("second", 1.5)])
    assert edits(frame, ("ate.rmse",), {"other"})[0] == []


def test_runs_that_shared_their_cores_are_counted_on_both_sides() -> None:
    rows = [*study("first", 1.0), *study("second", 1.0, **{"usage.contendedSeconds": 30.0})]
    assert only(rows).disturbed == (0, 12)
