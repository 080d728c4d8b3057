# SPDX-License-Identifier: Apache-2.0
"""Reconciler of Evaluations: measures finished runs in batches by evaluator Jobs.

A run without a result is measured again: a Job that is gone, a line that is missing and an operator that was
killed in between all come to the same. What Jobs found is taken in by result_taking.py.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from slamhive.analysis.subjects import Surroundings, subject_of
from slamhive.contract.settled import is_settled
from slamhive.contract.trajectory import TRAJECTORY
from slamhive.engine import AttemptState
from slamhive.jobs.requests import EvaluateRequest, RunItem
from slamhive.kube.api.errors import REFUSALS, AlreadyExists
from slamhive.kube.api.kinds import Key, Kind, Object, Role, annotations_of, key_of
from slamhive.kube.builders import batches, evaluator_job
from slamhive.kube.observing import observe_job
from slamhive.kube.pods import is_deleted
from slamhive.kube.reconciling import variants
from slamhive.kube.reconciling.evaluation_groups import EvaluationGroup, GroupMemory, group_of, key_for
from slamhive.kube.reconciling.evaluation_status import evaluation_status, problem_of
from slamhive.kube.reconciling.restoring import restore_folders
from slamhive.kube.reconciling.result_taking import (
    RUNS_ANNOTATION,
    give_up,
    runs_of,
    take_results,
    unforeseen,
)
from slamhive.kube.reconciling.waiting import Patience, patience, soonest
from slamhive.kube.status import condition, holds, moment, status_patch
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.sensors import SensorMode
from slamhive.model.status import EvaluationStatus, MappingRunStatus
from slamhive.model.variant import VariantDescription
from slamhive.plan import resolve

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.pods import Waiting
    from slamhive.kube.reconciling.catalogue import Catalogue


POD_ANNOTATION = "slamhive.io/pod"
_LOOK_SECONDS = 2.0
_WRITE_SECONDS = 2.0


class Evaluations:
    """Measures finished runs.

    Args:
        catalogue: Algorithms and Datasets.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._memories: defaultdict[Key, GroupMemory] = defaultdict(GroupMemory)

    def consider(self, cluster: Cluster, run: Object) -> None:
        """Have a finished run measured, if that is asked for and was not done."""
        key = key_for(run)
        if key is not None and run["status"].get("trajectory"):
            # One look answers for all runs that end within this time: it goes through all of their group, and
            # would find no batch to begin before.
            cluster.queue.add(key, min(_LOOK_SECONDS, cluster.settings.evaluation.delay_seconds))

    async def __call__(self, cluster: Cluster, key: Key) -> float | None:
        """Look at a group: take results in, start what is missing, write the Evaluation's status."""
        memory = self._memories[key]
        try:
            group = group_of(cluster, key, memory)
        except InputError as error:
            await self._refuse(cluster, key, str(error))
            return None
        if group is None:
            del self._memories[key]
            return None
        memory.refused = None
        busy: dict[str, set[str]] = {}
        delays: list[float | None] = []
        stuck: str | None = None
        for job in cluster.store.jobs_of(group.owner["uid"], Role.EVALUATE):
            if is_deleted(job):
                continue
            seen = observe_job(job, await cluster.pods_of(job))
            if seen.state is AttemptState.ENDED:
                await take_results(cluster, group, job, seen)
                continue
            waits = await self._wait(cluster, group, job, seen.waiting)
            if waits is not None:
                busy[job["metadata"]["name"]] = runs_of(job)
                delays.append(waits.seconds)
                stuck = stuck or waits.why
        # Read again: what was collected above is a result now, and must not be measured twice.
        group = group_of(cluster, key, memory) or group
        delays += await self._start_missing(cluster, group, set().union(*busy.values()), len(busy))
        delays.append(await self._write_status(cluster, group))
        if memory.trouble is not None:
            # The Evaluation, Sweep or run says so, until it is over.
            raise SystemFault(f"run folders can't be brought back from object storage: {memory.trouble}")
        if memory.refused is not None:
            raise SystemFault(f"the evaluator's Job is refused: {memory.refused}")
        if stuck is not None:
            raise SystemFault(f"the evaluator does not begin: {stuck}")
        return soonest(*delays)

    async def _start_missing(
        self, cluster: Cluster, group: EvaluationGroup, busy: set[str], active: int
    ) -> list[float | None]:
        missing = await self._missing(cluster, group, busy)
        if not missing:
            group.memory.forget_folders()
            return []
        wanted = cluster.settings.evaluation
        if active >= wanted.parallel_jobs:
            return []  # the end of one of them leads back here
        ended = [moment(run["status"].get("completionTime")) or 0.0 for run in missing]
        # A batch that is not full waits for more runs to end, as one Job can measure many; after failures it
        # waits longer.
        delay = group.wait_seconds(wanted.delay_seconds) * 2**group.memory.failures
        wait = min(ended) + delay - cluster.clock()
        if len(missing) < wanted.batch_size and wait > 0:
            return [wait]
        restored = await restore_folders(cluster, group, await self._orders(cluster, group, missing))
        for run in missing:
            if (problem := restored.refused.get(run["metadata"]["name"])) is not None:
                await give_up(cluster, group, run, problem)
        for batch in list(batches(restored.ready, wanted.batch_size))[: wanted.parallel_jobs - active]:
            await self._try_to_start(cluster, group, [dict(item) for item in batch])
        return restored.delays

    @staticmethod
    async def _missing(cluster: Cluster, group: EvaluationGroup, busy: set[str]) -> list[Object]:
        """Return the runs that are still to be measured and are in no Job."""
        missing = []
        for run in group.runs:
            if group.has_result(run):
                continue
            problem = problem_of(group, run)
            if problem is None and run["metadata"]["name"] not in busy:
                missing.append(run)
            elif problem is not None and group.name is None and not is_settled(run):
                # Given up by an operator that ended before anybody was told.
                await give_up(cluster, group, run, problem)
        return missing

    @staticmethod
    async def _try_to_start(cluster: Cluster, group: EvaluationGroup, batch: list[Object]) -> None:
        """Start a batch; runs of which no Job can be built are given up, those whose Job is refused wait."""
        try:
            await _start(cluster, group, batch)
        except InputError as error:
            names = {item["name"] for item in batch}
            for run in group.runs:
                if run["metadata"]["name"] in names:
                    await give_up(cluster, group, run, str(error))
        except REFUSALS as error:
            if error.retryable:
                raise
            group.memory.refused = str(error)

    @staticmethod
    async def _wait(
        cluster: Cluster, group: EvaluationGroup, job: Object, seen: Waiting | None
    ) -> Patience | None:
        """Return the time that a Job may still wait; None: it goes, and makes room for another."""
        # A pod that does not begin is no run's fault, and no run is given up for it: the cluster goes on
        # trying. Where operator or Evaluation ask for another one by now, there is another Job.
        asked = annotations_of(job).get(POD_ANNOTATION)
        if seen is None or asked in {None, _asked(cluster, group)}:
            return await patience(cluster, job, seen)
        await cluster.delete(key_of(Kind.JOB, job))
        return None

    async def _orders(self, cluster: Cluster, group: EvaluationGroup, runs: list[Object]) -> list[Object]:
        items = []
        for run in runs:
            try:
                items.append(self._order(cluster, run))
            except InputError as error:
                await give_up(cluster, group, run, str(error))
            except Exception as error:  # noqa: BLE001 - one bad record costs one record
                await give_up(cluster, group, run, unforeseen(cluster, run["metadata"]["name"], error))
        return items

    def _order(self, cluster: Cluster, run: Object) -> Object:
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

    @staticmethod
    async def _write_status(cluster: Cluster, group: EvaluationGroup) -> float | None:
        body = cluster.store.get(group.key)
        if group.name is None or body is None:
            return None
        found = {run["metadata"]["name"]: problem_of(group, run) for run in group.runs}
        problems = {name: problem for name, problem in found.items() if problem is not None}
        now = cluster.clock()
        status, conditions = evaluation_status(group, problems)
        status |= EvaluationStatus(observed_generation=body["metadata"].get("generation", 1))
        conditions += _admitted(group, body)
        wait = group.memory.written_at + _WRITE_SECONDS - now
        if not status_patch(body, status.as_patch(), conditions, now):
            return None
        if wait > 0:
            return wait
        # Each run that ends changes the Evaluation: its status is written every two seconds at most.
        group.memory.written_at = now
        await cluster.write_status(Kind.EVALUATION, body, status, conditions)
        return None

    @staticmethod
    async def _refuse(cluster: Cluster, key: Key, message: str) -> None:
        body = cluster.store.get(key)
        if body is None:
            return
        told = condition("Accepted", False, "InvalidSpec", message)
        if await cluster.write_status(Kind.EVALUATION, body, conditions=[told]) is not None:
            await cluster.api.event(Kind.EVALUATION, body, "Warning", "NotAccepted", message)


