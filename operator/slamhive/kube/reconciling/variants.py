# SPDX-License-Identifier: Apache-2.0
"""Variants on the cluster: one preparation Job each, readiness in the Dataset's status.

A variant's entry in ``Dataset.status.variants`` holds as long as the Dataset does: it never changes, so the
same name means the same recording. One whose folder is gone waits to be prepared anew, and keeps what is
known of it: runs that have ended are measured by that. A failed entry holds for the runs that were there when
it failed; a later run tries again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.contract.settled import is_settled
from slamhive.engine import VariantState
from slamhive.kube.api.encoding import encode
from slamhive.kube.api.errors import AlreadyExists
from slamhive.kube.api.kinds import Key, Kind, Label, Role, key_of, labels_of, owner_uids, owners_of
from slamhive.kube.builders import variant_job, variant_name
from slamhive.kube.observing import observe_variant
from slamhive.kube.pods import has_ended
from slamhive.kube.reconciling.waiting import patience, soonest
from slamhive.kube.status import iso, moment, variant_of
from slamhive.model.base import quantity
from slamhive.model.results import Reason
from slamhive.model.run import InputOptions
from slamhive.model.sensors import SensorMode
from slamhive.model.status import LIST_BYTES, MESSAGE_LENGTH, DatasetStatus, VariantEntry, VariantPhase

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.kube.cluster import Cluster
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset

_TOUCH_SECONDS = 3600.0
_NEW_SECONDS = 60.0
_PENDING_SECONDS = 5.0
_ENTRIES = 1000


@dataclass(frozen=True)
class Wanted:
    """The variant that a run reads.

    Attributes:
        name: its name in the Dataset's status.
        algorithm: the run's Algorithm.
        dataset: the run's Dataset.
        spec: the run's resolved spec.
    """

    name: str
    algorithm: Algorithm
    dataset: Dataset
    spec: dict[str, Any]

    @classmethod
    def by(cls, spec: dict[str, Any], algorithm: Algorithm, dataset: Dataset) -> Wanted:
        """Return the variant for a run's resolved spec."""
        options = InputOptions.model_validate(spec["input"])
        mode = algorithm.spec.mode(SensorMode(spec["sensors"]))
        formats = algorithm.spec.formats(mode)
        name = variant_name(dataset, mode.needs, options, formats, algorithm.spec.assets, mode.topics or ())
        return cls(name, algorithm, dataset, spec)


@dataclass(frozen=True)
class VariantSeen:
    """State of a variant, from the Dataset's status and its Job: ready, being made, failed or absent.

    Attributes:
        state: whether it is there.
        description: what it is, when it is ready.
        problem: why it could not be made.
        waiting: why its making does not begin; None where it does, or that isn't known yet.
    """

    state: VariantState
    description: dict[str, Any] | None = None
    problem: tuple[Reason, str] | None = None
    waiting: str | None = None


def look(cluster: Cluster, namespace: str, wanted: Wanted, created: float) -> VariantSeen:
    """Return the state of a variant.

    Args:
        cluster: the cluster.
        namespace: where.
        wanted: the variant.
        created: when the run that asks was made, or last tried, s since 1970: older failures don't count.
    """
    entry = _entry_of(cluster, Key(Kind.DATASET, namespace, wanted.dataset.name), wanted.name)
    if entry is not None and entry.phase is VariantPhase.READY:
        return VariantSeen(VariantState.READY, entry.description or {})
    # The Job tells as soon as it ends; until the Dataset's status says so too, runs would wait for a write in
    # between.
    for job in cluster.store.select(Kind.JOB, namespace, Label.VARIANT, wanted.name):
        seen = observe_variant(job, cluster.store.pods_of(job))
        if seen.state is VariantState.READY and seen.description is not None:
            return VariantSeen(VariantState.READY, seen.description.as_json())
        if seen.state is VariantState.MAKING:
            waiting = entry.message if entry and entry.phase is VariantPhase.PREPARING else None
            return VariantSeen(VariantState.MAKING, waiting=waiting)
        if seen.problem is not None and _made(job) >= created:
            return VariantSeen(VariantState.FAILED, problem=seen.problem)
    if entry is not None and entry.phase is VariantPhase.FAILED:
        since = moment(entry.changed_time) or 0.0
        if since >= created:
            return VariantSeen(VariantState.FAILED, problem=_problem_of(entry))
    return VariantSeen(VariantState.ABSENT)


