# SPDX-License-Identifier: Apache-2.0
"""A team's namespace with SLAM Hive in it, on a node whose disk the tests can read."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml
from onnode.documents import ROOT, Desk
from testcluster.access import until

if TYPE_CHECKING:
    from pathlib import Path

    from testcluster.access import Cluster

API_VERSION = "slamhive.io/v1alpha1"
DATASET = "synthetic-lidar"
OPERATOR = ("-l", "app.kubernetes.io/component=operator")
RUNS = "mappingruns.slamhive.io"
SECONDS = 300.0
FRAMES = 80
"""Scans of the recording that takes the place of the catalog's, at 10 Hz."""
CLASS = {
    "apiVersion": "storage.k8s.io/v1",
    "kind": "StorageClass",
    "metadata": {"name": "disk", "annotations": {"storageclass.kubernetes.io/is-default-class": "true"}},
    "provisioner": "kubernetes.io/no-provisioner",
}
"""Storage class that the documents take for granted: claims that name no class get a volume."""


def manifest(kind: str, name: str, **spec: Any) -> dict[str, Any]:
    """Return an object of ours."""
    return {"apiVersion": API_VERSION, "kind": kind, "metadata": {"name": name}, "spec": spec}


def needed_one_attempt(status: dict[str, Any]) -> bool:
    """Tell whether a run was tried once, but for attempts that a busy node ended: those are repeated."""
    return bool(1 <= status["attempts"] <= 1 + (status.get("faults") or 0))


def stand_in() -> dict[str, Any]:
    """Return a shorter and coarser recording under the name of the catalog's."""
    body: dict[str, Any] = yaml.safe_load((ROOT / "examples" / "datasets" / f"{DATASET}.yaml").read_text())
    body["spec"]["recording"]["synthetic"] |= {
        "durationSeconds": FRAMES / 10,
        "loops": 0.15,
        "lidar": {"rings": 16, "columns": 360},
    }
    del body["spec"]["attributes"]
    return body


def disk(namespace: str, claim: str, folder: Path, size: str) -> dict[str, Any]:
    """Return a volume for a claim in a folder of the node."""
    anywhere = {"key": "kubernetes.io/os", "operator": "In", "values": ["linux"]}
    spec = {
        "storageClassName": CLASS["metadata"]["name"],
        "capacity": {"storage": size},
        "accessModes": ["ReadWriteOnce"],
        "claimRef": {"namespace": namespace, "name": claim},
        "local": {"path": str(folder)},
        "nodeAffinity": {"required": {"nodeSelectorTerms": [{"matchExpressions": [anywhere]}]}},
    }
    metadata = {"name": f"{namespace}-{claim}"}
    return {"apiVersion": "v1", "kind": "PersistentVolume", "metadata": metadata, "spec": spec}


