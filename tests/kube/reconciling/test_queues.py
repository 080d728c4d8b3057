# SPDX-License-Identifier: Apache-2.0
"""Runs that go by a queue: let in, put off, let in again; the test plays Kueue, which keeps it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.refusals import forbidden
from testcluster.kwok import Play, moment_of
from testcluster.lab import condition_of, run, status_of, sweep, until

from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.reconciling import disruptions, waiting
from slamhive.model.base import PRIORITY_CLASS, QUEUE_NAME

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

QUEUE = "gpu"
FULL = (
    "couldn't assign flavors to pod set main: insufficient unused quota for cpu in flavor any, 1 more needed"
)


@pytest.fixture
def make_lab_with_kueue(
    make_fake_lab: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Lab]:
    """A function that gives a cluster with Kueue; what a Job waits for is said at once."""
    monkeypatch.setattr(waiting, "POD_SECONDS", 0.0)
    monkeypatch.setattr(waiting, "QUEUE_SECONDS", 0.2)
    monkeypatch.setattr("slamhive.kube.kueue.SERVED_SECONDS", 0.0)

    def make(**play: Any) -> Lab:
        found = make_fake_lab(**play)
        found.cluster.serve_kueue(now=True)
        return found

    return make


@pytest.fixture
def lab(make_lab_with_kueue: Callable[..., Lab]) -> Lab:
    """A cluster with Kueue, whose runs go on until they are ended."""
    return make_lab_with_kueue(hold=True)


def queued(body: dict[str, Any], name: str = QUEUE, **more: str) -> dict[str, Any]:
    """Return an object with a queue's name among its labels."""
    return body | {"metadata": body["metadata"] | {"labels": {QUEUE_NAME: name} | more}}


def jobs(lab: Lab, role: str = "run") -> list[dict[str, Any]]:
    found = lab.cluster.of("job", "lab")
    return [job for job in found if job["metadata"]["labels"].get(Label.ROLE) == role]


def pods(lab: Lab) -> list[dict[str, Any]]:
    found = lab.cluster.of("pod", "lab")
    return [pod for pod in found if pod["metadata"]["labels"].get(Label.ROLE) == "run"]


def let_in(lab: Lab, name: str = "one-1", **template: Any) -> None:
    """Have a Job start, as Kueue does: with what the flavor of its resources adds to its template."""
    lab.patch("job", name, {"spec": {"suspend": False, "template": template}})


def put_off(lab: Lab, name: str = "one-1") -> None:
    """Suspend a Job that runs, as Kueue does; the time of its start is taken back."""
    lab.patch("job", name, {"spec": {"suspend": True}})
    lab.patch("job", name, {"status": {"startTime": None}}, subresource="status")


def tell(lab: Lab, *conditions: tuple[str, str, str, str], name: str = "one-1", active: bool = True) -> None:
    """Make a Job's Workload, or have it say something else."""
    [job] = [one for one in jobs(lab) if one["metadata"]["name"] == name]
    body = {
        "apiVersion": "kueue.x-k8s.io/v1beta2",
        "kind": "Workload",
        "metadata": {"name": f"job-{name}", "labels": {"kueue.x-k8s.io/job-uid": job["metadata"]["uid"]}},
        "spec": {"active": active, "queueName": QUEUE, "podSets": []},
    }
    lab.apply(body)
    names = ("type", "status", "reason", "message")
    told = [dict(zip(names, one, strict=True)) for one in conditions]
    lab.patch("workload", f"job-{name}", {"status": {"conditions": told}}, subresource="status")


def scheduled(status: dict[str, Any]) -> dict[str, Any]:
    return condition_of(status, "Scheduled")


async def waits(op: Any, words: str, name: str = "one") -> dict[str, Any]:
    """Wait until a run says what it waits for in its queue."""
    return await status_of(
        op, Kind.MAPPING_RUN, name, lambda found: words in scheduled(found).get("message", "")
    )


def is_running(status: dict[str, Any]) -> bool:
    return status.get("phase") == "Running" and scheduled(status).get("status") == "True"


def is_over(status: dict[str, Any]) -> bool:
    return status.get("phase") in {"Succeeded", "Failed", "Cancelled"}


