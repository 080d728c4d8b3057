# SPDX-License-Identifier: Apache-2.0
"""Variants on the cluster: one preparation Job each, readiness in the Dataset's status.

A variant's entry in ``Dataset.status.variants`` holds as long as the Dataset does: it never changes, so the
same name means the same recording. A failed entry holds for the runs that were there when it failed; a later
run tries again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.engine import VariantState
from slamhive.kube.builders import variant_job, variant_name
from slamhive.kube.errors import AlreadyExists
from slamhive.kube.kinds import Key, Kind, Label, Role, key_of
from slamhive.kube.observing import observe_variant
from slamhive.kube.reconciling.refusals import patience
from slamhive.kube.status import changes, iso, moment
from slamhive.model.base import quantity
from slamhive.model.results import Reason
from slamhive.model.run import InputOptions
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.dataset import Dataset

_TOUCH_SECONDS = 3600.0
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
        roles = algorithm.spec.mode(SensorMode(spec["sensors"])).needs
        name = variant_name(dataset, roles, options, algorithm.spec.recording, algorithm.spec.assets)
        return cls(name, algorithm, dataset, spec)


@dataclass(frozen=True)
class VariantSeen:
    """What is known of a variant.

    Attributes:
        state: whether it is there.
        description: what it is, when it is ready.
        problem: why it could not be made.
    """

    state: VariantState
    description: dict[str, Any] | None = None
    problem: tuple[Reason, str] | None = None


def look(op: Operator, namespace: str, wanted: Wanted, created: float) -> VariantSeen:
    """Return what is known of a variant.

    Args:
        op: the operator.
        namespace: where.
        wanted: the variant.
        created: when the run that asks was made, or last tried, s since 1970: older failures don't count.
    """
    entry = entries(op, Key(Kind.DATASET, namespace, wanted.dataset.name)).get(wanted.name)
    if entry is not None and entry.get("phase") == "Ready":
        return VariantSeen(VariantState.READY, entry.get("description") or {})
    jobs = op.store.select(Kind.JOB, namespace, Label.VARIANT, wanted.name)
    for job in jobs:
        pods = op.store.select(Kind.POD, namespace, Label.VARIANT, wanted.name)
        seen = observe_variant(job, pods)
        if seen.state is VariantState.READY and seen.description is not None:
            return VariantSeen(VariantState.READY, seen.description.as_json())
        if seen.state is VariantState.MAKING:
            return VariantSeen(VariantState.MAKING)
        if seen.problem is not None and _made(job) >= created:
            return VariantSeen(VariantState.FAILED, problem=seen.problem)
    if entry is not None and entry.get("phase") == "Failed":
        since = moment(entry.get("changedTime")) or 0.0
        if since >= created:
            return VariantSeen(VariantState.FAILED, problem=_told(entry))
    return VariantSeen(VariantState.ABSENT)


async def make(op: Operator, namespace: str, wanted: Wanted, owner: dict[str, Any]) -> float | None:
    """Have a variant made, or join those that wait for it.

    Args:
        op: the operator.
        namespace: where.
        wanted: the variant.
        owner: reference to the object that needs it.

    Returns:
        Seconds after which to ask again, when there is no room for another preparation now.
    """
    jobs = op.store.select(Kind.JOB, namespace, Label.VARIANT, wanted.name)
    for job in jobs:
        pods = op.store.select(Kind.POD, namespace, Label.VARIANT, wanted.name)
        if observe_variant(job, pods).state is VariantState.FAILED:
            await op.delete(key_of(Kind.JOB, job))
            return _PENDING_SECONDS / 5
    if not jobs:
        active = [
            job
            for job in op.store.select(Kind.JOB, namespace, Label.ROLE, Role.PREPARE)
            if not _has_ended(job)
        ]
        if len(active) >= op.settings.preparation.parallel_jobs:
            return _PENDING_SECONDS
    body = variant_job(
        namespace=namespace,
        name=wanted.name,
        dataset=wanted.dataset,
        algorithm=wanted.algorithm,
        spec=wanted.spec,
        settings=op.settings,
        owners=[owner],
    )
    try:
        await op.create(Kind.JOB, body)
    except AlreadyExists:
        await _join(op, Key(Kind.JOB, namespace, body["metadata"]["name"]), owner)
    return None


async def join(op: Operator, namespace: str, wanted: Wanted, owner: dict[str, Any]) -> None:
    """Become an owner of the Job that makes a variant, so that it stays while this owner needs it."""
    for job in op.store.select(Kind.JOB, namespace, Label.VARIANT, wanted.name):
        owners = job["metadata"].get("ownerReferences") or []
        if not _has_ended(job) and owner["uid"] not in {item["uid"] for item in owners}:
            await _join(op, Key(Kind.JOB, namespace, job["metadata"]["name"]), owner)


async def _join(op: Operator, key: Key, owner: dict[str, Any]) -> None:
    job = await op.refresh(key)
    if job is None:
        return
    owners = job["metadata"].get("ownerReferences") or []
    if owner["uid"] in {item["uid"] for item in owners}:
        return
    patch = {
        "metadata": {
            "resourceVersion": job["metadata"]["resourceVersion"],
            "ownerReferences": [*owners, owner],
        }
    }
    await op.patch(key, patch)


class DatasetReconciler:
    """Keeps ``Dataset.status.variants`` true."""

    async def __call__(self, op: Operator, key: Key) -> float | None:
        """Take what preparation Jobs report into the Dataset's status."""
        dataset = op.store.get(key)
        if dataset is None:
            return None
        before = entries(op, key)
        after = dict(before)
        delays: list[float] = []
        for job in op.store.select(Kind.JOB, key.namespace, Label.DATASET, key.name):
            name = job["metadata"].get("labels", {}).get(Label.VARIANT)
            if name is not None:
                entry = self._entry(op, key.namespace, name, job, before.get(name) or {})
                after[name] = await self._without_pod(op, job, entry, delays)
        after = _within(op, key.namespace, after)
        if after == before:
            return min(delays, default=None)
        body = {
            "metadata": {"resourceVersion": dataset["metadata"]["resourceVersion"]},
            "status": {"variants": list(after.values())},
        }
        await op.patch(key, body, subresource="status")
        self._wake(op, key)
        return min(delays, default=None)

    @staticmethod
    async def _without_pod(
        op: Operator, job: dict[str, Any], entry: dict[str, Any], delays: list[float]
    ) -> dict[str, Any]:
        """Return an entry with why its Job has no pod; one whose pod is refused for long has failed."""
        if entry["phase"] != "Preparing":
            return entry
        pods = [pod for kind, pod in op.store.owned(job["metadata"]["uid"]) if kind is Kind.POD]
        waiting, seconds = await patience(op, job, observe_variant(job, pods).waiting)
        if waiting is None or seconds is None:
            return {field: value for field, value in entry.items() if field != "message"}
        if seconds > 0:
            delays.append(seconds)
            return entry | {"message": waiting.message}
        await op.delete(key_of(Kind.JOB, job))
        told = {"phase": "Failed", "message": f"{Reason.SYSTEM_FAULT}: {waiting.message}"}
        return entry | told | {"changedTime": iso(op.clock())}

    @staticmethod
    def _entry(
        op: Operator, namespace: str, name: str, job: dict[str, Any], known: dict[str, Any]
    ) -> dict[str, Any]:
        if known.get("phase") == "Ready":
            return known
        seen = observe_variant(job, op.store.select(Kind.POD, namespace, Label.VARIANT, name))
        entry: dict[str, Any] = {"name": name, "phase": "Preparing"}
        if seen.state is VariantState.READY and seen.description is not None:
            described = seen.description.as_json()
            entry |= {
                "phase": "Ready",
                "folder": f"variants/{described['folder']}",
                "sizeBytes": described["sizeBytes"],
                "description": described,
                "lastUsedTime": iso(op.clock()),
            }
        elif seen.problem is not None:
            entry |= {"phase": "Failed", "message": f"{seen.problem[0]}: {seen.problem[1]}"[:4096]}
        same = known and not changes(known, entry)
        return known if same else entry | {"changedTime": iso(op.clock())}

    @staticmethod
    def _wake(op: Operator, key: Key) -> None:
        for run in op.store.referring(key.namespace, Kind.DATASET, key.name):
            op.queue.add(key_of(Kind.MAPPING_RUN, run))


