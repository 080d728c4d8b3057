# SPDX-License-Identifier: Apache-2.0
"""Observation: classifies what Jobs and pods say into what the engine wants to know.

Pure: neither API nor clock.

A pod's end is taken as soon as the pod shows it, before its Job does: a Job here fails with its first pod.
Only what a disruption took (eviction by the node, drain, preemption, a lost node) is replaced by the Job, and
is seen as running until the replacement ends.

A pod that is taken away after its end takes nothing with it: its Job says that it succeeded, summary.json on
the volume what came out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from slamhive.engine import AttemptEnd, AttemptState, VariantState
from slamhive.kube.api.kinds import Label, labels_of
from slamhive.kube.builders.evaluation import EVALUATE, EVALUATOR, LINKS, READ, REPORT
from slamhive.kube.builders.restoring import RESTORE
from slamhive.kube.builders.run import ALGORITHM, MONITOR, RENDER
from slamhive.kube.builders.variant import PREPARE, PROGRAM, SHOW
from slamhive.kube.kueue import held_back, is_suspended, taken, was_taken
from slamhive.kube.pods import (
    NO_CONTAINER_CONFIG,
    Ending,
    Waiting,
    condition,
    container_of,
    disrupted,
    ending_of,
    has_completed,
    has_ended,
    has_failed,
    is_deleted,
    is_disrupted,
    is_finished,
    message_of,
    newest,
    refused_by_node,
    what_waits,
    why_unable,
)
from slamhive.kube.reports import Report, clean, moment, read_description, read_failure, read_report
from slamhive.model.results import Reason, remark_of
from slamhive.model.variant import program_title
from slamhive.playback.judging import judge
from slamhive.playback.pod import NAME as PLAYER

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.model.variant import VariantDescription

    Object = Mapping[str, Any]

Problem = tuple[Reason, str]

NO_POD = "NoPod"
"""Reason of a Job's waiting that has no pod, nobody knows why."""
PREPARATION_WAITS = "PreparationWaits"
"""Reason of runs whose preparation does not begin."""
TERMINATING = "Terminating"
"""Reason of the waiting of a pod that is taken away while its program runs."""
DISRUPTED = "Disrupted"
"""Reason of the waiting of a Job for another pod in the place of one that was taken."""
_HIDDEN_SECONDS = 2.0
_LOG_LINES = 5
_MAIN = (EVALUATE, REPORT, EVALUATOR, LINKS, PREPARE, READ, RESTORE)
"""Containers of our Jobs, the main ones first."""
_SILENT = "the monitor left no report"
_GONE = "its pod is gone"
_WELL = Ending(exit_code=0, signal=None, reason="Completed", message="", started=None, finished=None)
_BY_SUMMARY = "its Job and pod were gone: summary.json on the volume says how it ended, not its exit code"


