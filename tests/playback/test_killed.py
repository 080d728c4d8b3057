# SPDX-License-Identifier: Apache-2.0
"""Runs of ROS 2 nodes with a SIGKILL in every second one: nothing stays in memory, and no process, no domain.

SLAMHIVE_KILLS says how many runs; the default is short.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Archive

if TYPE_CHECKING:
    from conftest import Stage
    from slamhive.local.home.folder import Home


pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

RUNS = int(os.environ.get("SLAMHIVE_KILLS", "8"))
SHARED_MEMORY = Path("/dev/shm")
VICTIMS = ("node", "player", "slamhive", "all")
COMMAND = "import sys; from slamhive.cli.main import main; sys.exit(main())"


def dead_memory() -> set[str]:
    """Return the files of Fast DDS whose owner is gone: their lock is free."""
    found = set()
    for lock in SHARED_MEMORY.glob("fast*_el"):
        with suppress(OSError), lock.open() as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            found.add(lock.name)
    return found


def held_domains(home: Home) -> set[str]:
    """Return the domains that runs in a home had and that somebody still holds."""
    held = Path("/proc/net/unix").read_text()
    files = home.path.glob("runs/*/*/player/node.json")
    numbers = {json.loads(file.read_text())["variables"]["ROS_DOMAIN_ID"] for file in files}
    return {
        number for number in numbers if re.search(rf"@slamhive-ros2-domain-{number}$", held, re.MULTILINE)
    }


def processes(home: Home) -> dict[int, str]:
    """Return the command lines of the processes that were started by runs in a home."""
    found, wanted = {}, str(home.path).encode()
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            told = (entry / "environ").read_bytes() + (entry / "cmdline").read_bytes()
            if entry.name.isdigit() and wanted in told and int(entry.name) != os.getpid():
                found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found


def parts(home: Home, ours: int) -> dict[str, list[int]]:
    """Return the processes of a run that is being played, by what they are."""
    found: dict[str, list[int]] = {"node": [], "player": [], "slamhive": [ours]}
    for number, line in processes(home).items():
        if "slamhive.playback.player" in line:
            found["player"].append(number)
        elif "node.py" in line and "slamhive.monitor" not in line:
            found["node"].append(number)
    return found | {"all": [one for numbers in found.values() for one in numbers]}


def more_than(before: set[str], home: Home) -> list[object]:
    """Return the memory, domains and processes that runs left, once there are none or patience ends."""
    deadline = time.monotonic() + 30.0
    while True:
        left = [dead_memory() - before, held_domains(home), processes(home)]
        if not any(left) or time.monotonic() > deadline:
            return left
        time.sleep(0.1)


def begin(stage: Stage, name: str) -> subprocess.Popen[bytes]:
    """Start a run by the command, in a process of its own."""
    template = {
        "algorithmRef": {"name": "node2-posestamped"},
        "datasetRef": {"name": "tiny"},
        "input": {"duration": "3s", "rate": 3},
        "evaluate": False,
        "retries": 0,
    }
    body = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Sweep", "metadata": {"name": name}}
    sweep = stage.home.path / "sweep.yaml"
    sweep.write_text(json.dumps(body | {"spec": {"template": {"spec": template}}}))
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, "run", "--rerun", "-j", "1", str(sweep)],
        env=os.environ | {"SLAMHIVE_HOME": str(stage.home.path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def wait_until_played(stage: Stage, name: str, command: subprocess.Popen[bytes]) -> None:
    """Wait until the run's recording is played to its node."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and command.poll() is None:
        for report in stage.home.path.glob(f"runs/{name}/*/run/output/playback.json"):
            if '"Playing"' in report.read_text():
                return
        time.sleep(0.005)
    with Archive.open(stage.home.archive_url) as archive:
        raise AssertionError(f"nothing was played: {[one.message for one in archive.runs()]}")


def test_whatever_is_killed_nothing_stays_and_the_next_run_is_as_any(stage2: Stage) -> None:
    home, before = stage2.home, dead_memory()
    stage2.declare("PoseStamped", settle="200ms")
    killed: dict[str, int] = {}
    for number in range(RUNS):
        name, victim = f"run-{number}", VICTIMS[number // 2 % len(VICTIMS)]
        command = begin(stage2, name)
        if number % 2 == 0:
            wait_until_played(stage2, name, command)
            for process in parts(home, command.pid)[victim]:
                os.kill(process, signal.SIGKILL)
                killed[victim] = killed.get(victim, 0) + 1
        command.wait(120)
        if number % 2:
            with Archive.open(home.archive_url) as archive:
                (record,) = [one for one in archive.runs() if one.sweep == name]
            assert (record.message, record.phase) == (None, "Succeeded"), number
            assert record.frames is not None
            assert record.frames.offered == 30
            assert more_than(before, home) == [set(), set(), {}], f"after {victim} was killed"
            shutil.rmtree(home.path / "runs")
    assert min(killed[victim] for victim in VICTIMS[: RUNS // 2]) >= RUNS // 8
