# SPDX-License-Identifier: Apache-2.0
"""Times that forecasts of Sweeps go by."""

from __future__ import annotations

from typing import Any

from slamhive.kube.reconciling.sweep_forecast import RunTimes, ToldTime
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
    times.look([a_run("two", "Running")], {"one"}, BEGIN + 70)
    ended = times.look([], {"two"}, BEGIN + 74)
    assert [flight.name for flight in ended] == ["two"]
    assert times.mean(("icp", "hall")) == (10 + 14) / 2


def test_the_wait_for_a_node_is_no_time_of_a_run() -> None:
    times = RunTimes()
    times.look([a_run("one")], set(), BEGIN)
    times.look([a_run("one")], set(), BEGIN + 9, waiting={"one"})
    [ended] = times.look([], {"one"}, BEGIN + 13)
    assert times.mean(("icp", "hall")) == 4
    assert ended.made == BEGIN  # by which others are found to be passed over


def test_the_wait_for_an_image_is_no_time_of_a_run() -> None:
    times, held = RunTimes(), a_run("one", "Pending")
    held["status"]["conditions"] = [{"type": "Scheduled", "status": "False", "reason": "ImagePullBackOff"}]
    times.look([held], set(), BEGIN)
    times.look([held], set(), BEGIN + 50)
    times.look([], {"one"}, BEGIN + 60)
    assert times.mean(("icp", "hall")) == 10


def test_runs_that_were_deleted_or_cancelled_say_nothing_of_the_time_that_one_takes() -> None:
    times = RunTimes()
    times.look([a_run("deleted"), a_run("done")], set(), BEGIN)
    times.look([a_run("done")], set(), BEGIN + 2)
    times.look([], {"done"}, BEGIN + 8)
    cancelled = a_run("cancelled", "Cancelled")
    cancelled["status"]["completionTime"] = iso(BEGIN + 2)
    times.learn([cancelled])
    assert (times.ended, times.mean(("icp", "hall"))) == (1, 8)


def test_a_new_operator_takes_the_time_of_ended_runs_without_their_waits() -> None:
    times, ended = RunTimes(), a_run("one", "Succeeded")
    ended["status"] |= {"startTime": iso(BEGIN + 50), "completionTime": iso(BEGIN + 60)}
    times.learn([ended])
    assert times.mean(("icp", "hall")) == 10


def test_what_is_told_is_near_the_time_that_it_stands_for() -> None:
    told, seconds = ToldTime(), 1e6
    while seconds > 75:
        told.words(seconds)
        assert told.seconds is not None
        assert 1 / 1.16 < told.seconds / seconds < 1.16
        seconds *= 0.99