async def make(cluster: Cluster, namespace: str, wanted: Wanted, owner: dict[str, Any]) -> float | None:
    """Have a variant made, or join those that wait for it.

    Args:
        cluster: the cluster.
        namespace: where.
        wanted: the variant.
        owner: reference to the object that needs it.

    Returns:
        Seconds after which to ask again, when there is no room for another preparation now.
    """
    jobs = cluster.store.select(Kind.JOB, namespace, Label.VARIANT, wanted.name)
    for job in jobs:
        # The Job's name follows from the variant: one that failed, or whose word went with its pod, has to go
        # before another can be made.
        seen = observe_variant(job, cluster.store.pods_of(job))
        if seen.state in {VariantState.FAILED, VariantState.ABSENT}:
            await cluster.delete(key_of(Kind.JOB, job))
            return _PENDING_SECONDS / 5
    if not jobs:
        active = [
            job
            for job in cluster.store.select(Kind.JOB, namespace, Label.ROLE, Role.PREPARE)
            if not has_ended(job)
        ]
        # Other workers may have found the same room a moment ago.
        coming = cluster.being_created(Kind.JOB, namespace, Label.ROLE, Role.PREPARE)
        names = {job["metadata"]["name"] for job in (*active, *coming)}
        is_coming = any(labels_of(job).get(Label.VARIANT) == wanted.name for job in coming)
        if not is_coming and len(names) >= cluster.settings.preparation.parallel_jobs:
            return _PENDING_SECONDS
    body = variant_job(
        namespace=namespace,
        name=wanted.name,
        dataset=wanted.dataset,
        algorithm=wanted.algorithm,
        spec=wanted.spec,
        settings=cluster.settings,
        owners=[owner],
    )
    try:
        await cluster.create(Kind.JOB, body)
    except AlreadyExists:
        await _join(cluster, Key(Kind.JOB, namespace, body["metadata"]["name"]), owner)
    return None


async def join(cluster: Cluster, namespace: str, wanted: Wanted, owner: dict[str, Any]) -> None:
    """Become an owner of the Job that makes a variant, so that it stays while this owner needs it."""
    for job in cluster.store.select(Kind.JOB, namespace, Label.VARIANT, wanted.name):
        if not has_ended(job) and owner["uid"] not in owner_uids(job):
            await _join(cluster, Key(Kind.JOB, namespace, job["metadata"]["name"]), owner)


async def _join(cluster: Cluster, key: Key, owner: dict[str, Any]) -> None:
    job = await cluster.refresh(key)
    if job is None or owner["uid"] in owner_uids(job):
        return
    # Without the version a merge patch of the list would drop an owner that another worker has just added,
    # and the Job with it.
    await cluster.patch_seen(Kind.JOB, job, {"metadata": {"ownerReferences": [*owners_of(job), owner]}})