@dataclass(frozen=True)
class Attempted:
    """State of a run's attempt, as its Job and pod show it: progress, end and report.

    Attributes:
        state: whether its program runs, as far as the engine is concerned.
        end: how it ended.
        number: which attempt it is.
        waiting: why its program doesn't run yet.
        report: what its monitor told.
        silence: how the monitor ended, if it told nothing though the program ran, or what became of the pod:
            what is left is to be read and given to `with_report`; ``end`` is what stands if nothing is found.
        ending: how the algorithm's container ended.
        told: what the kubelet made of its entire pod, if anything.
        disrupted: UIDs of its pods that are taken, or were, by no fault of theirs, oldest first, and stay.
        put_off: UIDs of its pods that go, or went, because its Job was suspended, and don't stay.
        pod: name of its pod.
        pod_uid: identity of its pod, by which its folder is named.
        node: the node it ran on.
        image_id: the image that the runtime really ran.
        started: when the container began, ISO 8601.
        finished: when it had ended.
        log_tail: the last lines of its log.
    """

    state: AttemptState = AttemptState.NONE
    end: AttemptEnd | None = None
    number: int | None = None
    waiting: Waiting | None = None
    report: Report | None = None
    silence: str | None = None
    ending: Ending | None = None
    told: AttemptEnd | None = None
    disrupted: tuple[str, ...] = ()
    put_off: tuple[str, ...] = ()
    pod: str | None = None
    pod_uid: str | None = None
    node: str | None = None
    image_id: str | None = None
    started: str | None = None
    finished: str | None = None
    log_tail: str | None = None

    @property
    def needs_read(self) -> bool:
        """Tell whether what the monitor left is still to be read."""
        return self.silence is not None

    @property
    def may_lack_variant(self) -> bool:
        """Tell whether its variant's folder may be gone: the kubelet can't put together what it mounts.

        The kubelet has one word for this and for other faults of a container's configuration, and only its
        sentence says more. A variant that is there after all costs a look by its preparation, no more.
        """
        return self.waiting is not None and self.waiting.reason == NO_CONTAINER_CONFIG

    def with_report(self, report: Report | None, problem: Problem | None = None) -> Attempted:
        """Return the attempt with what was read of it.

        Args:
            report: what was found; None: nothing.
            problem: why nothing was found.
        """
        if report is None:
            why = "; ".join(text for text in (self.silence, problem and problem[1]) if text)
            return replace(self, silence=None, end=self.end and _unreported(self.end, why))
        end = self.end if self.ending is None else _concluded(self.told, self.ending, report)
        if self.ending is None and end is not None and _tells_end(end, report):
            end = _concluded(None, _WELL, report)
            end = end if end.reason else replace(end, remark=end.remark or _BY_SUMMARY)
        return replace(self, report=report, silence=None, end=end, pod_uid=self.pod_uid or report.pod)


def observe_attempt(
    job: Object | None,
    pods: Iterable[Object],
    *,
    was_interrupted: bool = False,
    at_work_since: float | None = None,
) -> Attempted:
    """Say what is seen of an attempt.

    Args:
        job: its Job; None when that is gone.
        pods: its pods.
        was_interrupted: whether a pod of it was seen being taken away while its program ran.
        at_work_since: since when its program runs as far as is known, s since 1970.
    """
    pods = [*pods]
    pod = newest(job, pods)
    gone = taken(job, pods, at_work_since)
    if pod is None:
        if job is None:
            return Attempted()
        return replace(_without_pod(job, was_interrupted=was_interrupted), put_off=gone)
    seen = replace(_seen(job, pod), disrupted=disrupted(pods), put_off=gone)
    if is_finished(pod) and was_taken(job, pod):
        return _taken(seen, job, pod)
    if not is_finished(pod):
        going = is_deleted(pod) and seen.ending is None
        return replace(seen, waiting=_going(job, pod) if going else what_waits(pod, ALGORITHM))
    if is_disrupted(pod) or is_deleted(pod):
        ended_before = pod["status"]["phase"] == "Succeeded" and not was_interrupted
        if not ended_before or _was_asked_to_end(pod, seen.ending):
            return _taken(seen, job, pod)
    return _ended(seen, pod)


def observe_lost(number: int, *, was_interrupted: bool) -> Attempted:
    """Say what is seen of an attempt that ran and has neither Job nor pod any more.

    Args:
        number: which attempt it is.
        was_interrupted: whether its pod was seen being taken away while its program ran.
    """
    end = AttemptEnd(reason=Reason.SYSTEM_FAULT, message="its Job was deleted by someone else")
    return Attempted(AttemptState.ENDED, end, number, silence=None if was_interrupted else _GONE)


def _without_pod(job: Object, *, was_interrupted: bool) -> Attempted:
    number = _number(job)
    if has_ended(job):
        end = AttemptEnd(reason=Reason.NODE_LOST, message="its pod was deleted")
        seen = Attempted(AttemptState.ENDED, end, number)
        if was_interrupted:
            return seen
        # A Job is complete when all containers of its pod ended with exit code 0.
        return replace(seen, silence=_GONE, ending=_WELL if has_completed(job) else None)
    begun = (job.get("status") or {}).get("startTime") or job["metadata"].get("creationTimestamp")
    waiting = Waiting(NO_POD, "its Job has no pod yet", moment(begun))
    if is_suspended(job):
        waiting = held_back(job)
    return Attempted(AttemptState.RUNNING, number=number, waiting=waiting)