@dataclass(frozen=True)
class Lab:
    """The namespace.

    Attributes:
        cluster: where it is.
        namespace: its name.
        desk: a shell in a checkout.
        results: the results volume, as a folder of the node.
        data: the data volume.
    """

    cluster: Cluster
    namespace: str
    desk: Desk
    results: Path
    data: Path

    def kubectl(self, *words: str, timeout: float = 120) -> str:
        """Run kubectl in the namespace."""
        return self.cluster.kubectl("-n", self.namespace, *words, timeout=timeout)

    def get(self, *words: str) -> Any:
        """Return objects of the namespace."""
        return self.cluster.get("-n", self.namespace, *words)

    def apply(self, *objects: dict[str, Any]) -> None:
        """Apply objects in the namespace."""
        self.cluster.apply(*objects, namespace=self.namespace)

    def apply_algorithm(self, folder: Path, **changes: Any) -> None:
        """Apply an Algorithm of the tests."""
        body = yaml.safe_load((folder / "algorithm.yaml").read_text())
        body["spec"] |= changes
        self.apply(body)

    def run(self, name: str, algorithm: str, **spec: Any) -> dict[str, Any]:
        """Return a small MappingRun."""
        base = {
            "algorithmRef": {"name": algorithm},
            "datasetRef": {"name": DATASET},
            "resources": {"cpu": "200m", "memory": "256Mi"},
            "timeout": "5m",
        }
        return manifest("MappingRun", name, **(base | spec))

    def begin(self, sweep: str, points: int, parallelism: int = 2) -> list[float]:
        """Begin a Sweep of runs that take a moment, and return the speeds that it runs."""
        self.apply_algorithm(ROOT / "tests" / "images" / "shell-algorithm")
        speeds = [round(1 + 0.1 * step, 1) for step in range(points)]
        self.apply(
            manifest(
                "Sweep",
                sweep,
                template={"spec": self.run("x", "shell-dead-reckoning")["spec"]},
                matrix=[{"path": "parameters.speed", "values": speeds}],
                parallelism=parallelism,
                cachePolicy="Rerun",
            )
        )
        return speeds

    def end_each_once(self, sweep: str, speeds: list[float]) -> list[dict[str, Any]]:
        """Wait for a Sweep that was begun, check that nothing was done twice, and return its runs."""
        self.completed(sweep)
        until(lambda: self.get("sweep", sweep)["status"].get("evaluated") == len(speeds), "all results", 240)
        status, runs = self.get("sweep", sweep)["status"], self.runs(sweep)
        assert (status["succeeded"], status["failed"], status["running"]) == (len(speeds), 0, 0)
        assert [run["spec"]["parameters"]["speed"] for run in runs] == speeds
        attempts = {run["metadata"]["name"]: run["status"]["attempts"] for run in runs}
        for kind in ("jobs", "pods"):
            items = self.get(kind, "-l", f"slamhive.io/sweep={sweep},slamhive.io/role=run")["items"]
            assert Counter(item["metadata"]["labels"]["slamhive.io/run"] for item in items) == attempts
        for run in runs:
            assert needed_one_attempt(run["status"])
            assert len(run["status"]["results"]) == 1
            folders = [*(self.results / "runs" / run["metadata"]["uid"]).iterdir()]
            assert len(folders) <= run["status"]["attempts"]
            assert any(str(folder).endswith(run["status"]["folder"]) for folder in folders)
        return runs

    def runs(self, sweep: str) -> list[dict[str, Any]]:
        """Return a Sweep's runs in the order of its points."""
        items = self.get(RUNS, "-l", f"slamhive.io/sweep={sweep}")["items"]
        return sorted(items, key=lambda item: int(item["metadata"]["labels"]["slamhive.io/point"]))

    def ended(self, name: str, seconds: float = SECONDS) -> dict[str, Any]:
        """Wait for the end of a run and return its status."""
        return self.wait("mappingrun", name, "Complete", seconds)

    def completed(self, name: str, seconds: float = SECONDS) -> dict[str, Any]:
        """Wait for the end of a Sweep and return its status."""
        return self.wait("sweep", name, "Complete", seconds)

    def evaluated(self, name: str, seconds: float = SECONDS) -> dict[str, Any]:
        """Wait for a run's own result and return its status."""
        return self.wait("mappingrun", name, "Evaluated", seconds)

    def wait(self, kind: str, name: str, condition: str, seconds: float = SECONDS) -> dict[str, Any]:
        """Wait for a condition of an object, as the documents do, and return the status."""
        kind = f"{kind}s.slamhive.io"
        limit = ("--for", f"condition={condition}", "--timeout", f"{seconds:g}s")
        try:
            self.kubectl("wait", f"{kind}/{name}", *limit, timeout=seconds + 60)
        except Exception:
            print(json.dumps(self.get(kind, name).get("status"), indent=1))  # noqa: T201 - what failed
            raise
        status: dict[str, Any] = self.get(kind, name)["status"]
        return status
