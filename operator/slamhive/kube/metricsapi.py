# SPDX-License-Identifier: Apache-2.0
"""The live view: CPU and memory of running algorithms, read from the cluster's metrics API.

One call a namespace, for all run pods. The figures go to Prometheus' gauges and are kept for each pod, so
that the exact ones of the monitor can be compared with them in the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.kube.api.errors import ApiError, Forbidden, NotFound
from slamhive.kube.api.kinds import Key, Kind, Label, Object, Role, labels_of
from slamhive.kube.metrics import PodLabels
from slamhive.model.base import quantity

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.kube.api.client import Api
    from slamhive.kube.metrics import Metrics
    from slamhive.kube.store import Store


CONTAINER = "algorithm"
RUN_PODS = f"{Label.ROLE}={Role.RUN}"
ENDED = frozenset({"Succeeded", "Failed"})
"""Phases of a pod whose containers run no more."""


@dataclass
class Observed:
    """CPU and memory of one pod's algorithm from the metrics API: the last figures and the largest.

    Attributes:
        samples: number of different samples seen.
        cores: the last CPU figure, a mean over the API's window (about 15 s).
        max_cores: the largest.
        memory_bytes: the last working set.
        max_memory_bytes: the largest.
        timestamp: the last sample's time, as the API writes it.
    """

    samples: int = 0
    cores: float = 0.0
    max_cores: float = 0.0
    memory_bytes: float = 0.0
    max_memory_bytes: float = 0.0
    timestamp: str = ""

    def add(self, timestamp: str, cores: float, memory_bytes: float) -> None:
        """Take in a sample; the same one again changes nothing."""
        # The API answers with the same sample until the kubelet's next one, some 15 s later.
        if timestamp and timestamp == self.timestamp:
            return
        self.timestamp = timestamp
        self.samples += 1
        self.cores, self.memory_bytes = cores, memory_bytes
        self.max_cores = max(self.max_cores, cores)
        self.max_memory_bytes = max(self.max_memory_bytes, memory_bytes)


class MetricsReader:
    """Reads the metrics API for all run pods.

    Args:
        api: the Kubernetes API.
        store: where pods are found by name.
        metrics: where the gauges are.
        namespaces: the operator's namespaces.

    Attributes:
        available: whether the metrics API answered last time; None before the first time.
        sentence: why not, in a sentence; empty when it did.
    """

    def __init__(self, api: Api, store: Store, metrics: Metrics, namespaces: Iterable[str]) -> None:
        self._api = api
        self._store = store
        self._metrics = metrics
        self._namespaces = tuple(namespaces)
        self._observed: dict[str, Observed] = {}
        self.available: bool | None = None
        self.sentence = ""

    def observed(self, pod_uid: str) -> Observed | None:
        """Return the observations of a pod; kept until the pod is gone."""
        return self._observed.get(pod_uid)

    def ended(self, pod_uid: str) -> None:
        """Show a pod that has ended no more; what was seen of it stays."""
        self._metrics.live.drop(pod_uid)

    def forget(self, pod_uid: str) -> None:
        """Forget a pod that is gone."""
        self._metrics.live.drop(pod_uid)
        self._observed.pop(pod_uid, None)

    async def read(self) -> bool:
        """Read the figures of all run pods; returns whether the API's availability changed.

        A namespace without running runs is not asked about once the API is known to be there.
        """
        before = self.available
        alive: set[str] = set()
        sentence = ""
        for namespace in self._namespaces:
            live = self._live_pods(namespace)
            alive.update(live.values())
            # The first time also an empty namespace is asked: people shall know before the first run whether
            # live figures will come.
            if not live and before is not None:
                continue
            try:
                items = await self._api.pod_metrics(namespace, RUN_PODS)
            except ApiError as error:
                sentence = _explained(error)
                continue
            self.available = True
            for item in items:
                self._take(namespace, item, live)
        # One namespace that can't be read is reason enough to say so, whatever the others answer.
        if sentence:
            self.available = False
        elif before is None:
            self.available = True
        if self.available:
            sentence = ""
        elif not sentence:
            sentence = self.sentence
        self.sentence = sentence
        self._metrics.live.keep(alive)
        return self.available is not before

    def _live_pods(self, namespace: str) -> dict[str, str]:
        return {
            pod["metadata"]["name"]: pod["metadata"]["uid"]
            for pod in self._store.of(Kind.POD, namespace)
            if labels_of(pod).get(Label.ROLE) == Role.RUN and pod["status"].get("phase") not in ENDED
        }

    def _take(self, namespace: str, item: Object, live: dict[str, str]) -> None:
        name = item["metadata"]["name"]
        uid = live.get(name)
        pod = self._store.get(Key(Kind.POD, namespace, name))
        # The API knows pods by name and may still answer for one that is gone; the uid tells a later one of
        # its name from it.
        if uid is None or pod is None or pod["metadata"]["uid"] != uid:
            return
        if pod["status"].get("phase") in ENDED:
            return
        for container in item.get("containers") or ():
            if container.get("name") == CONTAINER:
                usage = container.get("usage") or {}
                cores, memory = amount(usage.get("cpu", "0")), amount(usage.get("memory", "0"))
                self._observed.setdefault(uid, Observed()).add(item.get("timestamp", ""), cores, memory)
                self._metrics.live.show(uid, _pod_labels(namespace, pod), cores, memory)


def amount(text: str) -> float:
    """Return a quantity of the metrics API as a number; what is none counts as 0.

    >>> amount("250m"), amount("12345678n"), amount("64Mi")
    (0.25, 0.012345678, 67108864.0)
    """
    try:
        return quantity(text)
    except ValueError:
        return 0.0


def _pod_labels(namespace: str, pod: Object) -> PodLabels:
    labels = labels_of(pod)
    wanted = (Label.SWEEP, Label.ALGORITHM, Label.DATASET, Label.SLOT, Label.RUN)
    return PodLabels(namespace, *(labels.get(label, "") for label in wanted))


def _explained(error: ApiError) -> str:
    if isinstance(error, NotFound):
        return (
            "the cluster has no metrics API: live CPU and memory are missing in Prometheus, the monitor's "
            "exact figures still come; install metrics-server to have both"
        )
    if isinstance(error, Forbidden):
        return (
            f"live CPU and memory are missing: {error}; the chart's Role grants list of pods.metrics.k8s.io"
        )
    return f"live CPU and memory are missing, the metrics API does not answer: {error}"
