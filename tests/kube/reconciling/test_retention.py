# SPDX-License-Identifier: Apache-2.0
"""Runs beyond their Sweep's retention: from their ends into the archive, whoever ends in between."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.evaluators import measuring
from fakeapi.refusals import Refusal, forbidden
from testcluster.lab import condition_of, manifest, status_of, sweep, until

from slamhive.archive import Archive
from slamhive.kube.api.kinds import Kind, Label, annotations_of
from slamhive.kube.reconciling.sweep_runs import ARCHIVE_ONLY
from slamhive.kube.records import NOT_EVALUABLE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from testcluster.lab import Lab

    from slamhive.archive.records import FinishedPoint

RUNS = "mappingruns.slamhive.io"
SETTINGS = {"evaluation": {"delaySeconds": 0.1}}


def is_complete(status: dict[str, Any]) -> bool:
    return condition_of(status, "Complete").get("status") == "True"


def runs_of(lab: Lab) -> list[dict[str, Any]]:
    return [run for run in lab.cluster.of("mappingrun", "lab") if Label.SWEEP in run["metadata"]["labels"]]


def no_deletion(verb: str, resource: str, _body: dict[str, Any]) -> Refusal | None:
    return forbidden(RUNS, "x", "not now") if (verb, resource) == ("delete", RUNS) else None


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        yield archive


@pytest.fixture
def lab(fake_lab: Lab) -> Lab:
    """A lab whose evaluators find a result for each run."""
    fake_lab.cluster.log = measuring()
    return fake_lab


def study(**spec: Any) -> dict[str, Any]:
    return sweep(**{"sizes": 6, "template": {"evaluate": True}, "retention": {"runs": 2}} | spec)


def evaluations(archive: Archive) -> list[set[str]]:
    return [{result.evaluation for result in record.results} for record in archive.runs(sweep="study")]


async def test_nothing_is_written_of_them_but_their_objects(lab: Lab, archive: Archive) -> None:
    async with lab.operator(archive, **SETTINGS) as op:
        lab.apply(study())
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: len(runs_of(lab)) == 2, "the others to go")
    assert (status["succeeded"], status["evaluated"], status["cpuSeconds"]) == (6, 6, 48.0)
    assert [len(record.results) for record in archive.runs(sweep="study")] == [1] * 6
    assert (lab.calls.count(("create", RUNS)), lab.calls.count(("delete", RUNS))) == (6, 4)
    # The end and the result of the two that are kept; at first those that wait for the variant say so.
    assert 2 * 2 <= lab.calls.count(("patch", f"{RUNS}/status")) <= 2 * 2 + 2
    assert ("patch", RUNS) not in lab.calls


async def test_what_an_operator_left_behind_is_removed_and_not_measured_again(
    lab: Lab, archive: Archive
) -> None:
    lab.cluster.refuse(no_deletion)
    async with lab.operator(archive, **SETTINGS) as op:
        lab.apply(study())
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("evaluated") == 6)
    left = [run for run in runs_of(lab) if ARCHIVE_ONLY in annotations_of(run)]
    assert not any((run.get("status") or {}).get("phase") == "Succeeded" for run in left)
    assert len(left) == 4
    lab.cluster.refuse(lambda *_: None)
    lab.patch("sweep", "study", {"status": None}, subresource="status")
    lab.calls.clear()
    async with lab.operator(archive, **SETTINGS) as op:
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: len(runs_of(lab)) == 2, "the others to go")
    assert (status["succeeded"], status["evaluated"], status["cpuSeconds"]) == (6, 6, 48.0)
    assert [len(record.results) for record in archive.runs(sweep="study")] == [1] * 6
    assert ("create", "jobs.batch") not in lab.calls


async def test_those_that_another_operator_removes_while_one_begins_count(
    lab: Lab, archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are there when it looks for what is in flight, and gone when it has read the archive."""
    lab.cluster.refuse(no_deletion)
    async with lab.operator(archive, **SETTINGS) as op:
        lab.apply(study())
        await status_of(op, Kind.SWEEP, "study", is_complete)
    lab.cluster.refuse(lambda *_: None)
    loop, finished = asyncio.get_running_loop(), archive.finished

    def removing(uid: str) -> Iterator[tuple[str, FinishedPoint]]:
        for run in runs_of(lab):
            if ARCHIVE_ONLY in annotations_of(run):
                lab.delete("mappingrun", run["metadata"]["name"])
        seen = until(lambda: len(op.cluster.store.of(Kind.MAPPING_RUN, "lab")) == 2, "it to hear of that")
        asyncio.run_coroutine_threadsafe(seen, loop).result()
        return finished(uid)

    monkeypatch.setattr(archive, "finished", removing)
    lab.patch("sweep", "study", {"spec": {"maxFailures": 3}})  # so that it writes what it counts
    async with lab.operator(archive, **SETTINGS) as op:
        status = await status_of(op, Kind.SWEEP, "study", lambda found: found["observedGeneration"] == 2)
    assert (status["succeeded"], status["evaluated"], status["cpuSeconds"]) == (6, 6, 48.0)
    assert "deleted" not in status


