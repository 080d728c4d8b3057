# SPDX-License-Identifier: Apache-2.0
"""Reasons of ends and waits, from statuses that a real cluster wrote (golden/pods.json)."""

from __future__ import annotations

import base64
import copy
import json
import zlib
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from slamhive.engine import AttemptState, VariantState, classify
from slamhive.kube.observing import (
    Attempted,
    observe_attempt,
    observe_job,
    observe_lost,
    observe_variant,
)
from slamhive.kube.pods import Waiting, why_unable
from slamhive.kube.reconciling.waiting import ROOM_SECONDS, Patience, patience
from slamhive.kube.reports import Report, moment, read_report
from slamhive.model.results import Reason
from slamhive.playback.outcome import Played

PODS = json.loads((Path(__file__).parent / "golden" / "pods.json").read_text(encoding="utf-8"))
MISSING = "output/trajectory.txt is missing or not a regular file"
VIEW = {"name": "lidar", "type": "Lidar", "topic": "/points"}
DESCRIPTION = {
    "folder": "k1",
    "format": "Rosbag1",
    "recording": "recording.bag",
    "sensors": {"lidar": VIEW},
    "startTime": 1.0,
    "durationSeconds": 5.0,
    "frames": 50,
    "key": "k1",
    "sourceSha256": "0" * 64,
    "datasetSha256": "0" * 64,
    "sizeBytes": 3,
}


OK: str = PODS["ok"]["status"]["initContainerStatuses"][0]["state"]["terminated"]["message"]


def job(*conditions: str, **spec: Any) -> dict[str, Any]:
    found = [{"type": kind, "status": "True"} for kind in conditions]
    labels = {"slamhive.io/attempt": "2"}
    return {"metadata": {"uid": "job", "labels": labels}, "spec": spec, "status": {"conditions": found}}


def pod(name: str) -> dict[str, Any]:
    found: dict[str, Any] = copy.deepcopy(PODS[name])
    return found


def without_report(name: str) -> dict[str, Any]:
    found = pod(name)
    for status in found["status"]["initContainerStatuses"]:
        status["state"]["terminated"].pop("message", None)
    return found


def with_report(name: str, **told: Any) -> dict[str, Any]:
    found = pod(name)
    found["status"]["initContainerStatuses"][0]["state"]["terminated"]["message"] = json.dumps(
        {"v": 1} | told
    )
    return found


def seen(*pods: dict[str, Any], conditions: tuple[str, ...] = ()) -> Attempted:
    return observe_attempt(job(*conditions), pods)


@pytest.mark.parametrize(
    ("name", "reason", "message"),
    [
        ("ok", None, None),
        ("crash", Reason.ALGORITHM_FAILED, "exit code 3: cannot read topic /points"),
        ("segv", Reason.ALGORITHM_FAILED, "ended by signal 11 (SIGSEGV)"),
        ("oom", Reason.OUT_OF_MEMORY, "it needed more memory than its limit of 128 MiB"),
        ("deadline", Reason.DEADLINE_EXCEEDED, "it took more than 4 s"),
        (
            "pod-deadline",
            Reason.DEADLINE_EXCEEDED,
            "Pod was active on the node longer than the specified deadline",
        ),
        (
            "no-program",
            Reason.ALGORITHM_FAILED,
            'its program can\'t be started: "nosuch": executable file not found in $PATH',
        ),
        (
            "not-a-program",
            Reason.ALGORITHM_FAILED,
            'its program can\'t be started: "/etc": permission denied',
        ),
        (
            "monitor-killed",
            Reason.SYSTEM_FAULT,
            "its monitor was ended while the algorithm ran: nobody knows what it did since",
        ),
        ("silent", Reason.NO_TRAJECTORY, MISSING),
        ("poison", Reason.ALGORITHM_FAILED, 'exit code 2: "}{[ $(POD_UID) \\xff'),
        ("disk-full", Reason.OUTPUT_TOO_LARGE, 'Usage of EmptyDir volume "tmp" exceeds the limit "10Mi".'),
    ],
)
def test_each_end_has_its_reason(name: str, reason: Reason | None, message: str | None) -> None:
    attempted = seen(pod(name))
    assert (attempted.state, attempted.number, attempted.needs_read) == (AttemptState.ENDED, 2, False)
    assert attempted.end is not None
    assert classify(attempted.end) == (reason, message)


