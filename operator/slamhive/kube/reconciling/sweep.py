# SPDX-License-Identifier: Apache-2.0
"""A Sweep: keeps a window of MappingRuns in flight, counts, and says where it stands.

A run's name follows from the Sweep's uid and its index, so creating it twice finds the first. States and
counters reach the status in one checked write, at most every ``sweepWriteSeconds``; what a crash loses of
them is made again from the live runs and the archive.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.engine import (
    PointState,
    StartPoints,
    StopPoints,
    SweepDecision,
    SweepObserved,
    Verdict,
    decide_sweep,
)
from slamhive.kube.errors import REFUSALS, AlreadyExists, Conflict
from slamhive.kube.kinds import Key, Kind, Label, key_of
from slamhive.kube.reconciling.archiving import Retirement, at_its_end
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.reconciling.points import decode, encode
from slamhive.kube.reconciling.sweep_memory import SweepMemory, remember
from slamhive.kube.reconciling.sweep_runs import (
    Tally,
    free_slot,
    is_settled,
    point_of,
    run_body,
    slots_used,
    state_of,
)
from slamhive.kube.status import changes, condition, holds, iso, merged, metres, moment
from slamhive.model.base import seconds
from slamhive.model.errors import InputError
from slamhive.model.sweep import Sweep

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator
    from slamhive.kube.reconciling.catalogue import Catalogue

Object = dict[str, Any]

_LOOK_SECONDS = 0.1
_BLOCKED_SECONDS = 5.0
_SHOWN_PROBLEMS = 20
_AT_ONCE = 16


@dataclass(frozen=True)
class _Picture:
    """A Sweep as it is seen now.

    Attributes:
        key: its address.
        body: the object.
        sweep: the same as a record.
        memory: what is remembered of it.
        runs: its live runs by point.
        tally: figures over all its finished runs.
    """

    key: Key
    body: Object
    sweep: Sweep
    memory: SweepMemory
    runs: dict[int, Object]
    tally: Tally


class SweepReconciler:
    """Brings Sweeps to their end.

    Args:
        catalogue: Algorithms and Datasets.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._retirement = Retirement(catalogue)
        self._memory: dict[str, SweepMemory] = {}
        self._parsed: dict[str, tuple[int, Sweep]] = {}
        self._waiting: set[Key] = set()

    def waiting(self, namespace: str) -> list[Key]:
        """Return the Sweeps that wait for the catalog."""
        return [key for key in self._waiting if key.namespace == namespace]

    async def __call__(self, op: Operator, key: Key) -> float | None:
        """Look at a Sweep, start or stop what is due, and write what changed."""
        self._waiting.discard(key)
        body = op.store.get(key)
        if body is None or body["metadata"].get("deletionTimestamp"):
            self._tidy(op)
            return None
        try:
            sweep = self._sweep(body)
            memory = await self._remembered(op, key, body, sweep)
        except InputError as error:
            self._waiting.add(key)
            await self._refuse(op, key, body, str(error))
            return None
        now = op.clock()
        if now - memory.looked_at < _LOOK_SECONDS:
            return _LOOK_SECONDS
        memory.looked_at = now
        seen = await self._see(op, key, body, sweep, memory)
        if _is_outdated(seen):
            del self._memory[body["metadata"]["uid"]]
            return _LOOK_SECONDS
        return await self._advance(op, seen, now)

    def _tidy(self, op: Operator) -> None:
        alive = {
            body["metadata"]["uid"]
            for namespace in op.settings.namespaces
            for body in op.store.of(Kind.SWEEP, namespace)
        }
        for uid in [uid for uid in (*self._memory, *self._parsed) if uid not in alive]:
            self._memory.pop(uid, None)
            self._parsed.pop(uid, None)

    def _sweep(self, body: Object) -> Sweep:
        uid, generation = body["metadata"]["uid"], body["metadata"].get("generation", 1)
        known = self._parsed.get(uid)
        if known is None or known[0] != generation:
            known = (generation, parse(Sweep, body))
            self._parsed[uid] = known
        return known[1]

    async def _remembered(self, op: Operator, key: Key, body: Object, sweep: Sweep) -> SweepMemory:
        uid = body["metadata"]["uid"]
        if uid not in self._memory:
            live = {run["metadata"]["uid"]: state_of(run) for run in _own(op, key, uid)}
            accepted = bool(holds(body["status"], "Accepted"))
            catalog = self._catalogue.all(op.store, key.namespace)
            memory = await remember(sweep, body["status"], catalog, live, op.archive, accepted=accepted)
            made = (moment(run["metadata"].get("creationTimestamp")) for run in _own(op, key, uid))
            memory.started_at = memory.started_at or min(filter(None, made), default=None)
            most = op.settings.max_runs_without_archive
            if op.archive is None and len(memory.plan) > most:
                raise InputError(
                    f"spec.matrix: {len(memory.plan)} runs need an archive, without one at most {most} are "
                    "allowed: their objects would fill the cluster; set archive.existingSecret in the chart"
                )
            self._memory[uid] = memory
        return self._memory[uid]

    async def _see(self, op: Operator, key: Key, body: Object, sweep: Sweep, memory: SweepMemory) -> _Picture:
        runs = {}
        for run in _own(op, key, body["metadata"]["uid"]):
            index = point_of(run)
            if index is not None and index < len(memory.states):
                runs[index] = run
        gone = [index for index in memory.finished if index not in runs]
        for index in gone:
            memory.archived.add(await at_its_end(op, memory.finished.pop(index)))
        tally = Tally(
            memory.archived.reused,
            memory.archived.evaluated,
            memory.archived.cpu_seconds,
            list(memory.archived.best),
        )
        await self._look_for_missing(op, key, body["metadata"]["uid"], memory, runs)
        for index, run in runs.items():
            memory.states[index] = state_of(run)
            if memory.states[index] != PointState.ACTIVE:
                memory.finished[index] = run
                tally.add(run)
        return _Picture(key, body, sweep, memory, runs, tally)

    @staticmethod
    async def _look_for_missing(
        op: Operator, key: Key, uid: str, memory: SweepMemory, runs: dict[int, Object]
    ) -> None:
        """Find out about points in flight whose runs are not seen: deleted by someone, which cancels them."""
        index = memory.states.find(PointState.ACTIVE)
        while index >= 0:
            if index not in runs:
                # Another operator may have made it a moment ago: what the watch hasn't told yet is asked for.
                run = await op.refresh(Key(Kind.MAPPING_RUN, key.namespace, memory.plan.point(index).name))
                if run is not None and _is_of(run, uid):
                    runs[index] = run
                else:
                    memory.states[index] = PointState.FAILED
            index = memory.states.find(PointState.ACTIVE, index + 1)

    async def _advance(self, op: Operator, seen: _Picture, now: float) -> float | None:
        memory, sweep = seen.memory, seen.sweep
        observed = SweepObserved(
            states=memory.states,
            order=memory.order,
            parallelism=sweep.spec.parallelism or op.settings.default_parallelism,
            started_at=memory.started_at,
            cpu_seconds=seen.tally.cpu_seconds,
            cursor=memory.cursor,
            twins=memory.plan.twins,
        )
        decision = decide_sweep(sweep.spec, observed, now)
        memory.cursor = decision.cursor
        blocked: str | None = None
        for action in decision.actions:
            match action:
                case StartPoints(indices):
                    blocked = await self._start(op, seen, indices, now)
                case StopPoints(indices):
                    await self._cancel(op, [seen.runs[index] for index in indices if index in seen.runs])
        delays = [_BLOCKED_SECONDS] if blocked else []
        if sweep.spec.budget.wall_time is not None and decision.verdict is Verdict.RUNNING:
            delays.append(_budget_left(sweep, memory, now))
        delays += await self._write(op, seen, decision, blocked, now)
        if op.archive is not None:
            delays += await self._retirement.retire(op, seen.key, sweep, memory, seen.runs)
        return min(delays, default=None)

    async def _start(self, op: Operator, seen: _Picture, indices: tuple[int, ...], now: float) -> str | None:
        """Create the runs of points; returns why some could not be."""
        if op.archive is not None:
            await _insist_on_newest(op, seen)
        if seen.memory.started_at is None:
            seen.memory.started_at = now
        used = slots_used(seen.runs.values())
        limit = asyncio.Semaphore(_AT_ONCE)

        async def create(index: int, slot: int) -> str | None:
            async with limit:
                return await self._create(op, seen, index, slot)

        told = await asyncio.gather(*(create(index, free_slot(used)) for index in indices))
        return next((problem for problem in told if problem), None)

    @staticmethod
    async def _create(op: Operator, seen: _Picture, index: int, slot: int) -> str | None:
        plan = seen.memory.plan
        twin = plan.twins.get(index)
        body = run_body(seen.body, plan.point(index), slot, None if twin is None else plan.point(twin).name)
        try:
            run = await op.create(Kind.MAPPING_RUN, body)
        except AlreadyExists:
            key = key_of(Kind.MAPPING_RUN, body)
            found = await op.refresh(key)
            if found is None or found["metadata"].get("deletionTimestamp"):
                return f"{key.name} is still being deleted"
            owners = {item["uid"] for item in found["metadata"].get("ownerReferences") or ()}
            if seen.body["metadata"]["uid"] not in owners:
                return f"the name {key.name} is taken by a MappingRun that is not of this Sweep"
            run = found
        except REFUSALS as error:
            return str(error)
        seen.memory.states[index] = PointState.ACTIVE
        seen.runs[index] = run
        return None

    @staticmethod
    async def _cancel(op: Operator, runs: list[Object]) -> None:
        for run in runs:
            if not run["spec"].get("cancel"):
                await op.patch(key_of(Kind.MAPPING_RUN, run), {"spec": {"cancel": True}})

    async def _write(
        self, op: Operator, seen: _Picture, decision: SweepDecision, blocked: str | None, now: float
    ) -> list[float]:
        """Write the status if it changed and the last write is long enough ago; returns when to come back."""
        body, memory = seen.body, seen.memory
        settled = all(is_settled(run) for run in seen.runs.values())
        status = _figures(memory, seen.tally) | _standing(op, seen, decision, settled, blocked)
        if memory.started_at is not None:
            status["startTime"] = iso(memory.started_at)
        over = decision.verdict.is_final and settled
        if over and not body["status"].get("completionTime"):
            status["completionTime"] = iso(now)
        generation = body["metadata"].get("generation", 1)
        status["observedGeneration"] = generation
        status["conditions"] = merged(
            body["status"].get("conditions") or (), status.pop("fresh"), generation, now
        )
        patch = changes(body["status"], status)
        if not patch:
            return []
        wait = memory.written_at + op.settings.sweep_write_seconds - now
        if wait > 0 and not over:
            return [wait]
        memory.points = status["points"]
        answer = await op.patch(
            seen.key,
            {"metadata": {"resourceVersion": body["metadata"]["resourceVersion"]}, "status": patch},
            subresource="status",
        )
        memory.written_at = now
        if blocked and not holds(body["status"], "Blocked"):
            await op.api.event(Kind.SWEEP, answer, "Warning", "CannotCreate", blocked)
        await self._tell(op, body, answer)
        return []

    @staticmethod
    async def _tell(op: Operator, before: Object, after: Object) -> None:
        was, phase = before["status"].get("phase"), after["status"].get("phase")
        if phase == was or phase in {None, "Pending", "Evaluating"}:
            return
        bad = phase in {Verdict.TOO_MANY_FAILURES, Verdict.BUDGET_EXHAUSTED}
        text = f"{after['status'].get('progress')} runs done"
        await op.api.event(Kind.SWEEP, after, "Warning" if bad else "Normal", str(phase), text)

    @staticmethod
    async def _refuse(op: Operator, key: Key, body: Object, message: str) -> None:
        lines = message.splitlines()
        text = "\n".join(lines[:_SHOWN_PROBLEMS])
        generation = body["metadata"].get("generation", 1)
        before = body["status"].get("conditions") or ()
        fresh = [condition("Accepted", False, "InvalidSpec", text)]
        status = {"phase": "Pending", "conditions": merged(before, fresh, generation, op.clock())}
        patch = changes(body["status"], status)
        if patch:
            await op.patch(key, {"status": patch}, subresource="status")
            await op.api.event(Kind.SWEEP, body, "Warning", "NotAccepted", lines[0])


