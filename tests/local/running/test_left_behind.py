# SPDX-License-Identifier: Apache-2.0
"""Tests that what a killed slamhive left running is found and ended, also without a cgroup."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

from slamhive.engine import PointState
from slamhive.local.running.attempt import end_left_behind
from slamhive.monitor import SupervisorSpec, find_orphans

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PROGRAM = """
import subprocess, sys, time
subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)
open("ready", "w").close()
time.sleep(600)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run folder in which a program and its child run under a supervisor, without a cgroup."""
    folder = tmp_path / "runs" / "sweep" / "run"
    folder.mkdir(parents=True)
    spec = SupervisorSpec(
        argv=(sys.executable, "-c", PROGRAM),
        cwd=str(folder),
        env={"PATH": os.environ["PATH"]},
        log_path=str(folder / "log.txt"),
        usage_path=str(folder / "usage.csv"),
        summary_path=str(folder / "summary.json"),
        process_path=str(folder / "process.json"),
        cgroup="none",
    )
    (folder / "supervisor.json").write_text(spec.to_json())
    return folder


@pytest.mark.parametrize("supervisor_too", [False, True])
def test_orphans_of_any_run_are_ended(folder: Path, supervisor_too: bool) -> None:
    command = [sys.executable, "-m", "slamhive.monitor", "--spec", str(folder / "supervisor.json")]
    with subprocess.Popen(command) as process:
        try:
            deadline = time.monotonic() + 50
            while not (folder / "ready").exists():
                assert time.monotonic() < deadline
                time.sleep(0.02)
            if supervisor_too:
                process.send_signal(signal.SIGKILL)
                process.wait()
            assert find_orphans(folder / "process.json")
            record = (folder / "process.json").read_text()
            end_left_behind(folder.parents[1])
        finally:
            process.kill()
    (folder / "process.json").write_text(record)
    assert find_orphans(folder / "process.json") == []


def test_what_is_no_record_stops_nobody(tmp_path: Path) -> None:
    for name in ("cut-off", "folder"):
        (tmp_path / "sweep" / name).mkdir(parents=True)
    (tmp_path / "sweep/cut-off/process.json").write_text('{"boot": "')
    (tmp_path / "sweep/folder/process.json").mkdir()
    end_left_behind(tmp_path)
    assert not (tmp_path / "sweep/cut-off/process.json").exists()


def test_runs_that_wait_for_cores_do_not_begin_after_the_limit_of_failures(run_acts: Callable) -> None:
    wide = {"resources": {"cpu": str(os.cpu_count())}}
    job, notes = run_acts(["crash"], repetitions=6, maxFailures=0, template=wide)
    assert job.verdict == "TooManyFailures"
    assert job.count(PointState.FAILED) == len(notes.records) == 1
