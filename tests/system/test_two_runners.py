# SPDX-License-Identifier: Apache-2.0
"""Two `slamhive run` at once in one home: none of the runs twice, cores never shared, none lost by a kill."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import Any

import pytest

from slamhive.local.programs.cores import whole_cores

pytestmark = pytest.mark.timeout(600)


def sweep_of(system: Any, name: str, numbers: range) -> Any:
    return system.sweep(name, matrix=[{"path": "parameters.number", "values": list(numbers)}])


def spans(system: Any) -> list[tuple[float, float, set[int]]]:
    """Return start, end and processors of each attempt that ended by itself."""
    begun, found = {}, []
    for entry in system.journal():
        if entry["event"] == "start":
            begun[entry["run"]] = entry
        else:
            start = begun[entry["run"]]
            found.append((start["time"], entry["time"], set(start["cpus"])))
    return found


def shared_cores(system: Any) -> list[set[int]]:
    """Return the processors that two attempts had at the same time."""
    pairs = combinations(spans(system), 2)
    return [one[2] & two[2] for one, two in pairs if one[0] < two[1] and two[0] < one[1] and one[2] & two[2]]


@pytest.mark.parametrize("runs", [12, pytest.param(40, marks=pytest.mark.slow)])
def test_of_overlapping_sweeps_no_run_is_computed_twice(system: Any, runs: int) -> None:
    third = runs // 3
    files = [
        sweep_of(system, "one", range(100, 100 + 2 * third)),
        sweep_of(system, "two", range(100 + third, 100 + runs)),
    ]
    working = [system.fork("run", file) for file in files]
    for process in working:
        assert process.wait(500) == 0, system.printed(process)[1]
    contents = Counter(
        record.provenance.content_hash
        for name in ("one", "two")
        for record in system.records(name)
        if record.provenance.reused_from is None
    )
    assert len(contents) == len(system.journal("start")) == runs
    assert set(contents.values()) == {1}
    assert shared_cores(system) == []


@pytest.mark.parametrize("runs", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_what_a_killed_runner_leaves_the_other_finishes(system: Any, until: Any, runs: int) -> None:
    file = sweep_of(system, "s", range(300, 300 + runs))
    killed, stays = [system.fork("run", file) for _ in range(2)]
    until(lambda: len(system.journal("start")) >= 3 or killed.poll() is not None, "three runs begin")
    killed.kill()
    killed.wait()
    assert stays.wait(500) == 0, system.printed(stays)[1]
    records = system.records()
    assert (len(records), {record.phase for record in records}) == (runs, {"Succeeded"})
    begun = Counter(entry["run"] for entry in system.journal("start"))
    assert len(begun) == runs
    # What the killed one was at began again, at most one on each core.
    assert begun.total() <= runs + len(whole_cores())
    assert shared_cores(system) == []
