# SPDX-License-Identifier: Apache-2.0
"""Running sweeps on this machine: the window of runs in flight, and what is kept of them.

Several runners may be at work in one home. A run that another one is at, or whose equal another one computes,
is left to it and looked at again when it is done; the window is filled with other runs meanwhile.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol

from slamhive.archive import CatalogEntry, SweepRecord
from slamhive.archive.patience import Patience
from slamhive.archive.remarks import Remarks
from slamhive.engine import PointState, StartPoints, StopPoints, SweepObserved, Verdict, decide_sweep
from slamhive.local.home.changes import set_aside
from slamhive.local.home.claims import Claims
from slamhive.local.home.leases import LeaseKind
from slamhive.local.programs.cores import CorePool
from slamhive.local.programs.unavailable import GivenUp
from slamhive.local.running.ahead import make_ahead, missing
from slamhive.local.running.attempt import end_left_behind
from slamhive.local.running.choosing import RunChoice, first_of, twins_among
from slamhive.local.running.execution import AtWorkElsewhere, RunDriver, RunOrder, RunStep
from slamhive.local.running.outlook import Looking, Outlook, RunStanding
from slamhive.local.running.searching import SearchUnderWay
from slamhive.model.results import Phase, RunRecord
from slamhive.model.sweep import CachePolicy
from slamhive.monitor import sweep_stale_cgroups
from slamhive.plan import SearchPlan, whole_cores
from slamhive.sampling import Sampler

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from slamhive.engine import SweepDecision
    from slamhive.local.running.costs import Combinations
    from slamhive.local.running.execution import PlannedPoint
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.sweep import Sweep

_LOOK_SECONDS = 0.25
_EVERYTHING = RunChoice()


def run_uid(sweep_uid: str, index: int) -> str:
    """Return the identity of a run of a sweep on a workstation."""
    return f"{sweep_uid[:16]}-{index}"


@dataclass
class Job:
    """A sweep on its way.

    Attributes:
        sweep: what was asked for.
        uid: its identity.
        points: its runs.
        states: state of each point.
        reused: points that took an equal run's result.
        kept: points that were finished before.
        afresh: points that failed before and are done again.
        outlook: how its points stood before anything was done; None until that is known.
        asked: points that are asked for; None for all.
        again: finished points that are done again as someone asked for it.
        left_out: number of pending points that nobody asks for this time.
        twins: points that come out as another one does, with its index.
        elsewhere: points that another runner is at, or an equal of which it computes, with what it holds.
        done_elsewhere: number of points that another runner has finished meanwhile.
        search: which points are wanted, as the results say; None where all are.
        cores_elsewhere: number of cores that other runners have while some are waited for here.
        cpu_seconds: CPU time of the runs finished now and before.
        verdict: where it stands.
        message: why.
    """

    sweep: Sweep
    uid: str
    points: Combinations
    states: bytearray = field(default_factory=bytearray)
    order: Sequence[int] = ()
    reused: int = 0
    kept: int = 0
    afresh: set[int] = field(default_factory=set)
    cursor: int = 0
    cpu_seconds: float = 0.0
    started_at: float | None = None
    verdict: Verdict = Verdict.RUNNING
    message: str = ""
    outlook: Outlook | None = None
    asked: set[int] | None = None
    again: set[int] = field(default_factory=set)
    left_out: int = 0
    twins: Mapping[int, int] = field(default_factory=dict)
    at_a_time: int = 1
    elsewhere: dict[int, tuple[LeaseKind, str]] = field(default_factory=dict)
    done_elsewhere: int = 0
    cores_elsewhere: int = 0
    search: SearchUnderWay | None = None

    def __post_init__(self) -> None:
        if isinstance(self.points, SearchPlan):
            self.search = SearchUnderWay(self.points, self.uid, self.run_uid)
        self.states = bytearray(len(self.points))
        self.order = self.points.start_order(look_first=True)
        self.twins = self.points.twins

    def run_uid(self, index: int) -> str:
        """Return the identity of a point's run."""
        return run_uid(self.uid, index)

    def twin(self, index: int) -> str | None:
        """Return the identity of the run whose result a point's run takes, as it asks for the same."""
        twin = self.twins.get(index)
        return None if twin is None else self.run_uid(twin)

    def next_of(self, algorithms: Collection[str]) -> list[str]:
        """Return those of some algorithms that are still to run, that which is run first the first."""
        found: dict[str, None] = {}
        equal = set(self.outlook.of(RunStanding.EQUAL) if self.outlook is not None else ())
        for index in self.order if algorithms else ():
            if self.states[index] == PointState.PENDING and index not in equal:
                name = self.points.point(index).short_spec["algorithm"] or ""
                found |= {name: None} if name in algorithms else {}
            if len(found) == len(algorithms):
                break
        return list(found)

    def follow_search(self) -> None:
        """Have the points that the search wants now be those that are started."""
        if self.search is None:
            return
        if self.outlook is not None:
            new = range(len(self.outlook.standing), len(self.states))
            self.outlook.standing.extend(bytes(len(new)))
            # Of a list of trials that is lost: what has the place of another run goes aside.
            self.outlook.aside |= {index for index in new if self.run_uid(index) in self.outlook.seen}
        self.order, self.cursor = self.search.decision.wanted, 0
        wanted = sum(self.states[index] == PointState.PENDING for index in self.order)
        self.left_out = self.count(PointState.PENDING) - wanted

    def make_pending(self, index: int) -> None:
        """Have a point begin again that has begun."""
        self.states[index] = PointState.PENDING
        self.cursor = 0

    def count(self, state: PointState) -> int:
        """Return the number of points in a state."""
        return self.states.count(state)


