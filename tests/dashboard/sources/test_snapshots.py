# SPDX-License-Identifier: Apache-2.0
"""The table kept for the next start: what is taken from it is what the database holds."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import numpy as np
import pytest

from slamhive.analysis.frame import DERIVED
from slamhive.archive import Archive, connection
from slamhive.archive.connection import connect
from slamhive.dashboard.sources import archived as sources
from slamhive.dashboard.sources.archived import ArchiveData, Workstation
from slamhive.model.results import Phase
from slamhive.tables import snapshots
from slamhive.tables.loading import load
from slamhive.tables.reading import read_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.analysis.frame import Frame


def rows_of(frame: Frame) -> list[dict[str, Any]]:
    return frame.records(frame.names)


@pytest.fixture
def file(tmp_path: Path, assorted: str) -> Path:
    path = tmp_path / "cache" / "table.npz"
    snapshots.save(path, load(connect(assorted)))
    return path


def test_a_kept_table_is_the_one_that_was_read(file: Path, assorted: str) -> None:
    restored = snapshots.restore(file)
    assert restored is not None
    whole = load(connect(assorted))
    found = load(connect(assorted), restored)
    assert rows_of(found.frame) == rows_of(whole.frame)
    assert found.marks is restored.marks, "what is kept was read again"
    # What follows from other columns is not kept: it is made anew, as versions of sweeps may have changed.
    assert not DERIVED & set(restored.frame.stored)
    assert [path.name for path in file.parent.iterdir()] == ["table.npz"]


def test_what_changed_since_is_read_again(file: Path, assorted: str, make_run: Callable[..., Any]) -> None:
    with Archive.open(assorted) as archive:
        archive.put_run(make_run(3, phase=Phase.FAILED, results=[]))
        archive.remove_run("uid-005")
        archive.put_run(make_run(300))
    engine = connect(assorted)
    found = load(engine, snapshots.restore(file))
    assert rows_of(found.frame) == rows_of(load(engine).frame)


@pytest.mark.parametrize("keep", [0, 10, 500, -300, -1])
def test_a_damaged_file_is_left_alone(file: Path, keep: int) -> None:
    content = file.read_bytes()
    file.write_bytes(content[:keep] if keep else b"")
    assert snapshots.restore(file) is None


def test_strange_files_are_left_alone(file: Path, tmp_path: Path) -> None:
    assert snapshots.restore(tmp_path / "none.npz") is None
    np.savez(file, head=np.frombuffer(b'{"version": 2}', dtype=np.uint8))
    assert snapshots.restore(file) is None
    np.savez(file, head=np.array([object()], dtype=object))
    assert snapshots.restore(file) is None


def test_another_version_s_file_is_left_alone(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshots, "VERSION", snapshots.VERSION + 1)
    assert snapshots.restore(file) is None


@pytest.fixture
def settled(assorted: str) -> str:
    """An archive that nothing was written to for a while: the times of its files tell of each change."""
    for file in Path(assorted.removeprefix("sqlite:///")).parent.glob("*.sqlite*"):
        os.utime(file, (1e9, 1e9))
    return assorted


def test_an_unchanged_archive_is_not_asked_again(
    settled: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make_run: Callable[..., Any]
) -> None:
    first = read_table(settled, tmp_path)
    with monkeypatch.context() as away:
        away.setattr(connection, "connect", None)
        second = read_table(settled, tmp_path)
    assert rows_of(second.frame) == rows_of(first.frame)
    assert second.sweeps == first.sweeps
    assert second.sweeps
    with Archive.open(settled) as archive:
        archive.put_run(make_run(300))
        sweep = archive.sweeps()[0]
        archive.put_sweep(sweep.replace(uid="another-version"))
    third = read_table(settled, tmp_path)
    assert rows_of(third.frame) == rows_of(load(connect(settled)).frame)
    assert len(third.sweeps or ()) == len(first.sweeps or ()) + 1


def test_large_tables_are_kept_and_small_ones_not(
    assorted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "kept"
    data = ArchiveData(assorted, folder)
    data.look()
    data.keep()
    assert not folder.exists()
    monkeypatch.setattr(snapshots, "LEAST_ROWS", 1)
    data.keep()
    (kept,) = folder.iterdir()
    before = kept.stat().st_mtime_ns
    data.close()
    again = ArchiveData(assorted, folder)
    again.look()
    again.keep()
    assert rows_of(again.frame) == rows_of(data.frame)
    assert kept.stat().st_mtime_ns == before
    again.close()


async def test_a_server_keeps_its_table_after_the_first_answers(
    assorted: str, tmp_path: Path, open_app: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(snapshots, "LEAST_ROWS", 1)
    monkeypatch.setattr(sources, "KEEP_SECONDS", (0.01, 0.01))
    async with open_app(Workstation(assorted, tmp_path)) as client:
        total = (await client.get("/runs"))["total"]
        deadline = time.monotonic() + 60
        while not (kept := list((tmp_path / "cache").glob("dashboard-*.npz"))):
            assert time.monotonic() < deadline
            await anyio.sleep(0.05)
    restored = snapshots.restore(kept[0])
    assert restored is not None
    assert len(restored.frame) == total
