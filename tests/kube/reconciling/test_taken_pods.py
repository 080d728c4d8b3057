# SPDX-License-Identifier: Apache-2.0
"""Pods that are taken from runs: before and after their end, while an operator looks and while none does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from testcluster.kwok import Play, ended, moment_of, run_message
from testcluster.lab import condition_of, run, status_of, sweep, until

from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.reconciling import disruptions

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

TAKEN = {"type": "DisruptionTarget", "status": "True", "reason": "PreemptionByScheduler"}
WHY = "default-scheduler: preempting to accommodate a higher priority pod"


def is_over(status: dict[str, Any]) -> bool:
    return status.get("phase") in {"Succeeded", "Failed", "Cancelled"}


def pods(lab: Lab) -> list[dict[str, Any]]:
    """Return the pods of runs that are at work."""
    found = lab.cluster.of("pod", "lab")
    return [
        pod
        for pod in found
        if pod["metadata"]["labels"].get(Label.ROLE) == "run"
        and pod["status"]["phase"] not in {"Succeeded", "Failed"}
    ]


async def running(lab: Lab, name: str = "one") -> str:
    """Wait until a run is at work, and return its pod's name; no operator is there then."""
    async with lab.operator() as op:
        await status_of(op, Kind.MAPPING_RUN, name, lambda status: status.get("phase") == "Running")
    [pod] = pods(lab)
    return str(pod["metadata"]["name"])


@pytest.mark.parametrize("gone", [["pod"], ["pod", "job"]])
@pytest.mark.parametrize("left", [True, False])
async def test_a_run_that_ended_while_nobody_looked_has_succeeded_whoever_took_its_pod(
    make_fake_lab: Callable[..., Lab], gone: list[str], left: bool
) -> None:
    told = ended(0, run_message(pod="pod-7")) if left else ended(1, "no such folder")
    lab = make_fake_lab(hold=True, ends={"read": told})
    lab.apply(run(retries=0))
    pod = await running(lab)
    lab.cluster.end_pod(pod, "lab", moment_of(Play(), "run"))
    for kind in gone:
        lab.delete(kind, pod if kind == "pod" else "one-1")
    async with lab.operator() as op:
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        folder = f"runs/{op.cluster.store.of(Kind.MAPPING_RUN, 'lab')[0]['metadata']['uid']}/pod-7"
    assert status["attempts"] == 1
    if left:
        assert (status["phase"], status.get("faults"), status["folder"]) == ("Succeeded", None, folder)
        assert status["trajectory"]["path"] == f"{folder}/output/trajectory.txt"
        assert ("its Job and pod were gone" in status.get("message", "")) == ("job" in gone)
    else:
        reason = "SystemFault" if "job" in gone else "NodeLost"
        assert (status["phase"], status["reason"]) == ("Failed", reason)
        assert "no such folder" in status["message"]


async def test_a_run_that_is_broken_off_is_no_result_whatever_its_exit_code(
    make_fake_lab: Callable[..., Lab],
) -> None:
    lab = make_fake_lab(hold=True, ends={"read": ended(0, run_message(pod="pod-7"))})
    lab.cluster.ignore_sigterm(now=True)
    lab.apply(run(retries=0))
    pod = await running(lab)
    async with lab.operator() as op:
        lab.delete("pod", pod)
        await status_of(
            op, Kind.MAPPING_RUN, "one", lambda found: condition_of(found, "Scheduled")["status"] == "False"
        )
    lab.cluster.end_pod(pod, "lab", moment_of(Play(), "run"))  # it handles SIGTERM and exits with 0
    lab.cluster.ignore_sigterm(now=False)
    async with lab.operator() as op:
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"]) == ("Failed", "NodeLost")


async def test_a_preparation_is_made_again_where_its_word_went_with_its_pod(
    make_fake_lab: Callable[..., Lab],
) -> None:
    at_work = moment_of(Play(hold=True), "run")
    lab = make_fake_lab(ends={"prepare": at_work})
    async with lab.operator():
        lab.apply(run(retries=0))
        [pod] = await until(lambda: lab.cluster.of("pod", "lab"), "the preparation")
    lab.cluster.end_pod(pod["metadata"]["name"], "lab", moment_of(Play(), "prepare"))
    lab.delete("pod", pod["metadata"]["name"])
    lab.cluster.play_from_now(lab.pool, Play())
    async with lab.operator() as op:
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status.get("faults")) == ("Succeeded", None)


