# SPDX-License-Identifier: Apache-2.0
"""Operators with all their reconcilers, on a fake API server and on a real one.

``make test`` runs all tests here on the fake one, without root. ``make test-cluster`` runs those that ask for
``lab`` or ``make_lab`` on a real one too; what only the fake one can do asks for ``fake_lab``.
"""

from __future__ import annotations

import gc
import os
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.cluster import FakeCluster
from testcluster.kwok import Play
from testcluster.lab import Lab, algorithm, dataset
from testcluster.labs import lab, plays  # noqa: F401 - fixtures
from testcluster.labs import make_lab as make_real_lab  # noqa: F401 - a fixture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@pytest.fixture(scope="session", autouse=True)
def frozen_memory() -> Iterator[None]:
    """Spare the collector what was there before: it looks through everything else after each operator."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture
def make_fake_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Lab]]:
    """A function that gives a fake cluster a catalog, and pods that end in a given way."""
    # The machine's own certificates take a tenth of a second to load, and nobody needs them here.
    monkeypatch.setenv("SSL_CERT_FILE", os.devnull)
    with ExitStack() as stack:
        cluster = stack.enter_context(FakeCluster(tmp_path))
        cluster.make_namespace("lab")

        def make(*, catalog: bool = True, **play: Any) -> Lab:
            made = Lab(cluster, "lab", stack.enter_context(cluster.play(Play(**play))))
            if catalog:
                made.apply(algorithm(), dataset())
            return made

        yield make


@pytest.fixture
def fake_lab(make_fake_lab: Callable[..., Lab]) -> Lab:
    """A fake cluster with a catalog, whose pods end well at once."""
    return make_fake_lab()


@pytest.fixture(params=["fake", pytest.param("real", marks=[pytest.mark.cluster, pytest.mark.timeout(900)])])
def make_lab(request: pytest.FixtureRequest) -> Callable[..., Lab]:
    """The same as ``make_fake_lab``, and the same on a real control plane."""
    make: Callable[..., Lab] = request.getfixturevalue(f"make_{request.param}_lab")
    return make
