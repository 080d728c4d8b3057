# SPDX-License-Identifier: Apache-2.0
"""Reconciler of a MappingRun: from its spec through its variant and its Job to a status.

What is seen goes to ``decide_run``; what it decides is done here, and run_recording.py writes it down.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.engine import AttemptState, Prepare, RunObserved, RunState, Start, Stop, decide_run
from slamhive.kube.api.errors import REFUSALS, AlreadyExists, ApiError, Forbidden
from slamhive.kube.api.kinds import Key, Kind, Label, Role, key_of, labels_of, owner_uids, reference
from slamhive.kube.builders import configuration, read_job, run_job
from slamhive.kube.builders.common import label_value
from slamhive.kube.builders.player import player
from slamhive.kube.builders.run import job_name
from slamhive.kube.observing import TERMINATING, Attempted, observe_attempt, observe_job, observe_lost
from slamhive.kube.pods import Waiting, live_pods
from slamhive.kube.pods import condition as condition_of
from slamhive.kube.reconciling import variants
from slamhive.kube.reconciling.archiving import ArchiveAway, KeptRuns
from slamhive.kube.reconciling.disruptions import Disruptions
from slamhive.kube.reconciling.run_recording import RunRecorder
from slamhive.kube.reconciling.run_status import RunFacts
from slamhive.kube.reconciling.variants import Wanted
from slamhive.kube.reconciling.waiting import (
    AGAIN_SECONDS,
    POD_SECONDS,
    Patience,
    patience,
    refused_seconds,
    soonest,
)
from slamhive.kube.records import sweep_of
from slamhive.kube.reports import read_report
from slamhive.kube.status import condition, moment, phase_of, run_state, since, state_fields
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.results import Phase, Reason
from slamhive.model.run import InputOptions
from slamhive.model.sensors import SensorMode
from slamhive.model.status import MappingRunStatus
from slamhive.model.variant import program_title
from slamhive.plan import option_problems, resolve, spec_hash

if TYPE_CHECKING:
    from slamhive.engine import Decision
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.archiving import Keeper
    from slamhive.kube.reconciling.catalogue import Catalogue
    from slamhive.kube.reconciling.evaluating import Evaluations
    from slamhive.kube.reconciling.reuse import ReusableRuns
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset

_TAKEN_SECONDS = 2.0


class _Resolved(NamedTuple):
    """A run's spec with all defaults, and what follows from it."""

    uid: str
    spec: dict[str, Any]
    hash: str
    wanted: Wanted


