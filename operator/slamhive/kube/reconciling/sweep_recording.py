# SPDX-License-Identifier: Apache-2.0
"""Recording of what becomes of a Sweep: into the archive, then into its status in one checked write."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.engine import PointState, SweepDecision, Verdict
from slamhive.kube.api.kinds import Key, Kind, Object
from slamhive.kube.kueue import QUEUE_WAITS
from slamhive.kube.reconciling.archiving import ArchiveAway, Keeper, in_thread
from slamhive.kube.reconciling.sweep_losses import remark
from slamhive.kube.reconciling.sweep_runs import SweepTally, encode_points, point_of
from slamhive.kube.status import condition, holds, iso, metres, status_patch
from slamhive.model.search import SearchRecord
from slamhive.model.status import SweepDisplay, SweepStatus

if TYPE_CHECKING:
    from slamhive.archive import Archive
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.sweep_picture import SweepPicture
    from slamhive.kube.reconciling.sweep_state import SweepMemory


_SHOWN_PROBLEMS = 20


class SweepRecorder:
    """Writes the statuses of Sweeps; what has ended is in the archive before.

    Args:
        archive: where finished runs are kept, if anywhere.
        keeper: writes them there, if there is one.
    """

    def __init__(self, archive: Archive | None, keeper: Keeper | None) -> None:
        self._archive = archive
        self._keeper = keeper

    async def record(
        self, cluster: Cluster, seen: SweepPicture, decision: SweepDecision, blocked: Object, now: float
    ) -> list[float]:
        """Write the status if it changed and the last write is long enough ago; returns when to come back."""
        body, memory = seen.body, seen.memory
        # A Sweep is complete when its runs are measured, not when they have ended.
        settled = len(seen.settled) == len(seen.runs)
        over = decision.verdict.is_final and settled
        # However many runs end, the status is written once in this time; the Sweep's own end does not wait.
        wait = memory.written_at + cluster.settings.sweep_write_seconds - now
        if wait > 0 and not over and memory.search is not None:
            return [wait]  # which of thousands of settings are the best is seen once in this time, too
        phase, conditions = _standing(cluster, seen, decision, settled, blocked)
        status = _figures(memory, seen.tally) | SweepStatus(
            phase=phase, observed_generation=body["metadata"].get("generation", 1)
        )
        if memory.started_at is not None:
            status |= SweepStatus(start_time=iso(memory.started_at))
        if over and not body["status"].get("completionTime"):
            status |= SweepStatus(completion_time=iso(now))
        is_news = bool(status_patch(body, status.as_patch(), conditions, now))
        fresh = self._keeper is not None and not all(memory.kept.has(run) for run in seen.settled)
        if not is_news and not fresh:
            return []
        if wait > 0 and not (over and is_news):
            return [wait]
        away = await self._keep(cluster, seen)
        # Noted before the answer: where that is lost, the write may have been done and must not look like
        # another operator's.
        memory.points = status.points
        answer = await cluster.write_status(Kind.SWEEP, body, status, conditions) or body
        memory.written_at = now
        news = blocked["status"] == "True" and not holds(body["status"], "Blocked")
        if news and blocked["reason"] != QUEUE_WAITS:  # to wait is what a queue is for
            await cluster.api.event(Kind.SWEEP, answer, "Warning", blocked["reason"], blocked["message"])
        await self._announce_phase(cluster, body, answer)
        if away is not None:
            raise away
        return []

    async def _keep(self, cluster: Cluster, seen: SweepPicture) -> ArchiveAway | None:
        """Archive what has ended before the status counts it: who deletes the Sweep then loses none of it.

        An archive that is away is told after the status is written, as the Sweep goes on.
        """
        try:
            if self._keeper is not None:
                await self._keeper.keep(cluster, seen.settled, seen.sweep.spec.evaluation, seen.memory.kept)
                points = seen.memory.replaced.keys() & {point_of(run) for run in seen.settled}
                await self._keeper.forget(uid for index in points for uid in seen.memory.replaced[index])
                for index in points:
                    del seen.memory.replaced[index]
                await self._copy_search(seen)
        except ArchiveAway as error:
            return error
        return None

    async def _copy_search(self, seen: SweepPicture) -> None:
        """Have the archive know what a search has tried, for those who look there."""
        search, archive = seen.memory.search, self._archive
        if search is None or archive is None:
            return
        news = len(search.plan.trials), seen.tally.reused
        if news != search.copied:
            record = SearchRecord(trials=[*search.plan.trials], spared=news[1])
            await in_thread(archive.put_search, seen.body["metadata"]["uid"], record)
            search.copied = news

    @staticmethod
    async def _announce_phase(cluster: Cluster, before: Object, after: Object) -> None:
        was, phase = before["status"].get("phase"), after["status"].get("phase")
        if phase == was or phase in {None, "Pending", "Evaluating"}:
            return
        bad = phase in {Verdict.TOO_MANY_FAILURES, Verdict.BUDGET_EXHAUSTED}
        done = after["status"].get("progress")
        text = f"{done} done" if "search" in after["status"] else f"{done} runs done"
        await cluster.api.event(Kind.SWEEP, after, "Warning" if bad else "Normal", str(phase), text)

    @staticmethod
    async def refuse(cluster: Cluster, body: Object, message: str) -> None:
        """Say why a Sweep isn't accepted."""
        lines = message.splitlines()
        text = "\n".join(lines[:_SHOWN_PROBLEMS])
        told = condition("Accepted", False, "InvalidSpec", text)
        if await cluster.write_status(Kind.SWEEP, body, SweepStatus(phase="Pending"), [told]) is not None:
            await cluster.api.event(Kind.SWEEP, body, "Warning", "NotAccepted", lines[0])


