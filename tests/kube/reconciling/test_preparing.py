# SPDX-License-Identifier: Apache-2.0
"""Variants of recordings on a fake API server: made once, shared, made again, and forgotten when unused."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from testcluster.kwok import NOW, Moment, Play, described, description, ended
from testcluster.lab import condition_of, dataset, manifest, run, status_of, sweep, until

from slamhive.jobs.messages import failed
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.status import moment
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

    from slamhive.kube.operator import Operator

HALL = Key(Kind.DATASET, "lab", "hall")
HOUR = 3600.0
_RUNNING = {"running": {"startedAt": NOW}}
HELD = {"prepare": Moment("Running", _RUNNING, _RUNNING)}
"""Preparations that go on for ever."""


def is_over(status: dict[str, Any]) -> bool:
    return status.get("phase") in {"Succeeded", "Failed", "Cancelled"}


def variants_of(op: Operator, key: Key = HALL) -> list[dict[str, Any]]:
    status = (op.cluster.store.get(key) or {}).get("status") or {}
    found: list[dict[str, Any]] = status.get("variants") or []
    return found


def preparations(op: Operator) -> list[dict[str, Any]]:
    jobs = op.cluster.store.of(Kind.JOB, "lab")
    return [job for job in jobs if job["metadata"]["labels"]["slamhive.io/role"] == "prepare"]


@pytest.mark.parametrize(
    ("exit_code", "message", "reason", "why"),
    [
        (
            1,
            failed(Reason.PREPARATION_FAILED, "the file is no bag"),
            "PreparationFailed",
            "the file is no bag",
        ),
        (0, "nonsense", "SystemFault", "the preparation's report can't be read"),
        (3, "nonsense", "SystemFault", "container 'prepare': exit code 3: nonsense"),
    ],
    ids=["its own word", "no word", "a crash"],
)
async def test_a_preparation_that_failed_fails_its_runs_and_is_tried_by_later_ones(
    make_fake_lab: Callable[..., Lab], exit_code: int, message: str, reason: str, why: str
) -> None:
    lab = make_fake_lab(ends={"prepare": ended(exit_code, message)})
    async with lab.operator() as op:
        lab.apply(run(retries=0))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        [entry] = await until(
            lambda: [one for one in variants_of(op) if one["phase"] == "Failed"], "the entry"
        )
        lab.cluster.play_from_now(lab.pool, Play())
        # Times are told in whole seconds: what was made in the second of the failure counts as before.
        await until(lambda: time.time() >= (moment(entry["changedTime"]) or 0.0) + 1, "the next second")
        lab.apply(run("two"))
        later = await status_of(op, Kind.MAPPING_RUN, "two", is_over)
        [again] = await until(
            lambda: [one for one in variants_of(op) if one["phase"] == "Ready"], "the variant"
        )
    assert (status["phase"], status["reason"]) == ("Failed", reason)
    assert why in status["message"]
    assert (entry["reason"], entry["message"]) == (reason, why)
    assert later["phase"] == "Succeeded"
    assert again["name"] == entry["name"]
    assert again["sizeBytes"] == 1 << 20


async def test_a_failure_of_before_is_no_reason_for_a_later_operator(
    make_fake_lab: Callable[..., Lab],
) -> None:
    lab = make_fake_lab(ends={"prepare": ended(1, failed(Reason.PREPARATION_FAILED, "the file is no bag"))})
    async with lab.operator() as op:
        lab.apply(run(retries=0))
        await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        [entry] = await until(
            lambda: [one for one in variants_of(op) if one["phase"] == "Failed"], "the entry"
        )
        lab.delete("mappingrun", "one")
        await until(lambda: not preparations(op), "the preparation to go with the run")
    # The Job is gone, and what the Dataset's status says of it was said after this run was made.
    lab.apply(run("two", retries=0))
    status = {"variants": [entry | {"changedTime": "2099-01-01T00:00:00Z"}]}
    lab.patch("dataset", "hall", {"status": status}, subresource="status")
    async with lab.operator() as op:
        told = await status_of(op, Kind.MAPPING_RUN, "two", is_over)
    assert (told["reason"], told["message"]) == ("PreparationFailed", "the file is no bag")


async def test_runs_that_need_the_same_variant_own_its_preparation_together(
    make_fake_lab: Callable[..., Lab],
) -> None:
    lab = make_fake_lab(ends=HELD)
    async with lab.operator() as op:
        lab.apply(run(), run("two"))

        def owners() -> set[str]:
            found = [job["metadata"].get("ownerReferences") or [] for job in preparations(op)]
            return {owner["name"] for references in found for owner in references}

        await until(lambda: owners() == {"one", "two"}, "both to own it")
        [job] = preparations(op)
        await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Preparing")
        lab.delete("mappingrun", "one")
        await until(lambda: owners() == {"two"}, "the first to go")
        assert [one["metadata"]["uid"] for one in preparations(op)] == [job["metadata"]["uid"]]
        [pod] = op.cluster.store.of(Kind.POD, "lab")
        lab.cluster.end_pod(pod["metadata"]["name"], "lab", ended(0, described(description())))
        status = await status_of(op, Kind.MAPPING_RUN, "two", is_over)
    assert status["phase"] == "Succeeded"


async def test_no_more_preparations_than_allowed_at_a_time(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(ends=HELD)
    lab.apply(dataset("yard"))
    async with lab.operator(preparation={"parallelJobs": 1}) as op:
        lab.apply(run())
        await until(lambda: preparations(op), "the first preparation")
        lab.apply(run("two", datasetRef={"name": "yard"}))
        await status_of(op, Kind.MAPPING_RUN, "two", lambda status: status.get("phase") == "Preparing")
        [job] = preparations(op)
        assert job["metadata"]["labels"]["slamhive.io/dataset"] == "hall"
        lab.cluster.play_from_now(lab.pool, Play())
        [pod] = await until(lambda: op.cluster.store.of(Kind.POD, "lab"), "its pod")
        lab.cluster.end_pod(pod["metadata"]["name"], "lab", ended(0, described(description())))
        await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        op.cluster.queue.add(Key(Kind.MAPPING_RUN, "lab", "two"))  # it would come back in five seconds
        status = await status_of(op, Kind.MAPPING_RUN, "two", is_over)
    assert status["phase"] == "Succeeded"


async def test_a_preparation_whose_pod_is_refused_for_long_has_failed(fake_lab: Lab) -> None:
    limits = {"limits": [{"type": "Container", "max": {"cpu": "2"}}]}
    fake_lab.apply(manifest("LimitRange", "small", **limits) | {"apiVersion": "v1"})
    # By a clock an hour ahead all patience with its Job is at an end.
    late = fake_lab.operator(clock=lambda: time.time() + HOUR, preparation={"cpu": "4"})
    async with late as op:
        fake_lab.apply(run(retries=0))
        [entry] = await until(
            lambda: [one for one in variants_of(op) if one["phase"] == "Failed"], "the entry"
        )
    assert "maximum cpu usage per Container is 2, but limit is 4" in entry["message"]


async def test_a_preparation_without_a_pod_says_why(fake_lab: Lab) -> None:
    limits = {"limits": [{"type": "Container", "max": {"cpu": "2"}}]}
    fake_lab.apply(manifest("LimitRange", "small", **limits) | {"apiVersion": "v1"})
    # Seconds later there could be a pod; the patience is longer.
    late = fake_lab.operator(
        clock=lambda: time.time() + 60, preparation={"cpu": "4"}, refusalGraceSeconds=HOUR
    )
    async with late as op:
        fake_lab.apply(run())
        [entry] = await until(lambda: [one for one in variants_of(op) if one.get("message")], "the reason")
        assert entry["phase"] == "Preparing"
        assert "maximum cpu usage per Container is 2, but limit is 4" in entry["message"]
        fake_lab.delete("limitrange", "small")
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["phase"] == "Succeeded"


NO_IMAGE = {"waiting": {"reason": "ErrImagePull", "message": "no such image"}}
UNPULLED = {"prepare": Moment("Pending", NO_IMAGE, NO_IMAGE)}
"""Preparations whose image can't be pulled."""


