# SPDX-License-Identifier: Apache-2.0
"""Leases: held by one at a time, free when their holder is killed, and cores are taken in turns."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from slamhive.local.home.folder import Home
from slamhive.local.home.leases import LeaseKind, Leases
from slamhive.local.programs.cores import CorePool
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

RUN = (LeaseKind.RUNS, "u-1")
CORES = [(0,), (1,), (2,)]

HOLDER = """
import sys
from pathlib import Path
from slamhive.local.home.folder import Home
from slamhive.local.home.leases import LeaseKind
home = Home.at(Path(sys.argv[1]))
with home.sharing("slamhive run"):
    leases = home.leases.take((LeaseKind.RUNS, "u-1"), (LeaseKind.FOLDERS, "s,a"))
    print("holding", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def leases(tmp_path: Path) -> Leases:
    return Leases(tmp_path / "leases")


@contextmanager
def holder(home: Path) -> Iterator[subprocess.Popen[str]]:
    """Have another process at work in a home, which holds a run."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, home], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "holding\n"
        yield process
    finally:
        process.kill()
        process.communicate()


def test_what_is_held_is_nobody_elses_until_it_is_given_back(leases: Leases) -> None:
    taken = leases.take(RUN)
    assert taken is not None
    assert leases.take(RUN) is None
    assert leases.held(LeaseKind.RUNS) == {"u-1"}
    leases.give_back(taken)
    assert leases.held(LeaseKind.RUNS) == set()
    assert leases.take(RUN) is not None


def test_of_several_all_are_taken_or_none(leases: Leases) -> None:
    leases.take((LeaseKind.FOLDERS, "s,a"))
    assert leases.take(RUN, (LeaseKind.FOLDERS, "s,a")) is None
    assert not leases.is_held(*RUN)


@pytest.mark.parametrize("name", ["a/../b", "x" * 300, "sweep/run"])
def test_any_name_is_a_lease_of_its_own(leases: Leases, name: str) -> None:
    leases.take((LeaseKind.RUNS, name))
    assert leases.is_held(LeaseKind.RUNS, name)
    assert not leases.is_held(LeaseKind.RUNS, f"{name}1")


def test_what_a_killed_runner_held_is_free(tmp_path: Path) -> None:
    home = Home.at(tmp_path)
    with holder(tmp_path) as process:
        assert home.leases.take(RUN) is None
        assert [(one.pid, one.what) for one in home.at_work()] == [(process.pid, "slamhive run")]
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert home.leases.take(RUN) is not None
        assert home.at_work() == []


def test_files_of_a_killed_runner_go_and_those_of_others_stay(tmp_path: Path) -> None:
    home = Home.at(tmp_path)
    kept = home.leases.take((LeaseKind.CONTENTS, "c-1"))
    with holder(tmp_path) as process:
        process.kill()
        process.wait()

    def files() -> list[str]:
        return sorted(path.parent.name for path in (tmp_path / "leases").glob("*/*"))

    assert files() == ["contents", "folders", "runs", "workers"]
    home.leases.tidy()
    assert files() == ["contents"]
    assert kept is not None
    assert home.leases.is_held(LeaseKind.CONTENTS, "c-1")


def test_many_share_a_home_and_one_is_alone_in_it(tmp_path: Path) -> None:
    home = Home.at(tmp_path)
    with (
        holder(tmp_path) as process,
        home.sharing(),
        pytest.raises(InputError, match=rf"slamhive run \(process {process.pid}, since .*are at work in"),
        home.exclusive("slamhive gc"),
    ):
        pass
    with (
        home.exclusive("slamhive gc"),
        pytest.raises(InputError, match=r"slamhive gc \(process .*is at work"),
        home.sharing(),
    ):
        pass


def test_a_home_without_room_for_leases_is_refused(tmp_path: Path) -> None:
    (tmp_path / "leases").write_text("")
    with pytest.raises(InputError, match=r"SLAMHIVE_HOME: .*leases"):
        Leases(tmp_path / "leases").take(RUN)


def test_cores_are_lent_to_one_pool_at_a_time(leases: Leases) -> None:
    mine, theirs = CorePool(leases, CORES), CorePool(leases, CORES)
    first, second = mine.take(2), theirs.take(1)
    assert first is not None
    assert second is not None
    assert {*first, *second} == set(CORES)
    assert theirs.take(1, stopped=lambda: True) is None
    mine.give_back(first)
    assert theirs.take(2) == first


def test_a_core_is_held_as_long_as_a_supervisor_has_it(leases: Leases) -> None:
    pool = CorePool(leases, CORES[:1])
    cores = pool.take(1)
    assert cores is not None
    (descriptor,) = pool.descriptors(cores)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=(descriptor,))
    os.close(descriptor)  # as the kernel does when the runner is killed
    assert CorePool(leases, CORES[:1]).take(1, stopped=lambda: True) is None
    child.kill()
    child.communicate()
    assert CorePool(leases, CORES[:1]).take(1) == CORES[:1]


def test_runners_take_turns(leases: Leases) -> None:
    """Of two that want all cores over and over, none waits for two turns of the other."""
    order: list[str] = []
    left = {"a": 5, "b": 5}

    def work(name: str) -> None:
        pool = CorePool(leases, CORES)

        def one() -> None:
            cores = pool.take(len(CORES))
            assert cores is not None
            order.append(name)
            left[name] -= 1
            while len(leases.held(LeaseKind.QUEUE)) < sum(count > 0 for count in left.values()):
                pass  # until all that want to go on wait
            pool.give_back(cores)

        threads = [threading.Thread(target=one) for _ in range(5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    held = CorePool(leases, CORES)
    cores = held.take(len(CORES))
    workers = [threading.Thread(target=work, args=(name,)) for name in "ab"]
    for worker in workers:
        worker.start()
    while len(leases.held(LeaseKind.QUEUE)) < 2:
        pass  # until both wait
    assert cores is not None
    held.give_back(cores)
    for worker in workers:
        worker.join()
    assert sorted(order) == [*"aaaaabbbbb"]
    assert "".join(order) in {"ababababab", "bababababa"}


def test_a_large_wish_is_not_passed_by_small_ones(leases: Leases) -> None:
    small, large = CorePool(leases, CORES), CorePool(leases, CORES)
    first = small.take(1)
    got: list[object] = []
    waiting = threading.Thread(target=lambda: got.append(large.take(3)))
    waiting.start()
    while not leases.held(LeaseKind.QUEUE):
        pass
    assert small.take(1, stopped=lambda: bool(leases.held(LeaseKind.QUEUE))) is None
    assert first is not None
    small.give_back(first)
    waiting.join()
    assert got == [CORES]


def test_a_ticket_of_a_killed_runner_holds_nobody_up(leases: Leases) -> None:
    (leases._folder / "queue").mkdir(parents=True)
    (leases._folder / "queue" / "000000000001").touch()
    assert CorePool(leases, CORES).take(3) == CORES
