# SPDX-License-Identifier: Apache-2.0
"""A maker of objects for the tests of upgrades: what a cluster stores of a sweep half done, and its kinds.

    .venv/bin/python -m pytest -p no:cacheprovider tests/upgrade/make_objects.py

in a checkout of the version writes ``tests/upgrade/objects/VERSION.tar.xz``. Nodes are played; the API
server, the operator and what it writes are real.
"""

from __future__ import annotations

import io
import json
import sys
import tarfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
for place in ("tests/cluster", "tests/kube/faults", "tests/upgrade"):
    sys.path.insert(0, str(ROOT / place))

from faultlab.arena import QUICK, played_logs  # noqa: E402
from own_cluster import own_cluster  # noqa: E402
from testcluster.fixtures import *  # noqa: E402, F403
from testcluster.lab import Lab, manifest, status_of, sweep  # noqa: E402
from testcluster.labs import *  # noqa: E402, F403

from slamhive import __version__  # noqa: E402
from slamhive.kube.api.client import Api  # noqa: E402
from slamhive.kube.api.kinds import Kind  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from testcluster.access import Cluster

OBJECTS = Path(__file__).parent / "objects"
NAMESPACE = "upgrade"
KINDS = ("algorithms", "datasets", "evaluations", "sweeps", "mappingruns")
POINTS = 6


@pytest.fixture(scope="session")
def control_plane() -> Iterator[Cluster]:
    """A cluster of its own: this version's kinds are not for the one that all tests share."""
    with own_cluster() as local:
        yield local.access()


async def test_make(make_lab: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop an operator half-way and pack what is stored then."""
    monkeypatch.setattr(Api, "logs", played_logs)
    lab = make_lab(delay_milliseconds=1000)
    lab.apply(
        sweep(sizes=POINTS, template={"evaluate": True}, parallelism=1),
        manifest("Evaluation", "origin", alignment="Origin", runs={"sweepRef": {"name": "study"}}),
    )
    async with lab.operator(**QUICK) as op:
        await status_of(op, Kind.SWEEP, "study", lambda status: status.get("succeeded", 0) >= POINTS // 2)
    pack(lab)


def pack(lab: Lab) -> None:
    """Write what is stored of a namespace, as it is but for its name."""
    items: list[dict[str, Any]] = []
    for kind in KINDS:
        items += lab.cluster.get(f"{kind}.slamhive.io", "-n", lab.namespace)["items"]
    for item in items:
        for name in ("managedFields", "resourceVersion"):
            item["metadata"].pop(name, None)
    text = json.dumps(items, indent=1, sort_keys=True).replace(lab.namespace, NAMESPACE)
    OBJECTS.mkdir(exist_ok=True)
    with tarfile.open(OBJECTS / f"{__version__}.tar.xz", "w:xz", preset=9) as archive:
        entry = tarfile.TarInfo("objects.json")
        entry.size = len(text.encode())
        archive.addfile(entry, io.BytesIO(text.encode()))
        for path in sorted((ROOT / "crds").glob("*.yaml")):
            archive.add(path, f"crds/{path.name}")
