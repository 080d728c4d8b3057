# SPDX-License-Identifier: Apache-2.0
"""A disk on a node that fails now and then, under the monitor, the preparation and the evaluator of a sweep.

SLAMHIVE_DISK_FAULTS=200 makes so many faults at least; without it there are few.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest
from onnode.disk_faults import Fault, compiler, under_faults
from onnode.documents import ROOT
from onnode.lab import manifest
from testcluster.access import until

if TYPE_CHECKING:
    from onnode.lab import Lab

WANTED = int(os.environ.get("SLAMHIVE_DISK_FAULTS", "3"))
REPETITIONS = 5
ALGORITHM = "shell-dead-reckoning"


def sweep(lab: Lab, name: str, number: int, **spec: Any) -> dict[str, Any]:
    """Return a Sweep of equal runs, at a frame rate by its number: for each a recording must be prepared."""
    template = lab.run("x", ALGORITHM, input={"frameRate": round(2 + 0.001 * number, 3)})["spec"]
    return manifest(
        "Sweep", name, template={"spec": template}, repetitions=REPETITIONS, parallelism=4, **spec
    )


def is_over(lab: Lab, name: str) -> bool:
    """Tell whether all runs of a Sweep have ended, and have been measured or say why not."""
    status = lab.get("sweep", name).get("status") or {}
    if status.get("phase") != "Complete":
        return False
    for run in lab.runs(name):
        held = {item["type"]: item for item in run["status"].get("conditions") or ()}
        measured = run["status"].get("results") or "Evaluated" in held
        if run["status"]["phase"] == "Succeeded" and not measured:
            return False
    return True


def wait(lab: Lab, name: str, seconds: float) -> None:
    """Wait for the end of a Sweep and its evaluations."""
    try:
        until(lambda: is_over(lab, name), f"the end of {name}", seconds, 1)
    except Exception:
        for one in (lab.get("sweep", name), *lab.runs(name)):
            print(one["metadata"]["name"], json.dumps(one.get("status"), indent=1))  # noqa: T201 - what hung
        raise


def problems(lab: Lab, name: str) -> list[str]:
    """Return the faults of a Sweep after disk faults, a sentence each."""
    runs, found = lab.runs(name), []
    if len(runs) != REPETITIONS:
        found.append(f"{len(runs)} runs of {REPETITIONS}")
    jobs = Counter(
        job["metadata"]["labels"]["slamhive.io/run"]
        for job in lab.get("jobs", "-l", f"slamhive.io/sweep={name},slamhive.io/role=run")["items"]
    )
    for run in runs:
        status, title = run["status"], run["metadata"]["name"]
        if jobs[title] > status.get("attempts", 0) + status.get("faults", 0):
            found.append(f"{title} has {jobs[title]} Jobs, and {status.get('attempts')} attempts")
        held = {item["type"]: item for item in status.get("conditions") or ()}
        if status["phase"] == "Failed" and not (status.get("reason") and status.get("message")):
            found.append(f"{title} failed and does not say why: {status}")
        if status["phase"] == "Succeeded" and not status.get("results") and not held["Evaluated"]["message"]:
            found.append(f"{title} has no result and does not say why")
        if len(status.get("results") or ()) > 1:
            found.append(f"{title} has results twice")
    return found


def figures(lab: Lab, name: str) -> set[tuple[str, float]]:
    """Return the sums of the trajectories and the errors of all runs that have them."""
    return {
        (run["status"]["trajectory"]["sha256"], run["status"]["results"][0]["ate"]["rmse"])
        for run in lab.runs(name)
        if run["status"].get("results")
    }


def test_a_disk_that_fails_on_the_node_loses_and_spoils_no_run(lab: Lab) -> None:
    if compiler() is None:
        pytest.skip("no C compiler: apt-get install gcc")
    lab.apply_algorithm(ROOT / "tests" / "images" / "shell-algorithm")
    made: list[Fault] = []
    words: Counter[str] = Counter()
    with under_faults(lab) as faults:
        number = 0
        while len(made) < WANTED:
            name = f"faulty-{number}"
            faults.plan(number)
            lab.apply(sweep(lab, name, number, cachePolicy="Rerun"))
            wait(lab, name, 900)
            assert problems(lab, name) == []
            for run in lab.runs(name):
                words[run["status"]["phase"], run["status"].get("reason"), run["status"].get("message")] += 1
            # Without faults: what is there is taken over, what is not is made, and all is the same.
            faults.end()
            lab.apply(sweep(lab, f"after-{number}", number))
            wait(lab, f"after-{number}", 300)
            status = lab.get("sweep", f"after-{number}")["status"]
            assert (status["succeeded"], status["failed"]) == (REPETITIONS, 0)
            right = figures(lab, f"after-{number}")
            assert len(right) == 1
            assert figures(lab, name) <= right
            made = faults.made()
            number += 1
    table = Counter((fault.container, fault.call, fault.path, fault.how) for fault in made)
    for line, count in (*sorted(table.items()), *words.most_common()):
        print(count, *line)  # noqa: T201 - with -s: the table of faults, and what became of the runs
    assert {fault.container for fault in made} & {"monitor", "prepare", "evaluate"}