def test_a_run_without_a_pose_has_ended_well_and_what_was_odd_is_said() -> None:
    lost = {"poses": 0, "durationSeconds": 0.0, "sha256": "0" * 64, "path": "output/trajectory.txt"}
    attempted = seen(with_report("ok", trajectory=lost, metricsProblem="metrics.json was ignored"))
    assert attempted.end is not None
    assert classify(attempted.end) == (None, None)
    assert attempted.end.remark == "metrics.json was ignored"
    assert attempted.report is not None
    assert attempted.report.trajectory is not None
    assert attempted.report.trajectory.poses == 0


def test_an_end_comes_with_what_the_monitor_and_the_runtime_know() -> None:
    attempted = seen(pod("ok"))
    assert attempted.report is not None
    assert attempted.report.usage is not None
    assert attempted.report.trajectory is not None
    assert attempted.report.usage.source == "cgroup-v1"
    assert attempted.report.started_at == "2026-11-21T15:12:19.831Z"
    assert (attempted.pod_uid, attempted.node) == ("pod", "node1")
    assert (attempted.started, attempted.finished) == ("2026-11-21T15:12:19Z", "2026-11-21T15:12:21Z")
    assert (attempted.image_id or "").startswith("sha256:")
    assert seen(pod("crash")).log_tail == "reading\ncannot read topic /points"
    assert seen(pod("poison")).log_tail == 'red\n"}{[ $(POD_UID) \\xff'
    assert seen(pod("disk-full")).log_tail is None


@pytest.mark.parametrize(
    ("name", "word", "reason", "part"),
    [
        ("unschedulable", "Unschedulable", None, "1 Insufficient cpu"),
        ("no-image", "ImagePullBackOff", Reason.IMAGE_PULL_FAILED, "image 'slamhive/nope:1'"),
        ("bad-image-name", "InvalidImageName", Reason.IMAGE_PULL_FAILED, "not a valid name"),
        ("no-variant", "CreateContainerConfigError", Reason.SYSTEM_FAULT, 'volumeMount "data"'),
    ],
)
def test_what_keeps_a_pod_waiting_is_told(name: str, word: str, reason: Reason | None, part: str) -> None:
    attempted = seen(pod(name))
    assert attempted.state is AttemptState.RUNNING
    waiting = attempted.waiting
    assert waiting is not None
    assert waiting.reason == word
    assert part in waiting.message
    assert attempted.may_lack_variant == (name == "no-variant")
    assert (waiting.end.reason if waiting.end else None) is reason


async def borne(
    waiting: Waiting | None, seconds: float, *messages: str, room_seconds: float = ROOM_SECONDS
) -> Patience:
    """Return the patience with a Job's pod that has waited for some seconds."""
    assert waiting is not None
    now = (waiting.since or 0.0) + seconds

    async def message(_namespace: str, _uid: str) -> str | None:
        return next(iter(messages), None)

    cluster: Any = SimpleNamespace(
        clock=lambda: now,
        settings=SimpleNamespace(image_pull_grace_seconds=120.0, refusal_grace_seconds=300.0),
        refused_pods=SimpleNamespace(message=message),
    )
    return await patience(cluster, {"metadata": {"namespace": "lab", "uid": "job"}}, waiting, room_seconds)


async def test_a_pod_that_is_to_go_says_so() -> None:
    going = pod("running")
    going["metadata"]["deletionTimestamp"] = "2026-11-21T15:16:00Z"
    attempted = seen(going)
    waiting = attempted.waiting
    assert waiting is not None
    assert (attempted.state, waiting.reason) == (AttemptState.RUNNING, "Terminating")
    assert await borne(waiting, 1e6) == Patience(waiting)


