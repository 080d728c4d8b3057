# SPDX-License-Identifier: Apache-2.0
"""A disk that refuses what the monitor writes: the run goes on, and its figures are told all the same."""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.monitor import Sample
from slamhive.monitor.pod.termination import write_message
from slamhive.monitor.programs.files import UsageTable
from slamhive.monitor.programs.orphans import write_atomically

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Pod

FAULTS = Path(__file__).parents[1] / "faults"
SAMPLE = Sample(time=1.0, cpu=2.0, resident=3, anonymous=4, working_set=5)
HEADER = "time_seconds,cpu_cores,resident_bytes,anonymous_bytes,working_set_bytes\n"
ROW = "1.0000,0.5000,3,4,5\n"


class Disk:
    """Takes the place of `os.write`: takes as many bytes of each write as there is room for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room = sys.maxsize
        self._write = os.write
        monkeypatch.setattr(os, "write", self)

    def __call__(self, descriptor: int, data: bytes) -> int:
        if self.room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = self._write(descriptor, data[: self.room])
        self.room -= count
        return count


def test_samples_wait_while_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    table = UsageTable(str(tmp_path / "usage.csv"))
    disk.room = len(HEADER + ROW) + 7
    for _ in range(3):
        table.add(1.0, 0.5, SAMPLE)
        table.flush()
    assert table.error is not None
    disk.room = sys.maxsize
    table.add(1.0, 0.5, SAMPLE)
    table.close()
    assert table.error is None
    assert (tmp_path / "usage.csv").read_text() == HEADER + 4 * ROW


def test_samples_of_a_disk_that_stays_full_end_no_run() -> None:
    table = UsageTable("/dev/full")
    for number in range(120_000):
        table.add(1.0, 0.5, SAMPLE)
        if number % 10_000 == 0:
            table.flush()
    table.close()
    assert table.error is not None
    assert table.error.errno == errno.ENOSPC


def test_what_was_there_stays_when_it_can_not_be_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "summary.json"
    write_atomically(str(place), "before")

    def refuse(_descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="Input/output") as caught:
        write_atomically(str(place), "after")
    assert caught.value.filename == str(place)
    assert place.read_text() == "before"
    assert list(tmp_path.iterdir()) == [place]


def test_the_last_word_is_whole_after_a_short_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[: len(data) // 2 + 1]))
    write_message(str(tmp_path / "message"), b'{"v": 1, "reason": null}')
    assert (tmp_path / "message").read_bytes() == b'{"v": 1, "reason": null}'


@pytest.fixture
def injector(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FAULTS))
    from injecting import Injector, compiler

    if compiler() is None:
        pytest.skip("needs a C compiler: sudo apt-get install gcc libc6-dev")
    with Injector(tmp_path_factory.mktemp("injector")) as found:
        yield found


def watched(pod: Pod, injector: Any, fault: Any, message: Path, wait_for: Callable[..., Any]) -> int:
    """Run an algorithm of half a second beside a sidecar with a fault; return the sidecar's exit code."""
    (pod.output / "trajectory.txt").write_text("1.0 0 0 0 0 0 0 1\n3.5 1 0 0 0 0 0 1\n")
    pod.variables = injector.variables(pod.folder, fault)
    sidecar = pod.sidecar(at_once=True, terminationMessage=str(message))
    algorithm = pod.python("import time\nopen('up', 'w').close()\ntime.sleep(600)")
    wait_for((pod.output / "up").exists)
    wait_for(lambda: any("usage.csv" in call.path for call in injector.calls(pod.folder)))
    pod.send(algorithm, signal.SIGKILL)
    algorithm.wait(50)
    wait_for(lambda: message.exists() and message.stat().st_size)
    pod.send(sidecar, signal.SIGTERM)
    return sidecar.wait(50)


def test_figures_reach_the_cluster_though_the_results_volume_is_full(
    pod: Pod, injector: Any, tmp_path_factory: pytest.TempPathFactory, wait_for: Callable[..., Any]
) -> None:
    from injecting import Fault

    message = tmp_path_factory.mktemp("kubelet") / "message"
    full = Fault(1, "ENOSPC", lasting=True, call="create")
    assert watched(pod, injector, full, message, wait_for) == 1
    told = json.loads(message.read_text())
    assert told["usage"]["samples"] >= 2
    assert told["trajectory"]["poses"] == 2
    assert not (pod.folder / "summary.json").exists()
