# SPDX-License-Identifier: Apache-2.0
"""However slamhive ends, the same command goes on: nothing is lost, nothing is done twice."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.timeout(600)

FEW = 10
STEPS = ("attempt.json", "process.json", "usage.csv", "summary.json")
"""Files of a run's folder, in the order in which they come."""


def wait_for_events(system: Any, process: Any, more: int) -> None:
    """Wait until the journal has so many more lines, or the command has ended."""
    wanted = len(system.journal()) + more
    deadline = time.monotonic() + 120
    while len(system.journal()) < wanted and process.poll() is None:
        assert time.monotonic() < deadline, system.printed(process)[1]
        time.sleep(0.03)


def wait_for_step(system: Any, process: Any, name: str) -> None:
    """Wait until another run has come to a step, or the command has ended."""

    def come() -> set[Path]:
        return set(system.home.path.glob(f"runs/s/*/{name}"))

    before = come()
    deadline = time.monotonic() + 120
    while come() <= before and process.poll() is None:
        assert time.monotonic() < deadline, system.printed(process)[1]
        time.sleep(0.03)


def wait_for_quiet(system: Any, seconds: float = 120) -> None:
    """Wait until nothing of the home lives."""
    deadline = time.monotonic() + seconds
    while left := system.alive():
        assert time.monotonic() < deadline, left
        time.sleep(0.1)  # looks through all processes of the machine


def finished_attempts(system: Any) -> set[str]:
    """Return the runs whose attempt has ended by itself, archived or not."""
    found = set()
    for path in system.home.path.glob("runs/s/*/summary.json"):
        if json.loads(path.read_text())["reason"] is None:
            found.add(path.parent.name)
    return found


def starts(system: Any, since: int = 0) -> list[str]:
    return [entry["run"] for entry in system.journal()[since:] if entry["event"] == "start"]


def as_kept(system: Any) -> dict[str, Any]:
    return {record.uid: record for record in system.records()}


def sweep_of(system: Any, runs: int) -> Any:
    """Return a sweep of so many runs, each of which takes a tenth of a second."""
    return system.sweep(matrix=[{"path": "parameters.number", "values": list(range(100, 100 + runs))}])


def kill(system: Any, process: Any) -> None:
    process.kill()


def kill_with_supervisors(system: Any, process: Any) -> None:
    os.kill(process.pid, signal.SIGSTOP)
    for pid in system.supervisors():
        os.kill(pid, signal.SIGKILL)
    process.kill()


@pytest.mark.parametrize(
    ("seed", "runs", "kills"), [(1, 14, 2), pytest.param(2, 40, 3, marks=pytest.mark.slow)]
)
def test_runs_killed_at_any_moment_give_all_results(system: Any, seed: int, runs: int, kills: int) -> None:
    sweep = sweep_of(system, runs)
    chance = random.Random(seed)
    kept: dict[str, Any] = {}
    for _ in range(kills):
        process = system.fork("run", sweep)
        wait_for_events(system, process, chance.randint(2, 12))
        wait_for_step(system, process, chance.choice(STEPS))
        kill(system, process)
        process.wait()
        wait_for_quiet(system)
        done, seen = finished_attempts(system), len(system.journal())
        now = as_kept(system)
        assert kept.items() <= now.items()
        kept = now
        assert {record.name for record in kept.values()} <= done
        again = system.fork("run", sweep)
        wait_for_events(system, again, chance.randint(1, 4))
        kill(system, again)
        again.wait()
        wait_for_quiet(system)
        assert not done & set(starts(system, seen))

    code, out, err = system("run", sweep)
    assert code == 0, err
    assert f"{runs} succeeded" in out
    records = system.records()
    assert sorted(record.index for record in records) == list(range(runs))
    assert all(record.phase is Phase.SUCCEEDED and record.results for record in records)
    assert kept.items() <= as_kept(system).items()
    assert not system.alive()


@pytest.mark.parametrize("how", [kill, kill_with_supervisors])
def test_what_a_killed_slamhive_left_behind_is_ended_when_any_sweep_starts(
    system: Any, how: Callable[[Any, Any], None]
) -> None:
    sweep = sweep_of(system, FEW)
    left: set[int] = set()
    for _ in range(5):  # between two runs there is nothing to leave
        process = system.fork("run", sweep)
        wait_for_events(system, process, 3)
        how(system, process)
        process.wait()
        left = set(system.alive())
        if left or how is kill:
            break
    assert left or how is kill
    seen = len(system.journal())
    code, _, err = system("run", system.sweep("other", repetitions=1))
    assert code == 0, err
    assert not system.alive()
    assert len(starts(system, seen)) == 1
    code, _, err = system("run", sweep)
    assert code == 0, err
    assert sorted(record.index for record in system.records()) == list(range(FEW))


def test_a_supervisor_that_is_killed_is_a_fault_of_the_machine_and_its_run_is_tried_again(
    system: Any,
) -> None:
    process = system.fork(
        "run", "-j", "1", system.sweep(template={"parameters": {"act": "noted", "number": 1500}})
    )
    wait_for_events(system, process, 1)
    for pid in system.supervisors():
        os.kill(pid, signal.SIGKILL)
    assert process.wait(120) == 0, system.printed(process)[1]
    assert len(starts(system)) == 2
    assert [record.attempts for record in system.records()] == [2]
    assert not system.alive()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_sweep_ends_cleanly_and_goes_on(system: Any, number: int) -> None:
    sweep = system.sweep(
        matrix=[{"path": "parameters.number", "values": [100, 101, 60_000, 102]}], parallelism=1
    )
    process = system.fork("run", sweep)
    wait_for_events(system, process, 5)
    process.send_signal(number)
    assert process.wait(120) == 130
    assert "the same command goes on" in system.printed(process)[1]
    assert not system.alive()
    assert [record.index for record in system.records()] == [0, 1]
    before = as_kept(system)

    again = system.fork("run", sweep)
    wait_for_events(system, again, 1)
    again.send_signal(number)
    assert again.wait(120) == 130
    half_done = starts(system)[2]
    assert starts(system)[3:] == [half_done]
    assert as_kept(system) == before


LARGE = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: large}
spec:
  recording:
    synthetic: {sensors: [Lidar], durationSeconds: 900, loops: 12, lidar: {rings: 64, columns: 1024}}
"""


def test_ctrl_c_does_not_wait_for_a_dataset_that_is_generated(system: Any, until: Any) -> None:
    manifest = system.home.path / "large.yaml"
    manifest.write_text(LARGE)
    process = system.start("run", manifest, system.sweep(template={"datasetRef": {"name": "large"}}))
    until(lambda: "generating the dataset large" in system.printed(process)[1], "the dataset to be begun")
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 130
    assert "Traceback" not in system.printed(process)[1]
    assert system.records() == []
    assert [path.name for path in system.home.path.glob("datasets/*large*") if path.is_dir()] == []


def test_a_second_ctrl_c_does_not_wait_for_a_program_that_ignores_the_first(system: Any) -> None:
    process = system.start("run", system.sweep(template={"parameters": {"act": "hang"}}))
    deadline = time.monotonic() + 120
    while not list(system.home.path.glob("runs/s/*/process.json")):
        assert time.monotonic() < deadline
        time.sleep(0.03)
    code = None
    while code is None:  # as who presses Ctrl-C until it ends: two at once count as one
        assert time.monotonic() < deadline
        process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            code = process.wait(0.3)
    assert code == 130, system.printed(process)[1]
    assert "Traceback" not in system.printed(process)[1]
    wait_for_quiet(system)
