# SPDX-License-Identifier: Apache-2.0
"""Reconciler of Evaluations: measures finished runs in batches by evaluator Jobs, and writes their results.

A run without a result is measured again: a Job that is gone, a line that is missing and an operator that was
killed in between all come to the same. What cannot be measured is noted at the run: evaluation_status.py.
"""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

from slamhive.analysis.subjects import Surroundings, subject_of
from slamhive.contract.trajectory import TRAJECTORY
from slamhive.engine import AttemptState
from slamhive.jobs.lines import Decoder
from slamhive.jobs.requests import EvaluateRequest, RunItem
from slamhive.kube.api.errors import REFUSALS, AlreadyExists, ApiError, NotFound
from slamhive.kube.api.kinds import Key, Kind, Label, Object, Role, key_of
from slamhive.kube.builders import batches, evaluator_job
from slamhive.kube.observing import EvaluatorObserved, lacks_pod, observe_evaluator
from slamhive.kube.reconciling import variants
from slamhive.kube.reconciling.evaluation_groups import Group, group_of, key_for
from slamhive.kube.reconciling.evaluation_status import evaluation_status, is_full, problem_of, with_problem
from slamhive.kube.reconciling.refusals import Patience, patience
from slamhive.kube.reconciling.restoring import Restoring
from slamhive.kube.status import condition, display, holds, moment, result_field, status_patch
from slamhive.model.errors import InputError, SlamHiveError, SystemFault
from slamhive.model.reported import problem_of_values
from slamhive.model.results import Result
from slamhive.model.sensors import SensorMode
from slamhive.model.status import MOST_RESULTS, EvaluationStatus, MappingRunStatus
from slamhive.model.variant import VariantDescription
from slamhive.plan import resolve

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.pods import Waiting
    from slamhive.kube.reconciling.catalogue import Catalogue


RUNS_ANNOTATION, IMAGES_ANNOTATION = "slamhive.io/runs", "slamhive.io/images"
_MOST_FAILURES = 3
_AT_ONCE = 8
_LOOK_SECONDS = 2.0
_WRITE_SECONDS = 2.0
_REFUSED_SECONDS = 15.0

_log = logging.getLogger("slamhive.operator")


