# SPDX-License-Identifier: Apache-2.0
"""Results of evaluator Jobs: taken from their logs into the statuses of the runs that they measured.

A run whose result can't be had is given up, with the reason: evaluation_status.py.
"""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

from slamhive.jobs.lines import Decoder
from slamhive.kube.api.encoding import encode
from slamhive.kube.api.errors import Invalid, NotFound
from slamhive.kube.api.kinds import Key, Kind, Object, annotations_of, key_of
from slamhive.kube.reconciling.evaluation_status import is_full, is_missing, problem_of, with_problem
from slamhive.kube.reconciling.variants import described
from slamhive.kube.status import condition, display, result_field, status_patch
from slamhive.model.errors import SlamHiveError
from slamhive.model.reported import problem_of_values
from slamhive.model.results import Outcome, Result
from slamhive.model.status import LIST_BYTES, MOST_RESULTS, MappingRunStatus

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.observing import JobObserved
    from slamhive.kube.reconciling.evaluation_groups import EvaluationGroup

RUNS_ANNOTATION = "slamhive.io/runs"
_MOST_FAILURES = 3
_AT_ONCE = 8

_log = logging.getLogger("slamhive.operator")


async def take_results(cluster: Cluster, group: EvaluationGroup, job: Object, seen: JobObserved) -> None:
    """Take an ended Job's results into the runs' statuses, then remove it."""
    decoder = Decoder()
    problem = seen.problem[1] if seen.problem else None
    if seen.pod is not None:
        try:
            decoder.add(await cluster.api.logs(group.key.namespace, seen.pod, seen.container))
        except NotFound:
            if await cluster.refresh(Key(Kind.POD, group.key.namespace, seen.pod)) is not None:
                raise
            problem = problem or "its pod was deleted"
        except Invalid as error:  # no container of it ever ran; other refusals say nothing of the evaluator
            problem = problem or str(error)
    limit = asyncio.Semaphore(_AT_ONCE)

    async def take(record: Object) -> SlamHiveError | None:
        async with limit:
            return await _try_to_take(cluster, group, record)

    # One record that can't be taken must not cost the others theirs.
    told = await asyncio.gather(*(take(record) for record in decoder.records.values()))
    passing = next((error for error in told if error is not None), None)
    if passing is not None:
        raise passing  # the others are taken in; these are tried again
    # A log may lose or cut lines. Runs whose lines are missing have no result, so the next look measures
    # them again.
    if decoder.is_complete:
        group.memory.failures = 0
    else:
        await count_failure(cluster, group, job, problem or "the evaluator's results are incomplete")
    # Last of all: an operator that dies before this finds the ended Job and takes its results in again.
    await cluster.delete(key_of(Kind.JOB, job))


async def count_failure(cluster: Cluster, group: EvaluationGroup, job: Object, problem: str) -> None:
    """Count a Job that failed; after several in a row its runs are given up."""
    group.memory.failures += 1
    if group.memory.failures < _MOST_FAILURES:
        return
    names = runs_of(job)
    for run in group.runs:
        now = cluster.store.get(key_of(Kind.MAPPING_RUN, run)) or run
        if run["metadata"]["name"] in names and is_missing(group, now):
            await give_up(cluster, group, now, problem)
    group.memory.failures = 0


async def _try_to_take(cluster: Cluster, group: EvaluationGroup, record: Object) -> SlamHiveError | None:
    """Take a record in, or give its run up; returns what keeps it from either and may pass."""
    try:
        try:
            await _take(cluster, group, record)
        except SlamHiveError as error:
            if error.retryable or isinstance(error, NotFound):
                return error
            await _give_up_record(cluster, group, record, str(error))
        except Exception as error:  # noqa: BLE001 - one bad record costs one record
            problem = unforeseen(cluster, str(record.get("name")), error)
            await _give_up_record(cluster, group, record, problem)
    except SlamHiveError as error:
        return error
    return None


async def _give_up_record(cluster: Cluster, group: EvaluationGroup, record: Object, problem: str) -> None:
    run = cluster.store.get(Key(Kind.MAPPING_RUN, group.key.namespace, str(record.get("name"))))
    if run is not None:
        await give_up(cluster, group, run, f"its result can't be kept: {problem}"[:1000])