class RunReconciler:
    """Brings MappingRuns to their end.

    Args:
        catalogue: Algorithms and Datasets.
        evaluations: who measures finished runs.
        reusable: finished runs by content.
        keeper: keeps runs that belong to no Sweep in the archive, if there is one.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        evaluations: Evaluations,
        reusable: ReusableRuns,
        keeper: Keeper | None = None,
    ) -> None:
        self._catalogue = catalogue
        self._evaluations = evaluations
        self._reusable = reusable
        self._recorder = RunRecorder(catalogue, evaluations, reusable, has_archive=keeper is not None)
        self._waiting: set[Key] = set()
        self._resolved: dict[Key, _Resolved] = {}
        self._keeper = keeper
        self._kept = KeptRuns()
        self._recalling = asyncio.Lock()
        self._recalled: set[str] = set()

    def waiting(self, namespace: str) -> list[Key]:
        """Return the runs that wait for the catalog."""
        return [key for key in self._waiting if key.namespace == namespace]

    async def __call__(self, cluster: Cluster, key: Key) -> float | None:
        """Look at a run, do what is to be done next, and write what changed."""
        await self._recall(cluster, key.namespace)
        again = await self._look(cluster, key)
        run = cluster.store.get(key)
        # Those of a Sweep are kept together.
        if self._keeper is not None and run is not None and Label.SWEEP not in labels_of(run):
            await self._keeper.keep_single(cluster, run, self._kept)
        return again

    async def _recall(self, cluster: Cluster, namespace: str) -> None:
        """Give runs that an earlier operator archived their ends, before one of them is followed further."""
        async with self._recalling:
            if self._keeper is None or namespace in self._recalled:
                return
            with suppress(ArchiveAway):  # what is there may be measured once more then
                await self._keeper.recall(cluster, cluster.store.of(Kind.MAPPING_RUN, namespace))
            self._recalled.add(namespace)

    async def _look(self, cluster: Cluster, key: Key) -> float | None:
        self._waiting.discard(key)
        run = cluster.store.get(key)
        if run is None or run["metadata"].get("deletionTimestamp"):
            self._resolved.pop(key, None)
            if run is None:
                self._reusable.forget(key)
            return None
        if phase_of(run["status"]).is_finished:
            self._resolved.pop(key, None)
            self._reusable.learn(run)
            self._evaluations.consider(cluster, run)
            return None
        state = run_state(MappingRunStatus.of(run))
        try:
            facts = self._facts(cluster, key, run, state)
        except UnknownNameError as error:
            self._waiting.add(key)
            fresh = [condition("Accepted", False, "CatalogIncomplete", str(error))]
            await cluster.write_status(Kind.MAPPING_RUN, run, state_fields(state), fresh)
            return None
        except InputError as error:
            await self._recorder.refuse(cluster, run, state, Reason.INVALID_PARAMETERS, str(error))
            return None
        if (lack := _lacks_image(facts)) is not None:
            await self._recorder.refuse(cluster, run, state, *lack)
            return None
        return await self._run_to_end(cluster, facts, state)

    def _facts(self, cluster: Cluster, key: Key, run: dict[str, Any], state: RunState) -> RunFacts:
        spec = run["spec"]
        algorithm = self._catalogue.algorithm(cluster.store, key.namespace, spec["algorithmRef"]["name"])
        dataset = self._catalogue.dataset(cluster.store, key.namespace, spec["datasetRef"]["name"])
        uid = run["metadata"]["uid"]
        # A run's spec never changes but for `cancel`, so it is resolved once; the uid tells a later run of
        # the same name.
        known = self._resolved.get(key)
        if known is None or known.uid != uid:
            resolved = resolve({name: spec[name] for name in spec if name != "cancel"}, algorithm, dataset)
            if not state.attempts and sweep_of(run) is None:  # a Sweep's hold what takes effect alone
                _insist_on_effects(resolved, algorithm, dataset)
            wanted = Wanted.by(resolved, algorithm, dataset)
            known = self._resolved[key] = _Resolved(uid, resolved, spec_hash(resolved), wanted)
        created = moment(run["metadata"].get("creationTimestamp")) or 0.0
        jobs = cluster.store.jobs_of(uid, Role.RUN)
        job = max(jobs, key=lambda found: int(labels_of(found).get(Label.ATTEMPT) or 0), default=None)
        return RunFacts(
            key=key,
            body=run,
            spec=known.spec,
            spec_hash=known.hash,
            algorithm=algorithm,
            dataset=dataset,
            wanted=known.wanted,
            variant=variants.look(cluster, key.namespace, known.wanted, max(created, state.not_before)),
            attempted=_seen(cluster, key, run, job, state),
            job=job,
        )

    async def _run_to_end(self, cluster: Cluster, facts: RunFacts, state: RunState) -> float | None:
        """Do what is next for a run that has all it needs; returns when to look again."""
        if facts.is_lost and await self._is_there(cluster, facts, state.attempts):
            return _TAKEN_SECONDS
        attempted, again = await self._with_report(cluster, facts, state)
        if attempted is None:
            return again
        disruptions = Disruptions.of(facts.body["status"], attempted)
        waits = await patience(cluster, facts.job, attempted.waiting, room_seconds=0.0)
        waits = disruptions.told(attempted, waits)
        facts = replace(facts, attempted=_borne(attempted, waits), disruptions=disruptions)
        # The status may be older than the Jobs: an operator can die between creating one and counting it.
        state = replace(state, attempts=max(state.attempts, attempted.number or 0))
        now = cluster.clock()
        # Looked for only where an attempt could begin: it can cost a query to the archive.
        may_begin = facts.attempted.state is AttemptState.NONE and state.not_before <= now
        equal = await self._reusable.find(cluster, facts) if may_begin and not facts.is_cancelled else None
        decision = decide_run(state, _observed(facts, is_reusable=equal is not None), now)
        starts = any(isinstance(action, Start) for action in decision.actions)
        try:
            delay = await self._act(cluster, facts, decision)
        except InputError as error:
            await self._recorder.refuse(cluster, facts.body, state, Reason.INVALID_PARAMETERS, str(error))
            return None
        except REFUSALS as error:
            prepares = any(isinstance(action, Prepare) for action in decision.actions)
            if error.retryable or not (starts or prepares):
                raise
            return await self._denied(cluster, facts, state, error)
        if waits.end is not None and facts.job is not None:
            await cluster.delete(key_of(Kind.JOB, facts.job))  # it would go on trying
            if facts.attempted.may_lack_variant:
                await variants.lose(cluster, facts.dataset_key, facts.wanted.name)
        # A start writes no status: the Job itself says that it was made, and its pod's events lead back here.
        if not starts:
            await self._recorder.record(cluster, facts, decision.state, equal)
        again = None if decision.look_again_at is None else decision.look_again_at - now
        return soonest(waits.seconds, delay, again)

    async def _with_report(
        self, cluster: Cluster, facts: RunFacts, state: RunState
    ) -> tuple[Attempted | None, float | None]:
        """Return the newest attempt with what its monitor left; None and when to look while that is read."""
        attempted = facts.attempted
        if not attempted.needs_read:
            return attempted, None
        # The termination message is a copy that can be missing. The truth is summary.json on the results
        # volume, which the operator does not mount: a Job reads it.
        body = read_job(
            run=facts.body, pod_uid=attempted.pod_uid, attempt=attempted.number, settings=cluster.settings
        )
        key = key_of(Kind.JOB, body)
        job = cluster.store.get(key)
        if job is None:
            try:
                job = await cluster.create(Kind.JOB, body)
            except AlreadyExists:
                job = await cluster.refresh(key)
            except REFUSALS as error:
                if error.retryable:
                    raise
                return None, await self._denied(cluster, facts, state, error)
        seen = observe_job(job, await cluster.pods_of(job))
        if seen.is_lost:
            await cluster.delete(key)  # that leads back here, and to another
            return None, None
        if seen.state is AttemptState.ENDED:
            return attempted.with_report(read_report(seen.words), seen.problem), None
        waits = await patience(cluster, job, seen.waiting)
        if waits.end is not None:
            await cluster.delete(key)  # it would go on trying
            return attempted.with_report(None, (Reason.SYSTEM_FAULT, waits.end.message or "")), None
        if waits.waiting is not None:
            told = f"what its monitor left is not read yet: {waits.why}"
            fresh = [condition("Scheduled", False, waits.waiting.reason, told)]
            await cluster.write_status(Kind.MAPPING_RUN, facts.body, state_fields(state), fresh)
        return None, waits.seconds

    @staticmethod
    async def _is_there(cluster: Cluster, facts: RunFacts, attempt: int) -> bool:
        """Check the API for the attempt's Job: another operator may have made it, unseen by our watch."""
        job = await cluster.refresh(Key(Kind.JOB, facts.key.namespace, job_name(facts.key.name, attempt)))
        return job is not None and facts.uid in owner_uids(job)

    async def _act(self, cluster: Cluster, facts: RunFacts, decision: Decision) -> float | None:
        """Do what was decided; returns after how many seconds to try what cannot be done now."""
        delay = None
        for action in decision.actions:
            match action:
                case Prepare():
                    delay = await variants.make(
                        cluster, facts.key.namespace, facts.wanted, _needing(facts.body)
                    )
                case Start(attempt):
                    delay = await self._start(cluster, facts, attempt)
                case Stop() if facts.job is not None:
                    await cluster.delete(key_of(Kind.JOB, facts.job))
                case _:  # evaluating follows from the finished status
                    pass
        if not decision.actions and decision.state.phase is Phase.PREPARING:
            await variants.join(cluster, facts.key.namespace, facts.wanted, _needing(facts.body))
        return delay

    async def _start(self, cluster: Cluster, facts: RunFacts, attempt: int) -> float | None:
        description = facts.variant.description or {}
        told = configuration(facts.key.name, facts.spec, facts.dataset, description)
        companion = player(
            run=facts.body,
            algorithm=facts.algorithm,
            configuration=told,
            description=description,
            settings=cluster.settings,
        )
        body = run_job(
            run=facts.body,
            spec=facts.spec,
            algorithm=facts.algorithm,
            configuration=told,
            description=description,
            attempt=attempt,
            settings=cluster.settings,
            companion=companion,
        )
        # The Job's name follows from run and attempt: after a crash, or beside a second operator, the first
        # Job is found and no second one is made.
        try:
            await cluster.create(Kind.JOB, body)
        except AlreadyExists:
            found = await cluster.refresh(key_of(Kind.JOB, body))
            ours = found is not None and facts.uid in owner_uids(found)
            if found is None or not ours or found["metadata"].get("deletionTimestamp"):
                return _TAKEN_SECONDS  # a namesake's Job that is on its way out
        except Forbidden as error:
            if not error.is_quota:
                raise
            fresh = [condition("Scheduled", False, "QuotaExceeded", str(error))]
            await cluster.write_status(Kind.MAPPING_RUN, facts.body, conditions=fresh)
            return AGAIN_SECONDS
        await variants.touch(cluster, facts.dataset_key, facts.wanted.name)
        # A pod that begins as pods do leads to no look; where none comes, one has to ask why.
        return POD_SECONDS

    async def _denied(
        self, cluster: Cluster, facts: RunFacts, state: RunState, error: ApiError
    ) -> float | None:
        """Tell that the cluster refuses a Job; the run fails when it does so for long."""
        message = str(error)
        # The condition's own time is used, so that a restart of the operator does not begin the patience
        # anew.
        begun = since(facts.body["status"], "Admitted", standing=False)
        again = refused_seconds(cluster, cluster.clock() if begun is None else begun)
        fresh = [condition("Admitted", False, "JobRefused", message)]
        if again is None:
            await self._recorder.refuse(cluster, facts.body, state, Reason.SYSTEM_FAULT, message, why=fresh)
            return None
        fresh.append(condition("Accepted", True, "Accepted"))
        await cluster.write_status(Kind.MAPPING_RUN, facts.body, state_fields(state), fresh)
        if begun is None:
            await cluster.api.event(Kind.MAPPING_RUN, facts.body, "Warning", "JobRefused", message)
        return again