async def test_runs_say_why_their_preparation_does_not_begin(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(ends=UNPULLED)
    async with lab.operator(imagePullGraceSeconds=HOUR) as op:
        lab.apply(run(), sweep(sizes=2))
        waits = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: condition_of(found, "Scheduled"))
        blocked = await status_of(
            *(op, Kind.SWEEP, "study"), lambda found: "2 of 2" in str(condition_of(found, "Blocked"))
        )
        [entry] = variants_of(op)
        [pod] = op.cluster.store.of(Kind.POD, "lab")
        lab.cluster.play_from_now(lab.pool, Play())
        lab.cluster.end_pod(pod["metadata"]["name"], "lab", ended(0, described(description())))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("phase") == "Complete")
    still = condition_of(blocked, "Blocked")
    assert (still["status"], still["reason"]) == ("True", "RunsStandStill")
    assert "its preparation does not begin" in still["message"]
    told = condition_of(waits, "Scheduled")
    assert (waits["phase"], told["status"], told["reason"]) == ("Preparing", "False", "PreparationWaits")
    assert "no such image" in told["message"]
    assert "no such image" in entry["message"]
    assert status["phase"] == "Succeeded"
    assert condition_of(status, "Scheduled")["status"] == "True"


async def test_a_preparation_whose_image_cannot_be_had_is_given_up(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(ends=UNPULLED)
    async with lab.operator(imagePullGraceSeconds=0) as op:
        lab.apply(run(retries=0))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        await until(lambda: not preparations(op), "its Job to go")
    assert (status["phase"], status["reason"]) == ("Failed", "ImagePullFailed")
    assert "no such image" in status["message"]


async def test_the_use_of_a_variant_is_noted_and_an_unused_one_forgotten(fake_lab: Lab) -> None:
    async with fake_lab.operator() as op:
        fake_lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        [entry] = await until(lambda: variants_of(op), "the variant")
    async with fake_lab.operator(clock=lambda: time.time() + 2 * HOUR) as op:
        fake_lab.apply(run("two"))
        await status_of(op, Kind.MAPPING_RUN, "two", is_over)
        [used] = variants_of(op)
    fake_lab.delete("mappingrun", "one")
    fake_lab.delete("mappingrun", "two")
    async with fake_lab.operator(clock=lambda: time.time() + 4 * HOUR, variantsLimit="1") as op:
        await until(lambda: not preparations(op), "the preparation to go with the runs")
        await until(lambda: not variants_of(op), "the variant to be forgotten")
    assert used["lastUsedTime"] > entry["lastUsedTime"]
    assert {**used, "lastUsedTime": ""} == {**entry, "lastUsedTime": ""}


async def test_the_preparation_of_a_sweep_belongs_to_the_sweep(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(ends=HELD)
    async with lab.operator() as op:
        lab.apply(sweep())
        [job] = await until(lambda: preparations(op), "the preparation")
        lab.delete("sweep", "study")
        await until(lambda: not preparations(op), "the preparation to go with the Sweep")
    [owner] = job["metadata"]["ownerReferences"]
    assert (owner["kind"], owner["name"]) == ("Sweep", "study")
    assert "controller" not in owner
