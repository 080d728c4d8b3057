# SPDX-License-Identifier: Apache-2.0
"""SLAM Hive on a real node, installed as its document says; all tests of this folder share it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "cluster"), str(HERE.parent / "contract"), str(HERE)]

from onnode import documents  # noqa: E402
from onnode.documents import ROOT, Desk  # noqa: E402
from onnode.first import First, follow  # noqa: E402
from onnode.lab import CLASS, Lab, disk, stand_in  # noqa: E402
from release import pack_charts  # noqa: E402
from testcluster.fixtures import *  # noqa: E402, F403

if TYPE_CHECKING:
    from collections.abc import Iterator

    from testcluster.access import Cluster

NAMESPACE = "lab"
"""Namespace of docs/kubernetes.md."""
IMAGES = ("slamhive", "evaluator", "kiss-icp", "genz-icp", "shell-algorithm")
"""Those that the tests run, as images/build calls them."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all tests of this folder."""
    for item in items:
        if item.nodeid.startswith("tests/e2e/"):
            item.add_marker("slow")
            item.add_marker("cluster")
            item.add_marker(pytest.mark.timeout(1800), append=False)


@pytest.fixture(scope="session")
def node_with_images(node_cluster: Cluster) -> Cluster:
    """The cluster with the images that the tests run."""
    if node_cluster.instance is None:
        pytest.skip("end-to-end tests use the node's disk: they run on a local cluster")
    # What is up to date is not built again.
    built = subprocess.run(
        [ROOT / "images" / "build", *IMAGES], capture_output=True, text=True, check=False, timeout=1500
    )
    if built.returncode:
        pytest.skip(f"the images can't be built: {built.stderr.strip()[-500:]}")
    for line in built.stdout.splitlines():
        node_cluster.load(f"docker.io/{line.split()[0]}")
    return node_cluster


@pytest.fixture(scope="session")
def desk(node_with_images: Cluster, tmp_path_factory: pytest.TempPathFactory) -> Desk:
    """A checkout with kubectl and helm on the PATH, its charts packed as in a release."""
    helm = os.environ.get("HELM") or shutil.which("helm")
    cached = Path(node_with_images.kubectl_path).parents[2] / "bin" / "helm"
    if helm is None and not cached.exists():
        pytest.skip("no helm: put it on the PATH, or `make cluster-up`, which builds it")
    programs = tmp_path_factory.mktemp("programs")
    (programs / "helm").symlink_to(helm or cached)
    (programs / "kubectl").symlink_to(node_with_images.kubectl_path)
    path = f"{programs}:{os.environ['PATH']}"
    made = Desk(programs / "checkout", node_with_images.environment | {"PATH": path})
    made.lay_out(pack_charts(programs / "helm", ROOT, programs, moment=0))
    return made


@pytest.fixture(scope="session")
def lab(node_with_images: Cluster, desk: Desk, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """SLAM Hive installed by the commands of docs/kubernetes.md, under restricted Pod Security.

    The catalog's recording is longer than a test needs: one of the same name is there before the chart, which
    leaves alone what it finds.
    """
    cluster = node_with_images
    volumes = tmp_path_factory.mktemp("volumes")
    names = [f"{NAMESPACE}-slamhive-{name}" for name in ("results", "data")]
    clear(cluster, desk, NAMESPACE, names)
    cluster.apply(CLASS)
    for name, size in (("results", "20Gi"), ("data", "50Gi")):
        (volumes / name).mkdir()
        cluster.apply(disk(NAMESPACE, f"slamhive-{name}", volumes / name, size))
    (install,) = documents.scripts(documents.sections("kubernetes.md")["Install"])
    kinds, _, rest = install.partition("kubectl create namespace")
    namespace, _, rest = rest.partition("helm install slamhive ")
    # As the document says for kinds that somebody has applied, as other tests do.
    known = cluster.run("get", "crd", "mappingruns.slamhive.io").returncode == 0
    desk.run(kinds.rstrip() + (" --take-ownership" if known else ""))
    desk.run(f"kubectl create namespace{namespace}")
    found = Lab(cluster, NAMESPACE, desk, volumes / "results", volumes / "data")
    found.apply(stand_in())
    told = desk.run(f"helm install slamhive {rest}")
    assert "ok    operator: ready" in told
    yield found
    cluster.kubectl("delete", "namespace", NAMESPACE, "--wait=false")
    cluster.kubectl("delete", "persistentvolume", *names, "--wait=false", "--ignore-not-found")
    cluster.kubectl("delete", "storageclass", CLASS["metadata"]["name"])


def clear(cluster: Cluster, desk: Desk, namespace: str, volumes: list[str]) -> None:
    """Take away what a session that was killed has left; the kinds stay."""
    desk.run("helm uninstall slamhive-crds --namespace kube-system --ignore-not-found")
    cluster.kubectl("delete", "namespace", namespace, "--ignore-not-found")
    cluster.kubectl("delete", "persistentvolume", *volumes, "--ignore-not-found")


@pytest.fixture(scope="session")
def first(lab: Lab, tmp_path_factory: pytest.TempPathFactory) -> First:
    """The document's first sweep, finished, watched by Prometheus and done on this machine too."""
    return follow(lab, tmp_path_factory.mktemp("first"))
