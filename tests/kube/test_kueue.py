# SPDX-License-Identifier: Apache-2.0
"""Runs of a queue on a real control plane with Kueue's own controller."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.nodes import status_of as played
from testcluster.kwok import Play, moment_of
from testcluster.lab import condition_of, run, status_of, until
from testcluster.labs import make_lab, plays  # noqa: F401 - fixtures

from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.reconciling import waiting
from slamhive.model.base import PRIORITY_CLASS, QUEUE_NAME

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from testcluster.lab import Lab
    from testcluster.local import Local

pytestmark = [pytest.mark.cluster, pytest.mark.timeout(900)]

API_VERSION = "kueue.x-k8s.io/v1beta2"


def kind(kind_: str, name: str, **more: Any) -> dict[str, Any]:
    """Return an object of Kueue's."""
    return {"apiVersion": API_VERSION, "kind": kind_, "metadata": {"name": name}} | more


@pytest.fixture
def lab(make_lab: Callable[..., Lab], kueue: Local, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:  # noqa: F811
    """A namespace whose queue has room for one run, and runs that go on until they are ended."""
    monkeypatch.setattr(waiting, "QUEUE_SECONDS", 1.0)
    made = make_lab(hold=True)
    room = [{"name": "cpu", "nominalQuota": "2"}, {"name": "memory", "nominalQuota": "100Gi"}]
    group = {"coveredResources": ["cpu", "memory"], "flavors": [{"name": made.namespace, "resources": room}]}
    spec = {
        "namespaceSelector": {},
        "preemption": {"withinClusterQueue": "LowerPriority"},
        "resourceGroups": [group],
    }
    made.apply(
        kind("ResourceFlavor", made.namespace),
        kind("ClusterQueue", made.namespace, spec=spec),
        kind("LocalQueue", "lab", spec={"clusterQueue": made.namespace}),
        kind("WorkloadPriorityClass", "urgent", value=1000),
    )
    yield made
    kueue.access().kubectl("delete", "clusterqueue,resourceflavor", made.namespace, "--wait=false")


def queued(name: str, queue: str = "lab", **labels: str) -> dict[str, Any]:
    body = run(name, retries=0, resources={"cpu": "1", "memory": "1Gi"})
    return body | {"metadata": body["metadata"] | {"labels": {QUEUE_NAME: queue} | labels}}


def pods(lab: Lab, name: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = lab.cluster.get("pods", "-n", lab.namespace, "-l", f"{Label.RUN}={name}")[
        "items"
    ]
    return found


def end(lab: Lab, name: str) -> str:
    """End a run's pod well; returns its UID."""
    [pod] = pods(lab, name)
    change = {"status": played(pod, moment_of(Play(), "run"))}
    lab.patch("pod", pod["metadata"]["name"], change, subresource="status")
    return str(pod["metadata"]["uid"])


def is_running(status: dict[str, Any]) -> bool:
    return status.get("phase") == "Running"


async def told(op: Any, name: str, words: str) -> dict[str, Any]:
    """Wait until a run says what it waits for."""
    return await status_of(
        op,
        Kind.MAPPING_RUN,
        name,
        lambda found: words in condition_of(found, "Scheduled").get("message", ""),
    )


async def test_a_run_is_admitted_preempted_and_resumed_and_has_one_result(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(queued("patient"))
        await status_of(op, Kind.MAPPING_RUN, "patient", is_running)
        [first] = pods(lab, "patient")
        lab.apply(queued("urgent", **{PRIORITY_CLASS: "urgent"}))
        await status_of(op, Kind.MAPPING_RUN, "urgent", is_running)
        status = await told(op, "patient", "its Job waits in queue 'lab': couldn't assign flavors to pod set")
        assert (status["phase"], status["disruptions"]) == ("Pending", 1)
        assert "insufficient unused quota for cpu" in condition_of(status, "Scheduled")["message"]
        end(lab, "urgent")
        await status_of(op, Kind.MAPPING_RUN, "urgent", lambda found: found.get("phase") == "Succeeded")
        await status_of(op, Kind.MAPPING_RUN, "patient", is_running)
        second = end(lab, "patient")
        status = await status_of(op, Kind.MAPPING_RUN, "patient", lambda found: found.get("completionTime"))
    assert (status["phase"], status["attempts"], status["disruptions"]) == ("Succeeded", 1, 1)
    assert status.get("faults") is None
    assert second != first["metadata"]["uid"]
    assert status["folder"].endswith(second)
    jobs = lab.cluster.get("jobs", "-n", lab.namespace, "-l", f"{Label.RUN}=patient")["items"]
    assert [job["metadata"]["name"] for job in jobs] == ["patient-1"]


async def test_a_run_says_that_its_queue_is_not_there_and_goes_on_when_it_is(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(queued("early", "later"))
        await told(op, "early", "its Job waits in queue 'later': LocalQueue later doesn't exist")
        lab.apply(kind("LocalQueue", "later", spec={"clusterQueue": lab.namespace}))
        await status_of(op, Kind.MAPPING_RUN, "early", is_running)


async def test_without_its_controller_what_runs_ends_and_what_waits_says_so(lab: Lab, kueue: Local) -> None:
    async with lab.operator() as op:
        lab.apply(queued("going"))
        await status_of(op, Kind.MAPPING_RUN, "going", is_running)
        kueue.stop("kueue")
        try:
            lab.apply(queued("waiting"))
            await told(op, "waiting", "no Workload was made for it: does Kueue's controller run")
            end(lab, "going")
            await status_of(op, Kind.MAPPING_RUN, "going", lambda found: found.get("phase") == "Succeeded")
        finally:
            kueue.start("kueue")
        await status_of(op, Kind.MAPPING_RUN, "waiting", is_running)
        await until(lambda: pods(lab, "waiting"), "its pod")
