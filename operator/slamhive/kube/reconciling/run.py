# SPDX-License-Identifier: Apache-2.0
"""Reconciler of a MappingRun: from its spec through its variant and its Job to a status.

What is seen goes to ``decide_run``; what it decides is done here. At most four writes: the Job, the status
when it starts, the status when it ends, and later its results.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from slamhive.engine import (
    AttemptEnd,
    AttemptState,
    Prepare,
    RunObserved,
    RunState,
    Start,
    Stop,
    decide_run,
)
from slamhive.kube.api.errors import REFUSALS, AlreadyExists, ApiError, Forbidden
from slamhive.kube.api.kinds import Key, Kind, Label, Role, key_of, reference
from slamhive.kube.builders import configuration, read_job, run_job
from slamhive.kube.builders.player import player
from slamhive.kube.builders.run import job_name
from slamhive.kube.observing import POD_SECONDS, Attempted, ReadObserved, observe_attempt, observe_read
from slamhive.kube.reconciling import variants
from slamhive.kube.reconciling.refusals import why_no_pod
from slamhive.kube.reconciling.run_status import (
    RunFacts,
    attempt_fields,
    provenance,
    reused_fields,
    usage_suspect,
)
from slamhive.kube.reconciling.variants import Wanted
from slamhive.kube.status import (
    condition,
    holds,
    iso,
    moment,
    phase_of,
    run_state,
    since,
    state_fields,
)
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.results import Phase, Reason
from slamhive.model.sensors import SensorMode
from slamhive.model.status import AlgorithmStatus, MappingRunStatus
from slamhive.plan import image_digest, option_problems, resolve, spec_hash

if TYPE_CHECKING:
    from slamhive.engine import Decision
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.catalogue import Catalogue
    from slamhive.kube.reconciling.evaluating import Evaluations
    from slamhive.kube.reconciling.reuse import Twins
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset
    from slamhive.model.results import RunRecord

_TAKEN_SECONDS = 2.0
_QUOTA_SECONDS = 15.0
_PODLESS_SECONDS = 15.0


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
        twins: finished runs by content.
    """

    def __init__(self, catalogue: Catalogue, evaluations: Evaluations, twins: Twins) -> None:
        self._catalogue = catalogue
        self._evaluations = evaluations
        self._twins = twins
        self._waiting: set[Key] = set()
        self._resolved: dict[Key, _Resolved] = {}

    def waiting(self, namespace: str) -> list[Key]:
        """Return the runs that wait for the catalog."""
        return [key for key in self._waiting if key.namespace == namespace]

    async def __call__(self, cluster: Cluster, key: Key) -> float | None:
        """Look at a run, do what is to be done next, and write what changed."""
        self._waiting.discard(key)
        run = cluster.store.get(key)
        if run is None or run["metadata"].get("deletionTimestamp"):
            self._resolved.pop(key, None)
            if run is None:
                self._twins.forget(key)
            return None
        if phase_of(run["status"]).is_finished:
            self._resolved.pop(key, None)
            self._twins.learn(run)
            self._evaluations.consider(cluster, run)
            return None
        state = run_state(MappingRunStatus.of(run))
        try:
            facts = self._look(cluster, key, run, state)
        except UnknownNameError as error:
            self._waiting.add(key)
            fresh = [condition("Accepted", False, "CatalogIncomplete", str(error))]
            await cluster.write_status(Kind.MAPPING_RUN, run, state_fields(state), fresh)
            return None
        except InputError as error:
            await self._refuse(cluster, run, state, Reason.INVALID_PARAMETERS, str(error))
            return None
        if not facts.algorithm.spec.image:
            message = f"Algorithm {facts.algorithm.name!r} names no image, which a cluster needs"
            await self._refuse(cluster, run, state, Reason.ALGORITHM_UNAVAILABLE, message)
            return None
        return await self._lead(cluster, facts, state)

    def _look(self, cluster: Cluster, key: Key, run: dict[str, Any], state: RunState) -> RunFacts:
        spec = run["spec"]
        algorithm = self._catalogue.algorithm(cluster.store, key.namespace, spec["algorithmRef"]["name"])
        dataset = self._catalogue.dataset(cluster.store, key.namespace, spec["datasetRef"]["name"])
        uid = run["metadata"]["uid"]
        # A run's spec never changes but for `cancel`, so it is resolved once; the uid tells a later run of
        # the same name.
        known = self._resolved.get(key)
        if known is None or known.uid != uid:
            resolved = resolve({name: spec[name] for name in spec if name != "cancel"}, algorithm, dataset)
            if not state.attempts:
                _insist_on_effects(resolved, algorithm, dataset)
            wanted = Wanted.by(resolved, algorithm, dataset)
            known = self._resolved[key] = _Resolved(uid, resolved, spec_hash(resolved), wanted)
        created = moment(run["metadata"].get("creationTimestamp")) or 0.0
        job, attempted = self._newest(cluster, uid)
        return RunFacts(
            key=key,
            body=run,
            spec=known.spec,
            spec_hash=known.hash,
            algorithm=algorithm,
            dataset=dataset,
            wanted=known.wanted,
            variant=variants.look(cluster, key.namespace, known.wanted, max(created, state.not_before)),
            attempted=attempted,
            job=job,
        )

    @staticmethod
    def _newest(cluster: Cluster, uid: str) -> tuple[dict[str, Any] | None, Attempted]:
        jobs = [
            job
            for kind, job in cluster.store.owned(uid)
            if kind is Kind.JOB and _label(job, Label.ROLE) == Role.RUN
        ]
        job = max(jobs, key=lambda found: int(_label(found, Label.ATTEMPT) or 0), default=None)
        return job, observe_attempt(job, cluster.store.pods_of(job))

    async def _lead(self, cluster: Cluster, facts: RunFacts, state: RunState) -> float | None:
        attempted = facts.attempted
        # The termination message is a copy that can be missing. The truth is summary.json on the results
        # volume, which the operator does not mount: a Job reads it.
        if attempted.needs_read:
            seen = await self._read(cluster, facts)
            if not seen.ended:
                return None
            attempted = attempted.with_report(seen.report, seen.problem)
            facts = replace(facts, attempted=attempted)
        now = cluster.clock()
        waits_for = []
        # Only Events say why a Job has no pod. They cost a call, so a new Job first gets the time that it
        # usually takes.
        if attempted.lacks_pod and attempted.usual_until <= now and facts.job is not None:
            attempted = attempted.with_refusal(await why_no_pod(cluster, facts.job))
            facts = replace(facts, attempted=attempted)
            waits_for.append(_PODLESS_SECONDS)
        patience = attempted.give_up_at(
            cluster.settings.image_pull_grace_seconds, cluster.settings.refusal_grace_seconds
        )
        waits_for += [patience - now] if patience is not None and patience > now else []
        if patience is not None and patience <= now:
            attempted = attempted.given_up()
            facts = replace(facts, attempted=attempted)
        # The status may be older than the Jobs: an operator can die between creating one and counting it.
        state = replace(state, attempts=max(state.attempts, attempted.number or 0))
        if _is_lost(attempted.state, state) and await self._is_there(cluster, facts, state.attempts):
            return _TAKEN_SECONDS
        fresh = attempted.state is AttemptState.NONE and state.not_before <= now
        cancel = bool(facts.body["spec"].get("cancel"))
        # Looked for only where an attempt could begin: it can cost a query to the archive.
        twin = await self._twins.find(cluster, facts) if fresh and not cancel else None
        decision = decide_run(state, self._observed(facts, state, twin), now)
        delay, denied = await self._try(cluster, facts, state, decision)
        if denied:
            return delay
        if patience is not None and patience <= now and facts.job is not None:
            await cluster.delete(key_of(Kind.JOB, facts.job))  # it would go on trying
            if attempted.may_lack_variant:
                await variants.lose(cluster, facts.dataset_key, facts.wanted.name)
        starts = any(isinstance(action, Start) for action in decision.actions)
        # A start writes no status: the Job itself says that it was made, and its pod's events lead back here.
        # This keeps a run at five writes.
        told = None if starts else await self._record(cluster, facts, decision.state, twin)
        if decision.look_again_at is not None:
            waits_for.append(decision.look_again_at - now)
        waits_for += [seconds for seconds in (delay, told) if seconds is not None]
        return min(waits_for, default=None)

    @staticmethod
    def _observed(facts: RunFacts, state: RunState, twin: RunRecord | None) -> RunObserved:
        """Return the engine's view of a run."""
        attempted, spec = facts.attempted, facts.spec
        attempt, end, number = attempted.state, attempted.end, attempted.number
        if _is_lost(attempt, state):
            attempt, number = AttemptState.ENDED, state.attempts
            end = AttemptEnd(reason=Reason.SYSTEM_FAULT, message="its Job was deleted by someone else")
        return RunObserved(
            retries=spec["retries"],
            cancel=bool(facts.body["spec"].get("cancel")),
            reusable=twin is not None,
            variant=facts.variant.state,
            variant_problem=facts.variant.problem,
            attempt=attempt,
            end=end,
            number=number,
            wants_evaluation=spec["evaluate"],
        )

    @staticmethod
    async def _is_there(cluster: Cluster, facts: RunFacts, attempt: int) -> bool:
        """Check the API for the attempt's Job: another operator may have made it, unseen by our watch."""
        job = await cluster.refresh(Key(Kind.JOB, facts.key.namespace, job_name(facts.key.name, attempt)))
        owners = (job["metadata"].get("ownerReferences") or ()) if job else ()
        return facts.body["metadata"]["uid"] in {owner["uid"] for owner in owners}

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
            image=cluster.settings.player_image,
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
            owners = (found["metadata"].get("ownerReferences") or ()) if found else ()
            ours = facts.body["metadata"]["uid"] in {item["uid"] for item in owners}
            if found is None or not ours or found["metadata"].get("deletionTimestamp"):
                return _TAKEN_SECONDS  # a namesake's Job that is on its way out
        except Forbidden as error:
            if not error.is_quota:
                raise
            fresh = [condition("Scheduled", False, "QuotaExceeded", str(error))]
            await cluster.write_status(Kind.MAPPING_RUN, facts.body, conditions=fresh)
            return _QUOTA_SECONDS
        await variants.touch(
            cluster, Key(Kind.DATASET, facts.key.namespace, facts.dataset.name), facts.wanted.name
        )
        # A pod that begins as pods do leads to no look; where none comes, one has to ask why.
        return POD_SECONDS

    async def _try(
        self, cluster: Cluster, facts: RunFacts, state: RunState, decision: Decision
    ) -> tuple[float | None, bool]:
        """Do what was decided; returns when to come back, and whether a Job can't be made, which is told."""
        try:
            return await self._act(cluster, facts, decision), False
        except InputError as error:
            await self._refuse(cluster, facts.body, state, Reason.INVALID_PARAMETERS, str(error))
            return None, True
        except REFUSALS as error:
            if not any(isinstance(action, Prepare | Start) for action in decision.actions):
                raise
            return await self._denied(cluster, facts, state, error), True

    async def _denied(
        self, cluster: Cluster, facts: RunFacts, state: RunState, error: ApiError
    ) -> float | None:
        """Tell that the cluster refuses a Job; the run fails when it does so for long."""
        now, message = cluster.clock(), str(error)
        # The condition's own time is used, so that a restart of the operator does not begin the patience
        # anew.
        begun = since(facts.body["status"], "Admitted", standing=False)
        left = (now if begun is None else begun) + cluster.settings.refusal_grace_seconds - now
        fresh = [condition("Admitted", False, "JobRefused", message)]
        if left <= 0:
            await self._refuse(cluster, facts.body, state, Reason.SYSTEM_FAULT, message, why=fresh)
            return None
        fresh.append(condition("Accepted", True, "Accepted"))
        await cluster.write_status(Kind.MAPPING_RUN, facts.body, state_fields(state), fresh)
        if begun is None:
            await cluster.api.event(Kind.MAPPING_RUN, facts.body, "Warning", "JobRefused", message)
        return min(left, _QUOTA_SECONDS)

    @staticmethod
    async def _read(cluster: Cluster, facts: RunFacts) -> ReadObserved:
        """Have a Job read what the pod did not tell; returns what is seen of it."""
        body = read_job(run=facts.body, pod_uid=facts.attempted.pod_uid or "", settings=cluster.settings)
        key = key_of(Kind.JOB, body)
        job = cluster.store.get(key)
        if job is None:
            try:
                job = await cluster.create(Kind.JOB, body)
            except AlreadyExists:
                job = await cluster.refresh(key)
        return observe_read(job, cluster.store.pods_of(job))

    async def _refuse(
        self,
        cluster: Cluster,
        run: dict[str, Any],
        state: RunState,
        reason: Reason,
        message: str,
        *,
        why: list[dict[str, Any]] | None = None,
    ) -> None:
        """Have a run fail that cannot start; ``why`` are conditions in the place of Accepted."""
        after = decide_run(state, RunObserved(problem=(reason, message)), cluster.clock()).state
        fresh = why or [condition("Accepted", False, str(reason), message)]
        fresh.append(condition("Complete", True, str(reason), message))
        ended = state_fields(after) | MappingRunStatus(completion_time=iso(cluster.clock()))
        await cluster.write_status(Kind.MAPPING_RUN, run, ended, fresh)
        await _announce(cluster, key_of(Kind.MAPPING_RUN, run))

    async def _record(
        self, cluster: Cluster, facts: RunFacts, state: RunState, twin: RunRecord | None
    ) -> float | None:
        """Write what is new; returns the seconds after which there may be more."""
        attempted = facts.attempted
        usual = attempted.usual_until - cluster.clock()
        waits = attempted.waiting_reason is not None and usual <= 0
        if state.phase is Phase.RUNNING and attempted.started is None and not waits:
            return usual if usual > 0 else None  # the Job says that it was created
        status = state_fields(state) | MappingRunStatus(variant=facts.wanted.name)
        fresh = [condition("Accepted", True, "Accepted"), *_scheduling(facts, state)]
        if holds(facts.body["status"], "Admitted") is False:
            fresh.append(condition("Admitted", True, "Admitted"))
        if state.phase is Phase.RUNNING and attempted.started is None:
            # For the engine the attempt runs from its Job on; people read Pending, with the reason, until its
            # program does.
            status |= MappingRunStatus(phase=Phase.PENDING)
        elif state.phase is Phase.RUNNING:
            status |= MappingRunStatus(start_time=attempted.started)
        if state.phase.is_finished:
            left, told = self._finished(cluster, facts, state, twin)
            status |= left
            fresh += told
        if state.phase.is_finished:
            await self._note_image(
                cluster, facts
            )  # before those that wait for the run's end look for its twins
        await cluster.write_status(Kind.MAPPING_RUN, facts.body, status, fresh)
        if state.phase.is_finished:
            await self._after(cluster, facts)
        return None

    def _finished(
        self, cluster: Cluster, facts: RunFacts, state: RunState, twin: RunRecord | None
    ) -> tuple[MappingRunStatus, list[dict[str, Any]]]:
        """Return the record of a run that has ended."""
        attempted, now = facts.attempted, cluster.clock()
        fresh = [condition("Complete", True, str(state.reason or state.phase), state.message or "")]
        if twin is not None and state.phase is Phase.SUCCEEDED:
            return reused_fields(twin, facts, self._twins.processors), [
                *fresh,
                condition("Reused", True, "EqualRun", f"took {twin.name}'s result"),
            ]
        if attempted.state is not AttemptState.ENDED:
            return MappingRunStatus(completion_time=iso(now)), fresh
        image = image_digest(attempted.image_id) if attempted.image_id else None
        hashed = self._twins.content_hash(facts, image)
        status = attempt_fields(facts.body["metadata"]["uid"], attempted, now)
        produced = provenance(
            attempted,
            facts,
            algorithm_hash=self._catalogue.algorithm_hash(facts.algorithm),
            content_hash=hashed,
        )
        status |= MappingRunStatus(provenance=produced)
        # An independent witness: the metrics API measures the same container from outside the pod.
        shown = cluster.usage.observed(attempted.pod_uid or "")
        usage = attempted.report.usage if attempted.report else None
        suspect = shown and usage_suspect(usage, shown.max_cores, shown.max_memory_bytes)
        if usage is not None and usage.suspect:
            fresh.append(condition("UsageSuspect", True, "FiguresDoubted", usage.suspect))
        elif usage is not None and suspect:
            fresh.append(condition("UsageSuspect", True, "SourcesDisagree", suspect))
            status |= MappingRunStatus(usage=usage.replace(suspect=suspect))
        return status, fresh

    async def _after(self, cluster: Cluster, facts: RunFacts) -> None:
        run = cluster.store.get(facts.key)
        if run is not None:
            await _announce(cluster, facts.key)
            self._twins.learn(run)
            self._evaluations.consider(cluster, run)

    @staticmethod
    async def _note_image(cluster: Cluster, facts: RunFacts) -> None:
        """Keep what an Algorithm's tag means today, so that equal runs are known before they start."""
        image = facts.attempted.image_id
        key = Key(Kind.ALGORITHM, facts.key.namespace, facts.algorithm.name)
        algorithm = cluster.store.get(key)
        if not image or algorithm is None or AlgorithmStatus.of(algorithm).image_id == image:
            return
        # Not for one version alone: of runs that end at the same time any may be the last to say so.
        patch = AlgorithmStatus(image_id=image).as_patch()
        await cluster.patch(key, {"status": patch}, subresource="status")


