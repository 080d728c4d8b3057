# SPDX-License-Identifier: Apache-2.0
"""Reconciler of a Sweep: keeps a window of MappingRuns in flight, counts them, and writes its status.

A run's name follows from the Sweep's uid and its index, so creating it twice finds the first. States and
counters reach the status in one checked write, at most every ``sweepWriteSeconds``; what a crash loses of
them is made again from the live runs and the archive.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slamhive.archive.known import known_trials
from slamhive.engine import PointState, StartPoints, StopPoints, Verdict
from slamhive.kube.api.errors import REFUSALS, AlreadyExists, Conflict
from slamhive.kube.api.kinds import Key, Kind, Object, key_of, owner_uids
from slamhive.kube.kueue import QUEUE_WAITS
from slamhive.kube.reconciling.archiving import ArchiveAway, Keeper, in_thread
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.reconciling.evaluation_groups import SWEEP_PREFIX
from slamhive.kube.reconciling.reuse import ReusableRuns
from slamhive.kube.reconciling.sweep_accounts import SweepLook
from slamhive.kube.reconciling.sweep_classes import make_anew
from slamhive.kube.reconciling.sweep_losses import (
    announcement,
    archived_by_others,
    are_missing,
    give_up,
    take_back,
    take_out,
)
from slamhive.kube.reconciling.sweep_picture import (
    SweepPicture,
    belongs_to,
    decide_now,
    is_outdated,
    leaving_pods,
    own_runs,
    owned_runs,
    pods_at_work,
)
from slamhive.kube.reconciling.sweep_recording import SweepRecorder, tell_archive
from slamhive.kube.reconciling.sweep_runs import (
    free_slot,
    held_back,
    is_archive_only,
    point_of,
    run_body,
    slots_used,
    standing_still,
    state_of,
    why_held_back,
)
from slamhive.kube.reconciling.sweep_search import Asker, written_trials
from slamhive.kube.reconciling.sweep_sharing import SlotSharing
from slamhive.kube.reconciling.sweep_state import SweepMemory, remember
from slamhive.kube.status import condition, holds, moment, phase_of
from slamhive.model.base import seconds
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.status import trial_field
from slamhive.model.sweep import CachePolicy, Sweep
from slamhive.sampling import Sampler

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.archive import Archive
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.catalogue import Catalogue
    from slamhive.kube.reconciling.sweep_search import SearchMemory
    from slamhive.model.search import Trial
    from slamhive.sampling import Proposer


_LOOK_SECONDS = 0.1
_LONGEST_LOOK_SECONDS = 0.3
_MANY = 100
_BLOCKED_SECONDS = 5.0
_AWAY_SECONDS = 10.0
_LEAVING_SECONDS = 1.0
_AT_ONCE = 16
_BATCHES_WAITING = 2


class SweepReconciler:
    """Brings Sweeps to their end.

    Args:
        catalogue: Algorithms and Datasets.
        archive: where finished runs are kept, if anywhere.
        sampler: proposes what searches try; default: one that nobody else uses.
        reusable: finished runs by content; default: nobody else's.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        archive: Archive | None = None,
        sampler: Proposer | None = None,
        reusable: ReusableRuns | None = None,
    ) -> None:
        self._catalogue = catalogue
        self._archive = archive
        self._asker = Asker(sampler or Sampler())
        self._reusable = reusable or ReusableRuns(catalogue, archive)
        self._keeper = Keeper(catalogue, archive) if archive is not None else None
        self._recorder = SweepRecorder(archive, self._keeper)
        self._sharing = SlotSharing(archive)
        self._memory: dict[str, SweepMemory] = {}
        self._parsed: dict[str, tuple[int, Sweep]] = {}
        self._waiting: set[Key] = set()
        self._archive_away: dict[str, str] = {}

    def waiting(self, namespace: str) -> list[Key]:
        """Return the Sweeps that wait for the catalog."""
        return [key for key in self._waiting if key.namespace == namespace]

    async def __call__(self, cluster: Cluster, key: Key) -> float | None:
        """Look at a Sweep, start or stop what is due, and write what changed."""
        self._waiting.discard(key)
        body = cluster.store.get(key)
        if body is None or body["metadata"].get("deletionTimestamp"):
            await self._tidy(cluster)
            return None
        try:
            again = await self._reconcile(cluster, key, body)
        except ArchiveAway as error:
            self._archive_away[body["metadata"]["uid"]] = str(error)
            self._sharing.rest(cluster, body["metadata"]["uid"])
            await tell_archive(cluster, key, condition("ArchiveUnavailable", True, "NoAnswer", str(error)))
            return _AWAY_SECONDS
        seen = cluster.store.get(key) or body
        if body["metadata"]["uid"] not in self._archive_away and holds(seen["status"], "ArchiveUnavailable"):
            await tell_archive(cluster, key, condition("ArchiveUnavailable", False, "Answers"))
        return again

    async def _reconcile(self, cluster: Cluster, key: Key, body: Object) -> float | None:
        """Accept a Sweep or refuse it, and drive its window; an archive that is away raises."""
        try:
            sweep = self._sweep(body)
            memory = await self._remembered(cluster, key, body, sweep)
        except InputError as error:
            self._waiting.add(key)
            uid = body["metadata"]["uid"]
            active = sum(state_of(run) is PointState.ACTIVE for run in own_runs(cluster, key, uid))
            self._sharing.rest(cluster, uid, active)
            await self._recorder.refuse(cluster, body, str(error))
            return None
        if body["metadata"].get("generation", 1) != (body.get("status") or {}).get("observedGeneration"):
            # Its runs may have to be measured by other settings now: no change of a run tells.
            cluster.queue.add(Key(Kind.EVALUATION, key.namespace, f"{SWEEP_PREFIX}{key.name}"))
        now = cluster.clock()
        # Every change of every run leads here; one look answers for all changes of a tenth of a second, or of
        # more where it goes through many runs.
        pause = min(_LOOK_SECONDS * (1 + len(memory.finished) / _MANY), _LONGEST_LOOK_SECONDS)
        if now - memory.looked_at < pause:
            return pause
        memory.looked_at = now
        search = memory.search
        if search is not None and not search.catch_up(written_trials(body), memory.states):
            del self._memory[body["metadata"]["uid"]]
            return _LOOK_SECONDS
        seen = await self._take_picture(cluster, key, body, sweep, memory)
        if is_outdated(seen):
            del self._memory[body["metadata"]["uid"]]
            return _LOOK_SECONDS
        if await make_anew(cluster, seen):
            return _LOOK_SECONDS
        return await self._drive_window(cluster, seen, now)

    async def _tidy(self, cluster: Cluster) -> None:
        alive = {
            body["metadata"]["uid"]
            for namespace in cluster.settings.namespaces
            for body in cluster.store.of(Kind.SWEEP, namespace)
        }
        self._sharing.leave(cluster, *(uid for uid in self._sharing.known if uid not in alive))
        for uid in [uid for uid in self._memory if uid not in alive]:
            memory = self._memory.pop(uid)
            try:
                await self._part(cluster, self._parsed[uid][1], memory)
            except ArchiveAway:
                self._memory[uid] = memory
                raise
        for uid in [uid for uid in (*self._parsed, *self._archive_away) if uid not in alive]:
            self._archive_away.pop(uid, None)
            self._parsed.pop(uid, None)

    async def _part(self, cluster: Cluster, sweep: Sweep, memory: SweepMemory) -> None:
        """Archive what has ended of a Sweep that was deleted, and tell what stays of it."""
        meta = sweep.metadata
        key = Key(Kind.SWEEP, meta.namespace or "", sweep.name)
        runs = {run["metadata"]["uid"]: run for run in owned_runs(cluster, key, meta.uid or "")}
        ended = {one.run["metadata"]["uid"]: one.run for one in memory.finished.values()}
        ended |= {uid: run for uid, run in runs.items() if phase_of(run["status"]).is_finished}
        text = f"{len(ended)} runs that had ended "
        if self._keeper is not None:
            await self._keeper.keep(cluster, [*ended.values()], sweep.spec.evaluation, memory.kept)
            kept = sweep.spec.retention.files == "Keep"
            files = "their folders stay where they are" if kept else "the collector removes their folders"
            text += f"are in the archive, as are those that were retired; {files}"
        else:
            text += "are gone with it, as there is no archive; the collector removes their folders"
        regarding = {"metadata": {"name": sweep.name, "namespace": key.namespace, "uid": meta.uid}}
        bad = ended and self._keeper is None
        await cluster.api.event(Kind.SWEEP, regarding, "Warning" if bad else "Normal", "Deleted", text)

    def _sweep(self, body: Object) -> Sweep:
        uid, generation = body["metadata"]["uid"], body["metadata"].get("generation", 1)
        known = self._parsed.get(uid)
        if known is None or known[0] != generation:
            known = (generation, parse(Sweep, body))
            self._parsed[uid] = known
        return known[1]

    async def _remembered(self, cluster: Cluster, key: Key, body: Object, sweep: Sweep) -> SweepMemory:
        uid = body["metadata"]["uid"]
        known = self._memory.get(uid)
        if known is not None and known.search is not None and known.search.search != sweep.spec.search:
            del self._memory[uid]  # it is to try more
        if uid not in self._memory:
            if self._keeper is not None:
                await self._keeper.recall(cluster, own_runs(cluster, key, uid))
            live = [run for run in own_runs(cluster, key, uid) if point_of(run) is not None]
            accepted = bool(holds(body["status"], "Accepted"))
            catalog = self._catalogue.all(cluster.store, key.namespace)
            memory = await remember(
                *(sweep, body, catalog, live, self._archive), accepted=accepted, cluster=cluster.identity
            )
            # An operator that was killed may not have written the start: its oldest live run tells it, or the
            # budget of wall time would begin anew.
            made = (moment(run["metadata"].get("creationTimestamp")) for run in own_runs(cluster, key, uid))
            memory.started_at = memory.started_at or min(filter(None, made), default=None)
            most = cluster.settings.max_runs_without_archive
            if self._archive is None and memory.most_runs > most:
                raise InputError(
                    f"spec.matrix: {memory.most_runs} runs need an archive, without one at most {most} are "
                    "allowed: their objects would fill the cluster; set archive.existingSecret in the chart"
                )
            self._memory[uid] = memory
        return self._memory[uid]

    async def _take_picture(
        self, cluster: Cluster, key: Key, body: Object, sweep: Sweep, memory: SweepMemory
    ) -> SweepPicture:
        runs = {}
        for run in own_runs(cluster, key, body["metadata"]["uid"]):
            index = point_of(run)
            if index is not None and index < len(memory.states):
                runs[index] = run
        await self._look_for_missing(cluster, body, sweep, memory, runs)
        for index, run in runs.items():
            memory.note(index, run)
        tally = replace(memory.archived)
        tally.add(*memory.finished.values(), *memory.deleted.values())
        if memory.search is not None:
            memory.search.look(memory.finished, runs, memory.states)
        return SweepPicture(key, body, sweep, memory, runs, tally)

    async def _look_for_missing(
        self, cluster: Cluster, body: Object, sweep: Sweep, memory: SweepMemory, runs: dict[int, Object]
    ) -> None:
        """Find out about points whose runs are not seen any more: deleted by someone, which cancels them."""
        key, uid = key_of(Kind.SWEEP, body), body["metadata"]["uid"]
        missing = []
        index = memory.states.find(PointState.ACTIVE)
        while index >= 0:
            if index not in runs:
                # Another operator may have made it a moment ago: what the watch hasn't told yet is asked for.
                run = await cluster.refresh(
                    Key(Kind.MAPPING_RUN, key.namespace, memory.plan.point(index).name)
                )
                if run is not None and belongs_to(run, uid):
                    runs[index] = run
                else:
                    missing.append(index)
            index = memory.states.find(PointState.ACTIVE, index + 1)
        if missing or are_missing(memory, runs):
            # A Sweep that is deleted takes its runs with it, and the watch of runs may tell before its own.
            there = await cluster.refresh(key)
            if there is None or there["metadata"]["uid"] != uid or there["metadata"].get("deletionTimestamp"):
                raise Conflict(f"{key} is being deleted", status=409)
        if missing and await archived_by_others(memory, self._archive, uid, missing):
            del self._memory[uid]
            raise Conflict(f"{key}: another operator has archived runs of it", status=409)
        names = await take_out(memory, self._archive, sweep.spec.retention.runs, runs)
        names += [give_up(memory, index) for index in missing]
        take_back(memory, runs)
        if names:
            text = announcement(memory, names)
            await cluster.api.event(Kind.SWEEP, body, "Warning", "RunsDeleted", text)

    async def _drive_window(self, cluster: Cluster, seen: SweepPicture, now: float) -> float | None:
        """Start or stop what is due, write what changed, and archive what is done."""
        memory, sweep = seen.memory, seen.sweep
        _note_start(seen, now)
        pods = pods_at_work(cluster, seen)
        leaving = leaving_pods(seen, pods)
        window = sweep.spec.parallelism or cluster.settings.default_parallelism
        room = max(0, window - len(leaving))
        decision = decide_now(seen, room, now)
        unsought: str | None = None
        if memory.search is not None and decision.verdict is Verdict.RUNNING:
            seen, unsought = await self._try_further(cluster, seen)
            decision = decide_now(seen, room, now)
        memory.cursor = decision.cursor
        unmade: str | None = None
        due: tuple[int, ...] = ()
        for action in decision.actions:
            match action:
                case StartPoints(indices) if not self._is_held_back(seen, window):
                    unmade = self._backlog(cluster, seen, window)
                    due = () if unmade else indices
                case StopPoints(indices):
                    await self._cancel(cluster, [seen.runs[index] for index in indices if index in seen.runs])
        look = SweepLook(seen.key, sweep, memory, seen.runs, pods, len(leaving), window, len(due))
        turn = await self._sharing.turn(cluster, look, now)
        memory.share = turn.share
        if turn.starts:
            unmade = await self._start(cluster, seen, due[: turn.starts], leaving, now)
            begun = [seen.runs[index] for index in due[: turn.starts] if index in seen.runs]
            self._sharing.begun(seen.body["metadata"]["uid"], begun, now)
        if unmade:
            self._sharing.rest(cluster, seen.body["metadata"]["uid"])
        delays = [_BLOCKED_SECONDS] if unmade or unsought else []
        delays += [_LEAVING_SECONDS] if leaving else []
        delays += [turn.delay] if turn.delay is not None else []
        active = seen.active
        still = standing_still(active, cluster.failing)
        queued = held_back(active)
        refused, refusal = turn.blocked or ("", None)
        blocked = "\n".join(filter(None, (refusal, unsought, unmade, still, queued)))
        words = (
            (refusal, refused),
            (unsought, "CannotSearch"),
            (unmade, "CannotCreate"),
            (still, "RunsStandStill"),
            (queued, QUEUE_WAITS),
            (True, "Free"),
        )
        word = next(word for told, word in words if told)
        if sweep.spec.budget.wall_time is not None and decision.verdict is Verdict.RUNNING:
            delays.append(_budget_left(sweep, memory, now))
        delays += await self._recorder.record(
            cluster, seen, decision, condition("Blocked", bool(blocked), word, blocked), now
        )
        if self._archive is not None and self._keeper is not None:
            body = cluster.store.get(seen.key) or seen.body
            delays += await self._keeper.retire(cluster, sweep, body, seen.settled, memory.kept)
            if seen.body["metadata"]["uid"] in self._archive_away:
                await in_thread(self._archive.get, seen.body["metadata"]["uid"])
                # It answers again: what was held back may start.
                del self._archive_away[seen.body["metadata"]["uid"]]
                delays.append(_LOOK_SECONDS)
        return min(delays, default=None)

    async def _try_further(self, cluster: Cluster, seen: SweepPicture) -> tuple[SweepPicture, str | None]:
        """Write down what a search tries next, before any run of it; returns what keeps it from that."""
        memory, search = seen.memory, seen.memory.search
        if search is None:
            return seen, None
        try:
            fresh = await self._known_before(cluster, seen, search) or await self._asker.further(search)
        except (InputError, SystemFault) as error:
            return seen, str(error)
        if not fresh and search.is_written(written_trials(seen.body)):
            return seen, None
        trials = [*search.fields, *map(trial_field, fresh)]
        # Checked: of two operators that ask at a time one writes, and the other goes on with what that wrote.
        status = {"search": {"trials": trials, "asked": len(trials)}}
        body = await cluster.write_status(Kind.SWEEP, seen.body, status) or seen.body
        for trial in fresh:
            search.draw(trial, memory.states)
        return replace(seen, body=body), None

    async def _known_before(self, cluster: Cluster, seen: SweepPicture, search: SearchMemory) -> list[Trial]:
        """Return the settings whose results the archive has already, which are tried first.

        Only where datasets are prepared as these settings read them it is known what is equal; what isn't
        known to be now is taken over all the same when its run begins.
        """
        takes = seen.sweep.spec.cache_policy != CachePolicy.RERUN and search.search.method.is_sampled
        if search.plan.trials or self._archive is None or not takes:
            return []
        content = self._reusable.contents(cluster, seen.key.namespace, search.plan)
        return await in_thread(known_trials, search.plan, self._archive, content)

    def _is_held_back(self, seen: SweepPicture, window: int) -> bool:
        """Tell whether finished runs wait for an archive that is away: more would fill the cluster."""
        if seen.body["metadata"]["uid"] not in self._archive_away:
            return False
        return len(seen.settled) >= seen.sweep.spec.retention.runs + window

    def _backlog(self, cluster: Cluster, seen: SweepPicture, window: int) -> str | None:
        """Return the reason to start nothing more now: runs end faster than they are measured and archived.

        Without this their objects would fill the cluster, however small the window is.
        """
        if self._archive is None:
            return None  # nothing is deleted then, and a Sweep has no more runs than the cluster may hold
        measuring = cluster.settings.evaluation
        ended, kept = len(seen.memory.finished), seen.sweep.spec.retention.runs
        most = kept + window + _BATCHES_WAITING * measuring.batch_size * measuring.parallel_jobs
        if ended < most:
            return None
        return f"{ended} runs that have ended, {kept} of them to keep, wait to be measured and archived"

    async def _start(
        self,
        cluster: Cluster,
        seen: SweepPicture,
        indices: tuple[int, ...],
        leaving: list[Mapping[str, Any]],
        now: float,
    ) -> str | None:
        """Create the runs of points; returns why some could not be."""
        if self._archive is not None:
            await _insist_on_newest(cluster, seen)
        if seen.memory.started_at is None:
            seen.memory.started_at = now
        used = slots_used([*seen.runs.values(), *leaving])
        limit = asyncio.Semaphore(_AT_ONCE)
        retained = sum(not is_archive_only(run) for run in seen.runs.values())
        room = seen.sweep.spec.retention.runs - retained if self._archive is not None else len(indices)

        async def create(index: int, slot: int, *, archive_only: bool) -> str | None:
            async with limit:
                return await self._create(cluster, seen, index, slot, archive_only=archive_only)

        told = await asyncio.gather(
            *(
                create(index, free_slot(used), archive_only=number >= room)
                for number, index in enumerate(indices)
            )
        )
        return next((problem for problem in told if problem), None)

    @staticmethod
    async def _create(
        cluster: Cluster, seen: SweepPicture, index: int, slot: int, *, archive_only: bool
    ) -> str | None:
        plan = seen.memory.plan
        twin = plan.twins.get(index)
        same = None if twin is None else plan.point(twin).name
        body = run_body(seen.body, plan.point(index), slot, same, archive_only=archive_only)
        try:
            run = await cluster.create(Kind.MAPPING_RUN, body)
        except AlreadyExists:
            key = key_of(Kind.MAPPING_RUN, body)
            found = await cluster.refresh(key)
            if found is None or found["metadata"].get("deletionTimestamp"):
                return f"{key.name} is still being deleted"
            # A name that belongs to someone else is reported, never taken over.
            if seen.body["metadata"]["uid"] not in owner_uids(found):
                return f"the name {key.name} is taken by a MappingRun that is not of this Sweep"
            run = found
        except REFUSALS as error:
            return str(error)
        seen.memory.states[index] = PointState.ACTIVE
        seen.runs[index] = run
        return None

    @staticmethod
    async def _cancel(cluster: Cluster, runs: list[Object]) -> None:
        for run in runs:
            if not run["spec"].get("cancel"):
                await cluster.patch(key_of(Kind.MAPPING_RUN, run), {"spec": {"cancel": True}})


