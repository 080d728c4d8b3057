# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Any

import pytest

from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.routing import is_news, routes
from slamhive.kube.store import Store


def thing(name: str, labels: dict[str, str] | None = None, **fields: Any) -> dict[str, Any]:
    metadata = {"name": name, "namespace": "lab", "uid": name, "resourceVersion": "1", "labels": labels or {}}
    return {"metadata": metadata, "spec": fields.get("spec", {}), "status": fields.get("status", {})}


def targets(keys: list[Key]) -> set[str]:
    return {f"{key.kind}/{key.name}" for key in keys}


@pytest.mark.parametrize("kind", [Kind.JOB, Kind.POD])
@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        ({Label.ROLE: "run", Label.RUN: "r", Label.SWEEP: "s"}, {"MappingRun/r"}),
        ({Label.ROLE: "read", Label.RUN: "r"}, {"MappingRun/r"}),
        ({Label.ROLE: "prepare", Label.DATASET: "d", Label.VARIANT: "v"}, {"Dataset/d"}),
        ({Label.ROLE: "evaluate", Label.EVALUATION: "e"}, {"Evaluation/e"}),
        ({Label.ROLE: "evaluate", Label.SWEEP: "s"}, {"Evaluation/sweep:s"}),
        ({Label.ROLE: "evaluate", Label.RUN: "r"}, {"Evaluation/run:r"}),
        ({Label.ROLE: "collect"}, set()),
        ({}, set()),
    ],
)
def test_a_job_or_pod_leads_to_what_it_works_for(
    kind: Kind, labels: dict[str, str], expected: set[str]
) -> None:
    assert targets(routes(kind, thing("x", labels))) == expected


def test_a_run_leads_to_itself_and_its_sweep() -> None:
    assert targets(routes(Kind.MAPPING_RUN, thing("r", {Label.SWEEP: "s"}))) == {"MappingRun/r", "Sweep/s"}
    assert targets(routes(Kind.MAPPING_RUN, thing("r"))) == {"MappingRun/r"}


@pytest.mark.parametrize(
    ("phase", "expected"), [("Running", {"MappingRun/r"}), ("Succeeded", set()), (None, set())]
)
def test_the_job_of_a_run_that_is_over_or_gone_leads_nowhere(phase: str | None, expected: set[str]) -> None:
    store = Store()
    if phase is not None:
        store.put(Kind.MAPPING_RUN, thing("r", status={"phase": phase}))
    job = thing("x", {Label.ROLE: "run", Label.RUN: "r"})
    assert targets(routes(Kind.JOB, job, store)) == expected


def job(suspend: bool = False, **status: Any) -> dict[str, Any]:
    return thing("j", {Label.ROLE: "run", Label.RUN: "r"}, spec={"suspend": suspend}, status=status)


def pod(role: str = "run", deleted: str | None = None, **status: Any) -> dict[str, Any]:
    body = thing("p", {Label.ROLE: role, Label.RUN: "r"}, status={"phase": "Pending"} | status)
    return body | {"metadata": body["metadata"] | {"deletionTimestamp": deleted}}


def container(**state: Any) -> dict[str, Any]:
    return {"containerStatuses": [{"name": "algorithm", "state": state}]}


def told(kind: str, status: str, reason: str | None = None) -> dict[str, Any]:
    return {"type": kind, "status": status, "reason": reason}


