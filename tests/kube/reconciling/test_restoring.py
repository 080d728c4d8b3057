# SPDX-License-Identifier: Apache-2.0
"""Evaluations of runs that took over a result whose folder is in object storage: it is brought back first."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.evaluators import measuring
from testcluster.kwok import Play, ended
from testcluster.lab import condition_of, manifest, status_of, sweep, until

from slamhive.archive import Archive
from slamhive.jobs.messages import failed
from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.reconciling import restoring
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from testcluster.lab import Lab

    from slamhive.kube.operator import Operator

EVALUATION = {"delaySeconds": 0.1}
STORE = {"configMap": "slamhive-store", "secret": "bucket-reader"}


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    with Archive.open(f"sqlite:///{tmp_path / 'archive.db'}") as found:
        yield found


def is_complete(status: dict[str, Any]) -> bool:
    return condition_of(status, "Complete").get("status") == "True"


def runs_of(op: Operator, name: str) -> list[dict[str, Any]]:
    return op.cluster.store.select(Kind.MAPPING_RUN, "lab", Label.SWEEP, name)


async def archived(lab: Lab, archive: Archive) -> set[str]:
    """Have three runs in the archive alone, and return their folders."""
    lab.cluster.log = measuring()
    async with lab.operator(archive, evaluation=EVALUATION) as op:
        lab.apply(sweep("first", retention={"runs": 0}, template={"evaluate": True}))
        await status_of(op, Kind.SWEEP, "first", is_complete)
        await until(lambda: not runs_of(op, "first"), "all runs to go")
    return {str(record.folder) for record in archive.runs(sweep="first")}


def jobs_made(lab: Lab) -> list[dict[str, Any]]:
    """Return a list that all Jobs get into that are asked for from now on."""
    made: list[dict[str, Any]] = []

    def seen(verb: str, resource: str, body: dict[str, Any]) -> None:
        if (verb, resource) == ("create", "jobs.batch"):
            made.append(body)

    lab.cluster.refuse(seen)
    return made


def role(job: dict[str, Any]) -> str:
    return str(job["metadata"]["labels"]["slamhive.io/role"])


DRIFT = manifest("Evaluation", "drift", runs={"sweepRef": {"name": "second"}}, alignment="Origin")


async def test_folders_of_others_are_on_the_volume_before_they_are_measured(
    fake_lab: Lab, archive: Archive
) -> None:
    folders = await archived(fake_lab, archive)
    made = jobs_made(fake_lab)
    async with fake_lab.operator(archive, evaluation=EVALUATION, store=STORE) as op:
        fake_lab.apply(sweep("second", template={"evaluate": True}), DRIFT)
        status = await status_of(op, Kind.EVALUATION, "drift", is_complete)
    assert status["evaluated"] == 3
    brought: list[str] = []
    for job in made:
        if role(job) == "restore":
            brought += job["metadata"]["annotations"]["slamhive.io/folders"].split(",")
        else:
            request = job["spec"]["template"]["metadata"]["annotations"]["slamhive.io/request"]
            assert {one["folder"] for one in json.loads(request)["runs"]} <= {*brought}
    assert sorted(brought) == sorted(folders)
    before = [job for job in made if role(job) == "restore"]
    [container] = before[0]["spec"]["template"]["spec"]["containers"]
    assert container["command"][-4:] == [
        *("--store", "/etc/slamhive-store/store.yaml"),
        *("--secret", "/etc/slamhive-store-secret"),
    ]
    evaluator = made[-1]["spec"]["template"]["spec"]
    assert "store" not in str([volume["name"] for volume in evaluator["volumes"]])


async def test_a_storage_that_is_away_is_told_at_the_evaluation_and_waited_for(
    fake_lab: Lab, archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(restoring, "_AGAIN_SECONDS", 0.5)
    await archived(fake_lab, archive)
    said = failed(Reason.SYSTEM_FAULT, "storage s3://lab/x: the keys are wrong")
    fake_lab.cluster.play_from_now(fake_lab.pool, Play(ends={"restore": ended(1, said)}))
    async with fake_lab.operator(archive, evaluation=EVALUATION, store=STORE) as op:
        fake_lab.apply(sweep("second", template={"evaluate": True}), DRIFT)

        def is_told(status: dict[str, Any]) -> bool:
            return "the keys are wrong" in str(condition_of(status, "ReconcileError").get("message"))

        await status_of(op, Kind.EVALUATION, "drift", is_told)
        fake_lab.cluster.play_from_now(fake_lab.pool, Play())
        status = await status_of(op, Kind.EVALUATION, "drift", is_complete)
    assert status["evaluated"] == 3


async def test_what_is_nowhere_is_told_at_its_run_and_keeps_no_other_from_being_measured(
    fake_lab: Lab, archive: Archive
) -> None:
    folders = await archived(fake_lab, archive)
    uid = min(folders).split("/")[1]
    left = json.dumps({"v": 1, "left": {uid: "it is gone"}})
    fake_lab.cluster.play_from_now(fake_lab.pool, Play(ends={"restore": ended(0, left)}))
    async with fake_lab.operator(archive, evaluation=EVALUATION, store=STORE) as op:
        fake_lab.apply(sweep("second", template={"evaluate": True}), DRIFT)
        status = await status_of(op, Kind.EVALUATION, "drift", lambda one: bool(one.get("failed")))
        status = await status_of(op, Kind.EVALUATION, "drift", lambda one: one.get("evaluated") == 2)
    assert "it is gone" in condition_of(status, "Complete")["message"]


async def test_without_a_store_nothing_is_brought(fake_lab: Lab, archive: Archive) -> None:
    await archived(fake_lab, archive)
    made = jobs_made(fake_lab)
    async with fake_lab.operator(archive, evaluation=EVALUATION) as op:
        fake_lab.apply(sweep("second", template={"evaluate": True}), DRIFT)
        await status_of(op, Kind.EVALUATION, "drift", is_complete)
    assert {role(job) for job in made} == {"evaluate"}