@pytest.mark.parametrize(
    ("told", "reason", "message"),
    [
        (
            'failed to generate container "a1" spec: failed to generate spec: no command specified',
            Reason.ALGORITHM_FAILED,
            "its program can't be started: no command specified",
        ),
        (
            "container init: unable to set memory limit to 2097152 (current usage: 2695168): unknown",
            Reason.OUT_OF_MEMORY,
            "its memory limit is too low to start a program",
        ),
        (
            'container init: error mounting "/var/lib/x" to rootfs at "/slamhive/assets/a": not a directory',
            Reason.SYSTEM_FAULT,
            "nothing could be mounted at /slamhive/assets/a",
        ),
        ("", Reason.ALGORITHM_FAILED, "its program can't be started: the runtime gave no reason"),
    ],
)
def test_why_a_program_cannot_start_is_told_shortly(told: str, reason: Reason, message: str) -> None:
    assert why_unable(told) == (reason, message)
    broken = pod("no-program")
    broken["status"]["containerStatuses"][0]["state"]["terminated"]["message"] = told
    end = seen(broken).end
    assert end is not None
    assert (end.reason, end.message) == (reason, message)


async def test_an_image_without_a_program_is_given_up() -> None:
    stuck = pod("no-variant")
    told = {
        "reason": "CreateContainerError",
        "message": "spec: failed to generate spec: no command specified",
    }
    stuck["status"]["containerStatuses"][0]["state"] = {"waiting": told}
    end = (await borne(seen(stuck).waiting, 121)).end
    assert end is not None
    assert end.reason is Reason.ALGORITHM_FAILED


async def test_a_node_whose_clock_is_behind_has_the_same_patience() -> None:
    """The kubelet's times are an hour old; the scheduler's are not."""
    behind = pod("no-image")
    status = behind["status"]
    began = moment(status["conditions"][0]["lastTransitionTime"])
    assert began is not None
    status["startTime"] = "2026-11-21T14:13:25Z"
    status["initContainerStatuses"][0]["state"]["running"]["startedAt"] = "2026-11-21T14:13:26Z"
    waiting = seen(behind).waiting
    assert waiting is not None
    assert waiting.since == began


async def test_patience_ends_for_an_image_but_not_for_room() -> None:
    waiting = seen(pod("no-image")).waiting
    assert await borne(waiting, 20) == Patience(waiting, 100.0)
    end = (await borne(waiting, 120)).end
    assert end is not None
    assert end.reason is Reason.IMAGE_PULL_FAILED
    assert (await borne(seen(pod("bad-image-name")).waiting, 0)).end is not None
    full = seen(pod("unschedulable")).waiting
    assert await borne(full, 1e6) == Patience(full)


@pytest.mark.parametrize(("room", "said"), [(0.0, True), (ROOM_SECONDS, False)])
async def test_a_full_cluster_is_said_at_runs_at_once_and_elsewhere_after_a_minute(
    room: float, *, said: bool
) -> None:
    full = seen(pod("unschedulable")).waiting
    found = await borne(full, 10, room_seconds=room)
    assert found == (Patience(full) if said else Patience(seconds=50.0))
    assert await borne(full, 60, room_seconds=room) == Patience(full)


async def test_a_claim_that_is_not_bound_is_said_at_once() -> None:
    full = seen(pod("unschedulable")).waiting
    assert full is not None
    told = "0/1 nodes are available: pod has unbound immediate PersistentVolumeClaims."
    unbound = replace(full, message=told)
    assert await borne(unbound, 0) == Patience(unbound)


async def test_a_job_without_a_pod_is_asked_about_after_seconds_and_again() -> None:
    young = job()
    young["metadata"]["creationTimestamp"] = "2026-01-01T00:00:00Z"
    waiting = observe_attempt(young, []).waiting
    assert await borne(waiting, 2, "an old story") == Patience(seconds=3.0)
    assert await borne(waiting, 10) == Patience(seconds=15.0)
    assert await borne(waiting, 1e6) == Patience(waiting, 15.0)
    refused = await borne(waiting, 10, "Error creating: the policy says no")
    assert (refused.why, refused.seconds, refused.end) == (
        "its pod is refused: the policy says no",
        15.0,
        None,
    )
    assert (await borne(waiting, 290, "no")).seconds == 10.0
    end = (await borne(waiting, 300, "no")).end
    assert end is not None
    assert (end.reason, end.message) == (Reason.SYSTEM_FAULT, "its pod is refused: no")
    quota = await borne(waiting, 1e6, "pods is forbidden: exceeded quota: pods")
    assert quota.waiting is not None
    assert (quota.waiting.reason, quota.seconds, quota.end) == ("QuotaExceeded", 15.0, None)


