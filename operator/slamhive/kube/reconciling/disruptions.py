# SPDX-License-Identifier: Apache-2.0
"""Disruptions of a run: evictions, preemptions, drains and lost nodes, counted in its status. Pure.

A Job replaces a pod that was taken so, at first after 10 s, then later each time, up to 10 min; one that a
queue suspended, when the queue lets it in again. No retry is used up by it; a run that is taken again and
again ends with a reason of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from slamhive.engine import AttemptEnd, AttemptState
from slamhive.kube.kueue import QUEUE_WAITS
from slamhive.kube.observing import DISRUPTED, NO_POD
from slamhive.kube.reports import clean
from slamhive.model.results import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.kube.observing import Attempted
    from slamhive.kube.reconciling.waiting import Patience

MOST_DISRUPTIONS = 20
"""Disruptions of one run from which on it is given up."""


@dataclass(frozen=True)
class Disruptions:
    """Disruptions of a run so far: their number, the pod that the last one took, and whether that is news."""

    count: int = 0
    pod: str | None = None
    is_news: bool = False

    @classmethod
    def of(cls, status: Mapping[str, Any], attempted: Attempted) -> Disruptions:
        """Return the disruptions that a status has counted, and those seen beyond."""
        count, last = status.get("disruptions") or 0, status.get("disruptedPod")
        # The last one of those that stay, and the last one of those that don't.
        known = (last or "").split()
        taken = [*attempted.disrupted]
        before = max((taken.index(uid) + 1 for uid in known if uid in taken), default=0)
        fresh = taken[before:] + [uid for uid in attempted.put_off if uid not in {*known, *taken}]
        if not fresh or attempted.state is not AttemptState.RUNNING:
            return cls(count, last)
        return cls(count + len(fresh), " ".join(dict.fromkeys(taken[-1:] + fresh[-1:])), is_news=True)

    @property
    def sentence(self) -> str:
        """Return a sentence on how many there were."""
        return f"taken by a disruption {'once' if self.count == 1 else f'{self.count} times'}"

    def told(self, attempted: Attempted, waits: Patience) -> Patience:
        """Return the patience with a run's pod, with what is to be said of one that a disruption took."""
        waiting = waits.waiting
        is_gone = waiting is not None and waiting.reason in {NO_POD, DISRUPTED}
        if self.count >= MOST_DISRUPTIONS and attempted.state is AttemptState.RUNNING:
            end = AttemptEnd(reason=Reason.DISRUPTED, message=f"{self.sentence}: no more are borne")
            return waits._replace(end=end)
        held = attempted.waiting
        if self.count and held is not None and held.reason == QUEUE_WAITS and (self.is_news or waiting):
            told = waiting or held
            return waits._replace(waiting=replace(told, message=clean(f"{told.message}; {self.sentence}")))
        if not self.count or waiting is None or not is_gone:
            return waits
        cause = f"{waiting.message}; " if waiting.reason == DISRUPTED else ""
        message = f"{cause}{self.sentence}; the Job controller makes the next pod after up to 10 min"
        return waits._replace(waiting=replace(waiting, reason=DISRUPTED, message=clean(message)))


NO_DISRUPTIONS = Disruptions()