def _borne(attempted: Attempted, waits: Patience) -> Attempted:
    """Return an attempt with what is to be said of its waiting, or as ended by it."""
    if waits.end is None:
        return replace(attempted, waiting=waits.waiting)
    return replace(attempted, waiting=waits.waiting, state=AttemptState.ENDED, end=waits.end)


def _observed(facts: RunFacts, *, is_reusable: bool) -> RunObserved:
    """Return the engine's view of a run."""
    attempted, spec = facts.attempted, facts.spec
    return RunObserved(
        retries=spec["retries"],
        cancel=facts.is_cancelled,
        reusable=is_reusable,
        variant=facts.variant.state,
        variant_problem=facts.variant.problem,
        attempt=attempted.state,
        end=attempted.end,
        number=attempted.number,
        wants_evaluation=spec["evaluate"],
        suspicion=(facts.variant.description or {}).get("suspicion"),
    )


def _seen(
    cluster: Cluster, key: Key, run: dict[str, Any], job: dict[str, Any] | None, state: RunState
) -> Attempted:
    """Return the newest attempt as Job, pods and status show it."""
    told = condition_of(run, "Scheduled") or {}
    interrupted = told.get("reason") == TERMINATING
    if job is not None:
        status = run.get("status") or {}
        # While the status says why it doesn't run, what took its pod is counted already.
        counted = phase_of(status) is not Phase.RUNNING or told.get("status") == "False"
        return observe_attempt(
            job,
            cluster.store.pods_of(job),
            was_interrupted=interrupted,
            at_work_since=None if counted else moment(status.get("startTime")),
        )
    # Of a Job that was deleted the pod lives on for its grace time, and nothing may run beside it.
    found = cluster.store.select(Kind.POD, key.namespace, Label.RUN, label_value(key.name))
    pods = [pod for pod in found if labels_of(pod).get(Label.ROLE) == Role.RUN]
    made = run["metadata"].get("creationTimestamp") or ""
    own = [pod for pod in pods if (pod["metadata"].get("creationTimestamp") or "") >= made]
    if live_pods(own):
        waiting = Waiting(TERMINATING, "its Job was deleted, and its pod has not ended")
        return replace(observe_attempt(None, live_pods(own)), waiting=waiting)
    if live_pods(pods):
        waiting = Waiting(TERMINATING, "the pod of an earlier run of this name has not ended")
        return Attempted(AttemptState.RUNNING, waiting=waiting)
    if state.phase is not Phase.RUNNING or state.attempts <= state.judged or run["spec"].get("cancel"):
        return Attempted()
    interrupted |= any(pod["status"].get("phase") == "Failed" for pod in own)
    return observe_lost(state.attempts, was_interrupted=interrupted)