def test_a_program_that_runs_waits_for_nothing() -> None:
    running = pod("running")
    assert seen(running).waiting is None
    assert seen(running).started is not None
    monitor = running["status"]["initContainerStatuses"][0]
    monitor["state"] = {"waiting": {"reason": "CrashLoopBackOff", "message": "back-off 10s"}}
    assert seen(running).waiting is None
    running["status"]["containerStatuses"][0]["state"] = {"waiting": {"reason": "PodInitializing"}}
    waiting = seen(running).waiting
    assert waiting is not None
    assert waiting.end is not None
    assert waiting.end.reason is Reason.SYSTEM_FAULT


def test_a_job_waits_for_its_pod_or_in_a_queue() -> None:
    young = job()
    young["metadata"]["creationTimestamp"] = "2026-01-01T00:00:00Z"
    waiting = observe_attempt(young, []).waiting
    assert waiting is not None
    assert (waiting.reason, waiting.since) == ("NoPod", datetime(2026, 1, 1, tzinfo=UTC).timestamp())
    queued = observe_attempt(job(suspend=True), []).waiting
    assert queued is not None
    assert queued.reason == "QueueWaits"
    assert observe_attempt(None, []) == Attempted()


def test_what_a_disruption_took_is_replaced_and_the_replacement_counts() -> None:
    taken = seen(pod("evicted"))
    assert (taken.state, taken.end) == (AttemptState.RUNNING, None)
    assert taken.waiting is not None
    assert taken.waiting.message == "its pod was taken away: Eviction API: evicting"
    both = seen(pod("replacement"), pod("evicted"))
    assert both.pod == PODS["replacement"]["metadata"]["name"]
    failed = seen(pod("evicted"), conditions=("Failed",))
    assert failed.end is not None
    assert failed.end.reason is Reason.NODE_LOST


@pytest.mark.parametrize("pods", [[], ["deleted"]])
def test_a_deleted_pod_is_no_fault_of_the_algorithm(pods: list[str]) -> None:
    there = [pod(name) for name in pods]
    assert seen(*there).state is AttemptState.RUNNING
    lost = seen(*there, conditions=("Failed",))
    assert lost.end is not None
    assert (lost.end.reason, lost.report) == (Reason.NODE_LOST, None)
    assert observe_attempt(None, there).state is (AttemptState.RUNNING if pods else AttemptState.NONE)


USABLE = read_report(OK)


@pytest.mark.parametrize(
    ("lost", "report", "reason"),
    [
        ("Complete", USABLE, None),
        ("Complete", Report(trajectory_problem=MISSING, trajectory_missing=True), Reason.NO_TRAJECTORY),
        ("Complete", None, Reason.NODE_LOST),
        ("Failed", USABLE, Reason.NODE_LOST),
        ("Failed", Report(reason=Reason.OUT_OF_MEMORY), Reason.OUT_OF_MEMORY),
        ("Failed", Report(played=Played(completed=True, reason=None, message=None)), None),
        ("gone", USABLE, None),
        ("gone", Report(trajectory_problem=MISSING, trajectory_missing=True), Reason.SYSTEM_FAULT),
        ("gone", replace(USABLE, played=Played(False, None, None)), Reason.SYSTEM_FAULT),
        ("gone", None, Reason.SYSTEM_FAULT),
    ],
)
def test_what_a_run_left_says_how_it_ended_where_its_pod_is_gone(
    lost: str, report: Report | None, reason: Reason | None
) -> None:
    def observed(*, was_interrupted: bool) -> Attempted:
        if lost == "gone":
            return observe_lost(2, was_interrupted=was_interrupted)
        return observe_attempt(job(lost), [], was_interrupted=was_interrupted)

    attempted = observed(was_interrupted=False)
    assert attempted.needs_read
    end = attempted.with_report(report).end
    assert end is not None
    assert classify(end)[0] is reason
    assert not observed(was_interrupted=True).needs_read