def _own(op: Operator, key: Key, uid: str) -> list[Object]:
    runs = op.store.select(Kind.MAPPING_RUN, key.namespace, Label.SWEEP, key.name)
    return [run for run in runs if _is_of(run, uid)]


def _is_of(run: Object, uid: str) -> bool:
    meta = run["metadata"]
    owners = meta.get("ownerReferences") or ()
    return any(owner["uid"] == uid for owner in owners) and not meta.get("deletionTimestamp")


def _is_outdated(seen: _Picture) -> bool:
    """Tell whether another operator wrote of ends that were never seen here, of runs that are archived."""
    memory, text = seen.memory, seen.body["status"].get("points")
    if text is None or text == memory.points:
        return False
    memory.points = text
    pairs = enumerate(zip(decode(text, len(memory.states)), memory.states, strict=True))
    return any(
        theirs >= PointState.SUCCEEDED and theirs != ours and index not in seen.runs
        for index, (theirs, ours) in pairs
    )


async def _insist_on_newest(op: Operator, seen: _Picture) -> None:
    """Make sure that no other operator has done points of which nothing is known here yet.

    An archived run's name is free again: only the Sweep's status says that its point is done.

    Raises:
        Conflict: the Sweep is newer than what was looked at.
    """
    fresh = await op.refresh(seen.key)
    if fresh is None or fresh["metadata"]["resourceVersion"] != seen.body["metadata"]["resourceVersion"]:
        raise Conflict(f"{seen.key} has changed since it was looked at", status=409)