async def touch(op: Operator, key: Key, name: str) -> None:
    """Note that a variant is used, at most once an hour."""
    known = entries(op, key)
    dataset = op.store.get(key)
    if name not in known or dataset is None:
        return
    used = moment(known[name].get("lastUsedTime")) or 0.0
    if op.clock() - used < _TOUCH_SECONDS:
        return
    known[name] = known[name] | {"lastUsedTime": iso(op.clock())}
    body = {
        "metadata": {"resourceVersion": dataset["metadata"]["resourceVersion"]},
        "status": {"variants": list(known.values())},
    }
    await op.patch(key, body, subresource="status")


async def forget(op: Operator, key: Key, name: str) -> None:
    """Take a variant that turned out to be gone from the volume out of a Dataset's status."""
    known = entries(op, key)
    dataset = op.store.get(key)
    for job in op.store.select(Kind.JOB, key.namespace, Label.VARIANT, name):
        await op.delete(key_of(Kind.JOB, job))  # its report would bring the entry back
    if dataset is None or known.pop(name, None) is None:
        return
    body = {
        "metadata": {"resourceVersion": dataset["metadata"]["resourceVersion"]},
        "status": {"variants": list(known.values())},
    }
    await op.patch(key, body, subresource="status")


def _within(op: Operator, namespace: str, known: dict[str, Any]) -> dict[str, Any]:
    """Return the entries that may stay: unused ones go while a namespace's variants are too large."""
    limit = quantity(op.settings.variants_limit)
    others = sum(
        item.get("sizeBytes", 0)
        for dataset in op.store.of(Kind.DATASET, namespace)
        for item in (dataset.get("status") or {}).get("variants") or ()
        if item["name"] not in known
    )
    total = others + sum(item.get("sizeBytes", 0) for item in known.values())
    used = {
        (run.get("status") or {}).get("variant")
        for run in op.store.of(Kind.MAPPING_RUN, namespace)
        if (run.get("status") or {}).get("phase") in {"Pending", "Preparing", "Running", None}
    }
    kept = dict(known)
    oldest = sorted(known.values(), key=lambda item: item.get("lastUsedTime") or item.get("changedTime", ""))
    for item in oldest:
        if total <= limit and len(kept) <= _ENTRIES:
            break
        ready_unused = item.get("phase") != "Preparing" and item["name"] not in used
        recent = op.clock() - (moment(item.get("changedTime")) or 0.0) < _TOUCH_SECONDS
        if ready_unused and not recent:
            total -= item.get("sizeBytes", 0)
            del kept[item["name"]]
    return kept


