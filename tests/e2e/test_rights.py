# SPDX-License-Identifier: Apache-2.0
"""Rights that the operator loses on a node in the middle of a sweep: each is told of, and no run is lost."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from onnode.lab import OPERATOR
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
    speeds = lab.begin(sweep, POINTS)
    until(lambda: (lab.get("sweep", sweep).get("status") or {}).get("succeeded"), "the first run", 240)
    with taken_away(lab, right):
        back = time.monotonic() + AWAY_SECONDS
        if right.begins_anew:
            lab.kubectl("delete", "pod", *OPERATOR, "--force", "--grace-period=0")
        for saying in right.sayings:
            until(partial(names, lab, sweep, right, saying), f"{saying.__doc__}", 120)
        until(lambda: time.monotonic() >= back, "the time to pass")
    lab.end_each_once(sweep, speeds)
    until(lambda: not at_the_sweep(lab, sweep), "the sentence to be taken back")
