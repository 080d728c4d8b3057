# SPDX-License-Identifier: Apache-2.0
"""Readings of a pod's status: why it waits, how a container ended, which node refused it. Pure."""

from __future__ import annotations

import re
import signal as signals
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.contract.lines import is_report
from slamhive.engine import AttemptEnd
from slamhive.kube.api.kinds import Label, Role, labels_of, owner_uids
from slamhive.kube.reports import clean, last_line, moment, tail
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    Object = Mapping[str, Any]

PULLS = frozenset(
    {
        "ErrImageNeverPull",
        "ErrImagePull",
        "ImageInspectError",
        "ImagePullBackOff",
        "RegistryUnavailable",
        "SignatureValidationFailed",
    }
)
"""Reasons that the kubelet gives where it can't have an image."""
NO_CONTAINER_CONFIG = "CreateContainerConfigError"
"""Reason that the kubelet gives where it can't put together what a container mounts and is told."""
_STARTS = frozenset({NO_CONTAINER_CONFIG, "CreateContainerError", "PostStartHookError", "RunContainerError"})
# Texts of container runtimes: nothing else in a pod's status tells these causes apart.
_MOUNTING = re.compile(r'error mounting "[^"]*" to rootfs at "([^"]*)"')
_NO_MEMORY = ("memory limit", "OOM-killed")
_UNABLE = ("StartError", "ContainerCannotRun")
_PROGRAM = ("exec: ", "executable file not found", "no command specified", "no such file or directory")


@dataclass(frozen=True)
class Waiting:
    """Reason and message that say why a pod doesn't run yet.

    Attributes:
        reason: one word for a condition.
        message: a sentence.
        since: since when at the earliest, s since 1970.
        end: what the attempt's end is if this lasts; None: it may last for ever.
        hopeless: whether it needs no patience to know that it lasts.
    """

    reason: str
    message: str
    since: float | None = None
    end: AttemptEnd | None = None
    hopeless: bool = False


@dataclass(frozen=True)
class Ending:
    """End of a container, from its pod's status: exit code or signal, reason, message and times.

    Attributes:
        exit_code: its exit code; None when a signal ended it or nobody knows.
        signal: the signal, as the exit codes above 128 tell it.
        reason: the runtime's word for it, such as OOMKilled.
        message: its termination message, or the last lines of its log.
        started: when it began, as the API server wrote it.
        finished: when it had ended.
    """

    exit_code: int | None
    signal: int | None
    reason: str
    message: str
    started: str | None
    finished: str | None

    @property
    def was_unable(self) -> bool:
        """Tell whether its program never ran."""
        return self.reason in _UNABLE

    @property
    def is_unknown(self) -> bool:
        """Tell whether nobody saw how it ended."""
        return self.reason == "ContainerStatusUnknown"

    @property
    def log(self) -> str:
        """Return the last lines of its log, empty where the message is the runtime's."""
        return "" if self.was_unable or self.is_unknown else self.message

    @property
    def sentence(self) -> str:
        """Return a sentence on its end, with the last line of its log."""
        if self.signal is not None:
            what = f"ended by signal {self.signal} ({_signal_name(self.signal)})"
        else:
            what = f"exit code {self.exit_code}"
        line = last_line(self.log)
        if self.signal is not None and is_report(line):
            return what
        return f"{what}: {line}" if line else what


def newest(job: Object | None, pods: Iterable[Object]) -> Object | None:
    """Return the Job's last pod: one that was disrupted is replaced by another.

    Args:
        job: the Job; pods of others don't count. None: it is gone, and its pods are given.
        pods: pods.
    """
    if job is not None:
        uid = job["metadata"]["uid"]
        pods = [pod for pod in pods if uid in owner_uids(pod)]
    return max(
        pods,
        key=lambda pod: (
            # Times are whole seconds.
            not is_disrupted(pod),
            pod["metadata"].get("creationTimestamp") or "",
            pod["metadata"]["name"],
        ),
        default=None,
    )