@pytest.mark.parametrize(
    ("deleted", "taken", "interrupted", "reason"),
    [
        ("15:12:52", None, False, None),
        ("15:12:49", None, False, Reason.NODE_LOST),
        (None, "15:12:22", False, None),
        (None, "15:12:20", False, Reason.NODE_LOST),
        ("15:12:52", None, True, Reason.NODE_LOST),
    ],
)
def test_a_finished_pod_that_is_taken_away_has_ended_well(
    deleted: str | None, taken: str | None, interrupted: bool, reason: Reason | None
) -> None:
    """The golden one ended at 15:12:21; a deletion is told by the end of its grace time."""
    found = pod("ok")
    if deleted:
        found["metadata"] |= {
            "deletionTimestamp": f"2026-11-21T{deleted}Z",
            "deletionGracePeriodSeconds": 30,
        }
    if taken:
        found["metadata"] |= {"deletionTimestamp": f"2026-11-21T{taken}Z", "deletionGracePeriodSeconds": 0}
        told = {"type": "DisruptionTarget", "status": "True", "lastTransitionTime": f"2026-11-21T{taken}Z"}
        found["status"]["conditions"].append(told)
    attempted = observe_attempt(job("Complete"), [found], was_interrupted=interrupted)
    assert attempted.end is not None
    assert classify(attempted.end)[0] is reason
    assert (attempted.report is None) == (reason is not None)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("ok", Reason.SYSTEM_FAULT),
        ("crash", Reason.ALGORITHM_FAILED),
        ("oom", Reason.OUT_OF_MEMORY),
        ("pod-deadline", Reason.DEADLINE_EXCEEDED),
    ],
)
def test_what_the_monitor_did_not_tell_is_read(name: str, reason: Reason) -> None:
    attempted = seen(without_report(name))
    assert attempted.needs_read
    nothing = attempted.with_report(None)
    assert not nothing.needs_read
    assert nothing.end is not None
    assert classify(nothing.end)[0] is reason
    read = attempted.with_report(Report(reason=Reason.OUTPUT_TOO_LARGE, message="too much"))
    assert read.end is not None
    assert read.report is not None
    assert read.end.reason is Reason.OUTPUT_TOO_LARGE


@pytest.mark.parametrize("name", ["monitor", "player"])
@pytest.mark.parametrize(
    ("count", "died", "fault"),
    [(1, "2026-11-21T15:12:19Z", True), (1, "2026-11-21T15:12:18Z", False), (0, None, False)],
)
def test_nothing_is_believed_of_who_died_while_the_algorithm_ran(
    name: str, count: int, died: str | None, fault: bool
) -> None:
    """A report too may have been written by the algorithm then; before it began, nobody could."""
    found = pod("ok")
    statuses = found["status"]["initContainerStatuses"]
    if name == "player":
        statuses.append(copy.deepcopy(statuses[0]) | {"name": "player"})
    statuses[-1] |= {"restartCount": count, "lastState": {"terminated": {"finishedAt": died}}}
    attempted = seen(found)
    assert attempted.end is not None
    assert attempted.end.reason is (Reason.SYSTEM_FAULT if fault else None)
    assert (attempted.report is None, attempted.needs_read) == (fault, False)


def not_rendered(told: dict[str, Any] | None) -> dict[str, Any]:
    """Return a pod whose settings files were not rendered, as a kubelet tells of it."""
    found = pod("ok")
    waiting = {"state": {"waiting": {"reason": "PodInitializing"}}}
    ended = {"exitCode": 1, "reason": "Error", "finishedAt": "2026-11-21T15:12:19Z"}
    message = {} if told is None else {"message": json.dumps(told)}
    found["status"] |= {
        "phase": "Failed",
        "initContainerStatuses": [
            {"name": "render", "state": {"terminated": ended | message}},
            {"name": "monitor", **waiting},
        ],
        "containerStatuses": [{"name": "algorithm", **waiting}],
    }
    return found


