# SPDX-License-Identifier: Apache-2.0
"""The table of columns says what ``flatten`` says, and follows the archive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from slamhive.dashboard.loading import Loaded, load

from slamhive.analysis import flatten
from slamhive.archive import Archive
from slamhive.archive.connection import connect
from slamhive.model.results import Outcome, Phase, Result

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.analysis.frame import Frame
    from slamhive.model.results import RunRecord

DERIVED = {"id", "status", "disturbed", "ate.extended"}
UNLISTED = {"folder", "transform", "notes"}


def rows_of(frame: Frame) -> list[dict[str, Any]]:
    rows = frame.records([name for name in frame.names if name not in DERIVED])
    return [{name: value for name, value in row.items() if value is not None} for row in rows]


def flat_rows(archive: Archive) -> list[dict[str, Any]]:
    rows = [row for record in archive.runs() for row in flatten(record)]
    empty = (None, [], {}, "")
    return [
        {name: value for name, value in row.items() if value not in empty and name not in UNLISTED}
        for row in rows
    ]


def test_the_table_holds_what_flatten_gives(assorted: str) -> None:
    with Archive.open(assorted) as archive:
        assert rows_of(load(connect(assorted)).frame) == flat_rows(archive)


def change_result(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.put_result("uid-003", Result(evaluation="se3", outcome=Outcome.LOST, coverage=0.1))


def add_evaluation(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.put_result("uid-026", Result(evaluation="new", outcome=Outcome.TRACKED, values={"own": {"x": 1}}))


def add_runs(archive: Archive, make_run: Callable[..., RunRecord]) -> None:
    archive.put_runs(make_run(number) for number in range(100, 103))


def replace_run(archive: Archive, make_run: Callable[..., RunRecord]) -> None:
    archive.put_run(make_run(5, phase=Phase.FAILED, results=[]))


def remove_run(archive: Archive, _: Callable[..., RunRecord]) -> None:
    archive.remove_run("uid-007")


def rename_sweep(archive: Archive, _: Callable[..., RunRecord]) -> None:
    assert archive.set_aside("study", "elsewhere") > 0


CHANGES = (change_result, add_evaluation, add_runs, replace_run, remove_run, rename_sweep)


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_is_seen_as_if_all_were_read_again(
    change: Callable[..., None], assorted: str, make_run: Callable[..., RunRecord]
) -> None:
    engine = connect(assorted)
    before = load(engine)
    with Archive.open(assorted) as archive:
        change(archive, make_run)
        after = load(engine, before)
        assert after is not before
        assert rows_of(after.frame) == rows_of(load(engine).frame) == flat_rows(archive)


def test_nothing_is_read_again_without_a_change(assorted: str) -> None:
    engine = connect(assorted)
    before = load(engine)
    assert load(engine, before) is before


def test_an_empty_archive_is_an_empty_table(url: str) -> None:
    assert len(load(connect(url), Loaded()).frame) == 0


def test_many_small_batches_make_the_same_table(assorted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = load(connect(assorted))
    monkeypatch.setattr("slamhive.dashboard.loading.BATCH", 4)
    found = load(connect(assorted))
    assert rows_of(found.frame) == rows_of(whole.frame)
    # Among other rows a run looks the same, so that only what has changed is read again.
    assert found.marks == whole.marks
    monkeypatch.setattr("slamhive.dashboard.loading._STREAMED", 3)
    assert load(connect(assorted), found) is found


def test_what_became_of_a_run_is_one_word(assorted: str) -> None:
    frame = load(connect(assorted)).frame
    words = dict(zip(frame.column("uid").tolist(), frame.column("status").tolist(), strict=True))
    assert [words[f"uid-{number:03d}"] for number in (0, 24, 26)] == [
        "Tracked",
        "OutOfMemory",
        "NotEvaluated",
    ]