async def test_a_run_waits_in_its_queue_and_nobody_but_the_queue_starts_it(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(queued(run(retries=0), **{PRIORITY_CLASS: "low"}))
        status = await waits(op, f"its Job waits in queue '{QUEUE}': no Workload was made for it")
        assert (status["phase"], scheduled(status)["reason"]) == ("Pending", "QueueWaits")
        tell(lab, ("QuotaReserved", "False", "Pending", FULL))
        await waits(op, f"its Job waits in queue '{QUEUE}': {FULL}")
        [job] = jobs(lab)
        assert (job["spec"]["suspend"], pods(lab)) == (True, [])
        assert job["metadata"]["labels"][PRIORITY_CLASS] == "low"
        added = {"labels": {"kueue.x-k8s.io/podset": "main"}, "annotations": {"flavor": "any"}}
        selector = job["spec"]["template"]["spec"]["nodeSelector"]
        let_in(lab, metadata=added, spec={"nodeSelector": selector})
        await status_of(op, Kind.MAPPING_RUN, "one", is_running)
        [pod] = pods(lab)
        assert pod["metadata"]["labels"]["kueue.x-k8s.io/podset"] == "main"
        lab.cluster.end_pod(pod["metadata"]["name"], "lab", moment_of(Play(), "run"))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        [job] = jobs(lab)
    assert (status["phase"], status["attempts"], status.get("disruptions")) == ("Succeeded", 1, None)
    assert job["spec"]["template"]["metadata"]["annotations"]["flavor"] == "any"


@pytest.mark.parametrize("exit_code", [0, 143])
async def test_a_run_that_is_put_off_is_no_failure_and_goes_on_with_another_pod(
    lab: Lab, exit_code: int
) -> None:
    async with lab.operator() as op:
        lab.apply(queued(run(retries=0)))
        await waits(op, QUEUE)
        let_in(lab)
        await status_of(op, Kind.MAPPING_RUN, "one", is_running)
        [first] = pods(lab)
        lab.cluster.ignore_sigterm(now=True)
        put_off(lab)
        status = await waits(op, "its pod is being taken away: its Job was suspended")
        assert status["disruptions"] == 1
        # However it answers the signal, it says nothing about the algorithm.
        lab.cluster.end_pod(first["metadata"]["name"], "lab", moment_of(Play(exit_code=exit_code), "run"))
        lab.cluster.ignore_sigterm(now=False)
        status = await waits(op, f"its Job waits in queue '{QUEUE}'")
        assert "taken by a disruption once" in scheduled(status)["message"]
        await until(lambda: not pods(lab), "its pod to go")
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found["phase"] == "Pending")
        let_in(lab)
        await status_of(op, Kind.MAPPING_RUN, "one", is_running)
        [second] = pods(lab)
        lab.cluster.end_pod(second["metadata"]["name"], "lab", moment_of(Play(), "run"))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["attempts"], status["disruptions"]) == ("Succeeded", 1, 1)
    assert status.get("faults") is None
    assert status["folder"].endswith(second["metadata"]["uid"])


@pytest.mark.parametrize("goes_on", [False, True])
async def test_what_a_queue_took_while_no_operator_looked_is_counted_too(lab: Lab, goes_on: bool) -> None:
    async with lab.operator() as op:
        lab.apply(queued(run(retries=0)))
        await waits(op, QUEUE)
        let_in(lab)
        await status_of(op, Kind.MAPPING_RUN, "one", is_running)
    past = "2020-01-01T00:00:00Z"  # the times are whole seconds
    lab.patch("mappingrun", "one", {"status": {"startTime": past}}, subresource="status")
    put_off(lab)
    await until(lambda: not pods(lab), "its pod to go")
    if goes_on:
        let_in(lab)
        await until(lambda: pods(lab), "another pod")
    async with lab.operator() as op:
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("disruptions"))
        if not goes_on:
            assert status["phase"] == "Pending"
            assert "; taken by a disruption once" in scheduled(status)["message"]
            let_in(lab)
            await status_of(op, Kind.MAPPING_RUN, "one", is_running)
        [pod] = pods(lab)
        lab.cluster.end_pod(pod["metadata"]["name"], "lab", moment_of(Play(), "run"))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["disruptions"], status["attempts"]) == ("Succeeded", 1, 1)