def test_settings_that_can_not_be_rendered_are_the_users_and_no_fault_of_the_machine() -> None:
    sentence = "algorithm 'lio': files.0.template (lio.yaml): line 3: division by zero"
    told = {"v": 1, "error": {"reason": "InvalidParameters", "message": sentence}}
    attempted = seen(not_rendered(told))
    assert attempted.state is AttemptState.ENDED
    assert attempted.end is not None
    assert (attempted.end.reason, attempted.end.message) == (Reason.INVALID_PARAMETERS, sentence)
    assert not attempted.needs_read


def test_a_container_that_renders_and_dies_without_a_word_is_a_fault() -> None:
    end = seen(not_rendered(None)).end
    assert end is not None
    assert (end.reason, end.message) == (Reason.SYSTEM_FAULT, "container 'render': exit code 1")


@pytest.mark.parametrize(("seconds", "reason"), [(1, None), (600, Reason.SYSTEM_FAULT)])
def test_an_algorithm_that_hid_from_its_monitor_has_no_result(seconds: int, reason: Reason | None) -> None:
    found = with_report("ok", reason=None, startedAt=None, trajectory=json.loads(OK)["trajectory"])
    state = found["status"]["containerStatuses"][0]["state"]["terminated"]
    state["finishedAt"] = f"2026-11-21T15:{12 + seconds // 60}:20Z"
    end = seen(found).end
    assert end is not None
    assert end.reason is reason


def test_figures_that_are_doubted_are_said_so() -> None:
    usage = {
        "cpu": {"seconds": 0.1, "totalSeconds": 100},
        "suspect": "its reader claims 99% of its CPU seconds",
    }
    found = with_report("ok", usage=usage, trajectory=json.loads(OK)["trajectory"])
    end = seen(found).end
    assert end is not None
    assert end.remark == "UsageSuspect: its reader claims 99% of its CPU seconds"


def test_the_words_of_a_monitor_that_failed_are_kept() -> None:
    broken = without_report("ok")
    words = "Traceback\nModuleNotFoundError: No module named 'slamhive'\n"
    broken["status"]["initContainerStatuses"][0]["state"]["terminated"]["message"] = words
    missing = (Reason.SYSTEM_FAULT, "runs/1/2/summary.json does not exist")
    end = seen(broken).with_report(None, missing).end
    assert end is not None
    assert end.message == (
        "the monitor left no report: exit code 0: ModuleNotFoundError: No module named 'slamhive'; "
        "runs/1/2/summary.json does not exist"
    )


def test_a_failure_without_figures_says_why_it_has_none() -> None:
    failed = seen(without_report("crash"))
    assert failed.end is not None
    assert failed.end.message is not None
    end = failed.with_report(None, (Reason.SYSTEM_FAULT, "summary.json does not exist")).end
    assert end is not None
    assert classify(end)[0] is Reason.ALGORITHM_FAILED
    assert end.message == (
        f"{failed.end.message}; the monitor left no report: exit code 0; summary.json does not exist"
    )


def test_what_the_kubelet_said_of_the_pod_stands_after_its_report_was_read() -> None:
    read = seen(without_report("pod-deadline")).with_report(Report())
    assert read.end is not None
    assert read.end.reason is Reason.DEADLINE_EXCEEDED


def test_what_the_monitor_did_comes_before_how_the_program_took_it() -> None:
    end = seen(with_report("segv", reason="OutputTooLarge", message="it wrote too much")).end
    assert end is not None
    assert classify(end) == (Reason.OUTPUT_TOO_LARGE, "it wrote too much")
    ended_well = seen(with_report("ok", reason="DeadlineExceeded", message="late")).end
    assert ended_well is not None
    assert classify(ended_well)[0] is Reason.DEADLINE_EXCEEDED


@pytest.mark.parametrize("forged", ["Cancelled", "NodeLost", "ImagePullFailed", 5, [], {"a": 1}])
def test_a_report_cannot_ask_for_another_try(forged: Any) -> None:
    end = seen(with_report("crash", reason=forged)).end
    assert end is not None
    assert classify(end)[0] is Reason.ALGORITHM_FAILED


