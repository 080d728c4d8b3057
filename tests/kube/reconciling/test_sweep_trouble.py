# SPDX-License-Identifier: Apache-2.0
"""Sweeps on a fake API server that refuses, and with an archive that does not answer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.evaluators import measuring
from fakeapi.refusals import Refusal, conflict, forbidden
from testcluster.lab import algorithm, condition_of, run, status_of, sweep, until

from slamhive.archive import Archive
from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.reconciling.catalogue import Catalogue, parse
from slamhive.model.errors import SystemFault
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from testcluster.lab import Lab

    from slamhive.kube.operator import Operator

RUNS = "mappingruns.slamhive.io"


def is_complete(status: dict[str, Any]) -> bool:
    return condition_of(status, "Complete").get("status") == "True"


def runs_of(op: Operator, name: str = "study") -> list[dict[str, Any]]:
    return op.cluster.store.select(Kind.MAPPING_RUN, "lab", Label.SWEEP, name)


def reasons(lab: Lab) -> list[str]:
    """Return the reasons of all Events."""
    return [event["reason"] for event in lab.cluster.of("event", "lab")]


class Switched:
    """An archive that can be made not to answer."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self.away = False
        self.goes_after_writing = False

    def __getattr__(self, name: str) -> Any:
        def method(*words: Any, **options: Any) -> Any:
            if self.away:
                raise SystemFault("the archive does not answer")
            found = getattr(self._archive, name)(*words, **options)
            self.away = self.goes_after_writing and name == "put_used"
            return found

        return method


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Any]:
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        yield Switched(archive)


async def test_a_sweep_whose_runs_are_refused_says_so(fake_lab: Lab) -> None:
    def refusing(verb: str, resource: str, _body: dict[str, Any]) -> Refusal | None:
        return forbidden(RUNS, "x", "the policy says no") if (verb, resource) == ("create", RUNS) else None

    fake_lab.cluster.refuse(refusing)
    async with fake_lab.operator() as op:
        fake_lab.apply(sweep())
        status = await status_of(op, Kind.SWEEP, "study", lambda found: condition_of(found, "Blocked"))
        assert "the policy says no" in condition_of(status, "Blocked")["message"]
        fake_lab.cluster.refuse(lambda *_: None)
        fake_lab.patch("sweep", "study", {"metadata": {"labels": {"look": "again"}}})
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
    assert condition_of(status, "Blocked")["status"] == "False"
    assert reasons(fake_lab).count("CannotCreate") == 1


async def test_a_run_of_someone_else_under_a_points_name_is_not_taken_over(fake_lab: Lab) -> None:
    async with fake_lab.operator() as op:
        fake_lab.apply(sweep(sizes=1, suspend=True))
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("phase") == "Suspended")
        [body] = op.cluster.store.of(Kind.SWEEP, "lab")
        name = Plan(parse(Sweep, body), Catalogue().all(op.cluster.store, "lab"), strict=True).point(0).name
        fake_lab.apply(run(name, parameters={"size": 7}))
        fake_lab.patch("sweep", "study", {"spec": {"suspend": False}})
        status = await status_of(op, Kind.SWEEP, "study", lambda found: condition_of(found, "Blocked"))
        why = f"the name {name} is taken by a MappingRun that is not of this Sweep"
        assert condition_of(status, "Blocked")["message"] == why
        fake_lab.delete("mappingrun", name)
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
    assert status["succeeded"] == 1


async def test_a_budget_of_time_ends_a_sweep_and_its_runs(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(sweep(sizes=3, budget={"wallTime": "1s"}))
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: "BudgetExhausted" in reasons(lab), "the Event")
    assert status["phase"] == "BudgetExhausted"
    assert (status["failed"], status["pending"]) == (2, 1)