def _budget_left(sweep: Sweep, memory: SweepMemory, now: float) -> float:
    """Return after how many seconds to look at the budget of time again."""
    end = (memory.started_at or now) + seconds(sweep.spec.budget.wall_time or "0s")
    return min(max(end - now, _LOOK_SECONDS), 60.0)


def _figures(memory: SweepMemory, tally: Tally) -> Object:
    counts = {state: memory.states.count(state) for state in PointState}
    total = len(memory.states)
    done = counts[PointState.SUCCEEDED] + counts[PointState.FAILED]
    figures: Object = {
        "total": total,
        "pending": counts[PointState.PENDING],
        "running": counts[PointState.ACTIVE],
        "succeeded": counts[PointState.SUCCEEDED],
        "failed": counts[PointState.FAILED],
        "reused": tally.reused,
        "evaluated": tally.evaluated,
        "cpuSeconds": round(tally.cpu_seconds, 3),
        "progress": f"{done}/{total}",
        "best": tally.best,
        "points": encode(memory.states),
    }
    if tally.best:
        figures["display"] = {"ate": metres(tally.best[0]["ate"])}
    return figures | ({"selected": memory.selected} if memory.selected else {})


def _standing(
    op: Operator, seen: _Picture, decision: SweepDecision, settled: bool, blocked: str | None
) -> Object:
    verdict = decision.verdict
    final = verdict.is_final
    phase = str(verdict) if settled or not final else "Evaluating"
    fresh = [
        condition("Accepted", True, "Accepted", seen.memory.remarks),
        condition("Complete", final and settled, str(verdict) if final else "Running", decision.message),
        condition(
            "Suspended", verdict is Verdict.SUSPENDED, "Suspended" if seen.sweep.spec.suspend else "Active"
        ),
    ]
    if blocked or holds(seen.body["status"], "Blocked"):
        fresh.append(
            condition("Blocked", bool(blocked), "CannotCreate" if blocked else "Free", blocked or "")
        )
    available = op.usage.available
    if available is not None and (not available or holds(seen.body["status"], "LiveUsage") is False):
        reason = "MetricsAvailable" if available else "MetricsUnavailable"
        fresh.append(condition("LiveUsage", available, reason, op.usage.sentence))
    return {"phase": phase, "fresh": fresh}