class DatasetReconciler:
    """Keeps ``Dataset.status.variants`` true."""

    async def __call__(self, cluster: Cluster, key: Key) -> float | None:
        """Take what preparation Jobs report into the Dataset's status."""
        dataset = cluster.store.get(key)
        if dataset is None:
            return None
        before = {entry.name: entry for entry in DatasetStatus.of(dataset).variants}
        after = dict(before)
        delays: list[float | None] = []
        for job in cluster.store.select(Kind.JOB, key.namespace, Label.DATASET, key.name):
            name = labels_of(job).get(Label.VARIANT)
            if name is not None:
                entry = self._entry(cluster, name, job, before.get(name))
                after[name] = await self._while_waiting(cluster, job, entry, delays)
        after = _within(cluster, key.namespace, after)
        if after != before:
            await _write(cluster, dataset, after.values())
            self._wake(cluster, key)
        return soonest(*delays)

    @staticmethod
    async def _while_waiting(
        cluster: Cluster, job: dict[str, Any], entry: VariantEntry, delays: list[float | None]
    ) -> VariantEntry:
        """Return an entry with why its Job does not begin; one that can't for long has failed."""
        if entry.phase is not VariantPhase.PREPARING:
            return entry
        waits = await patience(cluster, job, observe_variant(job, cluster.store.pods_of(job)).waiting)
        if waits.end is None:
            delays.append(waits.seconds)
            return entry.replace(message=waits.why and waits.why[:MESSAGE_LENGTH])
        await cluster.delete(key_of(Kind.JOB, job))
        return entry.replace(
            phase=VariantPhase.FAILED,
            reason=waits.end.reason or Reason.SYSTEM_FAULT,
            message=(waits.end.message or "")[:MESSAGE_LENGTH],
            changed_time=iso(cluster.clock()),
        )

    @staticmethod
    def _entry(cluster: Cluster, name: str, job: dict[str, Any], known: VariantEntry | None) -> VariantEntry:
        if known is not None and known.phase is VariantPhase.READY:
            return known
        seen = observe_variant(job, cluster.store.pods_of(job))
        now = iso(cluster.clock())
        # What was known of it before its folder was lost stays until it is told anew: see lose().
        before = known or VariantEntry(name=name)
        if seen.state is VariantState.READY and seen.description is not None:
            return before.replace(
                phase=VariantPhase.READY,
                reason=None,
                message=None,
                folder=f"variants/{seen.description.folder}",
                size_bytes=seen.description.size_bytes,
                description=seen.description.as_json(),
                last_used_time=now,
                changed_time=now,
            )
        if seen.problem is None:
            # One that prepares already has a message of its own: why its Job does not begin.
            if before.phase is VariantPhase.PREPARING:
                return before
            return before.replace(phase=VariantPhase.PREPARING, reason=None, message=None, changed_time=now)
        reason, message = seen.problem[0], seen.problem[1][:MESSAGE_LENGTH]
        if before.phase is VariantPhase.FAILED and _problem_of(before) == (reason, message):
            return before
        return before.replace(phase=VariantPhase.FAILED, reason=reason, message=message, changed_time=now)

    @staticmethod
    def _wake(cluster: Cluster, key: Key) -> None:
        for run in cluster.store.referring(key.namespace, Kind.DATASET, key.name):
            cluster.queue.add(key_of(Kind.MAPPING_RUN, run))


async def touch(cluster: Cluster, key: Key, name: str) -> None:
    """Note that a variant is used, at most once an hour."""
    entry, dataset = _entry_of(cluster, key, name), cluster.store.get(key)
    if entry is None or dataset is None:
        return
    used = moment(entry.last_used_time) or 0.0
    if cluster.clock() - used >= _TOUCH_SECONDS:
        await _change(cluster, dataset, entry.replace(last_used_time=iso(cluster.clock())))


async def lose(cluster: Cluster, key: Key, name: str) -> None:
    """Note that a variant turned out to be gone from the volume, so that it is prepared anew.

    What is known of it stays: its name stands for one content, and runs that have read it can be measured
    only by its description.
    """
    for job in cluster.store.select(Kind.JOB, key.namespace, Label.VARIANT, name):
        await cluster.delete(key_of(Kind.JOB, job))  # its report would have it ready again
    entry, dataset = _entry_of(cluster, key, name), cluster.store.get(key)
    if entry is None or dataset is None or entry.phase is VariantPhase.PENDING:
        return
    now = iso(cluster.clock())
    await _change(
        cluster,
        dataset,
        entry.replace(phase=VariantPhase.PENDING, reason=None, message=None, changed_time=now),
    )