class Evaluations:
    """Measures finished runs.

    Args:
        catalogue: Algorithms and Datasets.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._failures: dict[Key, int] = {}
        self._written: dict[Key, float] = {}
        self._refused: dict[Key, tuple[float, str]] = {}
        self._restoring = Restoring()

    def consider(self, cluster: Cluster, run: Object) -> None:
        """Have a finished run measured, if that is asked for and was not done."""
        key = key_for(run)
        if key is not None and run["status"].get("trajectory"):
            # One look answers for all runs that end within this time: it goes through all of their group, and
            # would find no batch to begin before.
            cluster.queue.add(key, min(_LOOK_SECONDS, cluster.settings.evaluation.delay_seconds))

    async def __call__(self, cluster: Cluster, key: Key) -> float | None:
        """Look at a group: take results in, start what is missing, write the Evaluation's status."""
        try:
            group = group_of(cluster, key)
        except InputError as error:
            await self._refuse(cluster, key, str(error))
            return None
        if group is None:
            self._failures.pop(key, None)
            self._refused.pop(key, None)
            self._restoring.forget(key)
            return None
        busy: set[str] = set()
        active = 0
        delays: list[float] = []
        stuck: str | None = None
        for job in self._jobs(cluster, group):
            seen = observe_evaluator(job, cluster.store.pods_of(job))
            if seen.state is AttemptState.ENDED:
                await self._collect(cluster, group, job, seen)
                continue
            waits = await self._wait(cluster, group, job, seen.waiting)
            if waits is not None:
                active += 1
                busy |= _names(job)
                delays += [] if waits.seconds is None else [waits.seconds]
                stuck = stuck or waits.why
        # Read again: what was collected above is a result now, and must not be measured twice.
        group = group_of(cluster, key) or group
        delays += await self._start_missing(cluster, group, busy, active)
        delays += await self._write(cluster, group)
        if (trouble := self._restoring.trouble(key)) is not None:
            raise SystemFault(trouble)  # the Evaluation, Sweep or run says so, until it is over
        if stuck is not None:
            raise SystemFault(f"the evaluator does not begin: {stuck}")
        return min(delays, default=None)

    @staticmethod
    def _jobs(cluster: Cluster, group: Group) -> list[Object]:
        return [
            job
            for kind, job in cluster.store.owned(group.owner["uid"])
            if kind is Kind.JOB
            and (job["metadata"].get("labels") or {}).get(Label.ROLE) == Role.EVALUATE
            and not job["metadata"].get("deletionTimestamp")
        ]

    @staticmethod
    def _is_missing(group: Group, run: Object) -> bool:
        return not group.has_result(run) and problem_of(group, run) is None

    async def _start_missing(
        self, cluster: Cluster, group: Group, busy: set[str], active: int
    ) -> list[float]:
        missing = [
            run for run in group.runs if run["metadata"]["name"] not in busy and self._is_missing(group, run)
        ]
        if not missing:
            self._restoring.forget(group.key)
            return []
        wanted = cluster.settings.evaluation
        if active >= wanted.parallel_jobs:
            return []  # the end of one of them leads back here
        ended = [moment(run["status"].get("completionTime")) or 0.0 for run in missing]
        # A batch that is not full waits for more runs to end, as one Job can measure many; after failures it
        # waits longer.
        delay = group.wait_seconds(wanted.delay_seconds) * 2 ** self._failures.get(group.key, 0)
        wait = min(ended) + delay - cluster.clock()
        if len(missing) < wanted.batch_size and wait > 0:
            return [wait]
        brought = await self._restoring.bring(cluster, group, await self._items(cluster, group, missing))
        for run in missing:
            if (problem := brought.refused.get(run["metadata"]["name"])) is not None:
                await self._give_up(cluster, group, run, problem)
        items, delays = brought.ready, brought.delays
        for batch in list(batches(items, wanted.batch_size))[: wanted.parallel_jobs - active]:
            delays += await self._try_to_start(cluster, group, [dict(item) for item in batch])
        return delays

    async def _try_to_start(self, cluster: Cluster, group: Group, batch: list[Object]) -> list[float]:
        """Start a batch; where its Job can't be had for long, its runs are given up."""
        now = cluster.clock()
        try:
            await self._start(cluster, group, batch)
        except InputError as error:
            problem = str(error)
        except REFUSALS as error:
            if error.retryable:
                raise
            problem = str(error)
            begun = self._refused.setdefault(group.key, (now, problem))[0]
            left = begun + cluster.settings.refusal_grace_seconds - now
            if left > 0:
                self._refused[group.key] = begun, problem
                return [min(left, _REFUSED_SECONDS)]
        else:
            self._refused.pop(group.key, None)
            return []
        names = {item["name"] for item in batch}
        for run in group.runs:
            if run["metadata"]["name"] in names:
                await self._give_up(cluster, group, run, problem)
        return []

    async def _wait(
        self, cluster: Cluster, group: Group, job: Object, seen: Waiting | None
    ) -> Patience | None:
        """Return the time that a Job may still wait; None: it goes, and makes room for another."""
        # A pod that does not begin is no run's fault, and no run is given up for it: the kubelet goes on
        # trying. Where operator or Evaluation no longer name its image, there is another Job with today's.
        has_pod = seen is not None and not lacks_pod(seen)
        images = (job["metadata"].get("annotations") or {}).get(IMAGES_ANNOTATION)
        if has_pod and images not in {None, _images(cluster, group)}:
            await cluster.delete(key_of(Kind.JOB, job))
            return None
        waits = await patience(cluster, job, seen)
        if waits.end is None or has_pod:
            return waits
        await self._failed(cluster, group, job, waits.end.message or "")
        await cluster.delete(key_of(Kind.JOB, job))
        return None

    async def _items(self, cluster: Cluster, group: Group, runs: list[Object]) -> list[Object]:
        items = []
        for run in runs:
            try:
                items.append(self._item(cluster, run))
            except InputError as error:
                await self._give_up(cluster, group, run, str(error))
            except Exception as error:  # noqa: BLE001 - one bad record costs one record
                await self._give_up(cluster, group, run, _unforeseen(cluster, run["metadata"]["name"], error))
        return items

    def _item(self, cluster: Cluster, run: Object) -> Object:
        """Return the evaluator's order for a run.

        Raises:
            InputError: a sentence about why it cannot be measured.
        """
        namespace, status = run["metadata"]["namespace"], MappingRunStatus.of(run)
        if status.trajectory is None:
            raise InputError("its status does not say which file its trajectory is")
        algorithm = self._catalogue.algorithm(cluster.store, namespace, run["spec"]["algorithmRef"]["name"])
        dataset = self._catalogue.dataset(cluster.store, namespace, run["spec"]["datasetRef"]["name"])
        spec = resolve(run["spec"], algorithm, dataset)
        key = Key(Kind.DATASET, namespace, dataset.name)
        told = variants.described(cluster, key, status.variant or "")
        if told is None:
            raise InputError(f"variant {status.variant} of Dataset {dataset.name!r} is not known any more")
        known = VariantDescription.model_validate(told)
        if known.ground_truth is None:
            raise InputError(f"Dataset {dataset.name!r} has no ground truth")
        level = known.gravity_aligned
        given = Surroundings(
            truth_frame=known.T_body_frame or _IDENTITY,
            by_role={role: view.T_body_sensor for role, view in known.sensors.items()},
            by_name=known.extrinsics,
            remap=spec["input"].get("remap"),
            gravity_aligned=dataset.spec.has_level_truth if level is None else level,
            window=(known.start_time, known.start_time + known.duration_seconds),
        )
        return RunItem.of(
            subject_of(algorithm.spec, SensorMode(spec["sensors"]), given),
            uid=run["metadata"]["uid"],
            name=run["metadata"]["name"],
            folder=status.trajectory.path.removesuffix(f"/{TRAJECTORY}"),
            sha256=status.trajectory.sha256,
            dataset=dataset.name,
        ).as_json()

    async def _start(self, cluster: Cluster, group: Group, batch: list[Object]) -> None:
        request = EvaluateRequest(evaluation=group.name, settings=group.settings, runs=batch).as_json()
        body = evaluator_job(
            group.key.namespace,
            request,
            settings_hash=group.hash,
            attempt=self._failures.get(group.key, 0) + 1,
            labels=group.labels,
            owners=[group.owner],
            settings=cluster.settings,
            evaluator=group.evaluator,
            notes={
                RUNS_ANNOTATION: ",".join(run["name"] for run in batch),
                IMAGES_ANNOTATION: _images(cluster, group),
            },
        )
        try:
            await cluster.create(Kind.JOB, body)
        except AlreadyExists:
            await cluster.refresh(key_of(Kind.JOB, body))

    async def _collect(self, cluster: Cluster, group: Group, job: Object, seen: EvaluatorObserved) -> None:
        """Take an ended Job's results into the runs' statuses, then remove it."""
        decoder = Decoder()
        problem = seen.problem[1] if seen.problem else None
        if seen.pod is not None:
            try:
                decoder.add(await cluster.api.logs(group.key.namespace, seen.pod, seen.container))
            except ApiError as error:
                if error.retryable:  # it says nothing about the evaluator
                    raise
                problem = problem or str(error)
        limit = asyncio.Semaphore(_AT_ONCE)

        async def take(record: Object) -> SlamHiveError | None:
            async with limit:
                return await self._try_to_take(cluster, group, record)

        # One record that can't be taken must not cost the others theirs.
        told = await asyncio.gather(*(take(record) for record in decoder.records.values()))
        passing = next((error for error in told if error is not None), None)
        if passing is not None:
            raise passing  # the others are taken in; these are tried again
        # A log may lose or cut lines. Runs whose lines are missing have no result, so the next look measures
        # them again.
        if decoder.is_complete:
            self._failures.pop(group.key, None)
        else:
            await self._failed(cluster, group, job, problem or "the evaluator's results are incomplete")
        # Last of all: an operator that dies before this finds the ended Job and takes its results in again.
        await cluster.delete(key_of(Kind.JOB, job))

    async def _failed(self, cluster: Cluster, group: Group, job: Object, problem: str) -> None:
        count = self._failures.get(group.key, 0) + 1
        self._failures[group.key] = count
        if count < _MOST_FAILURES:
            return
        names = _names(job)
        for run in group.runs:
            now = cluster.store.get(key_of(Kind.MAPPING_RUN, run)) or run
            if run["metadata"]["name"] in names and self._is_missing(group, now):
                await self._give_up(cluster, group, now, problem)
        self._failures.pop(group.key, None)

    async def _try_to_take(self, cluster: Cluster, group: Group, record: Object) -> SlamHiveError | None:
        """Take a record in, or give its run up; returns what keeps it from either and may pass."""
        try:
            try:
                await self._take(cluster, group, record)
            except SlamHiveError as error:
                if error.retryable or isinstance(error, NotFound):
                    return error
                await self._give_up_record(cluster, group, record, str(error))
            except Exception as error:  # noqa: BLE001 - one bad record costs one record
                problem = _unforeseen(cluster, str(record.get("name")), error)
                await self._give_up_record(cluster, group, record, problem)
        except SlamHiveError as error:
            return error
        return None

    async def _give_up_record(self, cluster: Cluster, group: Group, record: Object, problem: str) -> None:
        run = cluster.store.get(Key(Kind.MAPPING_RUN, group.key.namespace, str(record.get("name"))))
        if run is not None:
            await self._give_up(cluster, group, run, f"its result can't be kept: {problem}"[:1000])

    async def _take(self, cluster: Cluster, group: Group, record: Object) -> None:
        key = Key(Kind.MAPPING_RUN, group.key.namespace, str(record.get("name")))
        run = cluster.store.get(key)
        # A run of this name may have been deleted and made anew while its predecessor was measured.
        if run is None or run["metadata"]["uid"] != record.get("uid"):
            return
        if "error" in record:
            await self._give_up(cluster, group, run, str(record["error"])[:1000])
            return
        try:
            result = Result.model_validate(record["result"])
        except ValueError as error:
            await self._give_up(cluster, group, run, f"the evaluator's result is not one: {error}"[:1000])
            return
        if group.name is not None:
            result = result.replace(evaluation=group.name)
        # Checked here, as the API server would refuse the whole status for one value of the wrong type.
        problem = problem_of_values(result.values)
        if problem is None and is_full(run, result.evaluation):
            problem = f"the run has results of {MOST_RESULTS} evaluations, the most that are kept"
        if problem is not None:
            await self._give_up(cluster, group, run, f"its result can't be kept: {problem}"[:1000])
            return
        fresh = [condition("Evaluated", True, "Evaluated")]
        await _update(cluster, key, record["uid"], fresh, result_field(result))
        spec = run["spec"]
        cluster.metrics.record_result(
            spec["algorithmRef"]["name"], spec["datasetRef"]["name"], result_field(result)
        )

    async def _give_up(self, cluster: Cluster, group: Group, run: Object, problem: str) -> None:
        if group.name is None:
            fresh = [condition("Evaluated", False, "NotEvaluable", problem)]
            await _update(cluster, key_of(Kind.MAPPING_RUN, run), run["metadata"]["uid"], fresh)
        await _note(cluster, group, run, problem)
        await cluster.api.event(
            Kind.MAPPING_RUN, run, "Warning", "NotEvaluable", f"{group.name or 'own'}: {problem}"
        )

    async def _write(self, cluster: Cluster, group: Group) -> list[float]:
        body = cluster.store.get(group.key)
        if group.name is None or body is None:
            return []
        found = {run["metadata"]["name"]: problem_of(group, run) for run in group.runs}
        problems = {name: problem for name, problem in found.items() if problem is not None}
        now = cluster.clock()
        status, conditions = evaluation_status(group, problems)
        status |= EvaluationStatus(observed_generation=body["metadata"].get("generation", 1))
        conditions += self._admitted(group, body)
        wait = self._written.get(group.key, 0.0) + _WRITE_SECONDS - now
        if not status_patch(body, status.as_patch(), conditions, now):
            return []
        if wait > 0:
            return [wait]
        # Each run that ends changes the Evaluation: its status is written every two seconds at most.
        self._written[group.key] = now
        await cluster.write_status(Kind.EVALUATION, body, status, conditions)
        return []

    def _admitted(self, group: Group, body: Object) -> list[Object]:
        refused = self._refused.get(group.key)
        if refused is not None:
            return [condition("Admitted", False, "JobRefused", refused[1])]
        return [condition("Admitted", True, "Admitted")] if holds(body["status"], "Admitted") is False else []

    @staticmethod
    async def _refuse(cluster: Cluster, key: Key, message: str) -> None:
        body = cluster.store.get(key)
        if body is None:
            return
        told = condition("Accepted", False, "InvalidSpec", message)
        if await cluster.write_status(Kind.EVALUATION, body, conditions=[told]) is not None:
            await cluster.api.event(Kind.EVALUATION, body, "Warning", "NotAccepted", message)


async def _note(cluster: Cluster, group: Group, run: Object, problem: str) -> None:
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


def _unforeseen(cluster: Cluster, name: str, error: Exception) -> str:
    """Return a sentence on an unexpected error, which is also logged and counted."""
    cluster.metrics.count_error(str(Kind.EVALUATION), "unforeseen")
    _log.error("MappingRun %s: measuring it failed in an unforeseen way", name, exc_info=error)
    return f"{type(error).__name__}: {error}"[:1000]


def _images(cluster: Cluster, group: Group) -> str:
    """Return the images of a Job that is made now, as they stand in its annotation."""
    own = group.evaluator.image if group.evaluator else ""
    return " ".join(filter(None, (cluster.settings.measuring_image, own)))


def _names(job: Object) -> set[str]:
    text = (job["metadata"].get("annotations") or {}).get(RUNS_ANNOTATION, "")
    return set(text.split(",")) - {""}


_IDENTITY = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
