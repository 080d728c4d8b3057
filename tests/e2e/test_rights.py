# SPDX-License-Identifier: Apache-2.0
"""Rights that the operator loses on a node in the middle of a sweep: each is told of, and no run is lost."""

from __future__ import annotations

import json
import time
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from onnode.documents import ROOT
from onnode.lab import OPERATOR, manifest, needed_one_attempt
from testcluster.access import until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from onnode.lab import Lab

AWAY_SECONDS = 16
POINTS = 6
ROLE = "slamhive-operator"


def at_the_sweep(lab: Lab, sweep: str) -> str:
    """Sentence of a Sweep that stands still."""
    held = lab.get("sweep", sweep)["status"].get("conditions") or ()
    return " ".join(one["message"] for one in held if one["type"] == "Blocked" and one["status"] == "True")


def at_its_runs(lab: Lab, sweep: str) -> str:
    """Sentences of the Warnings at the runs of a Sweep."""
    events = lab.get("events", "--field-selector", "involvedObject.kind=MappingRun,type=Warning")["items"]
    return " ".join(one["message"] for one in events if one["involvedObject"]["name"].startswith(sweep))


def in_the_log(lab: Lab, _sweep: str) -> str:
    """Log of the operator since it began."""
    # While its container is made, there is no log to be had.
    return str(lab.cluster.run("-n", lab.namespace, "logs", *OPERATOR, "--tail=-1").stdout)


@dataclass(frozen=True)
class Right:
    """A right of the operator's role.

    Attributes:
        group: API group.
        resource: what may be worked with.
        verbs: what may be done.
        sayings: where a sentence must name it.
        begins_anew: whether the operator must begin anew to miss it: a watch that is open stays open.
    """

    group: str
    resource: str
    verbs: tuple[str, ...]
    sayings: tuple[Callable[[Lab, str], str], ...]
    begins_anew: bool = False


RIGHTS = {
    "jobs": Right("batch", "jobs", ("create", "patch"), (at_the_sweep,)),
    "statuses": Right("slamhive.io", "mappingruns/status", ("patch",), (at_the_sweep, at_its_runs)),
    "pods": Right("", "pods", ("list", "watch"), (in_the_log,), begins_anew=True),
}


def names(lab: Lab, sweep: str, right: Right, saying: Callable[[Lab, str], str]) -> bool:
    """Tell whether the API server's words on a right stand somewhere."""
    return f'cannot {right.verbs[0]} resource "{right.resource}"' in saying(lab, sweep)


@contextmanager
def taken_away(lab: Lab, right: Right) -> Iterator[None]:
    """Take a right away from the operator as long as the context lasts."""
    rules = lab.get("role", ROLE)["rules"]
    lacking = []
    for rule in rules:
        for resource in rule["resources"]:
            is_it = (right.group, right.resource) in {(group, resource) for group in rule["apiGroups"]}
            verbs = [verb for verb in rule["verbs"] if not (is_it and verb in right.verbs)]
            lacking += [rule | {"resources": [resource], "verbs": verbs}] if verbs else []

    def write(held: list[dict[str, Any]]) -> None:
        lab.kubectl("patch", "role", ROLE, "--type=merge", "--patch", json.dumps({"rules": held}))

    write(lacking)
    try:
        yield
    finally:
        write(rules)


@pytest.mark.parametrize("name", RIGHTS)
def test_a_right_that_is_away_for_a_while_costs_no_run_and_is_told(lab: Lab, name: str) -> None:
    right, sweep = RIGHTS[name], f"without-{name}"
    lab.apply_algorithm(ROOT / "tests" / "images" / "shell-algorithm")
    speeds = [round(1 + 0.1 * step, 1) for step in range(POINTS)]
    lab.apply(
        manifest(
            "Sweep",
            sweep,
            template={"spec": lab.run("x", "shell-dead-reckoning")["spec"]},
            matrix=[{"path": "parameters.speed", "values": speeds}],
            parallelism=2,
            cachePolicy="Rerun",
        )
    )
    until(lambda: (lab.get("sweep", sweep).get("status") or {}).get("succeeded"), "the first run", 240)
    with taken_away(lab, right):
        back = time.monotonic() + AWAY_SECONDS
        if right.begins_anew:
            lab.kubectl("delete", "pod", *OPERATOR, "--force", "--grace-period=0")
        for saying in right.sayings:
            until(partial(names, lab, sweep, right, saying), f"{saying.__doc__}", 120)
        until(lambda: time.monotonic() >= back, "the time to pass")
    lab.completed(sweep, 300)
    until(lambda: lab.get("sweep", sweep)["status"].get("evaluated") == POINTS, "all results", 240)

    status, runs = lab.get("sweep", sweep)["status"], lab.runs(sweep)
    assert (status["succeeded"], status["failed"], status["running"]) == (POINTS, 0, 0)
    assert [run["spec"]["parameters"]["speed"] for run in runs] == speeds
    of_sweep = ("-l", f"slamhive.io/sweep={sweep},slamhive.io/role=run")
    for kind in ("jobs", "pods"):
        items = lab.get(kind, *of_sweep)["items"]
        each = Counter(item["metadata"]["labels"]["slamhive.io/run"] for item in items)
        assert each == {run["metadata"]["name"]: run["status"]["attempts"] for run in runs}
    for run in runs:
        assert needed_one_attempt(run["status"])
        assert len(run["status"]["results"]) == 1
    until(lambda: not at_the_sweep(lab, sweep), "the sentence to be taken back")