async def _insist_on_newest(cluster: Cluster, seen: SweepPicture) -> None:
    """Make sure that no other operator has done points of which nothing is known here yet.

    An archived run's name is free again: only the Sweep's status says that its point is done.

    Raises:
        Conflict: the Sweep is newer than what was looked at.
    """
    fresh = await cluster.refresh(seen.key)
    if fresh is None or fresh["metadata"]["resourceVersion"] != seen.body["metadata"]["resourceVersion"]:
        raise Conflict(f"{seen.key} has changed since it was looked at", status=409)


def _note_start(seen: SweepPicture, now: float) -> None:
    """Let a Sweep's time begin when the first of its runs is let in: the wait in a queue costs no budget."""
    memory, active = seen.memory, seen.active
    is_waiting = bool(active) and all(map(why_held_back, active))
    if is_waiting and len(active) + memory.states.count(PointState.PENDING) == len(memory.states):
        memory.started_at = None
    elif active:
        memory.started_at = memory.started_at or now


def _budget_left(sweep: Sweep, memory: SweepMemory, now: float) -> float:
    """Return after how many seconds to look at the budget of time again."""
    end = (memory.started_at or now) + seconds(sweep.spec.budget.wall_time or "0s")
    return min(max(end - now, _LOOK_SECONDS), 60.0)
