# SPDX-License-Identifier: Apache-2.0
"""Runs that cannot be measured, on a real control plane: what is told, and what a restarted operator knows.

Pods are played, so the logs of evaluators are given here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from testcluster.lab import condition_of, manifest, run, status_of, sweep, until

from slamhive.jobs.lines import encode_all
from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.reconciling.evaluation_status import problems_noted
from slamhive.kube.reconciling.result_taking import runs_of

if TYPE_CHECKING:
    from testcluster.lab import Lab

    from slamhive.kube.operator import Operator

SETTINGS = {"evaluation": {"delaySeconds": 0.1}}
WHY = "its trajectory has 2 poses"


class Evaluators:
    """Stand-in for evaluators' pods, whose logs tell an error of each run, or nothing."""

    def __init__(self) -> None:
        self.silent = False
        self.measured: list[tuple[str, ...]] = []
        """The runs of each Job whose log was read."""

    def log(self, op: Operator, namespace: str, pod: str) -> str:
        """Return the log of a pod."""
        found = op.cluster.store.get(Key(Kind.POD, namespace, pod))
        assert found is not None
        owner = found["metadata"]["ownerReferences"][0]["name"]
        job = op.cluster.store.get(Key(Kind.JOB, namespace, owner))
        assert job is not None
        names = job["metadata"]["annotations"]["slamhive.io/runs"].split(",")
        self.measured.append(tuple(names))
        runs = [op.cluster.store.get(Key(Kind.MAPPING_RUN, namespace, name)) for name in names]
        told = [
            {"uid": one["metadata"]["uid"], "name": one["metadata"]["name"], "error": WHY}
            for one in runs
            if one
        ]
        return "" if self.silent else "\n".join(encode_all(told))


@pytest.fixture
def evaluators(monkeypatch: pytest.MonkeyPatch) -> Evaluators:
    """The evaluators of all operators of the test."""
    return Evaluators()


@pytest.fixture
def operating(lab: Lab, evaluators: Evaluators, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function that runs an operator to which evaluators speak."""

    def operator() -> Any:
        context = lab.operator(**SETTINGS)
        started: list[Operator] = []

        async def logs(_: Api, namespace: str, pod: str, *__: Any, **___: Any) -> str:
            return evaluators.log(started[0], namespace, pod)

        class Running:
            async def __aenter__(self) -> Operator:
                monkeypatch.setattr(Api, "logs", logs)
                started.append(await context.__aenter__())
                return started[0]

            async def __aexit__(self, *error: object) -> None:
                await context.__aexit__(*error)

        return Running()

    return operator


def told(status: dict[str, Any]) -> bool:
    return bool(condition_of(status, "Evaluated").get("reason") == "NotEvaluable")


@pytest.mark.parametrize("silent", [False, True], ids=["refused", "silent"])
async def test_what_cannot_be_measured_is_not_tried_again_by_the_next_operator(
    lab: Lab, operating: Any, evaluators: Evaluators, *, silent: bool
) -> None:
    evaluators.silent = silent
    drift = manifest("Evaluation", "drift", runs={"names": ["one"]}, alignment="Origin")
    async with operating() as op:
        lab.apply(run("one", evaluate=True), drift)
        await status_of(op, Kind.MAPPING_RUN, "one", told)
        await status_of(op, Kind.EVALUATION, "drift", lambda status: status.get("failed") == 1)
        # The condition comes first, then the note, then the Job goes: an operator that ends before the last
        # leaves the run to be tried, or its log to be read, again.
        await until(lambda: {"", "drift"} <= _groups_noted(op, lab, "one"), "both to be noted")
        await until(lambda: not _evaluators_of(op, lab), "their Jobs to go")
    tried = len(evaluators.measured)
    assert tried == (6 if silent else 2)
    async with operating() as op:
        lab.apply(run("two", evaluate=True))
        await status_of(op, Kind.MAPPING_RUN, "two", told)
        status = await status_of(op, Kind.EVALUATION, "drift", lambda status: status.get("failed") == 1)
    assert {*evaluators.measured[tried:]} == {("two",)}
    why = "the evaluator's results are incomplete" if silent else WHY
    assert condition_of(status, "Complete")["message"] == f"one: {why}"


async def test_another_measurement_is_tried(lab: Lab, operating: Any, evaluators: Evaluators) -> None:
    """A failure belongs to its settings, and whoever removes the note has it tried again."""
    async with operating() as op:
        lab.apply(sweep(sizes=2, template={"evaluate": True}))
        runs = await until(lambda: _given_up(op, lab, 2), "both to be given up")
        before = len(evaluators.measured)
        lab.patch("sweep", "study", {"spec": {"evaluation": {"alignment": "Origin"}}})
        await status_of(op, Kind.SWEEP, "study", lambda status: status.get("observedGeneration") == 2)
        lab.patch("mappingrun", runs[0]["metadata"]["name"], {"metadata": {"labels": {"look": "again"}}})
        await until(lambda: len(evaluators.measured) > before, "another attempt")
        await until(lambda: all(_noted(op, lab, one) != _noted_of(one) for one in runs), "other notes")
        before = len(evaluators.measured)
        name = runs[1]["metadata"]["name"]
        lab.patch("mappingrun", name, {"metadata": {"annotations": {"slamhive.io/not-evaluable": None}}})
        await until(lambda: [*evaluators.measured[before:]][-1:] == [(name,)], "the run to be measured again")


def _groups_noted(op: Operator, lab: Lab, name: str) -> set[str]:
    found = op.cluster.store.get(Key(Kind.MAPPING_RUN, lab.namespace, name))
    return set(problems_noted(found)) if found else set()


def _evaluators_of(op: Operator, lab: Lab) -> list[dict[str, Any]]:
    return [job for job in op.cluster.store.of(Kind.JOB, lab.namespace) if runs_of(job)]


def _given_up(op: Operator, lab: Lab, count: int) -> list[dict[str, Any]]:
    runs = [one for one in op.cluster.store.of(Kind.MAPPING_RUN, lab.namespace) if _noted_of(one)]
    return runs if len(runs) == count else []


def _noted_of(one: dict[str, Any]) -> str:
    return str((one["metadata"].get("annotations") or {}).get("slamhive.io/not-evaluable", ""))


def _noted(op: Operator, lab: Lab, one: dict[str, Any]) -> str:
    found = op.cluster.store.get(Key(Kind.MAPPING_RUN, lab.namespace, one["metadata"]["name"]))
    return _noted_of(found) if found else ""
