# SPDX-License-Identifier: Apache-2.0
"""Results of finished runs on a fake API server: what evaluators say, and all that can go wrong with it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.evaluators import good, measuring
from fakeapi.refusals import Refusal, conflict, forbidden
from testcluster.kwok import Moment, Play, description, run_message
from testcluster.lab import condition_of, manifest, run, status_of, sweep, until

from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.status import holds

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

    Record = Callable[[dict[str, Any]], dict[str, Any]]

SETTINGS = {"evaluation": {"delaySeconds": 0.1}}


def refuses(verb: str, resource: str, refusal: Refusal, **labels: str) -> Any:
    """Return a function that refuses one kind of call, where the body has labels."""

    def refusing(asked: str, of: str, body: dict[str, Any]) -> Refusal | None:
        there = (body.get("metadata") or {}).get("labels") or {}
        fits = all(there.get(f"slamhive.io/{name}") == value for name, value in labels.items())
        return refusal if (asked, of) == (verb, resource) and fits else None

    return refusing


def is_told(status: dict[str, Any]) -> bool:
    return bool(condition_of(status, "Evaluated"))


WHY = "its recording may be why: sensors.lidar: points' times are in µs (points.times.unit)"


async def test_a_failed_run_names_the_findings_of_its_recording(make_fake_lab: Callable[..., Lab]) -> None:
    told = description(findings=["points.times.unit"], suspicion=WHY)
    lab = make_fake_lab(
        variant=told, exit_code=3, run=run_message(reason="AlgorithmFailed", message="exit code 3: no map")
    )
    async with lab.operator(**SETTINGS) as op:
        lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda seen: seen.get("phase") == "Failed")
    assert status["message"] == f"exit code 3: no map; {WHY}"
    assert status["provenance"]["prepared"]["findings"] == ["points.times.unit"]


@pytest.mark.parametrize(("outcome", "why"), [("Lost", WHY), ("Tracked", "")])
async def test_a_lost_run_names_the_findings_of_its_recording(
    make_fake_lab: Callable[..., Lab], outcome: str, why: str
) -> None:
    lab = make_fake_lab(variant=description(suspicion=WHY))

    def measured(asked: dict[str, Any]) -> dict[str, Any]:
        record = good(asked)
        return {"result": record["result"] | {"outcome": outcome}}

    lab.cluster.log = measuring(measured)
    async with lab.operator(**SETTINGS) as op:
        lab.apply(run(evaluate=True))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_told)
    evaluated = condition_of(status, "Evaluated")
    assert (evaluated["status"], evaluated["message"]) == ("True", why)


async def test_results_reach_runs_sweep_and_evaluations(fake_lab: Lab) -> None:
    errors = iter([0.5, 0.25, 0.25, 0.75])
    fake_lab.cluster.log = measuring(lambda asked: good(asked, rmse=next(errors)))
    labels = {"metadata": {"labels": {"family": "mine"}}}
    async with fake_lab.operator(**SETTINGS) as op:
        body = sweep(sizes=2, template={"evaluate": True})
        body["spec"]["template"] |= labels
        fake_lab.apply(body)
        status = await status_of(op, Kind.SWEEP, "study", lambda found: found.get("phase") == "Complete")
        [first, second] = op.cluster.store.of(Kind.MAPPING_RUN, "lab")
        chosen = {"matchLabels": {"family": "mine"}}
        fake_lab.apply(manifest("Evaluation", "again", runs=chosen, alignment="Origin"))
        measured = await status_of(op, Kind.EVALUATION, "again", lambda found: found.get("evaluated") == 2)
        fake_lab.apply(manifest("Evaluation", "none", runs={"names": ["nobody"]}))
        empty = await status_of(op, Kind.EVALUATION, "none", lambda found: condition_of(found, "Complete"))
        await until(lambda: not _jobs(op, "evaluate"), "all evaluators to go")
    assert (status["evaluated"], status["display"]) == (2, {"ate": "0.25 m"})
    assert [entry["ate"] for entry in status["best"]] == [0.25, 0.5]
    assert {one["status"]["display"]["ate"] for one in (first, second)} == {"0.25 m", "0.5 m"}
    assert condition_of(first["status"], "Evaluated")["status"] == "True"
    [group] = measured["summary"]["groups"]
    assert measured["summary"]["outcomes"] == {"Tracked": 2}
    assert group["ate"] == {"mean": 0.5, "median": 0.5, "std": pytest.approx(0.5 / 2**0.5)}
    assert (group["algorithm"], group["dataset"], group["tracked"]) == ("icp", "hall", 2)
    assert condition_of(measured, "Complete")["status"] == "True"
    assert condition_of(empty, "Complete")["reason"] == "NoRuns"


def _jobs(op: Any, role: str) -> list[dict[str, Any]]:
    jobs = op.cluster.store.of(Kind.JOB, "lab")
    return [job for job in jobs if job["metadata"]["labels"]["slamhive.io/role"] == role]


@pytest.mark.parametrize(
    ("record", "why"),
    [
        (lambda _: {"error": "too few poses"}, "too few poses"),
        (lambda _: {"result": {"outcome": "Marvellous"}}, "the evaluator's result is not one: "),
        (
            lambda asked: good(asked, rmse="short"),
            "its result can't be kept: ate.rmse: must be a number, found 'short'",
        ),
    ],
    ids=["an error", "no result", "a wrong value"],
)
async def test_what_an_evaluator_says_in_vain_is_noted_at_the_run(
    fake_lab: Lab, record: Record, why: str
) -> None:
    fake_lab.cluster.log = measuring(record)
    async with fake_lab.operator(**SETTINGS) as op:
        fake_lab.apply(run(evaluate=True))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_told)
        key = Key(Kind.MAPPING_RUN, "lab", "one")
        note = "slamhive.io/not-evaluable"
        await until(
            lambda: note in (op.cluster.store.get(key) or {})["metadata"].get("annotations", {}), "the note"
        )
        [event] = await until(lambda: fake_lab.cluster.of("event", "lab"), "the Event")
    assert status["phase"] == "Succeeded"
    assert condition_of(status, "Evaluated")["reason"] == "NotEvaluable"
    assert condition_of(status, "Evaluated")["message"].startswith(why)
    assert event["reason"] == "NotEvaluable"
    assert "results" not in status


async def test_without_ground_truth_nothing_is_measured(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(variant=description(groundTruth=None))
    async with lab.operator(**SETTINGS) as op:
        lab.apply(run(evaluate=True))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_told)
        assert not _jobs(op, "evaluate")
    assert condition_of(status, "Evaluated")["message"] == "Dataset 'hall' has no ground truth"


NO_RIGHT = forbidden("pods", "x", 'User "operator" cannot get resource "pods/log" in API group ""')
NO_ADDRESS = Refusal(404, "NotFound", "the server could not find the requested resource")


@pytest.mark.parametrize("refusal", [NO_RIGHT, NO_ADDRESS, forbidden("pods", "x", "says a policy")])
async def test_an_evaluator_whose_log_may_not_be_read_is_read_when_it_may(
    fake_lab: Lab, refusal: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.kube.queue.FIRST_BACKOFF_SECONDS", 0.01)
    fake_lab.cluster.log = measuring()
    fake_lab.cluster.refuse(refuses("get", "pods/log", refusal))
    async with fake_lab.operator(**SETTINGS) as op:
        fake_lab.apply(sweep(template={"evaluate": True}))
        status = await status_of(op, Kind.SWEEP, "study", lambda found: holds(found, "EvaluationError"))
        assert str(refusal) in condition_of(status, "EvaluationError")["message"]
        assert condition_of(status, "Complete")["status"] == "False"
        fake_lab.cluster.refuse(lambda *_: None)
        status = await status_of(op, Kind.SWEEP, "study", lambda found: holds(found, "Complete"))
    assert (status["succeeded"], status["evaluated"]) == (3, 3)


async def test_a_refused_evaluator_is_told_until_it_is_admitted(fake_lab: Lab) -> None:
    fake_lab.cluster.log = measuring()
    refusal = forbidden("jobs.batch", "x", "the image is not signed")
    fake_lab.cluster.refuse(refuses("create", "jobs.batch", refusal, role="evaluate"))
    async with fake_lab.operator(**SETTINGS) as op:
        fake_lab.apply(run(), manifest("Evaluation", "drift", runs={"names": ["one"]}))
        status = await status_of(op, Kind.EVALUATION, "drift", lambda found: condition_of(found, "Admitted"))
        assert condition_of(status, "Admitted")["status"] == "False"
        assert "the image is not signed" in condition_of(status, "Admitted")["message"]
        fake_lab.cluster.refuse(lambda *_: None)
        fake_lab.patch("evaluation", "drift", {"metadata": {"labels": {"look": "again"}}})
        status = await status_of(op, Kind.EVALUATION, "drift", lambda found: found.get("evaluated") == 1)
    assert condition_of(status, "Admitted")["status"] == "True"


async def test_an_evaluator_that_is_refused_for_long_is_waited_for(
    fake_lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.kube.queue.FIRST_BACKOFF_SECONDS", 0.01)
    fake_lab.cluster.log = measuring()
    refusal = forbidden("jobs.batch", "x", "the image is not signed")
    fake_lab.cluster.refuse(refuses("create", "jobs.batch", refusal, role="evaluate"))
    async with fake_lab.operator(refusalGraceSeconds=0, **SETTINGS) as op:
        fake_lab.apply(run(evaluate=True))
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: holds(found, "EvaluationError"))
        fake_lab.cluster.refuse(lambda *_: None)
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("results"))
    assert "the image is not signed" in condition_of(status, "EvaluationError")["message"]


async def test_an_evaluator_without_a_pod_is_waited_for(
    fake_lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.kube.queue.FIRST_BACKOFF_SECONDS", 0.01)
    fake_lab.cluster.log = measuring()
    limits = {"limits": [{"type": "Container", "max": {"cpu": "2"}}]}
    fake_lab.apply(manifest("LimitRange", "small", **limits) | {"apiVersion": "v1"})
    async with fake_lab.operator() as op:
        fake_lab.apply(run(evaluate=True))
        await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Succeeded")
    # By a clock an hour ahead all patience with its Job is at an end.
    greedy = {"evaluation": {"delaySeconds": 0.1, "cpu": "4"}}
    async with fake_lab.operator(clock=lambda: time.time() + 3600, **greedy) as op:
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: holds(found, "EvaluationError"))
    message = condition_of(status, "EvaluationError")["message"]
    assert "maximum cpu usage per Container is 2, but limit is 4" in message
    async with fake_lab.operator(**SETTINGS) as op:
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("results"))


async def test_an_evaluator_whose_image_cannot_be_had_is_told_until_another_one_can(
    make_fake_lab: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.kube.queue.FIRST_BACKOFF_SECONDS", 0.01)
    no_image = {"waiting": {"reason": "ErrImagePull", "message": "no such image"}}
    lab = make_fake_lab(ends={"evaluate": Moment("Pending", no_image, no_image)})
    lab.cluster.log = measuring()
    async with lab.operator(evaluatorImage="example.test/mistyped:1", **SETTINGS) as op:
        lab.apply(run(evaluate=True))
        stuck = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: holds(found, "EvaluationError"))
    lab.cluster.play_from_now(lab.pool, Play())
    async with lab.operator(evaluatorImage="example.test/evaluator:1", **SETTINGS) as op:
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("results"))
        status = await status_of(
            op, Kind.MAPPING_RUN, "one", lambda found: holds(found, "EvaluationError") is False
        )
    assert "the evaluator does not begin" in condition_of(stuck, "EvaluationError")["message"]
    assert "no such image" in condition_of(stuck, "EvaluationError")["message"]
    assert condition_of(status, "Evaluated")["status"] == "True"


@pytest.mark.parametrize("times", [2, 6], ids=["now and then", "without end"])
async def test_a_result_is_written_though_others_write_to_the_run(fake_lab: Lab, times: int) -> None:
    fake_lab.cluster.log = measuring()
    stale = conflict("mappingruns.slamhive.io", "one", "the object has been modified")
    left = [stale] * times

    def refusing(verb: str, resource: str, body: dict[str, Any]) -> Refusal | None:
        result = (body.get("status") or {}).get("results")
        return left.pop() if left and (verb, resource) == ("patch", RUN_STATUS) and result else None

    fake_lab.cluster.refuse(refusing)
    async with fake_lab.operator(**SETTINGS) as op:
        fake_lab.apply(run(evaluate=True))
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("results"))
    assert not left
    assert condition_of(status, "Evaluated")["status"] == "True"


RUN_STATUS = "mappingruns/status.slamhive.io"


async def test_a_result_that_the_server_refuses_costs_its_run_alone(fake_lab: Lab) -> None:
    fake_lab.cluster.log = measuring()
    odd = Refusal(422, "Invalid", "status.results[0]: no")
    with_result: list[str] = []

    def refusing(verb: str, resource: str, body: dict[str, Any]) -> Refusal | None:
        if (verb, resource) == ("patch", RUN_STATUS) and (body.get("status") or {}).get("results"):
            with_result.append(body["metadata"]["resourceVersion"])
            return odd if len(with_result) == 1 else None
        return None

    fake_lab.cluster.refuse(refusing)
    async with fake_lab.operator(**SETTINGS) as op:
        fake_lab.apply(sweep(sizes=2, parallelism=2, template={"evaluate": True}))
        status = await status_of(op, Kind.SWEEP, "study", lambda found: found.get("phase") == "Complete")
        told = [
            condition_of(one["status"], "Evaluated")["status"]
            for one in op.cluster.store.of(Kind.MAPPING_RUN, "lab")
        ]
    assert sorted(told) == ["False", "True"]
    assert status["evaluated"] == 1


async def test_a_run_that_was_made_anew_does_not_get_its_predecessors_result(fake_lab: Lab) -> None:
    def record(asked: dict[str, Any]) -> dict[str, Any]:
        return good(asked) | {"uid": "00000000-0000-0000-0000-000000000000"}

    fake_lab.cluster.log = measuring(record)
    async with fake_lab.operator(**SETTINGS) as op:
        fake_lab.apply(run(evaluate=True))
        await until(lambda: ("delete", "jobs.batch") in fake_lab.calls, "the results to be taken in")
        status = (op.cluster.store.get(Key(Kind.MAPPING_RUN, "lab", "one")) or {})["status"]
    assert "results" not in status


async def test_evaluators_of_others_are_refused_where_the_operator_is_told_to(fake_lab: Lab) -> None:
    mine = manifest(
        "Evaluation", "mine", runs={"names": ["one"]}, evaluator={"image": "mine:1", "command": ["x"]}
    )
    async with fake_lab.operator(customEvaluators=False) as op:
        fake_lab.apply(mine)
        status = await status_of(op, Kind.EVALUATION, "mine", lambda found: condition_of(found, "Accepted"))
        fake_lab.delete("evaluation", "mine")
        await until(
            lambda: op.cluster.store.get(Key(Kind.EVALUATION, "lab", "mine")) is None, "the Evaluation to go"
        )
    assert condition_of(status, "Accepted")["status"] == "False"
    assert "customEvaluators is false" in condition_of(status, "Accepted")["message"]


async def test_a_full_run_is_told_and_not_measured(fake_lab: Lab) -> None:
    fake_lab.cluster.log = measuring()
    async with fake_lab.operator(**SETTINGS) as op:
        fake_lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Succeeded")
        results = [{"evaluation": f"e{number}", "outcome": "Tracked"} for number in range(32)]
        fake_lab.patch("mappingrun", "one", {"status": {"results": results}}, subresource="status")
        note = {"slamhive.io/not-evaluable": "no JSON"}
        fake_lab.patch("mappingrun", "one", {"metadata": {"annotations": note}})
        fake_lab.apply(manifest("Evaluation", "late", runs={"names": ["one"]}))
        status = await status_of(op, Kind.EVALUATION, "late", lambda found: found.get("failed") == 1)
        assert not _jobs(op, "evaluate")
    assert "it has results of 32 evaluations" in condition_of(status, "Complete")["message"]


async def test_a_sweep_whose_settings_change_is_measured_anew(fake_lab: Lab) -> None:
    alignments: list[str] = []

    def record(asked: dict[str, Any]) -> dict[str, Any]:
        alignments.append(asked["settings"]["alignment"])
        return good(asked)

    fake_lab.cluster.log = measuring(record)
    async with fake_lab.operator(**SETTINGS) as op:

        def is_idle() -> bool:
            pods = [
                pod["metadata"]["labels"]["slamhive.io/role"] for pod in op.cluster.store.of(Kind.POD, "lab")
            ]
            busy = len(op.cluster.queue) or op.cluster.queue.active or op.cluster.queue.delayed
            return not (busy or _jobs(op, "evaluate") or "evaluate" in pods)

        fake_lab.apply(sweep(sizes=1, template={"evaluate": True}))
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("phase") == "Complete")
        await until(is_idle, "the evaluator to go")
        fake_lab.patch("sweep", "study", {"spec": {"evaluation": {"alignment": "Origin"}}})
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("observedGeneration") == 2)
        await until(is_idle, "the operator to have nothing to do")
    assert alignments == ["Auto", "Origin"]
