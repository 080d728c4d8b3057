# SPDX-License-Identifier: Apache-2.0
"""However slamhive ends while containers run: no result is lost, none is made twice, no container stays."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.local.programs.containers import Containers
from slamhive.model.results import Phase

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.local.programs.engines import Engine

pytestmark = pytest.mark.timeout(3000)

RUNS = int(os.environ.get("SLAMHIVE_KILLED_RUNS", "8"))
RUNS_A_KILL = 3
STEPS = ("attempt.json", "container.json", "process.json", "usage.csv", "summary.json")
"""Files of a run's folder, in the order in which they come."""
POSES = """
i=0
while [ $i -lt 100 ]; do
    echo "160000000$((i / 10)).$((i % 10)) $i 0 0 0 0 0 1"
    i=$((i + 1))
done > /slamhive/output/trajectory.txt
"""


@pytest.fixture
def boxed(system: Any, podman: Engine) -> Callable[[], list[str]]:
    """Make an algorithm known that has an image alone, and return what tells its containers."""
    for name, command in (("boxed", f"{POSES}sleep 0.2"), ("lasting", "sleep 600")):
        folder = system.home.path / "algorithms" / name
        folder.mkdir()
        spec = {
            "image": "slamhive/shell-algorithm:1.0.0",
            "command": ["sh", "-c", command],
            "modes": [{"name": "lidar", "roles": ["lidar"]}],
            "parameters": {"number": {"type": "Integer", "default": 0}},
            "output": {"frame": "lidar"},
        }
        header = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Algorithm", "metadata": {"name": name}}
        (folder / "algorithm.yaml").write_text(yaml.safe_dump(header | {"spec": spec}))
    label = f"io.slamhive.home={Containers(system.home).identity()}"
    return lambda: podman.labelled(label)


def sweep_of(system: Any, algorithm: str, runs: int) -> Any:
    template = {"algorithmRef": {"name": algorithm}, "parameters": {}, "resources": {"memory": "64Mi"}}
    return system.sweep(
        template=template, matrix=[{"path": "parameters.number", "values": list(range(runs))}], parallelism=2
    )


def ended(system: Any) -> dict[str, str]:
    """Return the begin of each attempt that has ended by itself."""
    found = {}
    for path in system.home.path.glob("runs/s/*/summary.json"):
        with suppress(FileNotFoundError):
            summary = json.loads(path.read_text())
            if summary["reason"] is None:
                found[path.parent.name] = summary["startedAt"]
    return found


def wait_for_step(system: Any, process: subprocess.Popen[str], name: str, more: int) -> None:
    """Wait until so many runs more have come to a step, or the command has ended."""

    def come() -> set[Path]:
        return {*system.home.path.glob(f"runs/s/*/{name}")}

    before = come()
    since: set[Path] = set()
    deadline = time.monotonic() + 120
    while len(since) < more and process.poll() is None:
        since |= come() - before
        assert time.monotonic() < deadline, system.printed(process)[1]
        time.sleep(0.003)


def kill(system: Any, process: subprocess.Popen[str]) -> None:
    process.kill()


def kill_with_supervisors(system: Any, process: subprocess.Popen[str]) -> None:
    """Kill the supervisors and their guards too: only the next slamhive can find what they leave."""
    os.kill(process.pid, signal.SIGSTOP)
    for pid in system.supervisors():
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    process.kill()


def test_runs_killed_at_any_moment_give_all_results_and_leave_no_container(
    system: Any, boxed: Callable[[], list[str]]
) -> None:
    sweep = sweep_of(system, "boxed", RUNS)
    chance = random.Random(RUNS)
    done: dict[str, str] = {}
    for _ in range(max(2, RUNS // RUNS_A_KILL)):
        process = system.start("run", sweep)
        wait_for_step(system, process, chance.choice(STEPS), chance.randint(1, RUNS_A_KILL))
        chance.choice((kill, kill_with_supervisors))(system, process)
        process.wait()
        deadline = time.monotonic() + 120
        while system.supervisors():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        now = ended(system)
        assert done.items() <= now.items(), "a run that had ended was done again"
        done = now

    code, out, err = system("run", sweep)
    assert code == 0, err
    assert f"{RUNS} succeeded" in out
    records = system.records()
    assert sorted(record.index for record in records) == list(range(RUNS))
    assert all(record.phase is Phase.SUCCEEDED and record.results for record in records)
    assert done.items() <= ended(system).items()
    assert boxed() == []


def test_a_container_ends_with_its_supervisor(
    system: Any, boxed: Callable[[], list[str]], until: Callable[..., Any]
) -> None:
    """Even when slamhive is in no state to end it."""
    process = system.start("run", sweep_of(system, "lasting", 1))
    until(lambda: [*system.home.path.glob("runs/s/*/usage.csv")] and boxed(), "the container to run")
    os.kill(process.pid, signal.SIGSTOP)
    parents = {pid: (f"/proc/{pid}/stat") for pid in system.supervisors()}
    for pid, path in parents.items():
        with open(path, encoding="ascii") as file:  # noqa: PTH123
            if int(file.read().rpartition(")")[2].split()[1]) == process.pid:
                os.kill(pid, signal.SIGKILL)
    until(lambda: not boxed(), "the container to go")
    process.kill()
    process.wait()


def test_ctrl_c_removes_the_container(
    system: Any, boxed: Callable[[], list[str]], until: Callable[..., Any]
) -> None:
    process = system.start("run", sweep_of(system, "lasting", 1))
    until(lambda: [*system.home.path.glob("runs/s/*/usage.csv")] and boxed(), "the container to run")
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 130
    assert boxed() == []
    assert system.records() == []


def test_a_player_that_a_killed_slamhive_left_goes_with_its_node(
    system: Any, boxed: Callable[[], list[str]], until: Callable[..., Any]
) -> None:
    played = system.sweep(
        template={
            "algorithmRef": {"name": "kiss-icp-ros"},
            "input": {"pace": "Realtime", "rate": 0.1},
            "parameters": {},
        }
    )
    process = system.start("run", "--container", "podman", played)
    until(lambda: [*system.home.path.glob("runs/s/*/usage.csv")] and len(boxed()) == 2, "both to run")
    kill_with_supervisors(system, process)
    process.wait()
    code, _, err = system("run", sweep_of(system, "boxed", 1))
    assert code == 0, err
    assert boxed() == []