async def test_an_operator_that_ends_before_the_archive_has_them_loses_none(
    lab: Lab, archive: Archive
) -> None:
    async with lab.operator(archive, evaluation={"delaySeconds": 1000}) as op:
        lab.apply(study(retention={"runs": 0}, parallelism=6))
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("succeeded") == 6)
    assert len(runs_of(lab)) == 6
    lab.calls.clear()
    async with lab.operator(archive, **SETTINGS) as op:
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: not runs_of(lab), "all to go")
    assert (status["succeeded"], status["evaluated"], status["cpuSeconds"]) == (6, 6, 48.0)
    assert [len(record.results) for record in archive.runs(sweep="study")] == [1] * 6
    assert ("create", RUNS) not in lab.calls


async def test_an_evaluation_measures_them_too(lab: Lab, archive: Archive) -> None:
    async with lab.operator(archive, **SETTINGS) as op:
        lab.apply(manifest("Evaluation", "rigid", runs={"sweepRef": {"name": "study"}}, alignment="SE3"))
        lab.apply(study())
        await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: len(runs_of(lab)) == 2, "the others to go")
        await until(lambda: [len(one) for one in evaluations(archive)] == [2] * 6, "the archive to have all")
    assert all("rigid" in names for names in evaluations(archive))


async def test_two_operators_do_each_once(lab: Lab, archive: Archive) -> None:
    async with lab.operator(archive, **SETTINGS) as op, lab.operator(archive, **SETTINGS):
        lab.apply(study(sizes=12, parallelism=3))
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: len(runs_of(lab)) == 2, "the others to go")
    assert (status["succeeded"], status["evaluated"], status.get("deleted")) == (12, 12, None)
    assert [len(record.results) for record in archive.runs(sweep="study")] == [1] * 12
    assert lab.calls.count(("create", RUNS)) == 12


async def test_one_that_can_t_be_measured_is_given_up_once(lab: Lab, archive: Archive) -> None:
    def refusing(verb: str, resource: str, _body: dict[str, Any]) -> Refusal | None:
        return (
            forbidden(RUNS, "x", "not now")
            if (verb, resource) == ("patch", "sweeps.slamhive.io/status")
            else None
        )

    lab.cluster.log = lambda *_: ""
    async with lab.operator(archive, **SETTINGS) as op:
        lab.apply(study(retention={"runs": 0}, sizes=1))
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 1)
        lab.cluster.refuse(refusing)  # so that it is neither archived nor deleted
        await until(
            lambda: any(NOT_EVALUABLE in annotations_of(run) for run in runs_of(lab)), "it to be given up"
        )
    lab.cluster.refuse(lambda *_: None)
    lab.calls.clear()
    async with lab.operator(archive, **SETTINGS) as op:
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: not runs_of(lab), "it to go")
    assert (status["succeeded"], status["evaluated"]) == (1, 0)
    assert ("create", "jobs.batch") not in lab.calls


async def test_one_that_is_deleted_by_hand_at_its_work_counts_as_failed(
    make_fake_lab: Callable[..., Lab], archive: Archive
) -> None:
    lab = make_fake_lab(hold=True)
    async with lab.operator(archive, **SETTINGS) as op:
        lab.apply(study(retention={"runs": 0}, sizes=3, parallelism=3))
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 3)
        for run in runs_of(lab):
            lab.delete("mappingrun", run["metadata"]["name"])
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
    assert (status["succeeded"], status["failed"], status["deleted"]) == (0, 3, 3)
    assert "3 runs were deleted by hand" in condition_of(status, "Complete")["message"]
