# SPDX-License-Identifier: Apache-2.0
"""Prometheus metrics: live gauges of running pods, histograms of finished runs, and the operator's own state.

Live series carry a slot instead of a run's name, so that a sweep of 80,000 runs has as many series as it has
runs at a time. They are made at each scrape from the pods alive then: what is gone leaves nothing behind.
"""

from __future__ import annotations

from collections import Counter as Tally
from typing import TYPE_CHECKING, Any, NamedTuple

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Histogram,
    ProcessCollector,
    disable_created_metrics,
    start_http_server,
)
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector

from slamhive.kube.status import rmse_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from wsgiref.simple_server import WSGIServer

    from prometheus_client.metrics_core import Metric

    from slamhive.kube.queue import Queue

_LIVE_LABELS = ("namespace", "sweep", "algorithm", "dataset", "slot")
_RUN_LABELS = ("algorithm", "dataset")
_SECONDS = tuple(base * 10.0**power for power in range(5) for base in (1.0, 2.0, 5.0))
_BYTES = tuple(2.0**power for power in range(24, 38))
_METRES = tuple(base * 10.0**power for power in range(-3, 2) for base in (1.0, 2.0, 5.0))
_RECONCILE_SECONDS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)


class PodLabels(NamedTuple):
    """Labels of the live Prometheus series of a run's pod."""

    namespace: str
    sweep: str
    algorithm: str
    dataset: str
    slot: str
    run: str


class Metrics:
    """All series, in a registry of their own.

    Args:
        run_name_label: whether live series carry the run's name too.
    """

    def __init__(self, *, run_name_label: bool = False) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]  # they double the series for nothing
        self.registry = CollectorRegistry()
        self.live = _Live(run_name_label=run_name_label)
        self._state = _OperatorState()
        self.registry.register(self.live)
        self.registry.register(self._state)
        ProcessCollector(registry=self.registry)
        self._cpu = self._histogram("run_cpu_seconds", "CPU time of finished runs in s.", _SECONDS)
        self._memory = self._histogram("run_memory_peak_bytes", "Resident peak of finished runs.", _BYTES)
        self._wall = self._histogram("run_wall_seconds", "Wall time of finished runs in s.", _SECONDS)
        self._ate = self._histogram("run_ate_metres", "RMSE of the absolute trajectory error in m.", _METRES)
        self._finished = Counter(
            "slamhive_runs_finished",
            "Runs that finished.",
            (*_RUN_LABELS, "phase", "reason"),
            registry=self.registry,
        )
        self._outcomes = Counter(
            "slamhive_runs_evaluated",
            "Runs that were evaluated.",
            (*_RUN_LABELS, "outcome"),
            registry=self.registry,
        )
        self._reconcile = Histogram(
            "slamhive_reconcile_seconds",
            "Time to reconcile one object in s.",
            ("kind", "outcome"),
            buckets=_RECONCILE_SECONDS,
            registry=self.registry,
        )
        self._errors = Counter(
            "slamhive_errors", "Things that went wrong.", ("where", "reason"), registry=self.registry
        )
        self._calls = Counter(
            "slamhive_api_calls",
            "Calls to the Kubernetes API.",
            ("verb", "resource", "code"),
            registry=self.registry,
        )

    def serve(self, port: int, address: str = "0.0.0.0") -> WSGIServer:  # noqa: S104 - Prometheus is outside
        """Serve the series over HTTP; returns the server, whose ``server_port`` is the port."""
        return start_http_server(port, address, registry=self.registry)[0]

    def record_finished(self, algorithm: str, dataset: str, status: Mapping[str, Any]) -> None:
        """Count a run that has just finished, by the status it got: call it once a run."""
        phase, reason = status.get("phase") or "", status.get("reason") or ""
        self._finished.labels(algorithm, dataset, phase, reason).inc()
        usage = status.get("usage") or {}
        figures = {
            self._cpu: (usage.get("cpu") or {}).get("seconds"),
            self._memory: (usage.get("memory") or {}).get("peakBytes"),
            self._wall: usage.get("wallSeconds"),
        }
        for histogram, value in figures.items():
            if value is not None:
                histogram.labels(algorithm, dataset).observe(value)

    def record_result(self, algorithm: str, dataset: str, result: Mapping[str, Any]) -> None:
        """Count what the run's own evaluation found: call it once a run."""
        self._outcomes.labels(algorithm, dataset, result.get("outcome") or "").inc()
        rmse = rmse_of(result)
        if rmse is not None:
            self._ate.labels(algorithm, dataset).observe(rmse)

    def count_call(self, verb: str, resource: str, code: str) -> None:
        """Count an attempt of a call to the API."""
        self._calls.labels(verb, resource, code).inc()

    def count_error(self, where: str, reason: str) -> None:
        """Count something that went wrong."""
        self._errors.labels(where, reason).inc()

    def observe_reconcile(self, kind: str, outcome: str, seconds: float) -> None:
        """Record how long an object took."""
        self._reconcile.labels(kind, outcome).observe(seconds)

    def watch_queue(self, queue: Queue) -> None:
        """Show the queue's depth at each scrape."""
        self._state.queue = queue

    def watch_phases(self, phases: Callable[[], Mapping[tuple[str, str], int]]) -> None:
        """Show the runs by (namespace, phase) at each scrape."""
        self._state.phases = phases

    def _histogram(self, name: str, text: str, buckets: tuple[float, ...]) -> Histogram:
        return Histogram(f"slamhive_{name}", text, _RUN_LABELS, buckets=buckets, registry=self.registry)