async def _start(cluster: Cluster, group: EvaluationGroup, batch: list[Object]) -> None:
    request = EvaluateRequest(evaluation=group.name, settings=group.settings, runs=batch).as_json()
    body = evaluator_job(
        group.key.namespace,
        request,
        settings_hash=group.hash,
        attempt=group.memory.failures + 1,
        labels=group.labels,
        owners=[group.owner],
        settings=cluster.settings,
        evaluator=group.evaluator,
        notes={
            RUNS_ANNOTATION: ",".join(run["name"] for run in batch),
            POD_ANNOTATION: _asked(cluster, group),
        },
    )
    try:
        await cluster.create(Kind.JOB, body)
    except AlreadyExists:
        await cluster.refresh(key_of(Kind.JOB, body))


def _admitted(group: EvaluationGroup, body: Object) -> list[Object]:
    if group.memory.refused is not None:
        return [condition("Admitted", False, "JobRefused", group.memory.refused)]
    return [condition("Admitted", True, "Admitted")] if holds(body["status"], "Admitted") is False else []


def _asked(cluster: Cluster, group: EvaluationGroup) -> str:
    """Return the images, CPU and memory of a Job that is made now, as they stand in its annotation."""
    own, wanted = group.evaluator.image if group.evaluator else "", cluster.settings.evaluation
    return " ".join(filter(None, (cluster.settings.measuring_image, own, wanted.cpu, wanted.memory)))


_IDENTITY = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
