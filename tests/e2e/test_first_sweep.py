# SPDX-License-Identifier: Apache-2.0
"""The document's first sweep: done as it says, as accurate as on a workstation, and seen by Prometheus."""

from __future__ import annotations

import re
from collections import Counter
from datetime import datetime
from typing import TYPE_CHECKING, Any

import pytest
from onnode.first import GAUGES, LONG, NAME
from onnode.lab import needed_one_attempt

if TYPE_CHECKING:
    from onnode.first import First

SEEN_SECONDS = 150
"""A run of that length doesn't slip through between two readings of the metrics API, on a busy node too."""


def place(spec: dict[str, Any]) -> tuple[Any, ...]:
    return (
        spec["algorithmRef"]["name"],
        spec["parameters"]["maxRange"],
        spec["input"]["frameRate"],
        spec["repetition"],
    )


def test_every_run_is_done_once_and_measured(first: First) -> None:
    assert "sweep.slamhive.io/first condition met" in first.told
    assert [run["metadata"]["labels"]["slamhive.io/point"] for run in first.runs] == [*map(str, range(16))]
    assert {first.status[name] for name in ("total", "succeeded", "evaluated")} == {16}
    assert first.status["failed"] == first.status["running"] == 0
    for run in first.runs:
        status = run["status"]
        assert status["phase"] == "Succeeded"
        assert needed_one_attempt(status)
        assert status["results"][0]["outcome"] == "Tracked"
        assert status["usage"]["cpu"]["seconds"] > 0
        assert status["usage"]["memory"]["peakBytes"] > 10_000_000
        assert status["usage"]["source"].startswith("cgroup")
    assert first.status["best"][0]["ate"] == min(ate(run) for run in first.runs)


def ate(run: dict[str, Any]) -> float:
    return float(run["status"]["results"][0]["ate"]["rmse"])


def test_results_are_those_of_a_workstation(first: First) -> None:
    """Both algorithms say of themselves that they are deterministic."""
    here = {
        (row["algorithm"], row["parameters.maxRange"], row["input.frameRate"], row["repetition"]): row
        for row in first.local
    }
    assert {place(run["spec"]) for run in first.runs} == here.keys()
    for run in first.runs:
        row, status = here[place(run["spec"])], run["status"]
        assert status["provenance"]["datasetSha256"] == row["provenance.datasetSha256"]
        assert status["provenance"]["specHash"] == row["provenance.specHash"]
        assert status["trajectory"]["poses"] == row["trajectory.poses"]
        assert ate(run) == pytest.approx(row["ate.rmse"], rel=1e-9), place(run["spec"])
        assert status["results"][0]["coverage"] == pytest.approx(row["coverage"], abs=1e-9)


def test_printed_columns(first: First, lab: Any) -> None:
    heading, *lines = lab.kubectl("get", "mappingruns").splitlines()
    assert heading.split() == [
        "NAME",
        "PHASE",
        "ALGORITHM",
        "DATASET",
        "OUTCOME",
        "ATE",
        "CPU",
        "MEMORY",
        "AGE",
    ]
    (line,) = [line for line in lines if line.startswith(f"{LONG}-")]
    assert re.search(r"Succeeded +kiss-icp +synthetic-lidar +Tracked +0\.\d+ m +0\.\d+ +\d+Mi", line)
    assert re.search(rf"^{NAME} +\w+ +16/16 +0 +0 +first-", lab.kubectl("get", "sweep", NAME, "--no-headers"))


def seconds(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def went_on(first: First) -> None:
    """Skip what an operator has that goes on, where a node without time for it has ended it by its probes."""
    assert "OOMKilled" not in first.anew
    if "probe failed" in first.anew:
        pytest.skip(f"the node had no time for the operator: {first.anew}")
    assert not first.anew


def watched(first: First) -> dict[str, Any]:
    if not first.gauges:
        pytest.skip("no prometheus: apt-get install prometheus")
    return first.gauges


@pytest.mark.parametrize("gauge", GAUGES)
def test_prometheus_has_the_live_gauges_of_each_run(first: First, gauge: str) -> None:
    """The long run, and others as long, by their slots, between their begins and their pods' ends."""
    went_on(first)
    series = watched(first)[gauge]
    long = [run for run in first.runs if run["status"]["usage"]["wallSeconds"] > SEEN_SECONDS]
    for run in [first.long, *long]:
        labels, status = run["metadata"].get("labels", {}), run["status"]
        wanted = {
            "namespace": run["metadata"]["namespace"],
            "sweep": labels.get("slamhive.io/sweep", ""),
            "slot": labels.get("slamhive.io/slot", ""),
            "algorithm": run["spec"]["algorithmRef"]["name"],
            "dataset": run["spec"]["datasetRef"]["name"],
        }
        begin, end = seconds(status["startTime"]), seconds(status["completionTime"])
        seen = [
            value
            for found, samples in series
            # Prometheus leaves out labels that are empty.
            if all(found.get(name, "") == word for name, word in wanted.items())
            for time, value in samples
            if begin <= time <= end
        ]
        assert seen, (wanted, begin, end)
        if gauge == "slamhive_run_memory_bytes":
            assert 0 < max(seen) < 1.2 * status["usage"]["memory"]["kernelPeakBytes"]
        else:
            assert 0 < max(seen) < 2
    slots = {found["slot"] for found, _ in series if found.get("sweep") == NAME}
    assert slots <= {"0", "1"}


def value(metrics: str, series: str) -> float:
    """Return a series' value, 0 where it isn't there."""
    found = re.search(rf"^{re.escape(series)} (\S+)$", metrics, re.MULTILINE)
    return float(found[1]) if found else 0.0


def test_histograms_and_counters_remain_and_live_series_do_not(first: First) -> None:
    went_on(first)
    assert not re.search(r"^slamhive_run_(cpu_cores|memory_bytes)\{", first.metrics, re.MULTILINE)
    runs = Counter(run["spec"]["algorithmRef"]["name"] for run in [*first.runs, first.long])
    assert runs == {"kiss-icp": 9, "genz-icp": 8}
    for algorithm, count in runs.items():
        labels = f'algorithm="{algorithm}",dataset="synthetic-lidar"'
        names = ("cpu_seconds", "memory_peak_bytes", "wall_seconds", "ate_metres")
        series = [f"slamhive_run_{name}_count{{{labels}}}" for name in names] + [
            f'slamhive_runs_finished_total{{{labels},phase="Succeeded",reason=""}}',
            f'slamhive_runs_evaluated_total{{{labels},outcome="Tracked"}}',
        ]
        added = {name: value(first.metrics, name) - value(first.before, name) for name in series}
        assert added == dict.fromkeys(series, count)


def test_no_pod_of_a_finished_run_is_alive(first: First, lab: Any) -> None:
    phases = {pod["status"]["phase"] for pod in lab.get("pods", "-l", f"slamhive.io/sweep={NAME}")["items"]}
    assert phases <= {"Succeeded", "Failed"}