def _seen(job: Object | None, pod: Object) -> Attempted:
    ending = ending_of(pod, ALGORITHM)
    status = container_of(pod, ALGORITHM)
    running = (status.get("state") or {}).get("running") or {}
    return Attempted(
        AttemptState.RUNNING,
        number=_number(job or pod),
        report=read_report(message_of(pod, MONITOR)) if is_finished(pod) else None,
        ending=ending,
        pod=pod["metadata"]["name"],
        pod_uid=pod["metadata"].get("uid"),
        node=(pod.get("spec") or {}).get("nodeName"),
        image_id=clean(status.get("imageID") or "", 300) or None,
        started=ending.started if ending else running.get("startedAt"),
        finished=ending.finished if ending else None,
        log_tail=ending.log or None if ending else None,
    )


def _going(job: Object | None, pod: Object) -> Waiting:
    """Return the wait of a pod that is to go: for its containers' end, or its node's word about it."""
    told = (condition(pod, "DisruptionTarget") or {}).get("message")
    why = "its Job was suspended" if was_taken(job, pod) else "it was deleted"
    return Waiting(TERMINATING, clean(f"its pod is being taken away: {told or why}"))


def _was_asked_to_end(pod: Object, ending: Ending | None) -> bool:
    """Tell whether a pod was to go before its program ended, as far as the pod still says so."""
    meta, ended = pod["metadata"], moment(ending.finished) if ending else None
    # The time of a deletion is that at which the grace time is over.
    grace = meta.get("deletionGracePeriodSeconds")
    asked = moment(meta.get("deletionTimestamp")) if grace else None
    told = moment((condition(pod, "DisruptionTarget") or {}).get("lastTransitionTime"))
    times = [time for time in (asked and asked - grace, told) if time is not None]
    return ended is None or any(time <= ended for time in times)


def _taken(seen: Attempted, job: Object | None, pod: Object) -> Attempted:
    """Return an attempt whose pod was taken from outside; only a Job that has ended makes that an end."""
    told = (condition(pod, "DisruptionTarget") or {}).get("message") or pod["status"].get("message")
    message = clean(f"its pod was taken away: {told}") if told else "its pod was deleted"
    if job is not None and has_ended(job):
        end = AttemptEnd(reason=Reason.NODE_LOST, message=message)
        return replace(seen, state=AttemptState.ENDED, end=end, report=None)
    # Nothing that it reported counts: its Job makes another pod, which begins anew.
    waiting = held_back(job) if job is not None and is_suspended(job) else Waiting(DISRUPTED, message)
    return replace(seen, waiting=waiting, report=None)


def _ended(seen: Attempted, pod: Object) -> Attempted:
    ending, report = seen.ending, seen.report
    told = _told_by_pod(pod, ending)
    # Where the kubelet ended the whole pod, monitor and player died of the same cause.
    fault = _interrupted(pod, ending) if told is None else None
    if fault is not None:
        return replace(seen, state=AttemptState.ENDED, end=fault, report=None)
    if ending is None:
        end = told or _not_rendered(pod)
        end = end or AttemptEnd(reason=Reason.SYSTEM_FAULT, message=_before_start(pod))
        return replace(seen, state=AttemptState.ENDED, end=end)
    seen = replace(seen, state=AttemptState.ENDED, end=_concluded(told, ending, report), told=told)
    if report is not None or ending.was_unable or ending.is_unknown:
        return seen
    # A monitor that failed leaves the end of its log as its termination message: it says why.
    monitor = ending_of(pod, MONITOR)
    return replace(seen, silence="nobody saw its end" if monitor is None else monitor.sentence)


def _concluded(told: AttemptEnd | None, ending: Ending, report: Report | None) -> AttemptEnd:
    """Return the end of an attempt whose program ran.

    Args:
        told: what the kubelet made of the entire pod, if anything.
        ending: how the algorithm's container ended.
        report: its monitor's. What the monitor did comes before what followed from it.
    """
    if told is not None and (report is None or report.reason is None):
        return told
    return _judged(ending, report)


