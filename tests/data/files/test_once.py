# SPDX-License-Identifier: Apache-2.0
import errno
import multiprocessing
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from slamhive.data.files.once import GRACE_SECONDS, evict, in_use, make_once
from slamhive.model.errors import InputError, SystemFault

FORK = multiprocessing.get_context("fork")


def fill(aside: Path) -> None:
    (aside / "one").write_bytes(b"1" * 1000)
    (aside / "sub").mkdir()
    (aside / "sub" / "two").write_bytes(b"2" * 1000)


def _want(folder: Path, log: Path, start: Any) -> None:
    def make(aside: Path) -> None:
        with log.open("a") as file:
            file.write("made\n")
        fill(aside)

    start.wait(50)
    make_once(folder, make)
    assert (folder / "sub" / "two").read_bytes() == b"2" * 1000


def test_ten_processes_make_it_once(tmp_path: Path) -> None:
    start = FORK.Barrier(10)
    arguments = (tmp_path / "it", tmp_path / "log", start)
    processes = [FORK.Process(target=_want, args=arguments) for _ in range(10)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
    assert [process.exitcode for process in processes] == [0] * 10
    assert (tmp_path / "log").read_text() == "made\n"
    assert not list(tmp_path.glob(".*.making"))


def _die_halfway(folder: Path, reached: Any) -> None:
    def make(aside: Path) -> None:
        fill(aside)
        reached.set()
        time.sleep(60)

    make_once(folder, make)


def test_killed_halfway_leaves_nothing_usable(tmp_path: Path) -> None:
    folder, reached = tmp_path / "it", FORK.Event()
    process = FORK.Process(target=_die_halfway, args=(folder, reached))
    process.start()
    assert reached.wait(50)
    os.kill(process.pid or 0, signal.SIGKILL)
    process.join(50)
    assert not folder.exists()
    assert list(tmp_path.glob(".it.making"))
    assert make_once(folder, fill)
    assert (folder / "one").stat().st_size == 1000
    assert not list(tmp_path.glob(".it.making"))


def test_leftovers_of_the_dead_are_swept_but_not_of_the_living(tmp_path: Path) -> None:
    (tmp_path / ".dead.making").mkdir()
    seen = []

    def make(aside: Path) -> None:
        evict(tmp_path, 0)
        seen.append(aside.is_dir())

    make_once(tmp_path / "alive", make)
    assert seen == [True]
    assert not (tmp_path / ".dead.making").exists()


def test_failing_leaves_nothing(tmp_path: Path) -> None:
    def fail(aside: Path) -> None:
        fill(aside)
        raise InputError("no")

    with pytest.raises(InputError):
        make_once(tmp_path / "it", fail)
    assert not [path for path in tmp_path.iterdir() if not path.name.endswith(".lock")]


def test_an_unsound_one_is_made_again_and_files_are_read_only(tmp_path: Path) -> None:
    folder = tmp_path / "it"
    assert make_once(folder, fill)
    assert not make_once(folder, fill, lambda _: True)
    assert make_once(folder, fill, lambda _: False)
    assert (folder / "sub" / "two").stat().st_mode & 0o222 == 0


def test_who_finds_it_does_not_wait_for_its_users(tmp_path: Path) -> None:
    make_once(tmp_path / "it", fill)
    with in_use(tmp_path / "it"), in_use(tmp_path / "it"):
        assert not make_once(tmp_path / "it", fill, lambda _: True)


def test_eviction_takes_the_longest_unused_and_spares_those_in_use(tmp_path: Path) -> None:
    for age, name in enumerate(("new", "used", "old", "oldest")):
        make_once(tmp_path / name, fill)
        then = time.time() - GRACE_SECONDS * (age + 2)
        os.utime(tmp_path / f".{name}.lock", (then, then))
    now = time.time()
    with in_use(tmp_path / "used"):
        # Entering counts as a use; make it old again, so that the lock alone protects it.
        os.utime(tmp_path / ".used.lock", (1, 1))
        assert evict(tmp_path, 6000, now) == ["oldest"]
        assert evict(tmp_path, 2000, now) == ["old", "new"]
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["used"]
    os.utime(tmp_path / ".used.lock", (now, now))
    assert evict(tmp_path, 0, now + GRACE_SECONDS - 1) == []
    assert evict(tmp_path, 0, now + GRACE_SECONDS + 1) == ["used"]
    with pytest.raises(SystemFault, match="was evicted"), in_use(tmp_path / "used"):
        pass


def test_a_time_that_cannot_be_noted_spoils_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "variant"
    assert make_once(folder, fill)

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "utime", refused)
    with in_use(folder):
        assert (folder / "one").exists()
