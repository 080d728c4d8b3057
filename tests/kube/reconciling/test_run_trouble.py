# SPDX-License-Identifier: Apache-2.0
"""MappingRuns on a fake API server that refuses, and on pods that say little: what is told, what goes on."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from fakeapi.refusals import Refusal, forbidden
from testcluster.kwok import Moment, Play, ended, moment_of, run_message
from testcluster.lab import algorithm, condition_of, manifest, run, status_of, until

from slamhive.jobs.messages import failed
from slamhive.kube.api.kinds import Key, Kind
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab


ONE = Key(Kind.MAPPING_RUN, "lab", "one")


def is_over(status: dict[str, Any]) -> bool:
    return status.get("phase") in {"Succeeded", "Failed", "Cancelled"}


def no_jobs(role: str) -> Callable[[str, str, dict[str, Any]], Refusal | None]:
    """Refuse the Jobs of a role, as an admission webhook does."""

    def refused(verb: str, resource: str, body: dict[str, Any]) -> Refusal | None:
        labels = (body.get("metadata") or {}).get("labels") or {}
        if (verb, resource, labels.get("slamhive.io/role")) != ("create", "jobs.batch", role):
            return None
        return forbidden("jobs.batch", "one-1", "the image is not signed")

    return refused


async def test_a_run_whose_job_is_refused_says_so_until_it_is_admitted(fake_lab: Lab) -> None:
    fake_lab.cluster.refuse(no_jobs("run"))
    async with fake_lab.operator() as op:
        fake_lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: condition_of(found, "Admitted"))
        assert "the image is not signed" in condition_of(status, "Admitted")["message"]
        fake_lab.cluster.refuse(lambda *_: None)
        fake_lab.patch("mappingrun", "one", {"metadata": {"labels": {"look": "again"}}})
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        [event] = await until(lambda: fake_lab.cluster.of("event", "lab"), "the Event")
    assert status["phase"] == "Succeeded"
    assert condition_of(status, "Admitted")["status"] == "True"
    assert event["reason"] == "JobRefused"


async def test_a_run_whose_job_is_refused_for_long_fails_with_the_reason(fake_lab: Lab) -> None:
    fake_lab.cluster.refuse(no_jobs("run"))
    async with fake_lab.operator(refusalGraceSeconds=0) as op:
        fake_lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"]) == ("Failed", "SystemFault")
    assert "the image is not signed" in status["message"]


async def test_a_run_waits_for_the_quota(fake_lab: Lab) -> None:
    hard = {"hard": {"count/jobs.batch": "1"}}
    fake_lab.apply(manifest("ResourceQuota", "few", **hard) | {"apiVersion": "v1"})
    async with fake_lab.operator() as op:
        fake_lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: condition_of(found, "Scheduled"))
        assert condition_of(status, "Scheduled")["reason"] == "QuotaExceeded"
        assert "exceeded quota: few" in condition_of(status, "Scheduled")["message"]
        fake_lab.delete("resourcequota", "few")
        fake_lab.patch("mappingrun", "one", {"metadata": {"labels": {"look": "again"}}})
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["phase"] == "Succeeded"


async def test_a_job_of_someone_else_under_a_runs_name_is_not_taken_over(fake_lab: Lab) -> None:
    template = {"spec": {"containers": [{"name": "x", "image": "x"}]}}
    other = manifest("Job", "one-1", template=template, suspend=True) | {"apiVersion": "batch/v1"}
    fake_lab.apply(other)
    async with fake_lab.operator() as op:
        fake_lab.apply(run())
        await until(
            lambda: op.cluster.store.get(Key(Kind.JOB, "lab", "one-1")), "the operator to meet the Job"
        )
        [job] = [job for job in fake_lab.cluster.of("job", "lab") if job["metadata"]["name"] == "one-1"]
        assert "ownerReferences" not in job["metadata"]
        fake_lab.delete("job", "one-1")
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["attempts"]) == ("Succeeded", 1)


async def test_what_a_silent_monitor_left_is_read_by_a_job(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(run="nothing", ends={"read": ended(0, run_message())})
    async with lab.operator() as op:
        lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["trajectory"]["poses"]) == ("Succeeded", 200)


async def test_a_run_of_which_nothing_can_be_read_is_a_fault(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(run="nothing", ends={"read": ended(0, "nothing either")})
    async with lab.operator() as op:
        lab.apply(run(retries=0))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"]) == ("Failed", "SystemFault")
    assert "the monitor left no report" in status["message"]


def waiting(reason: str, message: str) -> Moment:
    """Return a pod whose containers wait."""
    state = {"waiting": {"reason": reason, "message": message}}
    return Moment("Pending", state, state)


async def test_a_reading_that_cannot_begin_says_so_and_then_ends_the_attempt(
    make_fake_lab: Callable[..., Lab],
) -> None:
    lab = make_fake_lab(run="nothing", ends={"read": waiting("ErrImagePull", "no such image")})
    async with lab.operator(imagePullGraceSeconds=3600) as op:
        lab.apply(run(retries=0))

        def is_told(status: dict[str, Any]) -> bool:
            return "not read yet" in str(condition_of(status, "Scheduled").get("message"))

        status = await status_of(op, Kind.MAPPING_RUN, "one", is_told)
        assert "no such image" in condition_of(status, "Scheduled")["message"]
    async with lab.operator(imagePullGraceSeconds=0) as op:
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"]) == ("Failed", "SystemFault")
    assert "no such image" in status["message"]


async def test_a_reading_that_is_refused_says_so_and_goes_on_when_it_is_admitted(
    make_fake_lab: Callable[..., Lab],
) -> None:
    lab = make_fake_lab(run="nothing", ends={"read": ended(0, run_message())})
    lab.cluster.refuse(no_jobs("read"))
    async with lab.operator() as op:
        lab.apply(run())
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: condition_of(found, "Admitted"))
        assert "the image is not signed" in condition_of(status, "Admitted")["message"]
        lab.cluster.refuse(lambda *_: None)
        lab.patch("mappingrun", "one", {"metadata": {"labels": {"look": "again"}}})
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["attempts"]) == ("Succeeded", 1)
    assert condition_of(status, "Admitted")["status"] == "True"


async def test_an_image_that_cannot_be_had_is_given_up(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(ends={"run": waiting("ErrImagePull", "no such image")})
    async with lab.operator(imagePullGraceSeconds=0) as op:
        lab.apply(run(retries=0))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        await until(lambda: op.cluster.store.get(Key(Kind.JOB, "lab", "one-1")) is None, "the Job to go")
    assert status["phase"] == "Failed"
    assert "no such image" in status["message"]


async def test_a_variant_that_is_gone_is_made_again(
    make_fake_lab: Callable[..., Lab],
) -> None:
    gone = 'failed to prepare subPath for volumeMount "data" of container "algorithm"'
    lab = make_fake_lab(ends={"run": waiting("CreateContainerConfigError", gone)})
    async with lab.operator(refusalGraceSeconds=0, imagePullGraceSeconds=0) as op:
        lab.apply(run(retries=1))
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("faults") == 1)
        assert "subPath" in status["message"]
        lab.cluster.play_from_now(lab.pool, Play())
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["attempts"]) == ("Succeeded", 2)
    # The recording, the run, the recording again, the run again.
    assert lab.calls.count(("create", "jobs.batch")) == 4


async def test_figures_that_the_metrics_api_contradicts(
    make_fake_lab: Callable[..., Lab],
) -> None:
    lab = make_fake_lab(hold=True)
    lab.cluster.usage = {}
    async with lab.operator(metrics={"intervalSeconds": 0.05}) as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda status: status.get("phase") == "Running")
        [pod] = [pod for pod in op.cluster.store.of(Kind.POD, "lab") if pod["status"]["phase"] == "Running"]
        name = pod["metadata"]["name"]
        container = {"name": "algorithm", "usage": {"cpu": "3", "memory": "150Mi"}}
        lab.cluster.usage[name] = {
            "metadata": {"name": name},
            "timestamp": "2099-01-01T00:00:00Z",
            "containers": [container],
        }
        await until(lambda: op.cluster.usage.observed(pod["metadata"]["uid"]), "the figures to be read")
        lab.cluster.end_pod(name, "lab", moment_of(Play(), "run"))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    told = "the metrics API showed 3.00 cores, the sidecar 1.00 at most"
    assert status["usage"]["suspect"] == told
    assert condition_of(status, "UsageSuspect")["reason"] == "SourcesDisagree"


async def test_an_algorithm_that_the_schema_lets_pass_is_refused_by_the_language(fake_lab: Lab) -> None:
    fake_lab.apply(algorithm("odd", parameters={"size": {"type": "Number", "default": "x"}}))
    async with fake_lab.operator() as op:
        fake_lab.apply(run(algorithmRef={"name": "odd"}))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["reason"] == "InvalidParameters"
    assert "Algorithm 'odd': spec.parameters" in status["message"]


async def test_options_that_a_recording_cannot_give_are_refused(fake_lab: Lab) -> None:
    async with fake_lab.operator() as op:
        fake_lab.apply(run(input={"resolution": 0.5}))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert status["reason"] == "InvalidParameters"
    assert "spec.input" in status["message"]


FILES = [{"path": "icp.yaml", "template": "size: {{ 1 / parameters.size }}\n"}]


async def test_settings_files_are_asked_for_and_the_run_is_one_like_others(fake_lab: Lab) -> None:
    fake_lab.apply(algorithm("templated", files=FILES))
    async with fake_lab.operator() as op:
        fake_lab.apply(run(algorithmRef={"name": "templated"}))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
        [job] = [job for job in fake_lab.cluster.of("job", "lab") if job["metadata"]["name"] == "one-1"]
    assert (status["phase"], status["attempts"]) == ("Succeeded", 1)
    asked = json.loads(job["spec"]["template"]["metadata"]["annotations"]["slamhive.io/render"])
    assert asked["files"] == FILES


async def test_settings_that_can_not_be_rendered_fail_the_run_at_once(
    make_fake_lab: Callable[..., Lab],
) -> None:
    sentence = "algorithm 'templated': files.0.template (icp.yaml): line 1: division by zero"
    told = ended(1, failed(Reason.INVALID_PARAMETERS, sentence)).first
    waits = {"waiting": {"reason": "PodInitializing"}}
    lab = make_fake_lab(ends={"run": Moment("Failed", waits, told)})
    lab.apply(algorithm("templated", files=FILES))
    async with lab.operator() as op:
        lab.apply(run(algorithmRef={"name": "templated"}, parameters={"size": 0}, retries=3))
        status = await status_of(op, Kind.MAPPING_RUN, "one", is_over)
    assert (status["phase"], status["reason"], status["attempts"]) == ("Failed", "InvalidParameters", 1)
    assert status["message"] == sentence


async def test_a_template_that_is_none_is_told_at_the_run_with_its_line(fake_lab: Lab) -> None:
    files = [{"path": "icp.yaml", "template": "\nsize: {{ parameters.sise }}\n"}]
    fake_lab.apply(algorithm("templated", files=files))
    async with fake_lab.operator() as op:
        fake_lab.apply(run(algorithmRef={"name": "templated"}))
        status = await status_of(op, Kind.MAPPING_RUN, "one", lambda found: condition_of(found, "Accepted"))
    message = condition_of(status, "Accepted")["message"]
    assert "files.0.template: line 2: unknown parameter 'sise'; did you mean 'size'?" in message


@pytest.mark.parametrize("path", ["../icp.yaml", "/icp.yaml", "a/../../b", ".hidden"])
def test_the_api_server_refuses_a_path_out_of_its_folder(path: str, fake_lab: Lab) -> None:
    with pytest.raises(Refusal, match=r"files\[0\]\.path"):
        fake_lab.apply(algorithm("templated", files=[{"path": path, "template": ""}]))
