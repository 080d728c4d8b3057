# SPDX-License-Identifier: Apache-2.0
"""Sweeps on a real control plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

from testcluster.lab import algorithm, condition_of, dataset, status_of, sweep, until

from slamhive.archive import Archive
from slamhive.engine import PointState
from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.reconciling.sweep_runs import decode_points

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import Any

    from testcluster.lab import Lab

    from slamhive.kube.operator import Operator


def is_complete(status: dict[str, Any]) -> bool:
    return condition_of(status, "Complete").get("status") == "True"


def runs_of(op: Operator, name: str = "study") -> list[dict[str, Any]]:
    return op.cluster.store.select(Kind.MAPPING_RUN, op.cluster.settings.namespaces[0], Label.SWEEP, name)


async def test_a_sweep_runs_every_point_once(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(sweep(sizes=5, repetitions=2))
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        runs = runs_of(op)
    assert (status["succeeded"], status["failed"], status["progress"]) == (10, 0, "10/10")
    assert decode_points(status["points"], 10) == bytes([PointState.SUCCEEDED] * 10)
    assert status["cpuSeconds"] == 80.0
    assert sorted(int(run["metadata"]["labels"][Label.POINT]) for run in runs) == list(range(10))
    assert {run["metadata"]["labels"][Label.SLOT] for run in runs} == {"0", "1"}
    assert lab.calls.count(("create", "mappingruns.slamhive.io")) == 10
    # One preparation serves them all.
    assert lab.calls.count(("create", "jobs.batch")) == 11


async def test_never_more_runs_than_allowed_are_in_flight(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(sweep(sizes=6, parallelism=2))
        await status_of(op, Kind.SWEEP, "study", lambda status: status.get("running") == 2)
        lab.patch("sweep", "study", {"spec": {"parallelism": 4}})
        await status_of(op, Kind.SWEEP, "study", lambda status: status.get("running") == 4)
        assert len(runs_of(op)) == 4
        assert {run["metadata"]["labels"][Label.SLOT] for run in runs_of(op)} == {"0", "1", "2", "3"}


async def test_a_suspended_sweep_starts_nothing_until_it_is_resumed(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(sweep(suspend=True))
        status = await status_of(op, Kind.SWEEP, "study", lambda found: found.get("phase") == "Suspended")
        assert condition_of(status, "Suspended")["status"] == "True"
        assert not runs_of(op)
        lab.patch("sweep", "study", {"spec": {"suspend": False}})
        await status_of(op, Kind.SWEEP, "study", is_complete)


async def test_too_many_failures_end_a_sweep_and_its_runs(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(exit_code=1)
    async with lab.operator() as op:
        lab.apply(sweep(sizes=9, maxFailures=2, parallelism=1))
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
    assert status["phase"] == "TooManyFailures"
    assert "maxFailures is 2" in condition_of(status, "Complete")["message"]
    assert (status["failed"], status["pending"], status["running"]) == (3, 6, 0)


async def test_deleting_a_sweep_leaves_nothing(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(sweep())
        await status_of(op, Kind.SWEEP, "study", lambda status: status.get("running") == 2)
        lab.delete("sweep", "study")
        kinds = (Kind.MAPPING_RUN, Kind.JOB, Kind.POD)
        await until(lambda: not any(op.cluster.store.of(kind, lab.namespace) for kind in kinds), "all to go")


async def test_a_deleted_run_of_a_sweep_counts_as_cancelled(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(sweep(sizes=3, parallelism=1))
        await status_of(op, Kind.SWEEP, "study", lambda status: status.get("running") == 1)
        first = runs_of(op)[0]["metadata"]["name"]
        lab.delete("mappingrun", first)
        await status_of(op, Kind.SWEEP, "study", lambda status: status.get("failed") == 1)
        [second] = await until(
            lambda: [run for run in runs_of(op) if run["metadata"]["name"] != first], "the next run"
        )
        assert second["metadata"]["labels"][Label.SLOT] == "0"


async def test_runs_that_come_out_equal_are_run_once_whatever_is_reused(lab: Lab) -> None:
    slow = dataset("slow")
    slow["spec"]["sensors"]["lidar"]["rate"] = 5
    lab.apply(slow)
    axes = [
        {"path": "dataset", "values": ["slow", "hall"]},
        {"path": "input.frameRate", "values": [5, 8]},
    ]
    async with lab.operator() as op:
        lab.apply(sweep(matrix=axes, parallelism=4, cachePolicy="Rerun"))
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        runs = {int(run["metadata"]["labels"][Label.POINT]): run for run in runs_of(op)}
    assert (status["succeeded"], status["reused"]) == (4, 1)
    assert "1 of 4 runs are equal to others" in condition_of(status, "Accepted")["message"]
    assert [runs[index]["spec"]["input"]["frameRate"] for index in range(4)] == [5, 5, 5, 8]
    known = runs[1]["status"]["provenance"]
    assert known["reusedFrom"] == runs[0]["metadata"]["name"]
    assert (known["asked"], known["effective"]) == ({"frameRate": 8}, {"frameRate": 5})
    assert "asked" not in runs[0]["status"]["provenance"]


async def test_what_the_catalog_does_not_allow_is_said_and_starts_nothing(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(sweep(matrix=[{"path": "parameters.size", "values": [1, -1, "x"]}]))
        status = await status_of(op, Kind.SWEEP, "study", lambda found: condition_of(found, "Accepted"))
        told = condition_of(status, "Accepted")
        assert told["status"] == "False"
        assert "-1" in told["message"]
        assert "'x'" in told["message"]
        assert not runs_of(op)


async def test_a_sweep_waits_for_its_catalog(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(catalog=False)
    async with lab.operator() as op:
        lab.apply(sweep(), algorithm())
        status = await status_of(op, Kind.SWEEP, "study", lambda found: condition_of(found, "Accepted"))
        assert "hall" in condition_of(status, "Accepted")["message"]
        lab.apply(dataset())
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
    assert status["succeeded"] == 3


async def test_what_a_selector_chose_stays_chosen(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(catalog=False)
    for name in ("b", "c"):
        body = algorithm(name)
        body["metadata"]["labels"] = {"family": "icp"}
        lab.apply(body)
    lab.apply(dataset())
    axis = {"path": "algorithm", "selector": {"matchLabels": {"family": "icp"}}}
    async with lab.operator() as op:
        lab.apply(sweep(matrix=[axis]))
        first = await status_of(op, Kind.SWEEP, "study", is_complete)
    late = algorithm("a")
    late["metadata"]["labels"] = {"family": "icp"}
    lab.apply(late)
    async with lab.operator() as op:
        second = await status_of(op, Kind.SWEEP, "study", is_complete)
    assert first["selected"] == second["selected"] == [{"axis": 0, "names": ["b", "c"]}]
    assert second["total"] == 2


async def test_an_equal_run_is_not_computed_again(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(sweep("first"))
        await status_of(op, Kind.SWEEP, "first", is_complete)
        lab.calls.clear()
        lab.apply(sweep("second", sizes=4))
        status = await status_of(op, Kind.SWEEP, "second", is_complete)
        lab.apply(sweep("third", cachePolicy="Rerun"))
        again = await status_of(op, Kind.SWEEP, "third", is_complete)
    assert (status["succeeded"], status["reused"], status["cpuSeconds"]) == (4, 3, 8.0)
    assert again["reused"] == 0
    assert lab.calls.count(("create", "jobs.batch")) == 1 + 3


async def test_runs_beyond_the_retention_are_in_the_archive_alone(lab: Lab, tmp_path: Path) -> None:
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        async with lab.operator(archive) as op:
            lab.apply(sweep(sizes=6, retention={"runs": 2}))
            await status_of(op, Kind.SWEEP, "study", is_complete)
            await until(lambda: len(runs_of(op)) == 2, "the surplus to go")
            records = list(archive.runs(sweep="study"))
        assert len(records) == 6
        assert {record.usage.cpu.seconds for record in records if record.usage} == {8.0}
        # A status that was lost is made again from what lives and from the archive.
        lab.patch("sweep", "study", {"status": None}, subresource="status")
        lab.calls.clear()
        async with lab.operator(archive) as op:
            status = await status_of(op, Kind.SWEEP, "study", is_complete)
        assert (status["succeeded"], status["cpuSeconds"]) == (6, 48.0)
        assert ("create", "mappingruns.slamhive.io") not in lab.calls


async def test_a_sweep_too_large_to_live_without_an_archive_says_so(lab: Lab) -> None:
    async with lab.operator(maxRunsWithoutArchive=4) as op:
        lab.apply(sweep(sizes=5))
        status = await status_of(op, Kind.SWEEP, "study", lambda found: condition_of(found, "Accepted"))
    assert "5 runs need an archive" in condition_of(status, "Accepted")["message"]


async def test_two_operators_make_each_run_once(lab: Lab) -> None:
    async with lab.operator() as one, lab.operator():
        lab.apply(sweep(sizes=8, parallelism=3))
        status = await status_of(one, Kind.SWEEP, "study", is_complete)
        runs = runs_of(one)
    assert status["succeeded"] == len(runs) == 8
    assert lab.calls.count(("create", "mappingruns.slamhive.io")) == 8
    assert lab.calls.count(("create", "jobs.batch")) == 9
