# SPDX-License-Identifier: Apache-2.0
"""Processes that answer within limits: what one question takes ends no other, nor who asks."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

import pydantic.main
import pytest

from slamhive.model.base import Model
from slamhive.monitor.measuring import bounded
from slamhive.monitor.measuring.bounded import BoundedProcess, LimitError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MEBIBYTE = 1 << 20


class Unbuilt(Model):
    """Model that is built when it is first used, as all of ours are."""

    value: int


def answer(question: str, given: dict[str, Any]) -> Any:
    match question:
        case "memory":
            return len(bytearray(4096 * MEBIBYTE))  # far beyond what a large test process may free meanwhile
        case "time":
            while True:
                pass
        case "mistake":
            return 1 / 0
        case "given":
            return given
        case "processors":
            return os.sched_getaffinity(0)
        case "model":
            return Unbuilt(value=1).value
        case _:
            os.kill(os.getpid(), signal.Signals[question])
            return None


@pytest.fixture
def process() -> Iterator[BoundedProcess]:
    found = BoundedProcess(answer, 0, 32 * MEBIBYTE)
    yield found
    found.close()


@pytest.mark.parametrize(
    ("question", "sentence", "is_lasting"),
    [
        ("memory", "it takes more than 32 MiB of memory", True),
        ("time", "it takes more than 0 s of CPU time", True),
        ("SIGSEGV", "the process that did it ended (-11)", True),
        ("SIGKILL", "the process that did it ended (-9)", False),
    ],
)
def test_what_goes_beyond_a_limit_ends_alone(
    process: BoundedProcess, question: str, sentence: str, *, is_lasting: bool
) -> None:
    with pytest.raises(LimitError) as caught:
        process.ask(question)
    assert (str(caught.value), caught.value.is_lasting) == (sentence, is_lasting)
    assert process.ask("given", more=1) == {"more": 1}


def test_one_that_stands_still_is_ended(process: BoundedProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(bounded, "_STILL_SECONDS", 0.0)
        with pytest.raises(LimitError, match="stood still"):
            process.ask("SIGSTOP")
    assert process.ask("given", more=1) == {"more": 1}


def test_who_waits_is_told_of_its_end(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "begun")
    process = BoundedProcess(lambda *_: ((tmp_path / "begun").write_bytes(b""), signal.pause()), 9, None)
    found = []

    def ask() -> None:
        with pytest.raises(LimitError) as caught:
            process.ask(None)
        found.append(caught.value.is_lasting)

    thread = threading.Thread(target=ask)
    thread.start()
    (tmp_path / "begun").read_bytes()
    process.close()
    thread.join()
    assert found == [False]


def test_a_mistake_is_told_with_its_place(process: BoundedProcess) -> None:
    with pytest.raises(RuntimeError, match=r"return 1 / 0[^$]*ZeroDivisionError"):
        process.ask("mistake")


class Sent:
    """A value that counts how often it is sent."""

    times = 0

    def __reduce__(self) -> tuple[type[str], tuple[str]]:
        Sent.times += 1
        return str, ("value",)


def test_what_questions_share_is_sent_once_to_each_process(process: BoundedProcess) -> None:
    Sent.times, shared = 0, Sent()
    assert [process.ask("given", shared=shared) for _ in range(3)] == [{"shared": "value"}] * 3
    assert Sent.times == 1
    with pytest.raises(LimitError):
        process.ask("SIGKILL")
    assert process.ask("given", shared=shared) == {"shared": "value"}
    assert Sent.times == 2


class AskedLock:
    """Lock that another thread holds until somebody wants it."""

    def __init__(self) -> None:
        self._lock, self._wanted, held = threading.RLock(), threading.Event(), threading.Event()

        def hold() -> None:
            with self._lock:
                held.set()
                self._wanted.wait()

        threading.Thread(target=hold).start()
        held.wait()

    def __enter__(self) -> None:
        self._wanted.set()
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def test_it_begins_while_no_other_thread_builds_a_model(
    process: BoundedProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pydantic.main, "_rebuild_lock", AskedLock())
    assert process.ask("model") == 1


def test_it_works_on_the_processors_of_who_asks(process: BoundedProcess) -> None:
    everywhere = os.sched_getaffinity(0)
    assert process.ask("processors") == everywhere
    found = []

    def ask(processor: int) -> None:
        os.sched_setaffinity(0, {processor})
        found.append(process.ask("processors"))

    for processor in everywhere:
        thread = threading.Thread(target=ask, args=(processor,))
        thread.start()
        thread.join()
    assert found == [{processor} for processor in everywhere]


def test_one_that_nobody_has_any_more_ends_whatever_garbage_is_collected_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    faults: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", faults.append)

    def forsaken() -> int:
        process: Any = BoundedProcess(answer, 0, None)
        process.ask("given")
        pid, pipe, process.cycle = process._pid, process._pipe, [process]
        cycle = process.cycle
        del process
        gc.collect()  # puts the pipe, which is in use here, before the process that has it
        found = [type(one) for one in gc.get_objects() if one is pipe or one is cycle[0]]
        assert found == [type(pipe), BoundedProcess]
        return int(pid)

    pid = forsaken()
    gc.collect()
    assert faults == []
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_it_ends_with_its_owner_at_work_or_not() -> None:
    code = """
import os, signal, sys, threading
from slamhive.monitor.measuring.bounded import BoundedProcess
def answer(question, given):
    print(os.getpid(), flush=True)
    while question: pass
one, other = BoundedProcess(answer, 99, None), BoundedProcess(answer, 99, None)
one.ask(False)
threading.Thread(target=other.ask, args=(True,), daemon=True).start()
sys.stdin.read()
os.kill(os.getpid(), signal.SIGKILL)
"""
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as owner:
        assert owner.stdin is not None
        assert owner.stdout is not None
        assert all(int(owner.stdout.readline()) != owner.pid for _ in range(2))
        owner.stdin.close()
        # Nobody holds the pipe's other end any more.
        assert owner.stdout.read() == b""
        assert owner.wait() == -signal.SIGKILL
