# SPDX-License-Identifier: Apache-2.0
"""Tests that today's operator goes on with what earlier versions left in a cluster, half a Sweep included.

Objects are laid into etcd as they were stored: an API server would give each a new uid, and the names of runs
follow from that of their Sweep.
"""

from __future__ import annotations

import base64
import json
import tarfile
from typing import TYPE_CHECKING, Any

import pytest
from make_objects import KINDS, NAMESPACE, OBJECTS, POINTS, QUICK, played_logs
from own_cluster import own_cluster
from testcluster.access import until
from testcluster.fixtures import CRDS
from testcluster.kwok import Kwok, Play
from testcluster.lab import Lab, bound_volumes, status_of

from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Kind

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from testcluster.access import Cluster
    from testcluster.local import Local

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(900)]


def store(local: Local, items: list[dict[str, Any]]) -> None:
    """Lay objects into a cluster's etcd."""
    pairs = []
    for item in items:
        metadata = item["metadata"]
        key = f"/registry/slamhive.io/{item['kind'].lower()}s/{metadata['namespace']}/{metadata['name']}"
        pair = {"key": key, "value": json.dumps(item)}
        pairs.append({name: base64.b64encode(text.encode()).decode() for name, text in pair.items()})
    local.tell_etcd("kv/put", pairs)


def establish(cluster: Cluster, paths: list[Path]) -> None:
    cluster.apply_files(paths)
    cluster.await_kinds(f"{path.stem.partition('_')[2]}.slamhive.io" for path in paths)


def objects(cluster: Cluster) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the objects, by kind and name."""
    items = [item for kind in KINDS for item in cluster.get(f"{kind}.slamhive.io", "-n", NAMESPACE)["items"]]
    return {(item["kind"], item["metadata"]["name"]): item for item in items}


@pytest.fixture(params=sorted(OBJECTS.glob("*.tar.xz")), ids=lambda path: path.stem)
def upgraded(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Any]:
    """A cluster that had an earlier version, with today's kinds, and what was in it before."""
    with tarfile.open(request.param) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # Python 3.11.4 has it
        archive.extractall(tmp_path)  # noqa: S202 - an archive of our own
    items = json.loads((tmp_path / "objects.json").read_text())
    with own_cluster() as local:
        cluster = local.access()
        establish(cluster, sorted((tmp_path / "crds").glob("*.yaml")))
        cluster.kubectl("create", "namespace", NAMESPACE)
        store(local, items)
        until(lambda: len(objects(cluster)) == len(items), "all that was stored")
        before = objects(cluster)
        establish(cluster, CRDS)
        yield cluster, before


def finished(found: dict[tuple[str, str], dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the runs that have ended, by name."""
    runs = {name: item for (kind, name), item in found.items() if kind == "MappingRun"}
    return {name: item for name, item in runs.items() if item.get("status", {}).get("phase") == "Succeeded"}


async def test_all_is_stored_again_as_it_was_and_the_operator_goes_on(
    upgraded: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One test, as a cluster of its own takes long, and the operator changes what is compared first."""
    cluster, before = upgraded
    stored_again(cluster, before)
    await goes_on(cluster, before, monkeypatch)


def stored_again(cluster: Cluster, before: dict[tuple[str, str], dict[str, Any]]) -> None:
    """Read and store every object by today's kinds: nothing of it changes, new fields have their defaults."""
    assert {kind for kind, _ in before} == {"Algorithm", "Dataset", "Evaluation", "Sweep", "MappingRun"}
    for (kind, name), item in before.items():
        cluster.kubectl("label", kind, name, "-n", NAMESPACE, "upgraded=yes")
        again = {"status": item["status"]} if "status" in item else {}
        how = ("--subresource=status", "--type=merge", "-p", json.dumps(again))
        cluster.kubectl("patch", kind, name, "-n", NAMESPACE, *how)
    after = objects(cluster)
    assert after.keys() == before.keys()
    for key, item in after.items():
        for part in ("spec", "status"):
            assert kept(item.get(part), before[key].get(part)) == before[key].get(part), key
        assert item["metadata"]["uid"] == before[key]["metadata"]["uid"]


def kept(now: Any, before: Any) -> Any:
    """Return a value without the fields of its objects that weren't there before."""
    if isinstance(now, dict) and isinstance(before, dict):
        return {name: kept(value, before[name]) for name, value in now.items() if name in before}
    if isinstance(now, list) and isinstance(before, list) and len(now) == len(before):
        return [kept(*pair) for pair in zip(now, before, strict=True)]
    return now


async def goes_on(
    cluster: Cluster, before: dict[tuple[str, str], dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Let today's operator bring the Sweep to its end: what has ended stays as it is."""
    monkeypatch.setattr(Api, "logs", played_logs)
    done = finished(before)
    assert POINTS // 2 <= len(done) < POINTS
    disks, claims = bound_volumes(NAMESPACE)
    cluster.apply(*disks)
    names = [f"pv/{body['metadata']['name']}" for body in disks]
    cluster.kubectl("wait", "--for=jsonpath={.status.phase}=Available", "--timeout=240s", *names)
    cluster.apply(*claims)
    with Kwok(cluster).play(Play()) as pool:
        lab = Lab(cluster, NAMESPACE, pool)
        async with lab.operator(**QUICK) as op:
            status = await status_of(op, Kind.SWEEP, "study", lambda found: found.get("phase") == "Complete")
            await status_of(op, Kind.EVALUATION, "origin", lambda found: found.get("evaluated") == POINTS)
    assert status["succeeded"] == POINTS
    after = finished(objects(cluster))
    assert len(after) == POINTS
    for name, item in done.items():
        assert after[name]["metadata"]["uid"] == item["metadata"]["uid"]
        assert after[name]["status"]["completionTime"] == item["status"]["completionTime"]
        assert after[name]["status"]["attempts"] == item["status"]["attempts"]
    jobs = cluster.get("jobs", "-n", NAMESPACE, "-l", "slamhive.io/role=run")["items"]
    assert not {job["metadata"]["labels"]["slamhive.io/run"] for job in jobs} & set(done)