def live_pods(pods: Iterable[Object]) -> list[Object]:
    """Return the pods of runs of which a container may still be at work."""
    return [pod for pod in pods if not is_finished(pod) and labels_of(pod).get(Label.ROLE) == Role.RUN]


def is_finished(pod: Object) -> bool:
    """Tell whether all containers of a pod have ended for good."""
    return pod["status"].get("phase") in {"Succeeded", "Failed"}


def is_disrupted(pod: Object) -> bool:
    """Tell whether something that is no fault of the pod took it, so that its Job makes another."""
    return pod["status"].get("phase") == "Failed" and _is_target(pod)


def disrupted(pods: Iterable[Object]) -> tuple[str, ...]:
    """Return the UIDs of pods that are taken, or were, by what is no fault of theirs, the oldest first."""
    taken = (pod["metadata"] for pod in pods if _is_target(pod) and pod["status"].get("phase") != "Succeeded")
    return tuple(meta["uid"] for meta in sorted(taken, key=lambda meta: meta.get("creationTimestamp") or ""))


def _is_target(pod: Object) -> bool:
    return (condition(pod, "DisruptionTarget") or {}).get("status") == "True"


def is_deleted(pod: Object) -> bool:
    """Tell whether someone deleted a pod: how its containers ended may then say nothing about them.

    Whether they had ended before can't always be told by the pod: the kubelet's last update moves the time of
    the deletion behind theirs.
    """
    return bool(pod["metadata"].get("deletionTimestamp"))


def condition(obj: Object, kind: str) -> Mapping[str, Any] | None:
    """Return a condition of a pod or Job by its type."""
    found = (obj.get("status") or {}).get("conditions") or ()
    return next((item for item in found if item["type"] == kind), None)


def has_failed(job: Object | None) -> bool:
    """Tell whether a Job has failed for good."""
    return job is not None and (condition(job, "Failed") or {}).get("status") == "True"


def has_completed(job: Object | None) -> bool:
    """Tell whether a Job has succeeded."""
    return job is not None and (condition(job, "Complete") or {}).get("status") == "True"


def has_ended(job: Object) -> bool:
    """Tell whether a Job has succeeded or failed for good."""
    return has_failed(job) or has_completed(job)


def container_of(pod: Object, name: str) -> Mapping[str, Any]:
    """Return the status of a container, empty when there is none yet."""
    return next((item for item in _containers(pod) if item["name"] == name), {})


def ending_of(pod: Object, name: str) -> Ending | None:
    """Return the end of a container; None when it hasn't ended, or never was."""
    found = (container_of(pod, name).get("state") or {}).get("terminated")
    if found is None:
        return None
    code = found.get("exitCode")
    reason = found.get("reason") or ""
    unable = reason in _UNABLE
    # The kubelet reports a signal as 128 and its number. Codes of a program that could not be started are the
    # runtime's own.
    signal = code - 128 if isinstance(code, int) and 128 < code <= 128 + 64 and not unable else None
    return Ending(
        exit_code=None if signal is not None else code,
        signal=signal,
        reason=reason,
        message=tail(found.get("message"), 4096) or "",
        started=None if unable else _known(found.get("startedAt")),
        finished=_known(found.get("finishedAt")),
    )


def message_of(pod: Object, name: str) -> str | None:
    """Return a container's own last words, those of its last life when it died while it was started again."""
    status = container_of(pod, name)
    for word in ("state", "lastState"):
        message = ((status.get(word) or {}).get("terminated") or {}).get("message")
        if message:
            return str(message)
    return None


def what_waits(pod: Object, main: str) -> Waiting | None:
    """Return the obstacle that keeps a pod from running; None when nothing does.

    Args:
        pod: a pod that hasn't finished.
        main: its main container: what keeps others from running counts until this one runs.
    """
    scheduled = condition(pod, "PodScheduled")
    if scheduled is not None and scheduled.get("status") != "True":
        since = moment(scheduled.get("lastTransitionTime"))
        message = clean(scheduled.get("message") or "no node has room for it")
        return Waiting(clean(scheduled.get("reason") or "Unschedulable", 100), message, since)
    if (container_of(pod, main).get("state") or {}).keys() & {"running", "terminated"}:
        return None
    since = _ready_since(pod, scheduled)
    for status in _containers(pod):
        waiting = (status.get("state") or {}).get("waiting")
        if waiting is not None:
            found = _explained(status, waiting, since, main)
            if found is not None:
                return found
    return None


