# SPDX-License-Identifier: Apache-2.0
"""Results that can't be kept, without a cluster: one bad record costs one record."""

from __future__ import annotations

import json
from typing import Any

import pytest
from testcluster.kept import ALGORITHM, DATASET, GRACE, READY, RUN, Cluster, catalogued, standing

from slamhive.jobs.lines import encode_all
from slamhive.jobs.report import report
from slamhive.jobs.requests import EvaluateRequest, RunItem
from slamhive.kube.api.errors import Forbidden, Invalid, ServerFault
from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.loop import FAILURES_TOLD
from slamhive.kube.reconciling import result_taking
from slamhive.kube.records import NOT_EVALUABLE, record_of
from slamhive.kube.settings import EvaluationJobs
from slamhive.kube.status import iso

GOOD = {"outcome": "Tracked", "coverage": 1.0, "values": {"ate": {"rmse": 0.1}}}
DONE = {"terminated": {"exitCode": 0, "reason": "Completed", "finishedAt": "2027-01-15T08:00:00Z"}}
COMPLETE = [{"type": "Complete", "status": "True"}]


def finished(name: str, **more: Any) -> dict[str, Any]:
    trajectory = {"poses": 2, "durationSeconds": 1, "sha256": "a" * 64}
    path = f"runs/uid-{name}/pod/output/trajectory.txt"
    return {"phase": "Succeeded", "trajectory": trajectory | {"path": path}, "variant": "v"} | more


@pytest.fixture
async def cluster() -> Cluster:
    made = catalogued()
    for name in ("a", "b"):
        made.apply(Kind.MAPPING_RUN, name, RUN, **finished(name))
    made.evaluation = made.apply(
        Kind.EVALUATION, "mine", {"runs": {"names": ["a", "b"]}, "evaluator": {"image": "x", "command": []}}
    )
    return made


def ended(cluster: Cluster, log: str) -> Key:
    """Have an evaluator Job that measured both runs, and printed a log."""
    labels = {
        str(Label.ROLE): "evaluate",
        str(Label.EVALUATION): "mine",
        str(Label.MANAGED_BY): "slamhive",
    }
    owner = {"kind": "Evaluation", "name": "mine", "uid": "uid-mine"}
    noted = {"slamhive.io/runs": "a,b"}
    job = cluster.apply(
        Kind.JOB, "job", {}, conditions=COMPLETE, labels=labels, owner=owner, annotations=noted
    )
    containers = [{"name": "report", "state": DONE}]
    owner = {"kind": "Job", "name": "job", "uid": "uid-job"}
    cluster.apply(
        Kind.POD, "pod", {}, phase="Succeeded", containerStatuses=containers, labels=labels, owner=owner
    )
    cluster.printed["pod"] = log
    return job


def records(of_a: dict[str, Any]) -> str:
    """Return a log with a record of run a and a good one of run b."""
    told = [{"uid": "uid-a", "name": "a", "result": GOOD | {"evaluation": "mine"} | of_a}]
    told.append({"uid": "uid-b", "name": "b", "result": GOOD | {"evaluation": "mine"}})
    return "".join(encode_all(told))


