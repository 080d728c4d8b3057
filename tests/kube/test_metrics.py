# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import urllib.request

import pytest

from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.metrics import Metrics, PodLabels
from slamhive.kube.queue import Queue

LABELS = {"namespace": "lab", "sweep": "s", "algorithm": "kiss", "dataset": "d", "slot": "0"}
POD = PodLabels("lab", "s", "kiss", "d", "0", "run-1")
RUN = {"algorithm": "kiss", "dataset": "d"}


@pytest.fixture
def metrics() -> Metrics:
    return Metrics()


def test_live_series_carry_a_slot_and_no_run(metrics: Metrics) -> None:
    metrics.live.show("uid", POD, 1.5, 2e6)
    value = metrics.registry.get_sample_value
    assert value("slamhive_run_cpu_cores", LABELS) == 1.5
    assert value("slamhive_run_memory_bytes", LABELS) == 2e6


def test_the_run_is_a_label_by_choice() -> None:
    metrics = Metrics(run_name_label=True)
    metrics.live.show("uid", POD, 1.5, 2e6)
    value = metrics.registry.get_sample_value
    assert value("slamhive_run_cpu_cores", LABELS | {"run": "run-1"}) == 1.5


def test_a_slot_taken_over_shows_one_series_and_a_gone_pod_none(metrics: Metrics) -> None:
    value = metrics.registry.get_sample_value
    metrics.live.show("old", POD, 1.0, 10.0)
    metrics.live.show("new", POD._replace(run="run-2"), 2.0, 20.0)
    assert value("slamhive_run_cpu_cores", LABELS) == 3.0
    metrics.live.drop("old")
    assert value("slamhive_run_cpu_cores", LABELS) == 2.0
    metrics.live.drop("new")
    assert value("slamhive_run_cpu_cores", LABELS) is None


def test_finished_runs_are_counted_and_measured(metrics: Metrics) -> None:
    usage = {"cpu": {"seconds": 12.5}, "memory": {"peakBytes": 3e8}, "wallSeconds": 30.0}
    metrics.record_finished("kiss", "d", {"phase": "Succeeded", "usage": usage})
    metrics.record_finished("kiss", "d", {"phase": "Failed", "reason": "OutOfMemory"})
    value = metrics.registry.get_sample_value
    counted = RUN | {"phase": "Failed", "reason": "OutOfMemory"}
    assert value("slamhive_runs_finished_total", counted) == 1
    assert value("slamhive_run_cpu_seconds_sum", RUN) == 12.5
    assert value("slamhive_run_cpu_seconds_count", RUN) == 1
    assert value("slamhive_run_memory_peak_bytes_sum", RUN) == 3e8
    assert value("slamhive_run_wall_seconds_bucket", RUN | {"le": "50.0"}) == 1
    assert value("slamhive_run_wall_seconds_bucket", RUN | {"le": "20.0"}) == 0


def test_results_are_counted_and_their_errors_measured(metrics: Metrics) -> None:
    metrics.record_result("kiss", "d", {"outcome": "Tracked", "ate": {"rmse": 0.03}})
    metrics.record_result("kiss", "d", {"outcome": "Lost"})
    value = metrics.registry.get_sample_value
    assert value("slamhive_runs_evaluated_total", RUN | {"outcome": "Lost"}) == 1
    assert value("slamhive_run_ate_metres_count", RUN) == 1
    assert value("slamhive_run_ate_metres_sum", RUN) == 0.03


async def test_the_operator_shows_its_state(metrics: Metrics) -> None:
    queue = Queue()
    metrics.watch_queue(queue)
    metrics.watch_phases(lambda: {("lab", "Running"): 3})
    queue.add(Key(Kind.SWEEP, "lab", "s"))
    metrics.count_call("get", "pods", "200")
    metrics.count_error("Sweep", "Conflict")
    metrics.observe_reconcile("Sweep", "ok", 0.02)
    value = metrics.registry.get_sample_value
    assert value("slamhive_queue_depth", {"state": "ready"}) == 1
    assert value("slamhive_runs", {"namespace": "lab", "phase": "Running"}) == 3
    assert value("slamhive_api_calls_total", {"verb": "get", "resource": "pods", "code": "200"}) == 1
    assert value("slamhive_errors_total", {"where": "Sweep", "reason": "Conflict"}) == 1
    assert value("slamhive_reconcile_seconds_sum", {"kind": "Sweep", "outcome": "ok"}) == 0.02


def test_the_series_are_served(metrics: Metrics) -> None:
    metrics.live.show("uid", POD, 1.5, 2e6)
    server = metrics.serve(0, "127.0.0.1")
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{server.server_port}/metrics") as answer:
            text = answer.read().decode()
    finally:
        server.shutdown()
        server.server_close()
    assert "slamhive_run_cpu_cores{" in text
    assert "_created" not in text
