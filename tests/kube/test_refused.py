# SPDX-License-Identifier: Apache-2.0
"""Tests of objects that a cluster refuses for good, without a cluster: each says why it does not go on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from testcluster.kept import GRACE, RUN, Cluster, catalogued, standing

from slamhive.kube.api.errors import Forbidden, Invalid, ServerFault
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.loop import FAILURES_TOLD

if TYPE_CHECKING:
    from slamhive.kube.api.errors import ApiError

SENTENCE = "cannot create jobs.batch lab/one-1: spec.template.spec.containers[0].image: must not have blanks"
WEBHOOK = 'cannot create jobs.batch lab/one-1: admission webhook "validate.example" denied the request'
QUOTA = "cannot create jobs.batch lab/one-1: exceeded quota: jobs"


@pytest.fixture
async def cluster() -> Cluster:
    return catalogued()


async def test_a_run_whose_job_cannot_be_built_fails(cluster: Cluster) -> None:
    text = {f"note{number}": "x" * 9000 for number in range(14)}
    noted = {"kueue.x-k8s.io/note": "x" * 150_000}
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN | {"parameters": text}, annotations=noted)
    status = await cluster.look(key)
    assert (status["phase"], status["reason"]) == ("Failed", "InvalidParameters")
    assert "bytes in all, an object holds 262144" in status["message"]
    assert standing(status, "Accepted") == ("False", "InvalidParameters", status["message"])
    assert cluster.told["one", "InvalidParameters"] == status["message"]


async def test_nothing_is_kept_of_a_run_that_is_deleted_before_it_ends(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden(QUOTA)
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    runs = cluster.loop._reconcilers[Kind.MAPPING_RUN]
    assert [*runs._resolved] == [key]
    cluster.seen.observe(Kind.MAPPING_RUN, "DELETED", cluster.objects[key])
    await cluster.look(key)
    assert not runs._resolved


@pytest.mark.parametrize("error", [Invalid(SENTENCE), Forbidden(WEBHOOK)])
async def test_a_run_whose_job_is_refused_for_long_fails(cluster: Cluster, error: ApiError) -> None:
    cluster.refusals[Kind.JOB] = error
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    status = await cluster.look(key)
    assert status["phase"] == "Pending"
    assert standing(status, "Admitted") == ("False", "JobRefused", str(error))
    assert cluster.told["one", "JobRefused"] == str(error)
    assert cluster.seen.queue.delayed == 1
    assert (await cluster.look(key, GRACE - 1))["phase"] == "Pending"
    status = await cluster.look(key, 2)
    assert (status["phase"], status["reason"], status["message"]) == ("Failed", "SystemFault", str(error))
    assert standing(status, "Complete")[0] == "True"
    assert cluster.told["one", "SystemFault"] == str(error)


async def test_a_run_whose_job_is_taken_at_last_goes_on(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden(WEBHOOK)
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    cluster.refusals.clear()
    await cluster.look(key, 10)
    status = await cluster.look(key, 10)
    assert (status["phase"], status["attempts"]) == ("Pending", 1)
    assert standing(status, "Admitted")[0] == "True"


async def test_a_used_up_quota_is_waited_for(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden(QUOTA)
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    status = await cluster.look(key, 100 * GRACE)
    assert "phase" not in status
    assert standing(status, "Scheduled") == ("False", "QuotaExceeded", QUOTA)


async def test_a_preparation_that_is_refused_fails_its_run(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden(WEBHOOK)
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN | {"input": {"duration": "5s"}})
    await cluster.look(key)
    status = await cluster.look(key, GRACE + 1)
    assert (status["phase"], status["message"]) == ("Failed", WEBHOOK)


REFUSED_POD = 'pods "one-1-x" is forbidden: maximum cpu usage per Container is 500m, but limit is 1'


async def test_a_run_whose_pod_is_refused_for_long_fails_with_the_reason(cluster: Cluster) -> None:
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    cluster.failed_creates = ["Error creating: an old story", f"Error creating: {REFUSED_POD}"]
    status = await cluster.look(key, 10)
    told = f"its pod is refused: {REFUSED_POD}"
    assert standing(status, "Scheduled") == ("False", "PodRefused", told)
    status = await cluster.look(key, GRACE)
    assert (status["phase"], status["reason"], status["message"]) == ("Failed", "SystemFault", told)
    assert not [found for found in cluster.objects if found.kind is Kind.JOB]


@pytest.mark.parametrize(
    ("messages", "reason"),
    [([], "NoPod"), (["Error creating: pods is forbidden: exceeded quota: pods"], "QuotaExceeded")],
)
async def test_a_pod_that_may_still_come_is_waited_for(
    cluster: Cluster, messages: list[str], reason: str
) -> None:
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN)
    await cluster.look(key)
    cluster.failed_creates = messages
    status = await cluster.look(key, 100 * GRACE)
    assert status["phase"] == "Pending"
    assert standing(status, "Scheduled")[1] == reason
    assert cluster.seen.queue.delayed == 1


async def test_a_preparation_whose_pod_is_refused_fails_its_run(cluster: Cluster) -> None:
    key = cluster.apply(Kind.MAPPING_RUN, "one", RUN | {"input": {"duration": "5s"}})
    assert (await cluster.look(key))["phase"] == "Preparing"
    cluster.failed_creates = [f"Error creating: {REFUSED_POD}"]
    dataset = Key(Kind.DATASET, "lab", "hall")
    status = await cluster.look(dataset, 10)
    told = f"its pod is refused: {REFUSED_POD}"
    assert (status["variants"][1]["phase"], status["variants"][1]["message"]) == ("Preparing", told)
    assert cluster.seen.queue.delayed == 1
    status = await cluster.look(dataset, GRACE)
    assert status["variants"][1]["phase"] == "Failed"
    status = await cluster.look(key, 1)
    assert (status["phase"], status["reason"], status["message"]) == ("Failed", "SystemFault", told)


async def test_a_sweep_whose_runs_are_refused_ends(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Invalid(SENTENCE)
    names = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
    sweep = cluster.apply(Kind.SWEEP, "study", {"template": {"spec": names}, "repetitions": 2})
    for _ in range(4):
        await cluster.look(sweep, 1)
        for run in [key for key in cluster.objects if key.kind is Kind.MAPPING_RUN]:
            await cluster.look(run, GRACE)
    status = await cluster.look(sweep, 1)
    assert (status["failed"], status["progress"]) == (2, "2/2")
    assert standing(status, "Complete")[0] == "True"


async def test_a_sweep_says_why_its_runs_are_refused(cluster: Cluster) -> None:
    cluster.refusals[Kind.MAPPING_RUN] = Forbidden("cannot create mappingruns lab/study: policy says no")
    names = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
    sweep = cluster.apply(Kind.SWEEP, "study", {"template": {"spec": names}})
    status = await cluster.look(sweep)
    assert standing(status, "Blocked") == (
        "True",
        "CannotCreate",
        "cannot create mappingruns lab/study: policy says no",
    )
    assert cluster.told["study", "CannotCreate"].endswith("policy says no")


@pytest.mark.parametrize("error", [Forbidden(WEBHOOK), Invalid("no such field"), ServerFault("down")])
@pytest.mark.parametrize("refused", ["jobs", "statuses"])
async def test_a_sweep_counts_and_names_runs_that_stand_still(
    cluster: Cluster, error: ApiError, refused: str
) -> None:
    def check(key: Key, _: dict[str, Any]) -> None:
        if key.kind is Kind.MAPPING_RUN:
            raise error

    cluster.refusals[Kind.JOB] = error
    if refused == "statuses":
        cluster.refusals[Kind.JOB] = Forbidden(QUOTA)  # which a run's status has to say
        cluster.check = check
    names = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
    sweep = cluster.apply(Kind.SWEEP, "study", {"template": {"spec": names}, "repetitions": 2})
    assert "Blocked" not in str(await cluster.look(sweep))
    runs = [key for key in cluster.objects if key.kind is Kind.MAPPING_RUN]
    woken = set()
    for run in runs * FAILURES_TOLD:
        await cluster.look(run)
        woken |= cluster.seen.queue._queued
    assert sweep in woken
    status = await cluster.look(sweep, 1)
    first = runs[0].name
    held, word, sentence = standing(status, "Blocked")
    assert (held, word) == ("True", "RunsStandStill")
    assert sentence.startswith(f"2 of 2 runs in flight don't go on; {first}: ")
    assert sentence.endswith(str(error))
    assert cluster.told["study", "RunsStandStill"] == sentence
    reason = "JobRefused" if refused == "jobs" and not error.retryable else "ReconcileError"
    assert cluster.told[first, reason].endswith(str(error))
    cluster.check = None
    cluster.refusals.clear()
    for run in runs * 2:
        await cluster.look(run, 10)
    assert standing(await cluster.look(sweep, 1), "Blocked")[:2] == ("False", "Free")