def _tells_end(end: AttemptEnd, report: Report) -> bool:
    """Tell whether a report says how a program ended of which neither Job nor pod does.

    Args:
        end: the end as it is without: a lost pod's where its Job has failed, a fault where that is gone.
        report: what was found on the volume.
    """
    played = report.played
    if report.reason is not None or played is not None:
        return report.reason is not None or bool(played and played.completed)
    # One that was broken off would have been seen to be, unless no operator was there.
    return end.reason is Reason.SYSTEM_FAULT and report.trajectory is not None


def _unreported(end: AttemptEnd, why: str) -> AttemptEnd:
    """Return an end with the reason why there is no report of the monitor, and so no figures."""
    before = f"{end.message}; " if end.message and end.message != _SILENT else ""
    return replace(end, message=clean(f"{before}{_SILENT}: {why}"))


def _told_by_pod(pod: Object, ending: Ending | None) -> AttemptEnd | None:
    """Return an end that the kubelet made of the entire pod."""
    word, message = pod["status"].get("reason") or "", clean(pod["status"].get("message") or "")
    if word == "DeadlineExceeded":
        return AttemptEnd(reason=Reason.DEADLINE_EXCEEDED, message=message)
    if word == "Evicted":
        # One word of the kubelet has two causes, which only its sentence tells apart: a disk that the
        # algorithm filled, or a node that ran short of memory, for which it is not to blame.
        disk = any(part in message.lower() for part in ("ephemeral", "emptydir"))
        return AttemptEnd(reason=Reason.OUTPUT_TOO_LARGE if disk else Reason.NODE_LOST, message=message)
    if word in {"NodeLost", "NodeShutdown", "Shutdown", "Terminated"}:
        return AttemptEnd(reason=Reason.NODE_LOST, message=message or "its node went away")
    if ending is None and word:
        return AttemptEnd(reason=Reason.SYSTEM_FAULT, message=refused_by_node(pod))
    return None


def _interrupted(pod: Object, ending: Ending | None) -> AttemptEnd | None:
    """Return the fault that a monitor or player died while the algorithm ran.

    It is told by the kubelet alone: while either starts again, the algorithm may change what it says.
    """
    begun = None if ending is None else moment(ending.started)
    for name in (MONITOR, PLAYER):
        if begun is not None and _began_again(container_of(pod, name), begun):
            message = f"its {name} was ended while the algorithm ran: nobody knows what it did since"
            return AttemptEnd(reason=Reason.SYSTEM_FAULT, message=message)
    return None


def _began_again(status: Mapping[str, Any], begun: float) -> bool:
    """Tell whether a container died since a time; the kubelet tells times in whole seconds."""
    state, last = status.get("state") or {}, (status.get("lastState") or {}).get("terminated") or {}
    now = state.get("running") or state.get("terminated") or {}
    started, died = moment(now.get("startedAt")), moment(last.get("finishedAt"))
    if started is not None and started > begun:
        return True
    times = [time for time in (started, died) if time is not None]
    return bool(status.get("restartCount")) and (not times or max(times) >= begun)


def _not_rendered(pod: Object) -> AttemptEnd | None:
    """Return the end of an attempt whose settings files could not be rendered."""
    failure = read_failure(message_of(pod, RENDER))
    return None if failure is None else AttemptEnd(reason=failure.reason, message=failure.message)


def _before_start(pod: Object) -> str:
    """Return a sentence on the container that kept the algorithm from being started."""
    for status in pod["status"].get("initContainerStatuses") or ():
        ending = ending_of(pod, status["name"])
        if ending is not None and status["name"] != MONITOR and ending.exit_code != 0:
            told = why_unable(ending.message)[1] if ending.was_unable else ending.sentence
            return f"container {status['name']!r}: {told}"
    return refused_by_node(pod)


def _judged(ending: Ending, report: Report | None) -> AttemptEnd:
    """Return the end of an attempt, from what the kubelet, the monitor and the player saw."""
    return judge(_watched(ending, report), report.played if report else None)


