# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Any

import pytest

from slamhive.kube.kinds import Key, Kind, Label
from slamhive.kube.routing import routes
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
