# SPDX-License-Identifier: Apache-2.0
"""Pytest fixtures: laboratories, namespaces in which operators run in the test's own process."""

from __future__ import annotations

import itertools
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest
from testcluster.kwok import Play
from testcluster.lab import Lab, algorithm, bound_volumes, dataset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from testcluster.access import Cluster
    from testcluster.kwok import Kwok, Pool

__all__ = ["lab", "make_lab", "plays"]

_NUMBERS = itertools.count()


@pytest.fixture(scope="session")
def plays(kwok: Kwok) -> Iterator[Callable[[Play], Pool]]:
    """Pools of played nodes by how their pods end, kept for the session."""
    pools: dict[str, Pool] = {}
    with ExitStack() as stack:

        def play(how: Play) -> Pool:
            key = repr(how)
            if key not in pools:
                pools[key] = stack.enter_context(kwok.play(how, pool=f"pool{next(_NUMBERS)}"))
            return pools[key]

        yield play


@pytest.fixture
def make_lab(crds: Cluster, namespace: str, plays: Callable[[Play], Pool]) -> Iterator[Callable[..., Lab]]:
    """A function that gives the test's namespace a catalog, and pods that end in a given way."""
    disks, claims = bound_volumes(namespace)
    names = [f"pv/{body['metadata']['name']}" for body in disks]
    crds.apply(*disks)
    crds.kubectl("wait", "--for=jsonpath={.status.phase}=Available", "--timeout=240s", *names)
    crds.apply(*claims)

    def make(*, catalog: bool = True, **play: Any) -> Lab:
        lab = Lab(crds, namespace, plays(Play(**play)))
        if catalog:
            lab.apply(algorithm(), dataset())
        return lab

    yield make
    crds.kubectl("delete", *names, "--wait=false", "--ignore-not-found")


@pytest.fixture
def lab(make_lab: Callable[..., Lab]) -> Lab:
    """A namespace with catalog whose pods end well at once."""
    return make_lab()