async def test_what_a_drain_and_a_queue_take_in_turns_is_counted_once_each(lab: Lab) -> None:
    taken = {"phase": "Failed", "conditions": [{"type": "DisruptionTarget", "status": "True"}]}
    known: set[str] = set()

    async def next_pod(op: Any) -> str:
        def at_work() -> list[dict[str, Any]]:
            found = [pod for pod in pods(lab) if pod["status"]["phase"] == "Running"]
            return [pod for pod in found if pod["metadata"]["uid"] not in known]

        [pod] = await until(at_work, "a pod")
        known.add(pod["metadata"]["uid"])
        await status_of(op, Kind.MAPPING_RUN, "one", is_running)
        return str(pod["metadata"]["name"])

    async with lab.operator() as op:
        lab.apply(queued(run(retries=0)))
        await waits(op, QUEUE)
        let_in(lab)
        for number in range(1, 6):
            name = await next_pod(op)
            if number % 2:
                lab.patch("pod", name, {"status": taken}, subresource="status")
            else:
                lab.cluster.ignore_sigterm(now=True)
                put_off(lab)
                await waits(op, "its Job was suspended")
                lab.cluster.ignore_sigterm(now=False)
            await status_of(
                op, Kind.MAPPING_RUN, "one", lambda found, n=number: found.get("disruptions") == n
            )
            if not number % 2:
                await waits(op, QUEUE)
                let_in(lab)
        await next_pod(op)
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_running)
    assert (status["disruptions"], status["attempts"]) == (5, 1)


async def test_a_run_that_is_put_off_too_often_ends_with_a_reason_of_its_own(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disruptions, "MOST_DISRUPTIONS", 2)
    async with lab.operator() as op:
        lab.apply(queued(run(retries=5)))
        for number in (1, 2):
            await waits(op, QUEUE)
            let_in(lab)
            await status_of(op, Kind.MAPPING_RUN, "one", is_running)
            lab.cluster.ignore_sigterm(now=True)
            put_off(lab)
            await status_of(
                op, Kind.MAPPING_RUN, "one", lambda found, n=number: found.get("disruptions") == n
            )
            lab.cluster.ignore_sigterm(now=False)
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        await until(lambda: not jobs(lab), "its Job to go")
    assert (status["phase"], status["reason"], status.get("faults")) == ("Failed", "Disrupted", None)


@pytest.mark.parametrize(
    ("conditions", "active", "words"),
    [
        ([("QuotaReserved", "False", "Inadmissible", "LocalQueue gpu doesn't exist")], True, "doesn't exist"),
        ([("QuotaReserved", "True", "QuotaReserved", "Quota reserved")], True, "waits to be let in"),
        (
            [
                ("QuotaReserved", "True", "QuotaReserved", "Quota reserved"),
                ("Admitted", "False", "UnsatisfiedChecks", "The workload has failed admission checks"),
            ],
            True,
            "The workload has failed admission checks",
        ),
        ([("Evicted", "True", "Deactivated", "Exceeded the limit")], False, "is not active: Exceeded"),
        ([], True, "Kueue has not looked at it yet"),
    ],
)
async def test_a_waiting_run_says_what_its_workload_says(
    lab: Lab, conditions: list[tuple[str, str, str, str]], active: bool, words: str
) -> None:
    async with lab.operator() as op:
        lab.apply(queued(run()))
        await waits(op, QUEUE)
        tell(lab, *conditions, active=active)
        await waits(op, words)


async def test_without_the_right_to_read_workloads_the_queue_is_named(lab: Lab) -> None:
    lab.cluster.refuse(
        lambda _verb, resource, _body: (
            forbidden(resource, "", "no right") if resource.startswith("workloads") else None
        )
    )
    async with lab.operator() as op:
        lab.apply(queued(run()))
        status = await waits(op, QUEUE)
    assert scheduled(status)["message"] == f"its Job waits in queue '{QUEUE}'"


async def test_where_kueue_is_not_there_or_goes_a_waiting_run_says_so_and_one_at_work_ends(lab: Lab) -> None:
    lab.cluster.serve_kueue(now=False)
    async with lab.operator() as op:
        lab.apply(queued(run()))
        await waits(op, "Kueue is not there (kueue.x-k8s.io/v1beta2 is not served), so nothing starts it")
        lab.cluster.serve_kueue(now=True)
        await waits(op, "no Workload was made for it")
        let_in(lab)
        await status_of(op, Kind.MAPPING_RUN, "one", is_running)
        lab.cluster.serve_kueue(now=False)
        [pod] = pods(lab)
        lab.cluster.end_pod(pod["metadata"]["name"], "lab", moment_of(Play(), "run"))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["phase"] == "Succeeded"


