# SPDX-License-Identifier: Apache-2.0
"""Routing: the keys of the objects that must be reconciled because another object changed.

The store's caller puts them into the queue. Pure.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.kube.api.kinds import Key, Kind, Label, Object, Role, labels_of
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.kube.store import Store


OWN_EVALUATIONS = {"sweep:": Label.SWEEP, "run:": Label.RUN}
"""Beginnings of the names under which Sweeps and runs are evaluated as they ask themselves, and the label
that such Jobs carry instead of an Evaluation's name. No object can have such a name."""

_FINISHED = frozenset(str(phase) for phase in Phase if phase.is_finished)


def routes(kind: Kind, obj: Object, store: Store | None = None, *, new: bool = False) -> list[Key]:
    """Return the keys to reconcile because an object appeared, changed or went.

    Args:
        kind: the object's kind.
        obj: the object, or what it was before it went.
        store: where runs that wait for an Algorithm or Dataset, and Evaluations that may select a finished
            run, are looked up; without it these are left out.
        new: whether the object appeared or went, which Sweeps that name it may have been waiting for.
    """
    namespace = obj["metadata"].get("namespace", "")
    if kind in {Kind.JOB, Kind.POD}:
        keys = [*_of_job(obj, namespace)]
        if store is not None and _role(obj) == Role.RUN:
            keys = [key for key in keys if _goes_on(store.get(key))]
    elif kind is Kind.MAPPING_RUN:
        keys = [*_of_run(obj, namespace, store)]
    else:
        keys = [Key(kind, namespace, obj["metadata"]["name"])]
        if kind in {Kind.ALGORITHM, Kind.DATASET} and store is not None:
            keys += _waiting(kind, obj, namespace, store, new=new)
    return [*dict.fromkeys(keys)]


def is_news(kind: Kind, before: Object | None, after: Object) -> bool:
    """Tell whether a change can be of consequence.

    Jobs and pods change more often than anything follows from it: their controllers count, take finalizers
    away, and begin what is still to be waited for. Each look at a run costs more than all of these. A run
    without a pod is looked at after some time by itself.

    Args:
        kind: the object's kind.
        before: the object as it was; None where it was not known.
        after: the object as it is.
    """
    if kind.is_ours or _role(after) != Role.RUN:
        return True
    told = _told_by_job if kind is Kind.JOB else _told_by_pod
    return told(after) != (_QUIET if before is None else told(before))


_QUIET: Object = {}
_STARTING = frozenset({"ContainerCreating", "PodInitializing"})


def _told_by_job(job: Object) -> Object:
    """Return the part of a Job that a look at a run takes; nothing where it has only been made."""
    metadata, status = job["metadata"], job.get("status") or {}
    found = {
        "deleted": bool(metadata.get("deletionTimestamp")),
        "suspended": bool((job.get("spec") or {}).get("suspend")),
        "conditions": [(item["type"], item["status"]) for item in status.get("conditions") or ()],
    }
    return {name: value for name, value in found.items() if value}


def _told_by_pod(pod: Object) -> Object:
    """Return the part of a pod that a look at a run takes; nothing where that begins as pods do."""
    metadata, status = pod["metadata"], pod.get("status") or {}
    # What holds of a healthy pod says nothing; a disruption is told by a condition that holds.
    conditions = [
        (item["type"], item["status"], item.get("reason"), item.get("message"))
        for item in status.get("conditions") or ()
        if item["type"] == "DisruptionTarget" or (item["type"] == "PodScheduled" and item["status"] != "True")
    ]
    containers = [
        (item["name"], item.get("state"), item.get("lastState"), item.get("restartCount"))
        for field in ("initContainerStatuses", "containerStatuses")
        for item in status.get(field) or ()
        if not _is_starting(item)
    ]
    phase = status.get("phase")
    found = {
        "deleted": bool(metadata.get("deletionTimestamp")),
        "phase": None if phase == "Pending" else phase,
        "reason": (status.get("reason"), status.get("message")) if status.get("reason") else None,
        "conditions": conditions,
        "containers": containers,
    }
    return {name: value for name, value in found.items() if value}


def _is_starting(container: Object) -> bool:
    waiting = (container.get("state") or {}).get("waiting")
    return waiting is not None and waiting.get("reason") in _STARTING and not container.get("lastState")


def _role(obj: Object) -> str | None:
    return labels_of(obj).get(Label.ROLE)


def _goes_on(run: Object | None) -> bool:
    """Tell whether a run is there whose Jobs and pods still bear on anything."""
    return run is not None and not is_finished(run)


def is_finished(run: Object) -> bool:
    """Tell whether nothing more will happen to a MappingRun."""
    return (run.get("status") or {}).get("phase") in _FINISHED


def _of_job(obj: Object, namespace: str) -> Iterator[Key]:
    labels = labels_of(obj)
    named = {
        Role.RUN: [(Kind.MAPPING_RUN, Label.RUN)],
        Role.READ: [(Kind.MAPPING_RUN, Label.RUN)],
        Role.PREPARE: [(Kind.DATASET, Label.DATASET)],
        Role.EVALUATE: [(Kind.EVALUATION, Label.EVALUATION)],
        Role.RESTORE: [(Kind.EVALUATION, Label.EVALUATION)],
    }
    if labels.get(Label.ROLE) in {Role.EVALUATE, Role.RESTORE}:
        for prefix, label in OWN_EVALUATIONS.items():
            if name := labels.get(label):
                yield Key(Kind.EVALUATION, namespace, f"{prefix}{name}")
    for role, targets in named.items():
        if labels.get(Label.ROLE) == role:
            for kind, label in targets:
                if name := labels.get(label):
                    yield Key(kind, namespace, name)


def _of_run(run: Object, namespace: str, store: Store | None) -> Iterator[Key]:
    yield Key(Kind.MAPPING_RUN, namespace, run["metadata"]["name"])
    sweep = labels_of(run).get(Label.SWEEP)
    if sweep:
        yield Key(Kind.SWEEP, namespace, sweep)
    if store is not None and is_finished(run):
        for evaluation in store.of(Kind.EVALUATION, namespace):
            if may_select(evaluation, run):
                yield Key(Kind.EVALUATION, namespace, evaluation["metadata"]["name"])


def may_select(evaluation: Object, run: Object) -> bool:
    """Tell whether an Evaluation chooses a run by its name, its Sweep or its labels."""
    chosen: Object = evaluation["spec"].get("runs") or {}
    labels = labels_of(run)
    if run["metadata"]["name"] in (chosen.get("names") or ()):
        return True
    sweep = (chosen.get("sweepRef") or {}).get("name")
    if sweep is not None and labels.get(Label.SWEEP) == sweep:
        return True
    wanted: dict[str, str] = chosen.get("matchLabels") or {}
    return bool(wanted) and all(labels.get(name) == value for name, value in wanted.items())


def _waiting(kind: Kind, obj: Object, namespace: str, store: Store, *, new: bool) -> Iterator[Key]:
    for run in store.referring(namespace, kind, obj["metadata"]["name"]):
        if not is_finished(run):
            yield Key(Kind.MAPPING_RUN, namespace, run["metadata"]["name"])
    # Selectors of a matrix choose by label, so an entry that appears may concern a Sweep that does not name
    # it.
    if new:
        for sweep in store.of(Kind.SWEEP, namespace):
            yield Key(Kind.SWEEP, namespace, sweep["metadata"]["name"])