def refused_by_node(pod: Object) -> str:
    """Return the reason that a node didn't run a pod that was assigned to it."""
    status = pod["status"]
    return clean(f"{status.get('reason') or 'its pod failed'}: {status.get('message') or 'no reason given'}")


def _explained(
    status: Mapping[str, Any], waiting: Mapping[str, Any], since: float | None, main: str
) -> Waiting | None:
    word, told = waiting.get("reason") or "", clean(waiting.get("message") or "")
    name, image = status["name"], clean(status.get("image") or "", 300)
    if word == "InvalidImageName":
        message = f"image {image!r}: not a valid name of an image"
        return Waiting(
            word, message, since, AttemptEnd(reason=Reason.IMAGE_PULL_FAILED, message=message), True
        )
    if word in PULLS:
        message = f"image {image!r}: {_short_pull(told) or word}"
        return Waiting(word, message, since, AttemptEnd(reason=Reason.IMAGE_PULL_FAILED, message=message))
    if word in _STARTS or word == "CrashLoopBackOff":
        reason, message = Reason.SYSTEM_FAULT, clean(f"container {name!r}: {told or word}")
        # A program that is not in its image is the algorithm's mistake; what else keeps a container from
        # starting is the machine's.
        if name == main and any(part in told for part in _PROGRAM):
            reason, message = why_unable(told)
        return Waiting(word, message, since, AttemptEnd(reason=reason, message=message))
    return None


def _ready_since(pod: Object, scheduled: Mapping[str, Any] | None) -> float | None:
    """Return since when the container that is next could be started."""
    times = [moment((scheduled or {}).get("lastTransitionTime")), moment(pod["status"].get("startTime"))]
    for status in pod["status"].get("initContainerStatuses") or ():
        state = status.get("state") or {}
        times.append(moment((state.get("running") or {}).get("startedAt")))
        times.append(moment((state.get("terminated") or {}).get("finishedAt")))
    return max((time for time in times if time is not None), default=None)


def _short_pull(message: str) -> str:
    """Return the reason of a failed pull, without the wrapping that each layer of the kubelet adds."""
    text = message.rpartition("desc = ")[2] if "desc = " in message else message
    return clean(text, 300)


def why_unable(message: str) -> tuple[Reason, str]:
    """Return the reason that a runtime couldn't start a program, without what it says of itself."""
    place = _MOUNTING.search(message)
    if place is not None:
        return Reason.SYSTEM_FAULT, f"nothing could be mounted at {clean(place.group(1), 300)}"
    if any(part in message for part in _NO_MEMORY):
        return Reason.OUT_OF_MEMORY, "its memory limit is too low to start a program"
    why = last_line(message) or "the runtime gave no reason"
    for part in ("exec: ", "unable to start container process: ", "spec: "):
        _, found, rest = message.rpartition(part)
        if found and rest:
            why = clean(rest.removesuffix(": unknown"), 300)
            break
    return Reason.ALGORITHM_FAILED, f"its program can't be started: {why}"


def _containers(pod: Object) -> Iterator[Mapping[str, Any]]:
    for field in ("initContainerStatuses", "containerStatuses"):
        yield from pod["status"].get(field) or ()


def _known(time: str | None) -> str | None:
    """Return a time, None for the zero that the kubelet writes where it knows none."""
    found = moment(time)
    return time if found is not None and found > 0 else None


def _signal_name(number: int) -> str:
    try:
        return signals.Signals(number).name
    except ValueError:  # a real-time signal
        return f"SIGRTMIN+{number - signals.SIGRTMIN}"