def _insist_on_effects(spec: dict[str, Any], algorithm: Algorithm, dataset: Dataset) -> None:
    """Refuse what a recording can't give.

    Raises:
        InputError: one sentence a line.
    """
    mode = algorithm.spec.mode(SensorMode(spec["sensors"]))
    problems = option_problems(spec["input"], dataset, mode)
    if problems:
        raise InputError("\n".join(f"spec.{problem}" for problem in problems))


def _lacks_image(facts: RunFacts) -> tuple[Reason, str] | None:
    """Return the reason to refuse a run where a program of it has no image; None where all have one."""
    if not facts.algorithm.spec.image:
        message = f"Algorithm {facts.algorithm.name!r} names no image, which a cluster needs"
        return Reason.ALGORITHM_UNAVAILABLE, message
    name = InputOptions.model_validate(facts.spec["input"]).program
    if name is None or facts.dataset.spec.preparation(name).image:
        return None
    title = program_title(name, facts.dataset.name)
    return Reason.PREPARATION_FAILED, f"{title} names no image, which a cluster needs"


def _needing(run: dict[str, Any]) -> dict[str, Any]:
    """Return the reference to what needs a run's variant: its Sweep, or itself."""
    sweep = sweep_of(run)
    if sweep is None:
        return reference(Kind.MAPPING_RUN, run)
    # Several Sweeps can own one preparation, but an object can have one controller at most.
    return {key: value for key, value in sweep.items() if key != "controller"}
