# SPDX-License-Identifier: Apache-2.0
"""A kind cluster for the tests, where a Docker daemon answers."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from testcluster.access import Cluster
from testcluster.errors import ClusterError
from testcluster.places import home, locked

CONFIG = Path(__file__).resolve().parents[3] / "kind-config.yaml"
_PROGRAMS = {
    "docker": "docs.docker.com/engine/install",
    "kind": "kind.sigs.k8s.io",
    "kubectl": "kubernetes.io/docs/tasks/tools",
}


def missing() -> list[str]:
    """Return a sentence for each thing that a kind cluster lacks here."""
    found = [
        f"it needs {name} on the PATH: {place}" for name, place in _PROGRAMS.items() if not shutil.which(name)
    ]
    if not found and subprocess.run(["docker", "info"], capture_output=True, check=False).returncode:
        found.append("it needs a Docker daemon that answers: docker info")
    return found


@dataclass(frozen=True)
class Kind:
    """One kind cluster."""

    name: str

    @property
    def cluster(self) -> str:
        """Name of the cluster as kind knows it."""
        return f"slamhive-test-{self.name}"

    @property
    def kubeconfig(self) -> Path:
        """A kubeconfig of its own; the user's stays as it is."""
        return home() / f"{self.cluster}.kubeconfig"

    def alive(self) -> bool:
        """Tell whether it answers."""
        return self.kubeconfig.exists() and self.access().run("get", "--raw", "/readyz").returncode == 0

    def access(self) -> Cluster:
        """Return the running cluster as tests see it."""
        return Cluster("kind", self.kubeconfig, shutil.which("kubectl") or "kubectl", self._load)

    def up(self, *, node: bool = True, owner: int | None = None) -> Cluster:
        """Start it unless it runs."""
        del node, owner
        if problems := missing():
            raise ClusterError("\n".join(problems))
        with locked("instances"):
            if not self.alive():
                for name in ("data", "results"):
                    (CONFIG.parent / "kind-data" / name).mkdir(parents=True, exist_ok=True)
                self._kind(
                    *("create", "cluster", "--name", self.cluster, "--config", str(CONFIG)),
                    *("--kubeconfig", str(self.kubeconfig), "--wait", "300s"),
                )
        return self.access()

    def down(self) -> None:
        """End it."""
        with locked("instances"):
            self._kind("delete", "cluster", "--name", self.cluster, "--kubeconfig", str(self.kubeconfig))
            self.kubeconfig.unlink(missing_ok=True)

    def _load(self, image: str) -> None:
        self._kind("load", "docker-image", image, "--name", self.cluster)

    def _kind(self, *arguments: str) -> None:
        result = subprocess.run(
            ["kind", *arguments], cwd=CONFIG.parent, capture_output=True, text=True, check=False
        )
        if result.returncode:
            raise ClusterError(f"kind {arguments[0]} failed: {result.stderr.strip()[-1000:]}")
