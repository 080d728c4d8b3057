# SPDX-License-Identifier: Apache-2.0
"""Reading an archive again: what is kept on disk saves work and never shows what is not there any more."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Archive
from slamhive.model.results import Phase, RunRecord
from slamhive.tables import loading, snapshots
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from pathlib import Path


def make_run(number: int) -> RunRecord:
    return RunRecord(uid=f"u{number}", name=f"run-{number}", spec={}, phase=Phase.SUCCEEDED)


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An archive of three runs, for which a table is worth keeping."""
    monkeypatch.setattr(snapshots, "LEAST_ROWS", 1)
    path = tmp_path / "archive.sqlite"
    with Archive.open(f"sqlite:///{path}") as archive:
        archive.put_runs(map(make_run, range(3)))
    return path


def settle(file: Path) -> None:
    """Let a file's last change be a while ago."""
    moment = time.time() - 60
    os.utime(file, (moment, moment))


def names(file: Path) -> list[str]:
    found: list[str] = read_archive(f"sqlite:///{file}", file.parent / "cache").column("name").tolist()
    return found


def test_an_archive_that_did_not_change_is_not_looked_through(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settle(file)
    assert names(file) == ["run-0", "run-1", "run-2"]

    def look(*_: object) -> None:
        raise AssertionError("it was looked through")

    monkeypatch.setattr(loading, "_marks", look)
    assert names(file) == ["run-0", "run-1", "run-2"]


def test_what_was_written_since_is_there(file: Path) -> None:
    settle(file)
    names(file)
    with Archive.open(f"sqlite:///{file}") as archive:
        archive.put_run(make_run(3))
        assert names(file) == ["run-0", "run-1", "run-2", "run-3"]
        archive.remove_run("u1")
    assert names(file) == ["run-0", "run-2", "run-3"]
    settle(file)
    assert names(file) == ["run-0", "run-2", "run-3"]


def test_a_file_written_just_now_may_be_written_again_at_the_same_time(file: Path) -> None:
    os.utime(file)
    assert snapshots.stamp_of(f"sqlite:///{file}") is None
    settle(file)
    assert snapshots.stamp_of(f"sqlite:///{file}") is not None
    assert snapshots.stamp_of("postgresql://user@host/name") is None