STARTING = container(waiting={"reason": "ContainerCreating"})
STARTED = {"phase": "Running", **container(running={"startedAt": "2026-01-02T03:04:05Z"})}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (None, job()),
        (job(), job(startTime="2026-01-02T03:04:05Z", active=1, ready=0)),
        (job(active=1), job(active=0, uncountedTerminatedPods={"succeeded": ["u"]})),
    ],
)
def test_what_a_jobs_controller_counts_is_no_news(
    before: dict[str, Any] | None, after: dict[str, Any]
) -> None:
    assert not is_news(Kind.JOB, before, after)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (None, job(suspend=True)),
        (job(suspend=True), job()),
        (job(), job(conditions=[told("Failed", "True")])),
        (None, job(conditions=[told("Complete", "True")])),
    ],
)
def test_what_holds_a_job_back_or_ends_it_is_news(
    before: dict[str, Any] | None, after: dict[str, Any]
) -> None:
    assert is_news(Kind.JOB, before, after)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (None, pod()),
        (pod(), pod(conditions=[told("PodScheduled", "True")])),
        (pod(), pod(**STARTING, conditions=[told("PodScheduled", "True"), told("Ready", "False")])),
        (pod(**STARTED), pod(**STARTED, conditions=[told("Ready", "True")])),
    ],
)
def test_a_pod_that_begins_as_pods_do_is_no_news(
    before: dict[str, Any] | None, after: dict[str, Any]
) -> None:
    assert not is_news(Kind.POD, before, after)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (None, pod(role="prepare")),
        (None, pod(**STARTED)),
        (pod(**STARTING), pod(**STARTED)),
        (pod(), pod(conditions=[told("PodScheduled", "False", "Unschedulable")])),
        (pod(conditions=[told("PodScheduled", "False", "Unschedulable")]), pod()),
        (pod(**STARTING), pod(**container(waiting={"reason": "ErrImagePull"}))),
        (pod(**STARTED), pod(**STARTED, deleted="2026-01-02T03:04:05Z")),
        (pod(**STARTED), pod(**STARTED, conditions=[told("DisruptionTarget", "True")])),
        (pod(**STARTED), pod(phase="Failed", reason="Evicted", message="the node was low on memory")),
        (pod(**STARTED), pod(phase="Succeeded", **container(terminated={"exitCode": 0}))),
    ],
)
def test_what_keeps_a_pod_ends_it_or_takes_it_is_news(
    before: dict[str, Any] | None, after: dict[str, Any]
) -> None:
    assert is_news(Kind.POD, before, after)


@pytest.mark.parametrize(
    ("selector", "selected"),
    [
        ({"names": ["r"]}, True),
        ({"sweepRef": {"name": "s"}}, True),
        ({"matchLabels": {"team": "x"}}, True),
        ({"names": ["other"], "matchLabels": {"team": "x"}}, True),
        ({"names": ["other"]}, False),
        ({"sweepRef": {"name": "t"}}, False),
        ({"matchLabels": {"team": "x", "more": "y"}}, False),
    ],
)
def test_a_finished_run_leads_to_the_evaluations_that_select_it(
    selector: dict[str, Any], selected: bool
) -> None:
    store = Store()
    store.put(Kind.EVALUATION, thing("e", spec={"runs": selector}))
    labels = {Label.SWEEP: "s", "team": "x"}
    finished = thing("r", labels, status={"phase": "Succeeded"})
    assert ("Evaluation/e" in targets(routes(Kind.MAPPING_RUN, finished, store))) is selected
    running = thing("r", labels, status={"phase": "Running"})
    assert "Evaluation/e" not in targets(routes(Kind.MAPPING_RUN, running, store))


@pytest.mark.parametrize(("kind", "field"), [(Kind.ALGORITHM, "algorithmRef"), (Kind.DATASET, "datasetRef")])
def test_the_catalog_leads_to_unfinished_runs_that_name_it(kind: Kind, field: str) -> None:
    store = Store()
    for name, phase in [("waiting", "Pending"), ("done", "Failed")]:
        run = thing(name, spec={field: {"name": "x"}}, status={"phase": phase})
        store.put(Kind.MAPPING_RUN, run)
    store.put(Kind.SWEEP, thing("s"))
    assert targets(routes(kind, thing("x"), store)) == {f"{kind}/x", "MappingRun/waiting"}
    assert targets(routes(kind, thing("x"), store, new=True)) == {
        f"{kind}/x",
        "MappingRun/waiting",
        "Sweep/s",
    }
