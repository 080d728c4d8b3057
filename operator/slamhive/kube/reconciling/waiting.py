# SPDX-License-Identifier: Apache-2.0
"""Patience with pods that do not begin: of runs, preparations, evaluators, and of Jobs that restore folders.

What keeps a pod from running is borne alike by all of them:

- that the API server refuses it, for ``refusalGraceSeconds``;
- an image that can't be had, or a container that can't be started, for ``imagePullGraceSeconds``; an image
  whose name is none, not at all;
- a full cluster, a used-up quota, a queue, a PriorityClass that is not there, or a pod that nobody says
  anything of, without end.

No run is given up for an evaluator that does not begin, however long: that is said until it does.

Only when it is said differs. A run says it at once, in its own condition and without an Event: who looks at
it wants to know. Of the others it is told elsewhere, as an error of the Sweep or Evaluation that they work
for and of all runs of a Dataset; so a full cluster, which passes as a matter of course, is given a minute.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.engine import AttemptEnd
from slamhive.kube.api.errors import REFUSALS, ApiError, lacks_class, means_quota
from slamhive.kube.kueue import QUEUE_WAITS
from slamhive.kube.observing import NO_POD
from slamhive.kube.pods import Waiting
from slamhive.kube.priorities import CLASS_NOT_FOUND
from slamhive.kube.reports import clean
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster

POD_SECONDS = 5.0
"""Time in which any new Job has no pod: to ask for Events then would cost a call for each Job."""
ROOM_SECONDS = 60.0
QUEUE_SECONDS = 60.0
"""Time after which the reason why a queue lets nothing in is asked for again."""
AGAIN_SECONDS = 15.0


class Patience(NamedTuple):
    """Patience with a Job's pod: what it waits for, and how long it still may.

    Attributes:
        waiting: what is to be said of it; None where nothing keeps it from running, or a moment may help.
        seconds: after how many seconds to look again; None: the events of its pod lead back.
        end: what it ends with, as it has waited too long; None while it may wait.
    """

    waiting: Waiting | None = None
    seconds: float | None = None
    end: AttemptEnd | None = None

    @property
    def why(self) -> str | None:
        """Return the sentence that is to be said of it."""
        return self.waiting.message if self.waiting else None


async def patience(
    cluster: Cluster, job: dict[str, Any] | None, waiting: Waiting | None, room_seconds: float = ROOM_SECONDS
) -> Patience:
    """Return the time that a Job's pod may still wait, and the reason.

    Args:
        cluster: the cluster.
        job: the Job.
        waiting: as it was seen.
        room_seconds: for how long nothing is said of a full cluster.

    Raises:
        ApiError: the server can't be asked just now.
    """
    if waiting is None:
        return Patience()
    waited = cluster.clock() - (waiting.since or 0.0)
    again, grace = None, cluster.settings.image_pull_grace_seconds
    if job is not None and waiting.reason in {NO_POD, QUEUE_WAITS}:
        if waited < POD_SECONDS:  # most queues, too, let in at once what they have room for
            return Patience(seconds=POD_SECONDS - waited)
        if waiting.reason == QUEUE_WAITS:
            return Patience(await cluster.workloads.explained(job, waiting), QUEUE_SECONDS)
        waiting = await _explained(cluster, job, waiting)
        again, grace = AGAIN_SECONDS, cluster.settings.refusal_grace_seconds
    if waiting.end is None:
        # A quota may be used up for hours, and a claim unbound for ever: that is said at once.
        lasting = waiting.since is None or "persistentvolumeclaim" in waiting.message.lower()
        quiet = 0.0 if lasting else room_seconds - waited
        return Patience(seconds=again or quiet) if quiet > 0 else Patience(waiting, again)
    left = 0.0 if waiting.hopeless else grace - waited
    if left <= 0:
        return Patience(waiting, end=waiting.end)
    return Patience(waiting, soonest(left, again))


async def _explained(cluster: Cluster, job: dict[str, Any], waiting: Waiting) -> Waiting:
    """Return the waiting of a Job without a pod with its reason, which only Events say."""
    metadata = job["metadata"]
    try:
        message = await cluster.refused_pods.message(metadata["namespace"], metadata["uid"])
    except ApiError as error:
        if not isinstance(error, REFUSALS):
            raise
        message = None  # without the right to read Events the reason stays unknown
    message = clean((message or "").removeprefix("Error creating: "))
    if not message:
        return waiting
    told = clean(f"its pod is refused: {message}")
    # A used-up quota is waited for without end, as others' pods make room; a policy's refusal is not.
    if means_quota(message):
        return Waiting("QuotaExceeded", told)
    # A class can be made as long as it is missed.
    if lacks_class(message):
        return Waiting(CLASS_NOT_FOUND, told)
    return replace(
        waiting, reason="PodRefused", message=told, end=AttemptEnd(reason=Reason.SYSTEM_FAULT, message=told)
    )


def refused_seconds(cluster: Cluster, begun: float) -> float | None:
    """Return the seconds after which to ask again for a Job that is refused; None when its time is over.

    Args:
        cluster: the cluster.
        begun: since when it is refused, s since 1970.
    """
    left = begun + cluster.settings.refusal_grace_seconds - cluster.clock()
    return min(left, AGAIN_SECONDS) if left > 0 else None


def soonest(*delays: float | None) -> float | None:
    """Return the shortest of some delays; None where none is given."""
    return min((seconds for seconds in delays if seconds is not None), default=None)
