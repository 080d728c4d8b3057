# SPDX-License-Identifier: Apache-2.0
"""Recording of what becomes of a MappingRun: into its status, and to those who look at figures and Events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.engine import AttemptState, RunObserved, RunState, decide_run
from slamhive.kube.api.kinds import Key, Kind, Label, key_of, labels_of
from slamhive.kube.observing import DISRUPTED, PREPARATION_WAITS, TERMINATING
from slamhive.kube.pods import condition as condition_of
from slamhive.kube.reconciling.run_status import (
    RunFacts,
    attempt_fields,
    provenance,
    reused_fields,
    usage_suspect,
)
from slamhive.kube.reconciling.sweep_runs import is_archive_only
from slamhive.kube.status import condition, holds, iso, phase_of, state_fields
from slamhive.model.results import Phase, Reason
from slamhive.model.status import AlgorithmStatus, MappingRunStatus
from slamhive.plan import image_digest

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.catalogue import Catalogue
    from slamhive.kube.reconciling.evaluating import Evaluations
    from slamhive.kube.reconciling.reuse import ReusableRuns
    from slamhive.model.results import RunRecord


class RunRecorder:
    """Writes the statuses of MappingRuns.

    Args:
        catalogue: Algorithms and Datasets.
        evaluations: who measures finished runs.
        reusable: finished runs by content.
        has_archive: whether there is an archive, which alone is told of the ends of some runs.
    """

    def __init__(
        self, catalogue: Catalogue, evaluations: Evaluations, reusable: ReusableRuns, *, has_archive: bool
    ) -> None:
        self._has_archive = has_archive
        self._catalogue = catalogue
        self._evaluations = evaluations
        self._reusable = reusable

    @staticmethod
    async def refuse(
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
        await announce(cluster, key_of(Kind.MAPPING_RUN, run))

    async def record(
        self, cluster: Cluster, facts: RunFacts, state: RunState, equal: RunRecord | None
    ) -> None:
        """Write what is new of a run.

        Args:
            cluster: the cluster.
            facts: the run.
            state: what was decided.
            equal: the run whose result it takes, if any.
        """
        attempted = facts.attempted
        begins = state.phase is Phase.RUNNING and attempted.started is None
        if begins and attempted.waiting is None and Label.SWEEP in labels_of(facts.body):
            return  # the Job says that it was created, and the Sweep that somebody is at work
        status = state_fields(state) | MappingRunStatus(variant=facts.wanted.name)
        fresh = [condition("Accepted", True, "Accepted"), *_scheduling(facts, state)]
        taken = facts.disruptions
        if taken.is_news:
            status |= MappingRunStatus(disruptions=taken.count, disrupted_pod=taken.pod)
        if holds(facts.body["status"], "Admitted") is False:
            fresh.append(condition("Admitted", True, "Admitted"))
        if begins:
            # For the engine the attempt runs from its Job on; people read Pending, with the reason, until its
            # program does.
            status |= MappingRunStatus(phase=Phase.PENDING)
        elif state.phase is Phase.RUNNING:
            status |= MappingRunStatus(start_time=attempted.started)
        if state.phase.is_finished:
            left, told = self._finished(cluster, facts, state, equal)
            status |= left
            fresh += told
            await self._note_image(
                cluster, facts
            )  # before those that wait for the run's end look for one like it
        untold = self._has_archive and state.phase.is_finished and is_archive_only(facts.body)
        await cluster.write_status(Kind.MAPPING_RUN, facts.body, status, fresh, untold=untold)
        if taken.is_news:
            why = attempted.waiting.message if attempted.waiting else "its pod was taken away"
            text = why if taken.sentence in why else f"{why}; {taken.sentence}"
            await cluster.api.event(Kind.MAPPING_RUN, facts.body, "Warning", DISRUPTED, text)
        if state.phase.is_finished:
            await announce(cluster, facts.key)
            run = cluster.store.get(facts.key)
            if run is not None:
                self._reusable.learn(run)
                self._evaluations.consider(cluster, run)

    def _finished(
        self, cluster: Cluster, facts: RunFacts, state: RunState, equal: RunRecord | None
    ) -> tuple[MappingRunStatus, list[dict[str, Any]]]:
        """Return the record of a run that has ended."""
        attempted, now = facts.attempted, cluster.clock()
        fresh = [condition("Complete", True, str(state.reason or state.phase), state.message or "")]
        if equal is not None and state.phase is Phase.SUCCEEDED:
            return reused_fields(equal, facts, self._reusable.conditions), [
                *fresh,
                condition("Reused", True, "EqualRun", f"took {equal.name}'s result"),
            ]
        if attempted.state is not AttemptState.ENDED:
            return MappingRunStatus(completion_time=iso(now)), fresh
        image = image_digest(attempted.image_id) if attempted.image_id else None
        hashed = self._reusable.content_hash(facts, image)
        status = attempt_fields(facts.uid, attempted, now)
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


async def announce(cluster: Cluster, key: Key) -> None:
    """Tell those who look at figures and Events how a run ended."""
    run = cluster.store.get(key)
    if run is None:
        return
    spec, status = run["spec"], run["status"]
    cluster.metrics.record_finished(spec["algorithmRef"]["name"], spec["datasetRef"]["name"], status)
    if phase_of(status) is Phase.FAILED:
        text = status.get("message") or ""
        await cluster.api.event(Kind.MAPPING_RUN, run, "Warning", status.get("reason") or "Failed", text)


def _scheduling(facts: RunFacts, state: RunState) -> list[dict[str, Any]]:
    attempted = facts.attempted
    if state.phase is Phase.PREPARING:
        if facts.variant.waiting is not None:
            told = f"its preparation does not begin: {facts.variant.waiting}"
            return [condition("Scheduled", False, PREPARATION_WAITS, told)]
        # It began: whether the run itself finds a node is not known yet.
        waited = holds(facts.body["status"], "Scheduled") is False
        return [condition("Scheduled", None, "Preparing")] if waited else []
    waiting = attempted.waiting
    if waiting is not None and not state.phase.is_finished:
        return [condition("Scheduled", False, waiting.reason, waiting.message)]
    before = condition_of(facts.body, "Scheduled") or {}
    if attempted.node is not None or (state.phase.is_finished and before.get("reason") == TERMINATING):
        return [condition("Scheduled", True, "Scheduled")]
    return []