async def test_a_run_that_waits_can_be_cancelled(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(queued(run()))
        await waits(op, QUEUE)
        lab.patch("mappingrun", "one", {"spec": {"cancel": True}})
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], jobs(lab)) == ("Cancelled", [])


async def test_a_name_that_no_queue_can_have_is_refused(lab: Lab) -> None:
    study = sweep()
    study["spec"]["template"]["metadata"] = {"labels": {QUEUE_NAME: "Lab_1"}}
    async with lab.operator() as op:
        lab.apply(queued(run(), "Lab_1"), study, queued(sweep("other"), "Lab_1"))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        assert (status["phase"], status["reason"]) == ("Failed", "InvalidParameters")
        assert status["message"] == (
            f"metadata.labels: {QUEUE_NAME}: expected a name of lower-case letters, digits, - and ., "
            "at most 63 characters, found 'Lab_1'; try lab-1"
        )
        for name in ("study", "other"):
            status = await status_of(
                op, Kind.SWEEP, name, lambda found: condition_of(found, "Accepted").get("status") == "False"
            )
            assert "found 'Lab_1'; try lab-1" in condition_of(status, "Accepted")["message"]


async def test_a_sweep_says_what_its_runs_wait_for_and_its_time_begins_when_one_is_let_in(lab: Lab) -> None:
    async with lab.operator() as op:
        study = queued(sweep(sizes=3, parallelism=2, budget={"wallTime": "1h"}))
        study["spec"]["template"]["metadata"] = {"labels": {PRIORITY_CLASS: "high"}}
        lab.apply(study)
        status = await status_of(
            op,
            Kind.SWEEP,
            "study",
            lambda found: "2 of 2" in condition_of(found, "Blocked").get("message", ""),
        )
        told = condition_of(status, "Blocked")
        assert told["reason"] == "QueueWaits"
        assert f"its Job waits in queue '{QUEUE}'" in told["message"]
        assert (status["running"], len(jobs(lab))) == (2, 2)
        assert {job["metadata"]["labels"][PRIORITY_CLASS] for job in jobs(lab)} == {"high"}
        waited = status.get("startTime")
        op.cluster.clock = lambda clock=op.cluster.clock: clock() + 7200.0
        lab.patch("sweep", "study", {"spec": {"maxFailures": 3}})
        await until(
            lambda: op.cluster.store.of(Kind.SWEEP, "lab")[0]["status"]["observedGeneration"] == 2, "it"
        )
        first = jobs(lab)[0]["metadata"]["name"]
        let_in(lab, first)
        status = await status_of(
            op, Kind.SWEEP, "study", lambda found: found.get("startTime") not in {None, waited}
        )
        assert status["phase"] == "Running"


@pytest.mark.parametrize("role", ["prepare", "evaluate"])
async def test_what_prepares_and_measures_goes_by_no_queue_and_bears_to_be_put_off(
    make_lab_with_kueue: Callable[..., Lab], role: str
) -> None:
    lab = make_lab_with_kueue(ends={role: moment_of(Play(hold=True), "run")})
    where = "Scheduled" if role == "prepare" else "EvaluationError"

    def told(status: dict[str, Any]) -> str:
        return str(condition_of(status, where).get("message", ""))

    async with lab.operator(evaluation={"delaySeconds": 0}) as op:
        lab.apply(queued(run(evaluate=True)))
        if role == "evaluate":
            await waits(op, QUEUE)
            let_in(lab)
        [job] = await until(lambda: jobs(lab, role), "the Job")
        assert not job["spec"].get("suspend")
        assert QUEUE_NAME not in job["metadata"]["labels"]
        name = job["metadata"]["name"]
        await until(lambda: op.cluster.store.pods_of(job), "its pod")
        put_off(lab, name)
        await status_of(
            op, Kind.MAPPING_RUN, "one", lambda found: "suspended, by no queue that it names" in told(found)
        )
        let_in(lab, name)
        [pod] = await until(lambda: op.cluster.store.pods_of(job), "another pod")
        assert pod["metadata"]["name"]