def entries(op: Operator, key: Key) -> dict[str, dict[str, Any]]:
    """Return what a Dataset's status says of its variants, by name."""
    dataset = op.store.get(key) or {}
    variants = (dataset.get("status") or {}).get("variants") or ()
    return {item["name"]: item for item in variants}


def described(op: Operator, key: Key, name: str) -> dict[str, Any] | None:
    """Return the description of a variant, from its Job where the Dataset's status does not say it yet."""
    entry = entries(op, key).get(name)
    if entry is not None and entry.get("description"):
        return dict(entry["description"])
    for job in op.store.select(Kind.JOB, key.namespace, Label.VARIANT, name):
        seen = observe_variant(job, op.store.select(Kind.POD, key.namespace, Label.VARIANT, name))
        if seen.description is not None:
            return seen.description.as_json()
    return None


def _told(entry: dict[str, Any]) -> tuple[Reason, str]:
    reason, _, message = str(entry.get("message", "")).partition(": ")
    if reason in set(Reason):
        return Reason(reason), message
    return Reason.PREPARATION_FAILED, str(entry.get("message", "preparation failed"))


def _made(job: dict[str, Any]) -> float:
    return moment(job["metadata"].get("creationTimestamp")) or 0.0


def _has_ended(job: dict[str, Any]) -> bool:
    found = (job.get("status") or {}).get("conditions") or ()
    return any(item["type"] in {"Complete", "Failed"} and item["status"] == "True" for item in found)
