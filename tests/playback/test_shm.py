# SPDX-License-Identifier: Apache-2.0
"""Files of Fast DDS in /dev/shm that are removed and left: named and locked as it does it."""

from __future__ import annotations

import ctypes
import fcntl
import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from slamhive.playback.player.ros2 import shm
from slamhive.playback.player.ros2.shm import remove_dead_segments

if TYPE_CHECKING:
    from collections.abc import Iterator

SEGMENT = ("fastdds_0123456789abcdef", "fastdds_0123456789abcdef_el")
PORT = ("fastdds_port7411", "fastdds_port7411_el", "sem.fastdds_port7411_mutex")
OLDER = (
    "fastrtps_0123456789abcdef",
    "fastrtps_0123456789abcdef_el",
    "fastrtps_port7411",
    "fastrtps_port7411_el",
)


def put(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).write_bytes(b"x")


def left(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@contextmanager
def locked(path: Path, how: int = fcntl.LOCK_EX) -> Iterator[None]:
    with path.open() as file:
        fcntl.flock(file, how)
        yield


@pytest.mark.parametrize("names", [SEGMENT, PORT, OLDER, PORT[2:], PORT[:1], SEGMENT + PORT])
def test_what_nobody_locks_is_removed(tmp_path: Path, names: tuple[str, ...]) -> None:
    put(tmp_path, *names)
    assert remove_dead_segments(str(tmp_path)) == len(names)
    assert left(tmp_path) == []


@pytest.mark.parametrize("names", [SEGMENT, PORT])
def test_what_a_living_process_locks_stays(tmp_path: Path, names: tuple[str, ...]) -> None:
    put(tmp_path, *names)
    with locked(tmp_path / names[1]):
        assert remove_dead_segments(str(tmp_path)) == 0
    assert left(tmp_path) == sorted(names)
    assert remove_dead_segments(str(tmp_path)) == len(names)


def test_a_port_that_several_read_stays(tmp_path: Path) -> None:
    put(tmp_path, "fastdds_port7400", "fastdds_port7400_sl")
    with locked(tmp_path / "fastdds_port7400_sl", fcntl.LOCK_SH):
        assert remove_dead_segments(str(tmp_path)) == 0


def test_a_segment_without_a_lock_stays_until_it_is_old(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, SEGMENT[0])
    assert remove_dead_segments(str(tmp_path)) == 0
    monkeypatch.setattr(shm, "_OLD_SECONDS", -1.0)
    assert remove_dead_segments(str(tmp_path)) == 1


@pytest.mark.parametrize(
    "name",
    [
        *("fastdds_results.csv", "fastdds_0123456789abcdef_el.txt", "my_fastdds_port7411", "fastdds_port"),
        *("libpod_lock", "lttng-ust-wait-6", "sem.other", "fastdds_0123"),
    ],
)
def test_files_of_others_stay(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shm, "_OLD_SECONDS", -1.0)
    put(tmp_path, name)
    assert remove_dead_segments(str(tmp_path)) == 0
    assert left(tmp_path) == [name]


def test_segments_of_another_user_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path, *SEGMENT, *PORT)
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert remove_dead_segments(str(tmp_path)) == 0


def test_links_and_folders_of_such_names_stay(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("kept")
    (tmp_path / SEGMENT[0]).symlink_to(tmp_path / "mine")
    (tmp_path / SEGMENT[1]).symlink_to(tmp_path / "mine")
    (tmp_path / PORT[0]).mkdir()
    assert remove_dead_segments(str(tmp_path)) == 0
    assert len(left(tmp_path)) == 4


def test_a_machine_without_shared_memory_has_nothing_to_remove(tmp_path: Path) -> None:
    assert remove_dead_segments(str(tmp_path / "none")) == 0


@pytest.mark.skipif(not os.access(shm.FOLDER, os.W_OK), reason="needs shared memory")
def test_a_port_that_is_being_opened_stays_until_it_is() -> None:
    name = f"fastdds_port{10**6 + os.getpid()}"
    libc = ctypes.CDLL(None)
    libc.sem_open.restype = ctypes.c_void_p
    semaphore = ctypes.c_void_p(libc.sem_open(f"/{name}_mutex".encode(), os.O_CREAT, 0o644, 0))
    port = Path(shm.FOLDER) / name
    port.write_bytes(b"x")
    try:
        remove_dead_segments()
        assert port.exists()
        libc.sem_post(semaphore)
        remove_dead_segments()
        assert not port.exists()
        assert not port.with_name(f"sem.{name}_mutex").exists()
    finally:
        port.unlink(missing_ok=True)
        port.with_name(f"sem.{name}_mutex").unlink(missing_ok=True)