@pytest.mark.parametrize(
    ("word", "message", "reason"),
    [
        ("UnexpectedAdmissionError", "Allocate failed: no GPU", Reason.SYSTEM_FAULT),
        ("OutOfcpu", "Node didn't have enough resource: cpu", Reason.SYSTEM_FAULT),
        ("NodeLost", "Node node1 which was running pod is unresponsive", Reason.NODE_LOST),
        ("Terminated", "Pod was terminated in response to imminent node shutdown.", Reason.NODE_LOST),
        ("Evicted", "The node was low on resource: memory.", Reason.NODE_LOST),
        ("Evicted", "Pod ephemeral local storage usage exceeds the total limit", Reason.OUTPUT_TOO_LARGE),
    ],
)
def test_what_a_node_refused_or_ended_is_told(word: str, message: str, reason: Reason) -> None:
    refused = pod("unschedulable")
    refused["status"] = {"phase": "Failed", "reason": word, "message": message}
    end = seen(refused).end
    assert end is not None
    assert end.reason is reason
    assert message in (end.message or "")
    assert end.reason.is_infrastructure is (reason is not Reason.OUTPUT_TOO_LARGE)


def test_pods_of_other_jobs_do_not_count() -> None:
    other = pod("crash")
    other["metadata"]["ownerReferences"][0]["uid"] = "another"
    assert seen(other).pod is None


def ours(container: str, message: str | None, code: int = 0, **terminated: Any) -> dict[str, Any]:
    state = {"exitCode": code, "message": message, "finishedAt": "2026-11-21T15:13:23Z"} | terminated
    found = pod("ok")
    found["status"] = {
        "phase": "Failed" if code else "Succeeded",
        "containerStatuses": [{"name": container, "state": {"terminated": state}}],
    }
    return found


def packed(description: object) -> str:
    return json.dumps(
        {"v": 1, "z": base64.b64encode(zlib.compress(json.dumps(description).encode())).decode()}
    )


def test_a_preparation_describes_its_variant() -> None:
    found = observe_variant(job("Complete"), [ours("prepare", packed(DESCRIPTION))])
    assert found.state is VariantState.READY
    assert found.description is not None
    assert found.description.as_json()["folder"] == "k1"
    assert observe_variant(job(), []).state is VariantState.MAKING
    assert observe_variant(None, []).state is VariantState.ABSENT


ERROR = json.dumps({"v": 1, "error": {"reason": "DatasetMissing", "message": "no file a.bag"}})


@pytest.mark.parametrize(
    ("made", "reason", "part"),
    [
        (ours("prepare", ERROR, 1), Reason.DATASET_MISSING, "no file a.bag"),
        (ours("prepare", "Traceback\nBoom", 1), Reason.SYSTEM_FAULT, "exit code 1: Boom"),
        (ours("prepare", None, 137, reason="OOMKilled"), Reason.PREPARATION_FAILED, "more memory"),
        (ours("prepare", packed({"folder": "../x"})), Reason.SYSTEM_FAULT, "can't be read"),
        (ours("prepare", packed(DESCRIPTION | {"folder": "../x"})), Reason.SYSTEM_FAULT, "can't be read"),
        (
            ours("prepare", packed(DESCRIPTION | {"pad": "0" * (2 << 20)})),
            Reason.SYSTEM_FAULT,
            "can't be read",
        ),
        (ours("prepare", '{"v":1,"z":"AAAA"}'), Reason.SYSTEM_FAULT, "can't be read"),
        (ours("prepare", None), Reason.SYSTEM_FAULT, "can't be read"),
    ],
)
def test_a_preparation_that_failed_says_why(made: dict[str, Any], reason: Reason, part: str) -> None:
    found = observe_variant(job(), [made])
    assert (found.state, found.description) == (VariantState.FAILED, None)
    assert found.problem is not None
    assert found.problem[0] is reason
    assert part in found.problem[1]