class _Live(Collector):
    """CPU and memory of the pods alive; figures of pods with the same labels are added up."""

    def __init__(self, *, run_name_label: bool) -> None:
        self._named = run_name_label
        self._figures: dict[str, tuple[PodLabels, float, float]] = {}

    def show(self, uid: str, labels: PodLabels, cores: float, memory_bytes: float) -> None:
        """Show the figures of a pod."""
        self._figures[uid] = (labels, cores, memory_bytes)

    def drop(self, uid: str) -> None:
        """Show a pod no more."""
        self._figures.pop(uid, None)

    def keep(self, uids: set[str]) -> None:
        """Drop all pods but these."""
        # A copy, as dropping changes what is gone through.
        for uid in [*self._figures]:
            if uid not in uids:
                self.drop(uid)

    def __len__(self) -> int:
        return len(self._figures)

    def collect(self) -> Iterator[Metric]:
        """Return the series; called by the server's thread."""
        names = (*_LIVE_LABELS, "run") if self._named else _LIVE_LABELS
        cores: Tally[tuple[str, ...]] = Tally()
        memory: Tally[tuple[str, ...]] = Tally()
        # Of a copy: this is the thread of the server, and the operator writes meanwhile.
        for labels, pod_cores, pod_memory in [*self._figures.values()]:
            values = tuple(labels)[: len(names)]
            cores[values] += pod_cores  # type: ignore[assignment]
            memory[values] += pod_memory  # type: ignore[assignment]
        yield _family("slamhive_run_cpu_cores", "Cores that a run's algorithm uses.", names, cores)
        yield _family("slamhive_run_memory_bytes", "Working set of a run's algorithm.", names, memory)


class _OperatorState(Collector):
    """The operator's state at the moment of the scrape."""

    queue: Queue | None = None
    phases: Callable[[], Mapping[tuple[str, str], int]] | None = None

    def collect(self) -> Iterator[Metric]:
        """Return the series; called by the server's thread."""
        depths: dict[tuple[str, ...], int] = {}
        if self.queue is not None:
            depths = {
                ("ready",): len(self.queue),
                ("delayed",): self.queue.delayed,
                ("active",): len(self.queue.active),
            }
        yield _family("slamhive_queue_depth", "Objects that wait to be looked at.", ("state",), depths)
        phases = self.phases() if self.phases is not None else {}
        yield _family("slamhive_runs", "Runs that exist, by phase.", ("namespace", "phase"), phases)


def _family(name: str, text: str, labels: tuple[str, ...], values: Mapping[Any, float]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, text, labels=labels)
    for label_values, value in values.items():
        family.add_metric(label_values, value)
    return family
