# SPDX-License-Identifier: Apache-2.0
"""MappingRuns on a real control plane: each way to their end."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import pytest
from testcluster.kwok import Moment, run_message
from testcluster.lab import algorithm, condition_of, dataset, manifest, run, status_of, sweep, until

from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.user.queries import troubles

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from testcluster.lab import Lab


def is_over(status: dict[str, Any]) -> bool:
    return status.get("phase") in {"Succeeded", "Failed", "Cancelled"}


async def test_a_run_gets_its_figures_in_few_writes(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["phase"] == "Succeeded"
    assert status["usage"]["memory"]["peakBytes"] == 200 << 20
    assert status["trajectory"]["poses"] == 200
    assert status["trajectory"]["path"].startswith(f"{status['folder']}/output/")
    assert status["display"] == {"cpu": "0.80", "memory": "200Mi"}
    assert len(status["provenance"]["contentHash"]) == 64
    own = [call for call in lab.calls if call[1].startswith("mappingruns")]
    assert len(own) <= 3


async def test_a_run_whose_pod_is_being_made_is_taken_notice_of(make_fake_lab: Callable[..., Lab]) -> None:
    """Runs of a Sweep are spared that write; images take minutes to come."""
    coming = {"waiting": {"reason": "ContainerCreating"}}
    lab = make_fake_lab(ends={"run": Moment("Pending", coming, coming)})
    async with lab.operator() as op:
        lab.apply(run(), sweep(sizes=1))
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Pending")
        await until(lambda: len(lab.cluster.of("pod", "lab")) >= 3, "the pods of both and a preparation's")
        (other,) = [one for one in lab.cluster.of("mappingrun", "lab") if one["metadata"]["name"] != "one"]
    assert condition_of(status, "Accepted")["status"] == "True"
    assert troubles(Kind.MAPPING_RUN, other, inf) == []


@pytest.mark.parametrize(
    ("play", "reason", "message"),
    [
        ({"exit_code": 3}, "AlgorithmFailed", "exit code 3"),
        (
            {"exit_code": 137, "run": run_message(reason="DeadlineExceeded", message="too long")},
            "DeadlineExceeded",
            "too long",
        ),
        (
            {"run": run_message(trajectory=None, trajectoryProblem="no pose", trajectoryMissing=True)},
            "NoTrajectory",
            "no pose",
        ),
    ],
)
async def test_a_run_fails_for_its_true_reason(
    make_lab: Callable[..., Lab], play: dict[str, Any], reason: str, message: str
) -> None:
    lab = make_lab(**play)
    async with lab.operator() as op:
        lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"]) == ("Failed", reason)
    assert message in status["message"]
    assert status["attempts"] == 1


async def test_wrong_parameters_are_refused_with_the_field(lab: Lab) -> None:
    async with lab.operator() as op:
        lab.apply(run(parameters={"size": -1, "sice": 2}))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["reason"] == "InvalidParameters"
    told = condition_of(status, "Accepted")
    assert told["status"] == "False"
    assert "spec.parameters.size: -1 is below the minimum" in told["message"]
    assert "did you mean 'size'?" in told["message"]
    assert not [call for call in lab.calls if call == ("create", "jobs.batch")]


async def test_an_algorithm_without_an_image_cannot_run(lab: Lab) -> None:
    body = algorithm("local", local={"adapter": "adapter.py"})
    del body["spec"]["image"]
    lab.apply(body)
    async with lab.operator() as op:
        lab.apply(run(algorithmRef={"name": "local"}))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["reason"] == "AlgorithmUnavailable"
    assert "names no image" in status["message"]


async def test_a_program_without_an_image_prepares_nothing(fake_lab: Lab) -> None:
    body = dataset("masked")
    body["spec"]["preparations"] = {"here": {"local": {"adapter": "mask.py"}}}
    fake_lab.apply(body)
    async with fake_lab.operator() as op:
        fake_lab.apply(run(datasetRef={"name": "masked"}, input={"preparedBy": "here"}))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["reason"] == "PreparationFailed"
    expected = "the preparation 'here' of dataset 'masked' names no image, which a cluster needs"
    assert status["message"] == expected


async def test_a_run_whose_pod_is_refused_fails_with_the_reason(lab: Lab) -> None:
    limits = {"limits": [{"type": "Container", "max": {"cpu": "1500m"}}]}
    lab.apply(manifest("LimitRange", "small", **limits) | {"apiVersion": "v1"})
    async with lab.operator(refusalGraceSeconds=1) as op:
        lab.apply(run(resources={"cpu": "2", "memory": "1Gi"}, retries=0))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"]) == ("Failed", "SystemFault")
    assert "its pod is refused: pods " in status["message"]
    assert "maximum cpu usage per Container is 1500m" in status["message"]


async def test_a_run_waits_for_its_catalog(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(catalog=False)
    lab.apply(algorithm())
    async with lab.operator() as op:
        lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: condition_of(found, "Accepted"))
        assert status["phase"] == "Pending"
        assert "unknown dataset 'hall'" in condition_of(status, "Accepted")["message"]
        lab.apply(dataset())
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["phase"] == "Succeeded"
    assert condition_of(status, "Accepted")["status"] == "True"


async def test_cancelling_ends_the_job(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Running")
        lab.patch("mappingrun", "one", {"spec": {"cancel": True}})
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        assert status["phase"] == "Cancelled"
        await until(
            lambda: op.cluster.store.get(Key(Kind.JOB, lab.namespace, "one-1")) is None, "the Job to go"
        )


async def test_a_job_that_someone_deletes_is_another_attempt(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(run(retries=1))
        for attempt in (1, 2):
            await status_of(
                op,
                Kind.MAPPING_RUN,
                "one",
                lambda status, n=attempt: status.get("phase") == "Running" and status["attempts"] == n,
            )
            lab.delete("job", f"one-{attempt}")
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"], status["faults"]) == ("Failed", "SystemFault", 2)
    assert "deleted by someone else" in status["message"]


async def test_deleting_a_run_takes_its_job_along(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Running")
        lab.delete("mappingrun", "one")
        await until(
            lambda: not [kind for kind in (Kind.JOB, Kind.POD) if op.cluster.store.of(kind, lab.namespace)],
            "Job and pod to go, and the variant's Job, which nobody needs",
        )


async def test_an_operator_that_starts_later_takes_up_what_it_finds(lab: Lab) -> None:
    lab.apply(run("early"))
    async with lab.operator() as op:
        await status_of(op, Kind.MAPPING_RUN, "early", is_over)
    lab.calls.clear()
    lab.apply(run("late"))
    async with lab.operator() as op:
        await status_of(op, Kind.MAPPING_RUN, "late", is_over)
    # The variant is there, the first run is left alone.
    assert lab.calls.count(("create", "jobs.batch")) == 1