def by_program(message: str | None, code: int = 1, shown: int = 0, **terminated: Any) -> dict[str, Any]:
    """Return the pod of a preparation that ended while a program of the Dataset made its frames."""
    found = ours("program", message, code, **terminated)
    told = {"exitCode": shown, "message": ERROR if shown else None, "finishedAt": "2026-11-21T15:13:23Z"}
    theirs = [] if shown else found["status"]["containerStatuses"]
    first = {"name": "show", "state": {"terminated": told}}
    found["status"]["initContainerStatuses"] = [first, *theirs]
    waits = {"waiting": {"reason": "PodInitializing"}}
    found["status"]["containerStatuses"] = [{"name": "prepare", "state": waits}]
    return found


LATE = {"reason": "DeadlineExceeded", "message": "Pod was active on the node longer than the deadline"}
FULL = {"reason": "Evicted", "message": 'Usage of EmptyDir volume "own" exceeds the limit "5Gi". '}


@pytest.mark.parametrize(
    ("made", "status", "sentence"),
    [
        (
            by_program("loading\nno weights\n", 3),
            {},
            "failed: exit code 3; its log ends: loading | no weights",
        ),
        (by_program(None, 4), {}, "failed: exit code 4"),
        (by_program(ERROR, 1), {}, f"failed: exit code 1; its log ends: {ERROR}"),
        (by_program(None, 137, reason="OOMKilled"), {}, "failed: it needed more memory than its limit"),
        (by_program("on it", 137), LATE, "failed: it took more than its timeout; its log ends: on it"),
        (by_program(None, 137), FULL, f"failed: {FULL['message'].strip()}"),
    ],
)
def test_a_program_of_the_dataset_that_failed_is_told_by_name(
    made: dict[str, Any], status: dict[str, str], sentence: str
) -> None:
    labels = {"slamhive.io/preparation": "masked", "slamhive.io/dataset": "hall"}
    asked = job()
    asked["metadata"]["labels"] |= labels
    made["status"] |= status
    found = observe_variant(asked, [made])
    expected = f"the preparation 'masked' of dataset 'hall' {sentence}"
    assert (found.state, found.problem) == (VariantState.FAILED, (Reason.PREPARATION_FAILED, expected))


def test_what_comes_before_a_program_is_no_fault_of_it() -> None:
    asked = job()
    asked["metadata"]["labels"] |= {"slamhive.io/preparation": "masked", "slamhive.io/dataset": "hall"}
    found = observe_variant(asked, [by_program(None, shown=1)])
    assert found.problem == (Reason.DATASET_MISSING, "no file a.bag")


def test_an_evaluator_that_failed_says_which_container() -> None:
    assert observe_job(job("Complete"), [ours("evaluate", None)]).problem is None
    custom = ours("evaluator", "no such trajectory\n", 2)
    custom["status"]["initContainerStatuses"] = custom["status"]["containerStatuses"]
    custom["status"]["containerStatuses"] = [
        {"name": "report", "state": {"waiting": {"reason": "PodInitializing"}}}
    ]
    found = observe_job(job(), [custom])
    assert (found.state, found.container) == (AttemptState.ENDED, "report")
    expected = "container 'evaluator': exit code 2: no such trajectory"
    assert found.problem == (Reason.ALGORITHM_FAILED, expected)
    lost = observe_job(job("Complete"), [])
    assert (lost.problem, lost.is_lost) == (None, True)
    assert observe_job(job("Failed"), []).problem is not None


def test_what_was_read_is_a_report() -> None:
    text = json.dumps({"v": 1, "reason": None, "trajectoryProblem": "bad", "usage": {"samples": 3}})
    found = observe_job(job(), [ours("read", text)])
    assert found.state is AttemptState.ENDED
    report = read_report(found.words)
    assert report is not None
    assert report.trajectory_problem == "bad"
    failed = observe_job(job(), [ours("read", ERROR, 1)])
    assert (failed.state, read_report(failed.words)) == (AttemptState.ENDED, None)
    assert failed.problem == (Reason.DATASET_MISSING, "no file a.bag")
    assert observe_job(None, []).state is AttemptState.NONE
