# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Any

import pytest

from slamhive.kube.api.errors import ApiError, Forbidden, NotFound, ServerFault
from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.metrics import Metrics
from slamhive.kube.metricsapi import MetricsReader, amount
from slamhive.kube.store import Store

LABELS = {"namespace": "lab", "sweep": "s", "algorithm": "kiss", "dataset": "d", "slot": "3"}


class FakeApi:
    """Answers with samples, or with an error."""

    def __init__(self) -> None:
        self.answer: list[dict[str, Any]] | ApiError = []
        self.asked: list[tuple[str, str]] = []

    async def pod_metrics(self, namespace: str, labels: str) -> list[dict[str, Any]]:
        self.asked.append((namespace, labels))
        if isinstance(self.answer, ApiError):
            raise self.answer
        return self.answer


def pod(name: str, phase: str = "Running", version: int = 1) -> dict[str, Any]:
    labels = {
        Label.ROLE: "run",
        Label.SWEEP: "s",
        Label.ALGORITHM: "kiss",
        Label.DATASET: "d",
        Label.SLOT: "3",
        Label.RUN: "r",
    }
    metadata = {"name": name, "namespace": "lab", "uid": f"uid-{name}", "resourceVersion": str(version)}
    return {"metadata": metadata | {"labels": labels}, "status": {"phase": phase}}


def sample(name: str, cpu: str, memory: str, timestamp: str = "t1") -> dict[str, Any]:
    containers = [
        {"name": "monitor", "usage": {"cpu": "900m", "memory": "900Mi"}},
        {"name": "algorithm", "usage": {"cpu": cpu, "memory": memory}},
    ]
    return {"metadata": {"name": name}, "timestamp": timestamp, "containers": containers}


@pytest.fixture
def api() -> FakeApi:
    return FakeApi()


@pytest.fixture
def store() -> Store:
    return Store()


@pytest.fixture
def metrics() -> Metrics:
    return Metrics()


@pytest.fixture
def reader(api: FakeApi, store: Store, metrics: Metrics) -> MetricsReader:
    return MetricsReader(api, store, metrics, ["lab"])  # type: ignore[arg-type]


async def test_only_the_algorithm_counts(
    api: FakeApi, store: Store, metrics: Metrics, reader: MetricsReader
) -> None:
    store.put(Kind.POD, pod("p"))
    api.answer = [sample("p", "1500m", "64Mi"), sample("unknown", "1", "1Gi")]
    await reader.read()
    value = metrics.registry.get_sample_value
    assert value("slamhive_run_cpu_cores", LABELS) == 1.5
    assert value("slamhive_run_memory_bytes", LABELS) == 64 * 2**20
    assert len(metrics.live) == 1
    assert api.asked == [("lab", "slamhive.io/role=run")]


async def test_the_largest_of_what_was_seen_is_kept(
    api: FakeApi, store: Store, reader: MetricsReader
) -> None:
    store.put(Kind.POD, pod("p"))
    figures = [("2", "10Mi", "t1"), ("9", "99Mi", "t1"), ("1", "30Mi", "t2")]
    for cpu, memory, timestamp in figures:
        api.answer = [sample("p", cpu, memory, timestamp)]
        await reader.read()
    seen = reader.observed("uid-p")
    assert seen is not None
    assert (seen.samples, seen.cores, seen.max_cores) == (2, 1.0, 2.0)
    assert (seen.memory_bytes, seen.max_memory_bytes) == (30 * 2**20, 30 * 2**20)


async def test_an_ended_pod_leaves_the_gauges_but_not_what_was_seen(
    api: FakeApi, store: Store, metrics: Metrics, reader: MetricsReader
) -> None:
    store.put(Kind.POD, pod("p"))
    api.answer = [sample("p", "1", "1Mi")]
    await reader.read()
    store.put(Kind.POD, pod("p", "Succeeded", 2))
    await reader.read()
    assert len(metrics.live) == 0
    assert reader.observed("uid-p") is not None
    reader.forget("uid-p")
    assert reader.observed("uid-p") is None


async def test_a_pod_that_is_gone_leaves_the_gauges(
    api: FakeApi, store: Store, metrics: Metrics, reader: MetricsReader
) -> None:
    store.put(Kind.POD, pod("p"))
    api.answer = [sample("p", "1", "1Mi")]
    await reader.read()
    store.remove(Kind.POD, "lab", "p")
    await reader.read()
    assert len(metrics.live) == 0


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (NotFound("no"), "the cluster has no metrics API"),
        (ServerFault("503"), "the metrics API does not answer: 503"),
        (Forbidden("may not"), "may not; the chart's Role grants list of pods.metrics.k8s.io"),
    ],
)
async def test_a_missing_metrics_api_is_told_and_comes_back(
    api: FakeApi, store: Store, reader: MetricsReader, error: ApiError, words: str
) -> None:
    api.answer = error
    assert await reader.read()
    assert reader.available is False
    assert words in reader.sentence
    assert not await reader.read()
    assert words in reader.sentence
    store.put(Kind.POD, pod("p"))
    api.answer = []
    assert await reader.read()
    assert (reader.available, reader.sentence) == (True, "")


async def test_idle_namespaces_are_not_asked_about(api: FakeApi, reader: MetricsReader) -> None:
    assert await reader.read()
    assert not await reader.read()
    assert len(api.asked) == 1


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0),
        ("250m", 0.25),
        ("5u", 5e-6),
        ("1500000000n", 1.5),
        ("2Ki", 2048.0),
        ("-", 0.0),
        ("1X", 0.0),
    ],
)
def test_quantities_of_the_metrics_api(text: str, value: float) -> None:
    assert amount(text) == pytest.approx(value)
