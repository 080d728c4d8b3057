# SPDX-License-Identifier: Apache-2.0
"""The algorithm is found by its environment and ended as Ctrl-C would."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import uuid
from typing import TYPE_CHECKING

import pytest

from slamhive.playback.player.processes import AlgorithmProcesses, carriers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

WAIT = "import signal, sys, time; {}; print('up', flush=True); time.sleep(60)"
CHILD = "import subprocess; subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])"
IGNORE = "[signal.signal(n, signal.SIG_IGN) for n in ({})]"


@pytest.fixture
def mark() -> str:
    return f"SLAMHIVE_RUN=/nowhere/{uuid.uuid4()}"


@pytest.fixture
def start(mark: str) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    started = []

    def begin(code: str) -> subprocess.Popen[str]:
        name, _, value = mark.partition("=")
        process = subprocess.Popen(
            [sys.executable, "-c", WAIT.format(code)],
            env=os.environ | {name: value},
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        return process

    yield begin
    for process in started:
        for one in carriers(mark):
            os.kill(one.pid, 9)
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.parametrize(
    ("code", "by"),
    [
        ("pass", "SIGINT"),
        (CHILD, "SIGINT"),
        (IGNORE.format("signal.SIGINT,"), "SIGTERM"),
        (IGNORE.format("signal.SIGINT, signal.SIGTERM"), "SIGKILL"),
    ],
)
def test_it_is_ended(
    start: Callable[[str], subprocess.Popen[str]],
    mark: str,
    code: str,
    by: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("slamhive.playback.player.processes._KILL_SECONDS", 0.3)
    process = start(code)
    algorithm = AlgorithmProcesses(mark)
    assert algorithm.seen()
    assert algorithm.lives()
    assert algorithm.end(50.0 if by == "SIGINT" else 0.3, lambda: False) == by
    assert not algorithm.lives()
    process.wait(50)
    deadline = time.monotonic() + 50
    while carriers(mark) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert carriers(mark) == []


def test_nobody_is_found() -> None:
    algorithm = AlgorithmProcesses("SLAMHIVE_RUN=/no/such/run")
    assert not algorithm.seen()
    assert not algorithm.lives()
    assert algorithm.end(1.0, lambda: False) == "none"