class Watcher(Protocol):
    """Is told what happens, to show it."""

    def phase(self, job: Job, index: int, phase: Phase) -> None:
        """A run has entered a phase."""

    def step(self, job: Job, index: int, step: RunStep) -> None:
        """A run has come to a step."""

    def finished(self, job: Job, record: RunRecord) -> None:
        """A run is finished and kept."""

    def tick(self, jobs: Sequence[Job]) -> None:
        """Some time has passed."""


@dataclass(frozen=True)
class _PointEnd:
    job: Job
    index: int
    record: RunRecord | None
    error: BaseException | None = None
    elsewhere: str | None = None


class Runner:
    """Drives jobs with as many runs at a time as the machine's cores allow.

    Args:
        bench: what runs share.
        watcher: told what happens.
        parallelism: runs at the same time at most; default: as many as fit.
        wish: how much of what is asked for is done.
        begun: called with each job when it is known how its points stand and which are done.
    """

    def __init__(
        self,
        bench: Workbench,
        watcher: Watcher,
        *,
        parallelism: int | None = None,
        wish: RunChoice = _EVERYTHING,
        begun: Callable[[Job], None] = lambda _: None,
    ) -> None:
        self._bench = bench
        self._watcher = watcher
        self._wish = wish
        self._begun = begun
        self._cores = CorePool(bench.home.leases)
        self._claims = Claims(bench.home.leases)
        self._parallelism = parallelism or self._cores.size
        self._drivers: dict[tuple[str, int], RunDriver] = {}
        self._threads: list[threading.Thread] = []
        # No SimpleQueue: where a signal comes shortly before its time is over, it waits for ever.
        self._events: queue.Queue[_PointEnd] = queue.Queue()
        self._lock = threading.Lock()
        self._interrupted = False
        self._stopped: set[str] = set()
        self._looking = Looking(bench, making=True)
        self._sampler = Sampler()

    def run(self, jobs: Sequence[Job]) -> bool:
        """Bring jobs to their end, one after another.

        Returns:
            Whether it was interrupted.
        """
        # First of all: what a killed slamhive left running would disturb what is measured now.
        claims = self._claims
        self._bench.archive.patience = Patience(self._bench.tell, lambda: self._interrupted)
        self._bench.home.leases.tidy()
        end_left_behind(self._bench.home.path / "runs", claims.is_at_work)
        sweep_stale_cgroups()
        self._bench.programs.containers.remove_left_behind(claims.runs_at_work())
        self._bench.tidy()
        try:
            for job in jobs:
                self._resume(job, self._looking)
                self._begun(job)
            for job in jobs:
                if not self._interrupted:
                    self._run(job, jobs)
        except GivenUp:
            pass  # a dataset that was made to know what is stale
        finally:
            self._bench.archive.patience = None
            claims.give_back_all()
            self._sampler.close()
        return self._interrupted

    def interrupt(self, *, making: bool = True) -> None:
        """Start nothing more and end what runs; safe to call from a signal handler.

        Args:
            making: whether datasets, recordings and environments that are being made are given up too.
        """
        self._interrupted = True
        self._bench.gives_up = making

    def _resume(self, job: Job, looking: Looking) -> None:
        """Mark the points that are done; from now on this is the current version of the sweep."""
        archive, sweep, wish = self._bench.archive, job.sweep, self._wish
        most = 1 if sweep.spec.runs_alone else self._parallelism
        job.at_a_time = min(most, sweep.spec.parallelism or most)
        archive.put_sweep(
            SweepRecord(
                uid=job.uid,
                name=sweep.name,
                spec=sweep.spec.as_json(),
                created=datetime.now(UTC),
                evaluation=sweep.spec.evaluation.as_json(),
            )
        )
        if job.search is not None:
            anew = wish.rerun or sweep.spec.cache_policy is not CachePolicy.REUSE
            job.search.begin(archive, None if anew else looking.content)
            job.states = bytearray(len(job.points))
        job.outlook = looking.look(sweep.name, job.uid, job.points, job.run_uid)
        if wish.rerun:
            job.again |= {*job.outlook.finished, *job.outlook.of(RunStanding.EQUAL)}
        for index, standing in enumerate(job.outlook.standing):
            # A finished run of a changed adapter, environment or dataset is another experiment: it is done
            # again, and kept aside when that begins.
            if index in job.again and (job.asked is None or index in job.asked):
                continue
            if standing == RunStanding.DONE:
                job.states[index] = PointState.SUCCEEDED
            elif standing == RunStanding.FAILED and not wish.retry_failed:
                job.states[index] = PointState.FAILED
            elif standing in {RunStanding.FAILED, RunStanding.FAULT}:
                job.afresh.add(index)
        self._choose(job)
        job.kept = job.count(PointState.SUCCEEDED) + job.count(PointState.FAILED)
        job.cpu_seconds = archive.cpu_seconds(job.uid)

    def _choose(self, job: Job) -> None:
        """Leave out what nobody asks for this time."""
        pending = {index for index, state in enumerate(job.states) if state == PointState.PENDING}
        chosen = pending if job.asked is None else pending & job.asked
        if self._wish.first is not None and job.outlook is not None:
            chosen = first_of(job.order, job.outlook, chosen, self._wish.first)
        if len(chosen) == len(pending):
            return
        job.left_out = len(pending) - len(chosen)
        job.order = [index for index in job.order if index in chosen]
        job.again &= chosen
        job.twins = twins_among(job.points.twins, chosen, set(range(len(job.states))) - pending)

    def _run(self, job: Job, jobs: Sequence[Job]) -> None:
        try:
            self._lead(job, jobs)
        except BaseException:
            self._stop(job)
            raise
        for thread in self._threads:
            thread.join()
        self._threads.clear()
        if job.search is not None:
            job.search.end(self._bench.archive)

    def _lead(self, job: Job, jobs: Sequence[Job]) -> None:
        job.started_at = time.monotonic()
        self._advance(job)
        names = job.next_of(missing(self._bench, job.points.algorithm_names()))
        stopped, most = (lambda: job.uid in self._stopped), job.at_a_time - 1
        self._threads += make_ahead(names, self._bench, self._cores, most, stopped)
        while True:
            self._advance(job)
            decision = self._decide(job)
            job.cursor = decision.cursor
            job.verdict, job.message = decision.verdict, decision.message
            if job.search is not None and decision.verdict is Verdict.COMPLETE:
                job.message = job.search.decision.message
            if decision.verdict.is_final or self._interrupted:
                if job.uid not in self._stopped:
                    self._stop(job)
                self._look_for(job, list(job.elsewhere))
                if not job.count(PointState.ACTIVE):
                    break
            else:
                # What another runner has done or is at leaves room for others at once.
                passed = [action for action in decision.actions if not self._act(job, action)]
                if passed:
                    continue
                if decision.verdict is Verdict.SUSPENDED and not job.count(PointState.ACTIVE):
                    break
            self._wait(jobs)

    def _advance(self, job: Job) -> None:
        """Have a search go on as far as results say."""
        if job.search is None or job.sweep.spec.suspend or job.uid in self._stopped:
            return
        archive = self._bench.archive
        job.search.advance(archive, job.states, self._sampler, lambda: not self._interrupted)
        job.follow_search()

    def _decide(self, job: Job) -> SweepDecision:
        seen = SweepObserved(
            states=job.states,
            order=job.order,
            # Runs that are at another runner count as active, and take none of our places.
            parallelism=job.at_a_time + len(job.elsewhere),
            started_at=job.started_at,
            cpu_seconds=job.cpu_seconds,
            cursor=job.cursor,
            twins=job.twins,
            left_out=job.left_out,
            is_open=job.search is not None and not job.search.decision.is_over,
        )
        return decide_sweep(job.sweep.spec, seen, time.monotonic())

    def _act(self, job: Job, action: StartPoints | StopPoints) -> bool:
        """Do what was decided, and tell whether it was all to be done here."""
        if isinstance(action, StopPoints):
            self._stop(job)
            return True
        ours = [index for index in action.indices if self._is_ours(job, index)]
        for index in ours:
            job.states[index] = PointState.ACTIVE
            # A daemon: a second Ctrl-C shall not wait for a preparation to end.
            thread = threading.Thread(target=self._drive, args=(job, index), name=f"run-{index}", daemon=True)
            self._threads.append(thread)
            thread.start()
        return len(ours) == len(action.indices)

    def _is_ours(self, job: Job, index: int) -> bool:
        """Tell whether a point is to be run here: no other runner is at it, nor has done it meanwhile."""
        uid, point = job.run_uid(index), job.points.point(index)
        if not self._claims.run((job.uid, index), uid, f"{job.sweep.name}/{point.name}"):
            job.states[index] = PointState.ACTIVE
            job.elsewhere[index] = (LeaseKind.RUNS, uid)
            return False
        # Looked up only when it is claimed: before that, another runner may finish it at any moment.
        state = self._done_meanwhile(job, index, uid)
        if state is None:
            return True
        self._claims.give_back((job.uid, index))
        job.states[index] = state
        job.done_elsewhere += 1
        return False

    def _done_meanwhile(self, job: Job, index: int, uid: str) -> PointState | None:
        """Return the state of a point that another runner finished since the job began, if it did."""
        record = self._bench.archive.get(uid)
        seen = job.outlook.seen if job.outlook is not None else {}
        if record is None or not record.phase.is_finished or (uid in seen and seen[uid] == record.finished):
            return None
        if record.provenance.content_hash != self._looking.content(job.points.point(index)):
            if job.outlook is not None:  # another one of its adapter or dataset, which stays beside ours
                job.outlook.aside.add(index)
            return None
        if record.phase is Phase.SUCCEEDED:
            job.cpu_seconds += _computed_seconds(record)
            return PointState.SUCCEEDED
        if record.reason is not None and record.reason.is_infrastructure:
            job.afresh.add(index)
            return None
        return PointState.FAILED

    @staticmethod
    def _look_for(job: Job, indices: Iterable[int]) -> None:
        """Have points looked at again that were another runner's."""
        for index in indices:
            del job.elsewhere[index]
            job.make_pending(index)

    def _stop(self, job: Job) -> None:
        """End the job's runs, and let none begin that still waits for cores; a second time: at once."""
        with self._lock:
            self._stopped.add(job.uid)
            drivers = [driver for (uid, _), driver in self._drivers.items() if uid == job.uid]
        for driver in drivers:
            driver.cancel()

    def _drive(self, job: Job, index: int) -> None:
        try:
            point = job.points.point(index)
            self._watcher.step(job, index, RunStep.CORES)
            resources = point.spec["resources"]
            # Who runs alone holds all cores, of which it uses its own: nobody else gets any.
            alone = resources.get("exclusiveNodes")
            wanted = self._cores.size if alone else whole_cores(resources["cpu"])
            cores = self._cores.take(wanted, lambda: job.uid in self._stopped)
            if cores is None:
                self._events.put(_PointEnd(job, index, None))
                return
            try:
                record = self._one(job, index, point, cores)
            finally:
                self._cores.give_back(cores)
            self._events.put(_PointEnd(job, index, record))
        except AtWorkElsewhere as found:
            self._events.put(_PointEnd(job, index, None, elsewhere=found.content))
        except GivenUp:
            self._events.put(_PointEnd(job, index, None))
        except BaseException as error:  # noqa: BLE001 - a thread's error is raised again by the runner
            self._events.put(_PointEnd(job, index, None, error))

    def _one(
        self, job: Job, index: int, point: PlannedPoint, cores: list[tuple[int, ...]]
    ) -> RunRecord | None:
        order = RunOrder(
            uid=job.run_uid(index),
            point=point,
            sweep=job.sweep.name,
            sweep_uid=job.uid,
            labels=dict(job.sweep.spec.template.metadata.labels),
            remarks=Remarks.of_annotations(job.sweep.spec.template.metadata.annotations),
            settings=job.sweep.spec.evaluation,
            reuse=not self._redo(job, index) and job.sweep.spec.cache_policy is CachePolicy.REUSE,
            take_up=not self._redo(job, index) and index not in job.afresh,
            twin=job.twin(index),
            holding=self._cores.descriptors(cores),
        )
        used = cores[: whole_cores(point.spec["resources"]["cpu"])]
        cpus = tuple(cpu for core in used for cpu in core)
        driver = RunDriver(
            order,
            self._bench,
            cpus,
            lambda phase: self._watcher.phase(job, index, phase),
            lambda step: self._watcher.step(job, index, step),
            claim=lambda content: self._claims.content((job.uid, index), content),
        )
        with self._lock:
            # A run that waited for cores while its job was stopped must not begin any more.
            if job.uid in self._stopped:
                return None
            self._drivers[job.uid, index] = driver
        if job.outlook is not None and index in job.outlook.aside:
            set_aside(self._bench.archive, order.uid)
        try:
            return driver.drive()
        finally:
            with self._lock:
                del self._drivers[job.uid, index]

    def _redo(self, job: Job, index: int) -> bool:
        """Tell whether a point is done again whatever there is of it."""
        return self._wish.rerun or index in job.again

    def _wait(self, jobs: Sequence[Job]) -> None:
        """Wait for a run to end, and keep it; look up now and then."""
        try:
            ended = self._events.get(timeout=_LOOK_SECONDS)
        except queue.Empty:
            for job in jobs:
                free = [index for index, lease in job.elsewhere.items() if not self._claims.is_held(*lease)]
                self._look_for(job, free)
                job.cores_elsewhere = self._cores.elsewhere() if job.count(PointState.ACTIVE) else 0
            self._watcher.tick(jobs)
            return
        if ended.error is not None:
            raise ended.error
        self._keep(ended)
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        self._watcher.tick(jobs)

    def _snapshots(self, record: RunRecord) -> tuple[CatalogEntry, CatalogEntry]:
        workshop = self._bench.workshop
        return (
            CatalogEntry.of(workshop.algorithm(record.spec["algorithmRef"]["name"]).algorithm),
            CatalogEntry.of(workshop.dataset(record.spec["datasetRef"]["name"]).dataset),
        )

    def _keep(self, ended: _PointEnd) -> None:
        try:
            self._put(ended)
        finally:
            # Only now: whoever waits for this run looks for it in the archive.
            self._claims.give_back((ended.job.uid, ended.index))

    def _put(self, ended: _PointEnd) -> None:
        job, record = ended.job, ended.record
        if ended.elsewhere is not None:
            job.elsewhere[ended.index] = (LeaseKind.CONTENTS, ended.elsewhere)
            return
        # What was cancelled is no result: the next `slamhive run` does it again.
        if record is None or record.phase is Phase.CANCELLED:
            job.make_pending(ended.index)
            return
        # With the Algorithm and Dataset as they are now: it must stay known what ran when they have changed.
        self._bench.archive.put_run(record, *self._snapshots(record))
        good = record.phase is Phase.SUCCEEDED
        job.states[ended.index] = PointState.SUCCEEDED if good else PointState.FAILED
        if record.provenance.reused_from:
            job.reused += 1
        job.cpu_seconds += _computed_seconds(record)
        self._watcher.finished(job, record)


def _computed_seconds(record: RunRecord) -> float:
    """Return the CPU time that a run took, nothing where it took over a result."""
    if record.provenance.reused_from or record.usage is None:
        return 0.0
    return record.usage.cpu.seconds or 0.0