async def _take(cluster: Cluster, group: EvaluationGroup, record: Object) -> None:
    key = Key(Kind.MAPPING_RUN, group.key.namespace, str(record.get("name")))
    run = cluster.store.get(key)
    # A run of this name may have been deleted and made anew while its predecessor was measured.
    if run is None or run["metadata"]["uid"] != record.get("uid"):
        return
    if "error" in record:
        await give_up(cluster, group, run, str(record["error"])[:1000])
        return
    try:
        result = Result.model_validate(record["result"])
    except ValueError as error:
        await give_up(cluster, group, run, f"the evaluator's result is not one: {error}"[:1000])
        return
    if group.name is not None:
        result = result.replace(evaluation=group.name)
    # Checked here, as the API server would refuse the whole status for one value of the wrong type.
    problem = problem_of_values(result.values)
    if problem is None and is_full(run, result.evaluation):
        problem = f"the run has results of {MOST_RESULTS} evaluations, the most that are kept"
    others = [item for item in run["status"].get("results") or () if item["evaluation"] != result.evaluation]
    if problem is None and (size := len(encode([*others, result_field(result)]))) > LIST_BYTES:
        problem = f"with it the run's results have {size} bytes, at most {LIST_BYTES} are kept"
    if problem is not None:
        await give_up(cluster, group, run, f"its result can't be kept: {problem}"[:1000])
        return
    spec = run["spec"]
    why = ""
    if result.outcome is Outcome.LOST:
        dataset = Key(Kind.DATASET, group.key.namespace, spec["datasetRef"]["name"])
        known = described(cluster, dataset, run["status"].get("variant") or "") or {}
        why = known.get("suspicion") or ""
    fresh = [condition("Evaluated", True, "Evaluated", why)]
    await _update(cluster, key, record["uid"], fresh, result_field(result))
    cluster.metrics.record_result(
        spec["algorithmRef"]["name"], spec["datasetRef"]["name"], result_field(result)
    )


async def give_up(cluster: Cluster, group: EvaluationGroup, run: Object, problem: str) -> None:
    """Have a run say why a group can't measure it, which is not tried again."""
    if group.name is None:
        fresh = [condition("Evaluated", False, "NotEvaluable", problem)]
        await _update(cluster, key_of(Kind.MAPPING_RUN, run), run["metadata"]["uid"], fresh)
    await _note(cluster, group, run, problem)
    await cluster.api.event(
        Kind.MAPPING_RUN, run, "Warning", "NotEvaluable", f"{group.name or 'own'}: {problem}"
    )


async def _note(cluster: Cluster, group: EvaluationGroup, run: Object, problem: str) -> None:
    """Note at a run why a group can't measure it, whatever else is noted there at the same time."""

    def change(seen: Object) -> Object:
        if problem_of(group, seen) is not None:
            return {}
        return {"metadata": {"annotations": with_problem(group, seen, problem)}}

    await cluster.amend(key_of(Kind.MAPPING_RUN, run), run["metadata"]["uid"], change)


async def _update(
    cluster: Cluster, key: Key, uid: str, fresh: list[Object], result: Object | None = None
) -> None:
    """Write a result or a condition into a run's status, whatever else writes there at the same time."""

    def change(seen: Object) -> Object:
        status = seen["status"]
        after: Object = {}
        if result is not None:
            # A merge patch replaces lists whole, so the new list carries the results of all other
            # evaluations.
            kept = [
                item for item in status.get("results") or () if item["evaluation"] != result["evaluation"]
            ]
            after["results"] = [*kept, result]
            shown = display(MappingRunStatus.of(seen).usage, after["results"])
            after["display"] = shown.as_json() if shown else {}
        patch = status_patch(seen, after, fresh, cluster.clock())
        return {"status": patch} if patch else {}

    await cluster.amend(key, uid, change, subresource="status")


def unforeseen(cluster: Cluster, name: str, error: Exception) -> str:
    """Return a sentence on an unexpected error, which is also logged and counted."""
    cluster.metrics.count_error(str(Kind.EVALUATION), "unforeseen")
    _log.error("MappingRun %s: measuring it failed in an unforeseen way", name, exc_info=error)
    return f"{type(error).__name__}: {error}"[:1000]


def runs_of(job: Object) -> set[str]:
    """Return the names of the runs that a Job measures."""
    text = annotations_of(job).get(RUNS_ANNOTATION, "")
    return set(text.split(",")) - {""}
