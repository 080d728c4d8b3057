# SPDX-License-Identifier: Apache-2.0
"""Kueue beside the operator: Jobs that it holds back or took the pods from, and why they wait.

A Job that is to go by a queue is made suspended, and nobody here ever starts it: Kueue does, and suspends it
again to make room for others. The Job controller deletes the pod of a suspended Job without counting it, so
that Job goes on with another pod later. What it waits for is told by its Workload, which may be read where
the chart grants it; nothing is ever written there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.errors import REFUSALS, NotFound
from slamhive.kube.api.kinds import labels_of
from slamhive.kube.pods import Waiting, condition, has_ended, is_deleted
from slamhive.kube.reports import clean, moment
from slamhive.model.base import QUEUE_NAME

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from slamhive.kube.api.client import Api

    Object = Mapping[str, Any]

GROUP, VERSION, WORKLOADS = "kueue.x-k8s.io", "v1beta2", "workloads"
SERVED_SECONDS = 60.0
"""Time after which it is asked again whether Kueue is there."""
QUEUE_WAITS = "QueueWaits"
"""Reason of the waiting of a Job that is suspended, by a queue or by someone else."""
ABSENT = (
    f"Kueue is not there ({GROUP}/{VERSION} is not served), so nothing starts it: install Kueue 0.17 "
    f"or newer, or delete it and apply it without the label {QUEUE_NAME}"
)

NO_WORKLOAD = "no Workload was made for it: does Kueue's controller run, and does it serve this namespace?"
_OF_QUEUES_ALONE = (ABSENT, NO_WORKLOAD)


def is_suspended(job: Object | None) -> bool:
    """Tell whether a Job is held back: none of its pods may run."""
    return job is not None and bool((job.get("spec") or {}).get("suspend")) and not has_ended(job)


def suspended_or_resumed(job: Object | None) -> float | None:
    """Return the time at which a Job was last suspended or let go on, s since 1970; None: it never was."""
    return moment((condition(job or {}, "Suspended") or {}).get("lastTransitionTime"))


def was_taken(job: Object | None, pod: Object) -> bool:
    """Tell whether a pod went, or goes, because its Job was suspended, so that its Job makes another.

    How its containers ended says nothing then: an algorithm may well answer SIGTERM with exit code 0.
    """
    if job is None or has_ended(job) or not is_deleted(pod):
        return False
    resumed, made = suspended_or_resumed(job), moment(pod["metadata"].get("creationTimestamp"))
    return is_suspended(job) or (resumed is not None and made is not None and made < resumed)


def taken(job: Object | None, pods: Iterable[Object], at_work_since: float | None) -> tuple[str, ...]:
    """Return the UIDs of pods that went because their Job was suspended.

    Args:
        job: the Job.
        pods: its pods.
        at_work_since: since when its program runs as far as its status says, s since 1970. A Job that was
            suspended later had a pod even if nobody saw that go, and then its own UID and the time tell it.
    """
    gone = [str(pod["metadata"]["uid"]) for pod in pods if was_taken(job, pod)]
    changed = suspended_or_resumed(job)
    if gone or job is None or has_ended(job) or at_work_since is None or changed is None:
        return (*gone,)
    return (f"{job['metadata']['uid']}@{changed:.0f}",) if at_work_since < changed else ()


def held_back(job: Object) -> Waiting:
    """Return the waiting of a suspended Job, as far as the Job itself tells."""
    queue = labels_of(job).get(QUEUE_NAME)
    told = f"its Job waits in queue {queue!r}" if queue else "its Job is suspended, by no queue that it names"
    since = suspended_or_resumed(job) or moment(job["metadata"].get("creationTimestamp"))
    return Waiting(QUEUE_WAITS, clean(told), since)


class Workloads:
    """Finds out what suspended Jobs wait for, each by its own Workload: a listing of all costs too much.

    Args:
        api: the Kubernetes API.
        clock: returns the time in s since 1970.
    """

    def __init__(self, api: Api, clock: Callable[[], float]) -> None:
        self._api = api
        self._clock = clock
        self._is_served = False
        self._due = 0.0

    async def explained(self, job: Object, waiting: Waiting) -> Waiting:
        """Return the waiting of a suspended Job with what its Workload says, where that may be read.

        Raises:
            ApiError: the server can't be asked just now.
        """
        told = await self._told(job["metadata"]["namespace"], job["metadata"]["uid"])
        if told is None or (told in _OF_QUEUES_ALONE and QUEUE_NAME not in labels_of(job)):
            return waiting
        return replace(waiting, message=clean(f"{waiting.message}: {told}"))

    async def _told(self, namespace: str, job_uid: str) -> str | None:
        if self._clock() >= self._due:
            self._is_served = WORKLOADS in await self._api.served(GROUP, VERSION)
            self._due = self._clock() + SERVED_SECONDS
        if not self._is_served:
            return ABSENT
        try:
            found = await self._api.workloads(namespace, job_uid)
        except NotFound:
            return ABSENT
        except REFUSALS:
            return None  # without the right to read them it is known that the Job waits, and where
        return why_pending(found[0]) if found else NO_WORKLOAD


def why_pending(workload: Object) -> str:
    """Return the reason that a Workload is not let in, in Kueue's own words."""
    if (workload.get("spec") or {}).get("active") is False:
        evicted = (condition(workload, "Evicted") or {}).get("message")
        return f"its Workload is not active: {evicted}" if evicted else "its Workload is not active"
    # The last one that doesn't hold is the one that is waited for.
    for kind in ("Admitted", "QuotaReserved"):
        found = condition(workload, kind) or {}
        if found.get("status") == "False" and found.get("reason") != "NoReservation":
            return str(found.get("message") or found.get("reason"))
    if (condition(workload, "QuotaReserved") or {}).get("status") == "True":
        return "it has its share of the quota, and waits to be let in"
    return "Kueue has not looked at it yet"
