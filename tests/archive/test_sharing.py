# SPDX-License-Identifier: Apache-2.0
"""One database that clusters, their namespaces and a laptop write to."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from slamhive.analysis.selection import Selection, choose
from slamhive.archive import Archive, SweepRecord, Totals
from slamhive.engine import PointState
from slamhive.kube.reconciling.sweep_state import remember
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.results import CpuUsage, MemoryUsage, Phase, Usage
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.reconciling.sweep_state import SweepMemory
    from slamhive.model.results import RunRecord

    MakeRun = Callable[..., RunRecord]

LAPTOP = (None, None)
PLACES = [("cluster-a", "lab"), ("cluster-a", "students"), ("cluster-b", "lab"), LAPTOP]
HEAD = {"apiVersion": "slamhive.io/v1alpha1"}
ALGORITHM = Algorithm.model_validate(
    HEAD
    | {"kind": "Algorithm", "metadata": {"name": "icp"}}
    | {"spec": {"image": "icp:1", "modes": [{"name": "lidar"}], "output": {"frame": "lidar"}}}
)
DATASET = Dataset.model_validate(
    HEAD
    | {"kind": "Dataset", "metadata": {"name": "hall"}}
    | {
        "spec": {
            "recording": {"files": [{"path": "a.bag"}]},
            "sensors": {"lidar": {"type": "Lidar", "topic": "/points", "rate": 10}},
        }
    }
)


def uid_of(place: tuple[str | None, str | None]) -> str:
    return f"{PLACES.index(place)}0000000-0000-4000-8000-000000000000"


def a_sweep(place: tuple[str | None, str | None]) -> Sweep:
    spec = {"template": {"spec": {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}}}
    meta = {"name": "first", "namespace": place[1], "uid": uid_of(place)}
    return Sweep.model_validate(HEAD | {"kind": "Sweep", "metadata": meta, "spec": spec | {"repetitions": 4}})


async def recalled(url: str, place: tuple[str | None, str | None]) -> SweepMemory:
    """Return the memory of its Sweep that an operator which starts in a place has from the archive."""
    catalog = FixedCatalog({"icp": ALGORITHM}, {"hall": DATASET})
    with Archive.open(url) as archive:
        return await remember(a_sweep(place), {}, catalog, [], archive, accepted=True, cluster=place[0])


async def test_sweeps_are_told_apart_by_uid_in_a_shared_archive(url: str, make_run: MakeRun) -> None:
    """All are called ``first`` and have the same points; some of each are done."""
    with Archive.open(url) as archive:
        archive.put_sweep(
            SweepRecord(uid=uid_of(LAPTOP), name="first", spec={}, created=datetime(2026, 1, 1, tzinfo=UTC))
        )
    for place in PLACES[:-1]:
        await recalled(url, place)
    before = {}
    with Archive.open(url) as archive:
        for number, place in enumerate(PLACES, 1):
            for point in range(number):
                usage = Usage(cpu=CpuUsage(seconds=10.0**number), memory=MemoryUsage(peak_bytes=1))
                archive.put_run(
                    make_run(
                        f"{number}-{point}",
                        name=f"first-{point}",
                        sweep="first",
                        sweep_uid=uid_of(place),
                        cluster=place[0],
                        namespace=place[1],
                        index=point,
                        usage=usage,
                        phase=Phase.FAILED if place == ("cluster-b", "lab") else Phase.SUCCEEDED,
                    )
                )
        before = {record.uid: record for record in archive.runs()}
    for number, place in enumerate(PLACES[:-1], 1):
        memory = await recalled(url, place)
        done = PointState.FAILED if place == ("cluster-b", "lab") else PointState.SUCCEEDED
        assert list(memory.states) == [done] * number + [PointState.PENDING] * (4 - number)
        assert memory.archived.cpu_seconds == number * 10.0**number
    with Archive.open(url) as archive:
        assert {record.uid: record for record in archive.runs()} == before
        for number, place in enumerate(PLACES, 1):
            assert archive.totals(uid_of(place)) == Totals(number, 0, 0, number * 10.0**number)
            assert sum(1 for _ in archive.finished(uid_of(place))) == number
            found = archive.sweep("first", cluster=place[0], namespace=place[1])
            assert found is not None
            assert found.uid == uid_of(place)
    frame = read_archive(url)
    # None is an earlier version of another one.
    assert len(choose(frame, Selection(each=True)).frame) == len(before)
    for number, (cluster, namespace) in enumerate(PLACES[:-1], 1):
        where = f"cluster == '{cluster}' and namespace == '{namespace}'"
        assert len(choose(frame, Selection(where=where, each=True)).frame) == number


def test_who_does_not_know_the_cluster_leaves_it_as_it_is(url: str, make_run: MakeRun) -> None:
    """Case of `slamhive fetch`, whose user may see less than the operator."""
    sweep = SweepRecord(uid="s", name="first", spec={}, namespace="lab")
    with Archive.open(url) as archive:
        for cluster in ("cluster-a", None):
            archive.put_run(make_run("a", namespace="lab", cluster=cluster))
            archive.put_sweep(sweep.replace(cluster=cluster))
        record = archive.get("a")
        assert record is not None
        assert record.cluster == "cluster-a"
        assert archive.sweeps()[0].cluster == "cluster-a"


def test_records_of_before_clusters_were_told_apart_are_settled_once(url: str, make_run: MakeRun) -> None:
    with Archive.open(url) as archive:
        archive.put_run(make_run("old", namespace="lab"))
        archive.put_run(make_run("laptop"))
        archive.put_run(make_run("other", namespace="lab", cluster="cluster-b"))
        assert archive.settle("cluster-a", ["lab", "students"]) == 1
        assert archive.settle("cluster-c", ["lab"]) == 0
        found = {record.uid: record.cluster for record in archive.runs()}
    assert found == {"old": "cluster-a", "laptop": None, "other": "cluster-b"}
