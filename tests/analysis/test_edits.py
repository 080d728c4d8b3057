# SPDX-License-Identifier: Apache-2.0
"""Effects of an edit on errors, failures and load: on runs whose truth is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import with_derived
from slamhive.analysis.edits import NOT_TRACKED, Edit, EditLine, edits
from slamhive.analysis.selection import Selection, choose

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


def only(
    rows: list[dict[str, Any]],
    metrics: tuple[str, ...] = ("ate.rmse",),
    before: str = "first",
    changed: str = "algorithm",
) -> Edit:
    frame = frame_of(rows)
    column = {"algorithm": "provenance.algorithmHash", "dataset": "provenance.datasetSha256"}[changed]
    versions = dict(
        zip(frame.column(column).tolist(), frame.column(f"{changed}.version").tolist(), strict=True)
    )
    name = {"algorithm": "orb", "dataset": "hall"}[changed]
    (found,) = edits(frame, metrics, {(changed, name): versions[before]})[0]
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


def test_eleven_edits_are_told_of_by_the_last_one_alone() -> None:
    rows = [
        make_row("first", setting, k, factor * (setting + 1), id=1000 * edit + 10 * setting + k, created=edit)
        | {"provenance.algorithmHash": f"edit {edit}"}
        for edit, factor in enumerate((5.0, 9.0, 7.0, 3.0, 8.0, 6.0, 2.0, 4.0, 1.5, 7.5, 2.0, 3.0))
        for setting in range(3)
        for k in range(2)
    ]
    found = only(rows, before="edit 10")
    assert line(found, "ate.rmse").ratio == pytest.approx(1.5)
    assert line(found, NOT_TRACKED).of == found.runs == (6, 6)
    assert "correction" not in line(found, "ate.rmse").verdict


def test_an_edit_of_a_dataset_is_told_by_runs_of_algorithms_as_they_are_now() -> None:
    # The old adapter failed on both; the new one ran before and after the dataset was edited.
    old, new, yard = ({"provenance.datasetSha256": one} for one in ("x", "y", "z"))
    rows = [make_row("first", 0, k, None, **old) for k in range(3)]
    rows += [make_row("first", 0, k, None, **new) | {"id": 50 + k} for k in range(3)]
    rows += [make_row("second", 0, k, 1.0, **old) for k in range(3)]
    rows += [make_row("second", 0, k, 2.0, **new) | {"id": 10_050 + k, "created": 2e9} for k in range(3)]
    rows += [make_row("second", 0, k, 9.0, **yard) | {"id": 99 + k, "dataset": "yard"} for k in range(3)]
    found = only(rows, before="x", changed="dataset")
    assert line(found, "ate.rmse").ratio == pytest.approx(2.0)
    assert (line(found, NOT_TRACKED).of, line(found, NOT_TRACKED).before) == ((3, 3), 0)
    assert (found.unpaired, found.runs) == (0, (3, 3))


def test_an_edit_that_was_taken_back_is_after_what_it_undid() -> None:
    # What takes over an equal result says which version is current, and then counts once with the first one.
    again = make_row("first", 0, 0, 1.0) | {"id": 99_999, "created": 2e9, "provenance.reusedFrom": "first"}
    rows = [
        row | {"provenance.contentHash": str(row["id"] % 99_999)}
        for row in [*study("first", 1.0), *study("second", 4.0), again]
    ]
    frame = choose(frame_of(rows), Selection(superseded=True)).frame
    before = str(frame.column("algorithm.version").tolist()[-1])
    assert len(frame) == len(rows) - 1
    (found,) = edits(frame, ("ate.rmse",), {("algorithm", "orb"): before})[0]
    assert line(found, "ate.rmse").ratio == pytest.approx(0.25)


def test_what_failed_before_and_after_is_not_the_same_and_not_compared() -> None:
    rows = [
        make_row(version, setting, k, None) for version in VERSIONS[:2] for setting in (0, 1) for k in (0, 1)
    ]
    found = only(rows, ())
    assert [(one.metric, one.wins, one.failed, one.verdict) for one in found.lines] == [
        ("ate.rmse", (0, 0, 0), 2, ""),
        (NOT_TRACKED, (0, 0, 0), 2, ""),
    ]
    # Beside one that never works, another's doubled error is told as that.
    rows += [
        make_row(version, 2, k, error) for version, error in (("first", 1.0), ("second", 2.0)) for k in (0, 1)
    ]
    found = line(only(rows), "ate.rmse")
    assert (found.before, found.after, found.ratio) == pytest.approx((1.0, 2.0, 2.0))
    assert (found.wins, found.failed) == ((0, 1, 0), 2)


CPU = "usage.cpu.seconds"


def failing(version: str, **more: Any) -> list[dict[str, Any]]:
    return [
        make_row(version, setting, k, None, **{CPU: 0.1}, **more) for setting in range(3) for k in range(4)
    ]


@pytest.mark.parametrize(
    ("rows", "failed"),
    [
        ([*failing("first"), *study("second", 1.0)], (12, 0)),
        ([*study("first", 1.0), *failing("second")], (0, 12)),
    ],
)
def test_a_version_that_never_succeeded_has_no_load_that_is_better_or_worse(
    rows: list[dict[str, Any]], failed: tuple[int, int]
) -> None:
    found = only(rows, ("ate.rmse", CPU))
    assert [one.metric for one in found.lines] == ["ate.rmse", NOT_TRACKED]
    assert (line(found, NOT_TRACKED).before, line(found, NOT_TRACKED).after) == failed


def test_load_is_compared_of_the_runs_that_succeeded() -> None:
    rows = [*study("first", 1.0), *study("second", 1.0, **{CPU: 30.0}), *failing("second")[:3]]
    found = line(only([row | {"id": number} for number, row in enumerate(rows)], (CPU,)), CPU)
    assert (found.wins, found.after) == ((3, 0, 0), pytest.approx(30.0))


def test_what_was_not_edited_now_is_not_told_of() -> None:
    frame = frame_of([*study("first", 1.0), *study("second", 1.5)])
    assert edits(frame, ("ate.rmse",), {("algorithm", "other"): "0"})[0] == []


def test_of_the_runs_before_and_after_those_that_shared_their_cores_are_counted_each_once() -> None:
    rows = [*study("first", 1.0), *study("second", 1.0, **{"usage.contendedSeconds": 30.0})]
    # Measured in two ways, and on two datasets: still no more runs than there were.
    rows += [row | {"evaluation": "se3", "ate.rmse": 2 * row["ate.rmse"]} for row in rows]
    rows += [row | {"dataset": "yard", "id": row["id"] + 5000} for row in rows]
    found = only(rows)
    assert (found.disturbed, found.runs) == ((0, 24), (24, 24))