async def taken(cluster: Cluster, log: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the statuses of the Evaluation and of run a when a log was taken in."""
    job = ended(cluster, log)
    await cluster.look(cluster.evaluation)
    status = await cluster.look(cluster.evaluation, 10)
    assert job not in cluster.objects
    [result] = cluster.objects[Key(Kind.MAPPING_RUN, "lab", "b")]["status"]["results"]
    assert result["ate"] == {"rmse": 0.1}
    return status, cluster.objects[Key(Kind.MAPPING_RUN, "lab", "a")]["status"]


async def test_an_evaluator_of_others_is_refused_where_the_setting_says_so() -> None:
    made = catalogued()
    made.seen.settings = made.seen.settings.replace(custom_evaluators=False)
    made.apply(Kind.MAPPING_RUN, "a", RUN, **finished("a"))
    spec = {"runs": {"names": ["a"]}, "evaluator": {"image": "example.org/mine:1", "command": []}}
    status = await made.look(made.apply(Kind.EVALUATION, "mine", spec))
    assert standing(status, "Accepted")[0] == "False"
    assert "'example.org/mine:1' is not run here" in standing(status, "Accepted")[2]
    assert not [key for key in made.objects if key.kind is Kind.JOB]


@pytest.mark.parametrize(
    ("told", "declared", "level"),
    [({"gravityAligned": True}, False, True), ({"gravityAligned": False}, True, False), ({}, True, True)],
)
async def test_the_evaluator_hears_what_the_preparation_said_of_gravity(
    told: dict[str, Any], declared: bool, level: bool
) -> None:
    """Of a variant that an earlier version prepared the Dataset says it."""
    made = catalogued(ALGORITHM | {"output": ALGORITHM["output"] | {"gravityAligned": True}})
    key = Key(Kind.DATASET, "lab", "hall")
    [variant] = made.objects[key]["status"]["variants"]
    described = variant | {"name": "v", "description": READY | {"groundTruth": "poses"} | told}
    made.apply(Kind.DATASET, "hall", DATASET | {"gravityAligned": declared}, variants=[described])
    made.apply(Kind.MAPPING_RUN, "a", RUN, **finished("a"))
    await made.look(made.apply(Kind.EVALUATION, "mine", {"runs": {"names": ["a"]}}), 100)
    [job] = [body for key, body in made.objects.items() if key.kind is Kind.JOB]
    noted = job["spec"]["template"]["metadata"]["annotations"]["slamhive.io/request"]
    [item] = EvaluateRequest.model_validate(json.loads(noted)).runs
    assert RunItem.model_validate(item).gravity_aligned is level


WRONG = [
    ({"values": {"ate": "good"}}, "ate: must be a mapping, found 'good'"),
    ({"values": {"ate": {"rmse": "0.2"}}}, "ate.rmse: must be a number, found '0.2'"),
    ({"values": {"rpe": "x"}}, "rpe: must be a list, found 'x'"),
    ({"values": {"rpe": [{}] * 17}}, "rpe: at most 16 are allowed, here are 17"),
    ({"values": {"scale": True}}, "scale: must be a number, found 'True'"),
]


@pytest.mark.parametrize(("of_a", "problem"), WRONG)
async def test_a_wrong_result_is_given_up_and_the_others_are_kept(
    cluster: Cluster, of_a: dict[str, Any], problem: str
) -> None:
    status, run = await taken(cluster, records(of_a))
    assert (status["evaluated"], status["failed"]) == (1, 1)
    assert standing(status, "Complete")[:2] == ("True", "SomeFailed")
    assert f"a: its result can't be kept: {problem}" in standing(status, "Complete")[2]
    assert problem in cluster.told["a", "NotEvaluable"]
    assert "results" not in run


@pytest.mark.parametrize(("of_a", "problem"), WRONG)
def test_another_evaluators_wrong_result_is_reported_as_an_error(of_a: dict[str, Any], problem: str) -> None:
    runs = [{"uid": "uid-a", "name": "a"}]
    request = EvaluateRequest.model_validate({"evaluation": "mine", "settings": {}, "runs": runs})
    [record] = report(request, json.dumps({"name": "a"} | GOOD | of_a))
    assert record["error"].startswith(f"results.jsonl, line 1: {problem}")


async def test_a_result_that_the_api_refuses_is_given_up(cluster: Cluster) -> None:
    def check(_: Key, body: dict[str, Any]) -> None:
        if any(result.get("odd") for result in body.get("status", {}).get("results", ())):
            raise Invalid("status.results[0].odd: no")

    cluster.check = check
    status, run = await taken(cluster, records({"values": {"odd": 1}}))
    assert "a: its result can't be kept: status.results[0].odd: no" in standing(status, "Complete")[2]
    assert "results" not in run


async def test_what_nobody_foresaw_costs_one_record(cluster: Cluster) -> None:
    def check(_: Key, body: dict[str, Any]) -> None:
        if any(result.get("odd") for result in body.get("status", {}).get("results", ())):
            raise KeyError("odd")

    cluster.check = check
    status, _ = await taken(cluster, records({"values": {"odd": 1}}))
    assert "a: its result can't be kept: KeyError: 'odd'" in standing(status, "Complete")[2]


async def test_a_fault_that_passes_is_no_reason_to_give_up(cluster: Cluster) -> None:
    faults = [ServerFault("down")]

    def check(key: Key, _: dict[str, Any]) -> None:
        if key.name == "a" and faults:
            raise faults.pop()

    cluster.check = check
    status, run = await taken(cluster, records({}))
    assert (status["evaluated"], status["failed"]) == (2, 0)
    assert run["results"][0]["outcome"] == "Tracked"


async def test_values_do_not_stand_in_for_a_results_own_fields(cluster: Cluster) -> None:
    _, run = await taken(cluster, records({"coverage": None, "values": {"coverage": "all", "note": "x"}}))
    assert run["results"] == [{"note": "x", "evaluation": "mine", "outcome": "Tracked"}]


async def test_a_run_with_32_results_is_told_and_never_measured(cluster: Cluster) -> None:
    results = [{"evaluation": f"e{number}", "outcome": "Tracked"} for number in range(32)]
    cluster.apply(Kind.MAPPING_RUN, "a", RUN, **finished("a", results=results))
    status, run = await taken(cluster, records({}))
    assert "a: it has results of 32 evaluations" in standing(status, "Complete")[2]
    assert run["results"] == results
    assert not [key for key in cluster.objects if key.kind is Kind.JOB]


NO_RIGHT = 'cannot patch x: mappingruns is forbidden: User "a" cannot patch resource "mappingruns/status"'


async def test_a_result_for_which_an_object_has_no_room_is_given_up(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(result_taking, "LIST_BYTES", 1000)
    large = {"evaluation": "other", "outcome": "Tracked", "note": "x" * 900}
    cluster.apply(Kind.MAPPING_RUN, "a", RUN, **finished("a", results=[large]))
    status, run = await taken(cluster, records({}))
    assert "with it the run's results have 1030 bytes, at most 1000" in standing(status, "Complete")[2]
    assert run["results"] == [large]


async def test_a_missing_right_is_no_reason_to_give_up(cluster: Cluster) -> None:
    """Taken away for the result alone: that it can't be kept could be written."""

    def check(key: Key, body: dict[str, Any]) -> None:
        if key.name == "a" and "results" in body.get("status", {}):
            raise Forbidden(NO_RIGHT)

    cluster.check = check
    ended(cluster, records({}))
    for _ in range(FAILURES_TOLD):
        status = await cluster.look(cluster.evaluation)
    assert standing(status, "ReconcileError")[2].endswith(NO_RIGHT)
    cluster.check = None
    status = await cluster.look(cluster.evaluation, 10)
    assert (status["evaluated"], status["failed"]) == (2, 0)


async def test_runs_are_not_given_up_for_an_evaluator_that_is_refused(cluster: Cluster) -> None:
    cluster.refusals[Kind.JOB] = Forbidden("admission webhook denied the request")
    cluster.described()
    for _ in range(8):
        status = await cluster.look(cluster.evaluation, GRACE + 1)
    assert standing(status, "Admitted") == ("False", "JobRefused", "admission webhook denied the request")
    assert standing(status, "ReconcileError")[2].endswith("denied the request")
    assert status["failed"] == 0
    cluster.refusals.clear()
    status = await cluster.look(cluster.evaluation)
    assert standing(status, "Admitted")[0] == "True"
    assert standing(status, "ReconcileError")[0] == "False"


async def test_runs_are_not_given_up_for_an_evaluator_whose_pod_is_refused(cluster: Cluster) -> None:
    cluster.described()
    cluster.failed_creates = ["Error creating: pods is forbidden: no such image"]
    for _ in range(8):
        status = await cluster.look(cluster.evaluation, GRACE + 1)
    told = "the evaluator does not begin: its pod is refused: pods is forbidden: no such image"
    assert standing(status, "ReconcileError")[2].endswith(told)
    assert status["failed"] == 0
    [job] = [key for key in cluster.objects if key.kind is Kind.JOB]
    # Where another pod would be asked for by now, it is.
    wanted = EvaluationJobs(delay_seconds=0, cpu="100m")
    cluster.seen.settings = cluster.seen.settings.replace(evaluation=wanted)
    before = cluster.objects[job]
    await cluster.look(cluster.evaluation)
    assert cluster.objects[job] is not before


async def test_a_run_whose_trajectory_can_t_be_read_is_given_up_and_others_go_on(cluster: Cluster) -> None:
    cluster.described()
    key = cluster.apply(Kind.MAPPING_RUN, "a", RUN, **finished("a", trajectory={"later": 1}))
    await cluster.look(cluster.evaluation, 100)
    told = "its status does not say which file its trajectory is"
    assert told in cluster.objects[key]["metadata"]["annotations"]["slamhive.io/not-evaluable"]
    [job] = [body for found, body in cluster.objects.items() if found.kind is Kind.JOB]
    assert job["metadata"]["annotations"]["slamhive.io/runs"] == "b"


@pytest.mark.parametrize(
    ("notes", "message"),
    [
        ({"": {"why": "it has 2 poses"}}, "not evaluated: it has 2 poses"),
        ({"mine": {"why": "it has 2 poses"}}, None),
        ({"": "it has 2 poses"}, None),
        ("{", None),
    ],
    ids=["by its own settings", "by an Evaluation", "of another shape", "no JSON"],
)
def test_the_record_of_a_run_says_why_it_was_not_measured_as_a_workstation_s_does(
    cluster: Cluster, notes: Any, message: str | None
) -> None:
    text = notes if isinstance(notes, str) else json.dumps(notes)
    run = cluster.objects[Key(Kind.MAPPING_RUN, "lab", "a")]
    run["metadata"]["annotations"] = {NOT_EVALUABLE: text}
    assert record_of(run).message == message


@pytest.mark.parametrize(("running", "seconds"), [(0, 2), (16, 4), (200, 10)])
async def test_a_batch_waits_longer_while_more_runs_are_under_way(running: int, seconds: float) -> None:
    made = catalogued()
    made.seen.settings = made.seen.settings.replace(evaluation=EvaluationJobs(delay_seconds=2))
    made.described()
    labels = {"study": "large"}
    ended_at = iso(made.now)
    made.apply(Kind.MAPPING_RUN, "a", RUN, labels=labels, **finished("a", completionTime=ended_at))
    for number in range(running):
        made.apply(Kind.MAPPING_RUN, f"r{number}", RUN, labels=labels, phase="Running")
    key = made.apply(Kind.EVALUATION, "mine", {"runs": {"matchLabels": labels}})

    def jobs() -> int:
        return sum(key.kind is Kind.JOB for key in made.objects)

    await made.look(key, seconds - 0.1)
    assert not jobs()
    await made.look(key, 0.2)
    assert jobs() == 1