@pytest.mark.parametrize("how", ["cancel", "delete the Job", "delete the run"])
async def test_a_slot_is_free_when_its_pod_has_ended(make_fake_lab: Callable[..., Lab], how: str) -> None:
    lab = make_fake_lab(hold=True)
    lab.cluster.ignore_sigterm(now=True)
    async with lab.operator() as op:
        lab.apply(sweep(parallelism=1))
        [first] = await until(lambda: pods(lab), "the first pod")
        name = first["metadata"]["labels"][Label.RUN]
        await status_of(op, Kind.MAPPING_RUN, name, lambda status: status.get("phase") == "Running")
        if how == "cancel":
            lab.patch("mappingrun", name, {"spec": {"cancel": True}})
        else:
            lab.delete(*(("job", f"{name}-1") if "Job" in how else ("mappingrun", name)))
        await until(lambda: "deletionTimestamp" in pods(lab)[0]["metadata"], "the pod to be told")
        if how == "delete the run":
            await status_of(op, Kind.SWEEP, "study", lambda status: status.get("failed") == 1)
        else:
            await status_of(
                op,
                Kind.MAPPING_RUN,
                name,
                lambda found: condition_of(found, "Scheduled")["reason"] == "Terminating",
            )
        assert [pod["metadata"]["uid"] for pod in pods(lab)] == [first["metadata"]["uid"]]
        lab.cluster.ignore_sigterm(now=False)
        [second] = await until(
            lambda: [pod for pod in pods(lab) if pod["metadata"]["uid"] != first["metadata"]["uid"]],
            "the next pod",
        )
    labels = second["metadata"]["labels"]
    assert labels[Label.SLOT] == "0"
    wanted = (name, "2") if "Job" in how else (labels[Label.RUN], "1")
    assert (labels[Label.RUN], labels[Label.ATTEMPT]) == wanted
    assert (labels[Label.RUN] == name) == ("Job" in how)


async def test_a_run_waits_for_the_pod_of_an_earlier_one_of_its_name(
    make_fake_lab: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = make_fake_lab(hold=True)
    lab.cluster.ignore_sigterm(now=True)
    async with lab.operator() as op:
        lab.apply(run(retries=0))
        await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Running")
        [first] = pods(lab)
        monkeypatch.setattr("fakeapi.objects.now", lambda: "2100-01-01T00:00:00Z")
        lab.delete("mappingrun", "one")
        lab.apply(run(retries=0))
        await status_of(
            op,
            Kind.MAPPING_RUN,
            "one",
            lambda found: condition_of(found, "Scheduled").get("status") == "False",
        )
        assert [pod["metadata"]["uid"] for pod in pods(lab)] == [first["metadata"]["uid"]]
        lab.cluster.ignore_sigterm(now=False)
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Running")
    assert (status["attempts"], status.get("faults")) == (1, None)


async def preempt(lab: Lab, uid: str | None) -> str:
    """Take the pod at work away as the scheduler does; returns the next one's uid."""
    [pod] = await until(
        lambda: [one for one in pods(lab) if one["metadata"]["uid"] != uid], "a pod to be taken"
    )
    change = {"phase": "Failed", "conditions": [TAKEN | {"message": WHY}]}
    lab.patch("pod", pod["metadata"]["name"], {"status": change}, subresource="status")
    return str(pod["metadata"]["uid"])


async def test_disruptions_are_counted_and_cost_no_attempt(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(hold=True)
    uid = None
    async with lab.operator() as op:
        lab.apply(run(retries=0))
        for number in range(1, 7):
            uid = await preempt(lab, uid)
            status = await status_of(
                op, Kind.MAPPING_RUN, "one", lambda found, n=number: found.get("disruptions") == n
            )
        [pod] = await until(lambda: pods(lab), "the last pod")
        lab.cluster.end_pod(pod["metadata"]["name"], "lab", moment_of(Play(), "run"))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        events = [event for event in lab.cluster.of("event", "lab") if event["reason"] == "Disrupted"]
    assert (status["phase"], status["attempts"], status["disruptions"]) == ("Succeeded", 1, 6)
    assert "faults" not in status
    told = {event["message"].partition("taken by a disruption ")[2].partition(";")[0] for event in events}
    assert told == {"once", *(f"{number} times" for number in range(2, 7))}


async def test_a_run_that_is_taken_too_often_ends_with_a_reason_of_its_own(
    make_fake_lab: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disruptions, "MOST_DISRUPTIONS", 2)
    lab = make_fake_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(run(retries=5))
        first = await preempt(lab, None)
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("disruptions") == 1)
        await preempt(lab, first)
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        await until(lambda: not pods(lab), "all pods to go")
    assert (status["phase"], status["reason"], status["attempts"]) == ("Failed", "Disrupted", 1)
    assert status["message"] == "taken by a disruption 2 times: no more are borne"