def _watched(ending: Ending, report: Report | None) -> AttemptEnd:
    seen = AttemptEnd(exit_code=ending.exit_code, signal=ending.signal)
    if report is not None and report.reason is not None:
        return replace(seen, reason=report.reason, message=report.message or ending.sentence)
    # The first that holds decides: what is particular stands before what is general.
    for holds, reason, message in (
        (ending.reason == "OOMKilled", Reason.OUT_OF_MEMORY, "it needed more memory than its limit"),
        (ending.was_unable, *why_unable(ending.message)),
        (ending.is_unknown, Reason.NODE_LOST, "nobody saw how it ended"),
        (ending.exit_code != 0, None, ending.sentence),
        (report is None, Reason.SYSTEM_FAULT, _SILENT),
        (_hid(ending, report), Reason.SYSTEM_FAULT, "the monitor never saw the algorithm, though it ran"),
    ):
        if holds:
            return replace(seen, reason=reason, message=message)
    if report is None:
        return seen
    return replace(
        seen,
        trajectory_problem=report.trajectory_problem,
        trajectory_missing=report.trajectory_missing,
        remark=remark_of(report.usage, report.metrics_problem),
    )


def _hid(ending: Ending, report: Report | None) -> bool:
    """Tell whether an algorithm ran for seconds and its monitor did not find it."""
    begun, done = moment(ending.started), moment(ending.finished)
    seen = report is None or report.started_at is not None or report.usage is not None
    return not seen and begun is not None and done is not None and done - begun > _HIDDEN_SECONDS


@dataclass(frozen=True)
class VariantObserved:
    """State of a variant's preparation, as its Job and pod show it.

    Attributes:
        state: whether the variant is there.
        description: what it is, when it is.
        problem: why it isn't, when it failed.
        waiting: why the preparation doesn't run yet.
    """

    state: VariantState = VariantState.ABSENT
    description: VariantDescription | None = None
    problem: Problem | None = None
    waiting: Waiting | None = None


def observe_variant(job: Object | None, pods: Iterable[Object]) -> VariantObserved:
    """Say what is seen of a preparation.

    Args:
        job: its Job; None when there is none.
        pods: pods, its own among them.
    """
    pods = [*pods]
    seen = observe_job(job, pods)
    if seen.state is AttemptState.NONE:
        return VariantObserved()
    if seen.state is not AttemptState.ENDED:
        return VariantObserved(VariantState.MAKING, waiting=seen.waiting)
    if seen.is_lost:
        return VariantObserved()
    description = read_description(seen.words)
    if seen.problem is None and description is None:
        seen = replace(seen, problem=(Reason.SYSTEM_FAULT, "the preparation's report can't be read"))
    if seen.problem is not None:
        problem = _of_program(job, newest(job, pods)) or _of_preparation(seen.problem)
        return VariantObserved(VariantState.FAILED, problem=problem)
    return VariantObserved(VariantState.READY, description)


def _of_program(job: Object | None, pod: Object | None) -> Problem | None:
    """Return the problem of a program of the Dataset, where a preparation failed in its container."""
    name = labels_of(job or {}).get(Label.PREPARATION)
    if name is None or pod is None or ending_of(pod, PREPARE) is not None:
        return None
    laid = ending_of(pod, SHOW)
    if laid is None or laid.exit_code != 0:
        failure = read_failure(message_of(pod, SHOW))
        return None if failure is None else (failure.reason, failure.message)
    ending = ending_of(pod, PROGRAM)
    told = _told_by_pod(pod, ending)
    if ending is not None and ending.exit_code == 0:
        return None
    if told is not None and told.reason in {Reason.DEADLINE_EXCEEDED, Reason.OUTPUT_TOO_LARGE}:
        late = told.reason is Reason.DEADLINE_EXCEEDED
        what = "it took more than its timeout" if late else told.message or "it wrote too much"
    elif told is not None or ending is None:
        return None
    else:
        end = _watched(ending, None)
        if end.reason in {Reason.NODE_LOST, Reason.SYSTEM_FAULT}:
            return None
        what = (
            str(end.message) if end.reason is not None or ending.signal else f"exit code {ending.exit_code}"
        )
    log = clean(" | ".join((ending.message if ending else "").split("\n")[-_LOG_LINES:]), 600)
    title = program_title(name, labels_of(job or {}).get(Label.DATASET, ""))
    end_of_log = f"; its log ends: {log}" if log else ""
    return Reason.PREPARATION_FAILED, f"{title} failed: {what}{end_of_log}"