async def _change(cluster: Cluster, dataset: dict[str, Any], entry: VariantEntry) -> None:
    """Write one entry of a Dataset's status."""
    known = DatasetStatus.of(dataset).variants
    await _write(cluster, dataset, [entry if item.name == entry.name else item for item in known])


async def _write(cluster: Cluster, dataset: dict[str, Any], entries: Iterable[VariantEntry]) -> None:
    # Not checked here: where there are too many, the API server has a sentence for it.
    await cluster.write_status(Kind.DATASET, dataset, DatasetStatus().replace(variants=list(entries)))


def _within(cluster: Cluster, namespace: str, known: dict[str, VariantEntry]) -> dict[str, VariantEntry]:
    """Return the entries that may stay: unused ones go while a namespace's variants are too large."""
    limit = quantity(cluster.settings.variants_limit)
    # The limit holds for a namespace, as all its Datasets share one volume. Of the others' entries, which can
    # be thousands, only the sizes are read.
    others = sum(
        item.get("sizeBytes", 0)
        for dataset in cluster.store.of(Kind.DATASET, namespace)
        for item in (dataset.get("status") or {}).get("variants") or ()
        if item["name"] not in known
    )
    total = others + sum(entry.size_bytes or 0 for entry in known.values())
    # A run that has ended is measured by the description of what it read.
    used = {
        (run.get("status") or {}).get("variant")
        for run in cluster.store.of(Kind.MAPPING_RUN, namespace)
        if not is_settled(run)
    }
    kept = dict(known)
    sizes = {name: len(encode(entry.as_json())) for name, entry in known.items()}
    size = sum(sizes.values())
    for entry in sorted(known.values(), key=lambda item: item.last_used_time or item.changed_time or ""):
        # Of more the API server refuses the whole status.
        is_full = len(kept) > _ENTRIES or size > LIST_BYTES
        if total <= limit and not is_full:
            break
        ready_unused = entry.phase is not VariantPhase.PREPARING and entry.name not in used
        # Use is noted once an hour at most, so a new entry may look unused although runs read it; where there
        # is no room for an hour's entries, those of a minute stay.
        recent = cluster.clock() - (moment(entry.changed_time) or 0.0)
        if ready_unused and recent >= (_NEW_SECONDS if is_full else _TOUCH_SECONDS):
            total -= entry.size_bytes or 0
            size -= sizes[entry.name]
            # Only the entry goes here. The collector removes the folder when no Dataset names it any more.
            del kept[entry.name]
    return kept


def _entry_of(cluster: Cluster, key: Key, name: str) -> VariantEntry | None:
    """Return the entry of one variant in a Dataset's status; the others are not even read."""
    return variant_of(cluster.store.get(key) or {}, name)


def described(cluster: Cluster, key: Key, name: str) -> dict[str, Any] | None:
    """Return the description of a variant, from its Job where the Dataset's status does not say it yet."""
    entry = _entry_of(cluster, key, name)
    if entry is not None and entry.description:
        return dict(entry.description)
    for job in cluster.store.select(Kind.JOB, key.namespace, Label.VARIANT, name):
        seen = observe_variant(job, cluster.store.pods_of(job))
        if seen.description is not None:
            return seen.description.as_json()
    return None


def _problem_of(entry: VariantEntry) -> tuple[Reason, str]:
    """Return the reason that a variant could not be made."""
    reason, message = entry.reason, entry.message or "preparation failed"
    if reason is None:  # earlier versions wrote it before the sentence
        first, _, rest = message.partition(": ")
        reason, message = (first, rest) if first in set(Reason) else (None, message)
    return Reason(reason) if reason in set(Reason) else Reason.PREPARATION_FAILED, message


def _made(job: dict[str, Any]) -> float:
    return moment(job["metadata"].get("creationTimestamp")) or 0.0