async def test_an_archive_that_is_away_holds_a_sweep_back_and_loses_nothing(
    fake_lab: Lab, archive: Any
) -> None:
    archive.away = True
    async with fake_lab.operator(archive) as op:
        fake_lab.apply(sweep(sizes=6, retention={"runs": 1}))
        status = await status_of(op, Kind.SWEEP, "study", _archive_is_away)
        assert condition_of(status, "ArchiveUnavailable")["message"] == "the archive does not answer"
        archive.away, archive.goes_after_writing = False, True
        fake_lab.patch("sweep", "study", {"metadata": {"labels": {"look": "again"}}})
        await until(lambda: archive.away, "the first runs to be written")
        await status_of(op, Kind.SWEEP, "study", _archive_is_away)
        await until(lambda: len(runs_of(op)) >= 3, "the window to fill")
        archive.away = archive.goes_after_writing = False
        fake_lab.patch("sweep", "study", {"metadata": {"labels": {"look": "oncemore"}}})
        status = await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: len(runs_of(op)) == 1, "the surplus to go")
        status = await status_of(op, Kind.SWEEP, "study", lambda found: not _archive_is_away(found))
    assert (status["succeeded"], status["cpuSeconds"]) == (6, 48.0)


def _archive_is_away(status: dict[str, Any]) -> bool:
    return condition_of(status, "ArchiveUnavailable").get("status") == "True"


async def test_a_run_that_changes_while_it_is_archived_is_archived_once_more(
    fake_lab: Lab, archive: Any
) -> None:
    left = [conflict(RUNS, "x", "the object has been modified")]

    def refusing(verb: str, resource: str, _body: dict[str, Any]) -> Refusal | None:
        return left.pop() if left and (verb, resource) == ("delete", RUNS) else None

    fake_lab.cluster.refuse(refusing)
    async with fake_lab.operator(archive) as op:
        fake_lab.apply(sweep(sizes=3, retention={"runs": 0, "files": "Delete"}))
        await status_of(op, Kind.SWEEP, "study", is_complete)
        await until(lambda: not runs_of(op), "all runs to go")
    records = list(archive.runs(sweep="study"))
    assert not left
    assert len(records) == 3
    assert {record.folder for record in records} == {None}


async def test_an_equal_run_is_found_in_the_archive(fake_lab: Lab, archive: Any) -> None:
    fake_lab.cluster.log = measuring()
    settings = {"evaluation": {"delaySeconds": 0.1}}
    async with fake_lab.operator(archive, **settings) as op:
        fake_lab.apply(sweep("first", retention={"runs": 0}, template={"evaluate": True}))
        await status_of(op, Kind.SWEEP, "first", is_complete)
        await until(lambda: not runs_of(op, "first"), "all runs to go")
    fake_lab.calls.clear()
    async with fake_lab.operator(archive) as op:
        fake_lab.apply(sweep("second"))
        status = await status_of(op, Kind.SWEEP, "second", is_complete)
        usage = [one["status"]["usage"]["cpu"]["seconds"] for one in runs_of(op, "second")]
    assert (status["succeeded"], status["reused"]) == (3, 3)
    assert usage == [8.0] * 3
    assert status["best"][0]["ate"] == 0.25
    assert ("create", "jobs.batch") not in fake_lab.calls


async def test_what_left_the_catalog_is_archived_without_it(fake_lab: Lab, archive: Any) -> None:
    async with fake_lab.operator(archive) as op:
        fake_lab.apply(sweep(sizes=2))
        await status_of(op, Kind.SWEEP, "study", is_complete)
        fake_lab.delete("algorithm", "icp")
        await until(lambda: not op.cluster.store.of(Kind.ALGORITHM, "lab"), "the Algorithm to go")
        fake_lab.patch("sweep", "study", {"spec": {"retention": {"runs": 0}}})
        await until(lambda: not runs_of(op), "all runs to go")
    assert [record.spec["algorithmRef"]["name"] for record in archive.runs(sweep="study")] == ["icp"] * 2


async def test_a_catalog_with_something_wrong_in_it_is_used_without_that(fake_lab: Lab) -> None:
    odd = algorithm("odd", parameters={"size": {"type": "Number", "default": "x"}})
    fake_lab.apply(odd)
    async with fake_lab.operator() as op:
        fake_lab.apply(sweep("good"), sweep("bad", matrix=[{"path": "algorithm", "values": ["icp", "odd"]}]))
        await status_of(op, Kind.SWEEP, "good", is_complete)
        status = await status_of(op, Kind.SWEEP, "bad", lambda found: condition_of(found, "Accepted"))
    assert "odd" in condition_of(status, "Accepted")["message"]
