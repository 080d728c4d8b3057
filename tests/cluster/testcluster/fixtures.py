# SPDX-License-Identifier: Apache-2.0
"""Pytest fixtures: clusters for a session, a namespace for a test.

A cluster that `make cluster-up` started is used and left up; otherwise the first test that needs one starts
it, and it ends with the session, however that ends. Where there can be none, tests are skipped and say how to
have one; where SLAMHIVE_TEST_CLUSTER asks for one in vain, they fail.
"""

from __future__ import annotations

import itertools
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from testcluster import choice
from testcluster.kwok import Kwok
from testcluster.local import Local
from testcluster.places import DEFAULT
from testcluster.programs import build, files_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from testcluster.access import Cluster
    from testcluster.kind import Kind

CRDS = sorted((Path(__file__).resolve().parents[3] / "crds").glob("*.yaml"))
_NUMBERS = itertools.count()
_SESSION = pytest.StashKey["_Session"]()


class _Session:
    """The cluster of one test session."""

    def __init__(self, session: pytest.Session) -> None:
        self._session = session
        self._ours: Local | Kind | choice.Current | None = None
        self._pipe: tuple[int, int] | None = None

    def cluster(self, *, node: bool) -> Cluster:
        """Return the running cluster, started or completed as needed."""
        chosen = choice.choose()
        if chosen.problems and chosen.asked:
            pytest.fail(chosen.sentence(), pytrace=False)
        if chosen.mode == "none":
            pytest.skip(chosen.sentence())
        if self._ours is None:
            usual = choice.cluster(DEFAULT)
            # Sessions side by side would stop each other's programs and count each other's nodes.
            if "PYTEST_WORKER" not in os.environ and usual.alive():
                return usual.up(node=node)
            self._ours = choice.cluster(f"test{os.getpid()}")
            self._pipe = os.pipe()
            self._session.addfinalizer(self.end)
        return self._ours.up(node=node, owner=self._pipe[0] if self._pipe else None)

    def end(self) -> None:
        """End the cluster that the session started."""
        if self._ours is not None:
            self._ours.down()
            self._ours = None
        for descriptor in self._pipe or ():
            os.close(descriptor)
        self._pipe = None


def _session(request: pytest.FixtureRequest) -> _Session:
    stash = request.config.stash
    if _SESSION not in stash:
        stash[_SESSION] = _Session(request.session)
    return stash[_SESSION]


@pytest.fixture(scope="session")
def control_plane(request: pytest.FixtureRequest) -> Cluster:
    """An API server with its controllers and scheduler; there may be no node."""
    return _session(request).cluster(node=False)


@pytest.fixture(scope="session")
def node_cluster(request: pytest.FixtureRequest) -> Cluster:
    """The same cluster with a node on which pods run, and the metrics API."""
    return _session(request).cluster(node=True)


@pytest.fixture(scope="session")
def local_cluster(node_cluster: Cluster) -> Local:
    """The same as a cluster whose programs can be stopped and started."""
    return _local(node_cluster)


@pytest.fixture(scope="session")
def local_control_plane(control_plane: Cluster) -> Local:
    """The control plane as one whose programs can be stopped, and whose etcd can be told something."""
    return _local(control_plane)


def _local(cluster: Cluster) -> Local:
    if cluster.instance is None:
        pytest.skip("only a local cluster's programs are ours")
    return Local.named(cluster.instance)


@pytest.fixture(scope="session")
def crds(control_plane: Cluster) -> Cluster:
    """The cluster with our kinds."""
    control_plane.apply_files(CRDS)
    control_plane.await_kinds(f"{path.stem.partition('_')[2]}.slamhive.io" for path in CRDS)
    return control_plane


@pytest.fixture
def make_namespace(request: pytest.FixtureRequest, control_plane: Cluster) -> Iterator[Callable[[str], str]]:
    """A function that makes namespaces with restricted Pod Security, named after the test and a suffix."""
    made: list[str] = []
    stem = re.sub("[^a-z0-9]+", "-", request.node.name.lower()).strip("-")[:40].strip("-")

    def make(suffix: str = "") -> str:
        name = f"t-{stem}-{os.getpid()}-{next(_NUMBERS)}{suffix}"
        labels = {"pod-security.kubernetes.io/enforce": "restricted"}
        metadata = {"name": name, "labels": labels}
        control_plane.apply({"apiVersion": "v1", "kind": "Namespace", "metadata": metadata})
        made.append(name)
        return name

    yield make
    for name in made:
        control_plane.kubectl("delete", "namespace", name, "--wait=false", "--ignore-not-found")


@pytest.fixture
def namespace(make_namespace: Callable[[str], str]) -> str:
    """A namespace of the test's own with restricted Pod Security."""
    return make_namespace("")


@pytest.fixture(scope="session")
def kueue(local_control_plane: Local) -> Iterator[Local]:
    """The control plane with Kueue at work; its kinds stay, and what tests make of them."""
    build(("kueue",))
    cluster = local_control_plane.access()
    paths = sorted(files_of("kueue").glob("*.yaml"))
    cluster.apply_files(paths)
    cluster.await_kinds(f"{path.stem.partition('_')[2]}.kueue.x-k8s.io" for path in paths)
    local_control_plane.start("kueue")
    yield local_control_plane
    local_control_plane.stop("kueue")


@pytest.fixture(scope="session")
def kwok(control_plane: Cluster) -> Kwok:
    """Nodes and pods that are only played."""
    return Kwok(control_plane)