def _of_preparation(problem: Problem) -> Problem:
    """Return a problem as one of preparing: a recording that asks too much is no fault of the machine."""
    reason, message = problem
    if reason is Reason.OUT_OF_MEMORY:
        return Reason.PREPARATION_FAILED, "preparing needed more memory than preparation.memory allows"
    if reason is Reason.DEADLINE_EXCEEDED:
        return Reason.PREPARATION_FAILED, "preparing took longer than preparation.timeout allows"
    if reason in {Reason.ALGORITHM_FAILED, Reason.NODE_LOST}:
        return Reason.SYSTEM_FAULT, message
    return problem


@dataclass(frozen=True)
class JobObserved:
    """State of a Job that prepares, evaluates, reads or restores, as the Job and its pod show it.

    Attributes:
        state: whether it runs.
        problem: why it failed; None when it didn't.
        waiting: why it doesn't run yet.
        words: the last words of its main container.
        pod: name of its pod, for its log.
        container: its main container.
    """

    state: AttemptState = AttemptState.NONE
    problem: Problem | None = None
    waiting: Waiting | None = None
    words: str | None = None
    pod: str | None = None
    container: str = ""

    @property
    def is_lost(self) -> bool:
        """Tell whether it did what it should, and what it said of that went with its pod."""
        return self.state is AttemptState.ENDED and self.problem is None and self.pod is None


def observe_job(job: Object | None, pods: Iterable[Object]) -> JobObserved:
    """Say what is seen of a Job that prepares, evaluates, reads or restores.

    Args:
        job: the Job; None when there is none.
        pods: pods, its own among them.
    """
    if job is None:
        return JobObserved()
    pod = newest(job, pods)
    if pod is None:
        seen = _without_pod(job, was_interrupted=True)
        lost = (Reason.SYSTEM_FAULT, "its pod was deleted") if has_failed(job) else None
        return JobObserved(seen.state, lost, seen.waiting)
    main = next((name for name in _MAIN if container_of(pod, name)), _MAIN[0])
    base = JobObserved(AttemptState.RUNNING, pod=pod["metadata"]["name"], container=main)
    if was_taken(job, pod) or not is_finished(pod):
        held = is_deleted(pod) and is_suspended(job)
        return replace(base, waiting=held_back(job) if held else what_waits(pod, main))
    if is_disrupted(pod) or (is_deleted(pod) and pod["status"]["phase"] != "Succeeded"):
        if not has_failed(job):
            return base
        return replace(
            base, state=AttemptState.ENDED, problem=(Reason.SYSTEM_FAULT, "its pod was taken away")
        )
    words = message_of(pod, main)
    problem = None if pod["status"]["phase"] == "Succeeded" else _why_failed(pod, words)
    return replace(base, state=AttemptState.ENDED, problem=problem, words=words)


def _why_failed(pod: Object, words: str | None) -> Problem:
    failure = read_failure(words)
    if failure is not None:
        return failure.reason, failure.message
    for name in _MAIN:
        ending = ending_of(pod, name)
        told = _told_by_pod(pod, ending)
        if told is not None and told.reason is not None:
            return told.reason, told.message or ""
        if ending is not None and ending.exit_code != 0:
            end = _judged(ending, None)
            return end.reason or Reason.ALGORITHM_FAILED, f"container {name!r}: {end.message}"
    return Reason.SYSTEM_FAULT, refused_by_node(pod)


def _number(obj: Object) -> int | None:
    text = labels_of(obj).get(Label.ATTEMPT) or ""
    return int(text) if text.isdecimal() and len(text) < 10 else None