async def tell_archive(cluster: Cluster, key: Key, told: Object) -> None:
    """Write whether the archive answers into a Sweep's conditions; an Event says that it does not."""
    body = cluster.store.get(key)
    if body is None:
        return
    answer = await cluster.write_status(Kind.SWEEP, body, conditions=[told])
    if answer is not None and told["status"] == "True":
        await cluster.api.event(Kind.SWEEP, answer, "Warning", told["type"], told["message"])


def _figures(memory: SweepMemory, tally: SweepTally) -> SweepStatus:
    counts = {state: memory.states.count(state) for state in PointState}
    search = memory.search
    standing = None if search is None else search.standing(tally)
    if search is not None:
        # Of runs that a search may have asked for, those that it doesn't ask for don't count.
        counts[PointState.PENDING] = len(search.wanted(memory.states))
    total = sum(counts.values())
    done = counts[PointState.SUCCEEDED] + counts[PointState.FAILED]
    status = SweepStatus(
        total=total,
        pending=counts[PointState.PENDING],
        running=counts[PointState.ACTIVE],
        succeeded=counts[PointState.SUCCEEDED],
        failed=counts[PointState.FAILED],
        reused=tally.reused,
        evaluated=tally.evaluated,
        cpu_seconds=round(tally.cpu_seconds, 3),
        progress=f"{done}/{total}" if standing is None else f"{standing.decided}/{standing.most} trials",
        best=tally.best,
        points=encode_points(memory.states),
        deleted=memory.deletions or None,
        share=memory.share,
    )
    if tally.best:
        status |= SweepStatus(display=SweepDisplay(ate=metres(tally.best[0].ate)))
    if standing is not None:
        status |= SweepStatus(search=standing)
    return status | SweepStatus(selected=memory.selected) if memory.selected else status


def _standing(
    cluster: Cluster, seen: SweepPicture, decision: SweepDecision, settled: bool, blocked: Object
) -> tuple[str, list[Object]]:
    """Return the standing of a Sweep: its phase, for printing, and its conditions."""
    verdict = decision.verdict
    final = verdict.is_final
    phase = str(verdict) if settled or not final else "Evaluating"
    told = "; ".join(filter(None, (decision.message, remark(seen.memory))))
    fresh = [
        condition("Accepted", True, "Accepted", seen.memory.remarks),
        condition("Complete", final and settled, str(verdict) if final else "Running", told),
        condition(
            "Suspended", verdict is Verdict.SUSPENDED, "Suspended" if seen.sweep.spec.suspend else "Active"
        ),
    ]
    if blocked["status"] == "True" or holds(seen.body["status"], "Blocked"):
        fresh.append(blocked)
    available = cluster.usage.available
    if available is not None and (not available or holds(seen.body["status"], "LiveUsage") is False):
        reason = "MetricsAvailable" if available else "MetricsUnavailable"
        fresh.append(condition("LiveUsage", available, reason, cluster.usage.sentence))
    return phase, fresh
