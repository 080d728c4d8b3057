# SPDX-License-Identifier: Apache-2.0
"""Times that forecasts of Sweeps go by."""

from __future__ import annotations

from typing import Any

from slamhive.kube.reconciling.sweep_forecast import RunTimes
from slamhive.kube.status import iso

BEGIN = 1.8e9


def a_run(name: str, phase: str | None = None) -> dict[str, Any]:
    return {
        "metadata": {"name": name, "uid": name, "creationTimestamp": iso(BEGIN)},
        "spec": {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}},
        "status": {"phase": phase} if phase else {},
    }


def test_the_wait_for_a_preparation_is_no_time_of_a_run() -> None:
    times = RunTimes()
    for seconds in (0, 30, 60):
        times.look([a_run("one", "Preparing"), a_run("two", "Preparing")], set(), BEGIN + seconds)
    times.look([a_run("one"), a_run("two", "Running")], set(), BEGIN + 62)
    times.look([a_run("two", "Running")], set(), BEGIN + 70)
    ended = times.look([], set(), BEGIN + 74)
    assert [flight.name for flight in ended] == ["two"]
    assert times.mean(("icp", "hall")) == (10 + 14) / 2