async def _announce(cluster: Cluster, key: Key) -> None:
    """Tell those who look at figures and Events how a run ended."""
    run = cluster.store.get(key)
    if run is None:
        return
    spec, status = run["spec"], run["status"]
    cluster.metrics.record_finished(spec["algorithmRef"]["name"], spec["datasetRef"]["name"], status)
    if phase_of(status) is Phase.FAILED:
        text = status.get("message") or ""
        await cluster.api.event(Kind.MAPPING_RUN, run, "Warning", status.get("reason") or "Failed", text)


def _is_lost(attempt: AttemptState, state: RunState) -> bool:
    """Tell whether the Job of an attempt that was running is not seen any more."""
    return attempt is AttemptState.NONE and state.phase is Phase.RUNNING and state.attempts > state.judged


def _insist_on_effects(spec: dict[str, Any], algorithm: Algorithm, dataset: Dataset) -> None:
    """Refuse what a recording can't give; a Sweep's runs hold what takes effect already.

    Raises:
        InputError: one sentence a line.
    """
    mode = algorithm.spec.mode(SensorMode(spec["sensors"]))
    problems = option_problems(spec["input"], dataset, mode)
    if problems:
        raise InputError("\n".join(f"spec.{problem}" for problem in problems))


def _label(obj: dict[str, Any], label: str) -> str | None:
    value = (obj["metadata"].get("labels") or {}).get(label)
    return str(value) if value is not None else None


def _needing(run: dict[str, Any]) -> dict[str, Any]:
    """Return the reference to what needs a run's variant: its Sweep, or itself."""
    for owner in run["metadata"].get("ownerReferences") or ():
        if owner.get("kind") == Kind.SWEEP:
            # Several Sweeps can own one preparation, but an object can have one controller at most.
            return {key: value for key, value in owner.items() if key != "controller"}
    return reference(Kind.MAPPING_RUN, run)


def _scheduling(facts: RunFacts, state: RunState) -> list[dict[str, Any]]:
    attempted = facts.attempted
    if state.phase is Phase.PREPARING:
        if facts.variant.waiting is not None:
            told = f"its preparation does not begin: {facts.variant.waiting}"
            return [condition("Scheduled", False, "PreparationWaits", told)]
        # It began: whether the run itself finds a node is not known yet.
        waited = holds(facts.body["status"], "Scheduled") is False
        return [condition("Scheduled", None, "Preparing")] if waited else []
    if attempted.waiting_reason is not None and not state.phase.is_finished:
        return [condition("Scheduled", False, attempted.waiting_reason, attempted.waiting_message or "")]
    if attempted.node is not None:
        return [condition("Scheduled", True, "Scheduled")]
    return []
