# SPDX-License-Identifier: Apache-2.0
"""Operators that are killed, cut off and told nonsense, on a real control plane with played nodes."""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from faultlab import arena as arenas
from testcluster.labs import *  # noqa: F403

from slamhive.kube.api.client import Api

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from faultlab.arena import Arena
    from testcluster.access import Cluster
    from testcluster.kwok import Play, Pool


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let what operators leave half-read at their death be no warning."""
    for item in items:
        if item.nodeid.startswith("tests/kube/faults/"):
            item.add_marker(pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"))
            item.add_marker(pytest.mark.filterwarnings("ignore::ResourceWarning"))


@pytest.fixture
async def arena(
    crds: Cluster, plays: Callable[[Play], Pool], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[Arena]:
    """Arena in which instances of scenarios are played."""
    monkeypatch.setattr(Api, "logs", arenas.played_logs)
    gc.freeze()  # kopf collects garbage whenever it ends
    async with arenas.arena_on(crds, plays, tmp_path) as found:
        yield found
    gc.unfreeze()
    gc.collect()  # what is thrown away by kopf and by killed operators warns now or at the session's end
