# SPDX-License-Identifier: Apache-2.0
"""Tests of a Sweep's runs and its counts."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from slamhive.contract.settled import is_settled
from slamhive.engine import PointState
from slamhive.kube.api.kinds import Label
from slamhive.kube.reconciling.sweep_runs import (
    Finished,
    SweepTally,
    free_slot,
    run_body,
    slots_used,
    state_of,
)
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, Plan

SWEEP = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: study, uid: 8a1f}
spec:
  template:
    metadata:
      labels: {kueue.x-k8s.io/queue-name: lab, slamhive.io/slot: "99"}
    spec: {algorithmRef: {name: icp}, datasetRef: {name: hall}}
  repetitions: 2
"""


def a_run(phase: str | None = None, *, name: str = "r", slot: int = 0, **status: Any) -> dict[str, Any]:
    told = ({"phase": phase} if phase else {}) | status
    spec = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}, "evaluate": True}
    labels = {str(Label.SLOT): str(slot), str(Label.POINT): "3"}
    return {"metadata": {"name": name, "labels": labels}, "spec": spec, "status": told}


def finished(phase: str, **run: Any) -> Finished:
    return Finished.of(a_run(phase, **run))


def tracked(error: float, outcome: str = "Tracked") -> list[dict[str, Any]]:
    return [{"evaluation": "se3", "outcome": outcome, "coverage": 1.0, "ate": {"rmse": error}}]


def test_a_run_of_a_point_is_owned_labelled_and_whole() -> None:
    sweep = Sweep.model_validate(yaml.safe_load(SWEEP))
    body = {
        "metadata": {"name": "study", "namespace": "lab", "uid": "8a1f"},
        "spec": {"template": {"metadata": sweep.spec.template.metadata.as_json()}},
    }
    point = Plan(sweep, FixedCatalog(), strict=False).point(1)
    run = run_body(body, point, 4)
    labels = run["metadata"]["labels"]
    assert run["metadata"]["name"] == point.name
    assert run["metadata"]["ownerReferences"][0]["uid"] == "8a1f"
    assert labels["kueue.x-k8s.io/queue-name"] == "lab"
    assert (labels["slamhive.io/point"], labels["slamhive.io/slot"]) == ("1", "4")
    assert (run["spec"]["repetition"], run["spec"]["seed"]) == (1, 2)
    assert "cancel" not in run["spec"]


@pytest.mark.parametrize(
    ("phase", "state"),
    [
        (None, PointState.ACTIVE),
        ("Running", PointState.ACTIVE),
        ("Succeeded", PointState.SUCCEEDED),
        ("Failed", PointState.FAILED),
        ("Cancelled", PointState.FAILED),
    ],
)
def test_a_phase_is_a_points_state(phase: str | None, state: PointState) -> None:
    assert state_of(a_run(phase)) is state


def test_slots_of_finished_runs_are_free_again() -> None:
    used = slots_used([a_run("Running", slot=0), a_run("Succeeded", slot=1), a_run("Running", slot=2)])
    assert [free_slot(used), free_slot(used)] == [1, 3]


def test_a_tally_counts_cpu_once_and_ranks_tracked_runs() -> None:
    tally = SweepTally()
    usage = {"cpu": {"seconds": 2.0}}
    tally.add(finished("Succeeded", name="b", usage=usage, results=tracked(0.2)))
    tally.add(finished("Succeeded", name="a", usage=usage, results=tracked(0.1)))
    tally.add(finished("Succeeded", name="lost", results=tracked(0.01, "Partial")))
    tally.add(finished("Succeeded", name="copy", usage=usage, provenance={"reusedFrom": "a"}))
    tally.add(finished("Failed", name="bad", usage=usage))
    assert (tally.reused, tally.evaluated, tally.cpu_seconds) == (1, 3, 6.0)
    assert [entry.name for entry in tally.best] == ["a", "b"]


@pytest.mark.parametrize(
    ("run", "settled"),
    [
        (a_run("Running"), False),
        (a_run("Failed"), True),
        (a_run("Succeeded", trajectory={"poses": 3}), False),
        (a_run("Succeeded", trajectory={"poses": 3}, results=tracked(0.1)), True),
        (a_run("Succeeded", trajectory={"poses": 3}, conditions=[{"type": "Evaluated"}]), True),
        (a_run("Succeeded"), True),
    ],
)
def test_a_run_is_settled_when_nothing_more_comes(run: dict[str, Any], settled: bool) -> None:
    assert is_settled(run) is settled
