# SPDX-License-Identifier: Apache-2.0
"""MappingRuns of a Sweep: their manifests, their slots, and the figures over those that are done. Pure."""

from __future__ import annotations

import base64
import binascii
import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.archive.remarks import NOTE, TAGS
from slamhive.contract.settled import FILES, is_settled
from slamhive.engine import PointState
from slamhive.kube.api.kinds import MANAGER, Kind, Label, annotations_of, key_of, labels_of, reference
from slamhive.kube.kueue import QUEUE_WAITS
from slamhive.kube.observing import PREPARATION_WAITS
from slamhive.kube.pods import condition as condition_of
from slamhive.kube.priorities import CLASS_NOT_FOUND
from slamhive.kube.status import phase_of, rmse_of
from slamhive.model.base import PRIORITY_CLASS, QUEUE_NAME
from slamhive.model.results import Outcome, Phase
from slamhive.model.status import BEST_LENGTH, BestRun

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.kube.api.kinds import Key
    from slamhive.plan import Point

ASKED = "slamhive.io/asked"
"""Annotation of runs whose spec holds what took effect: the input options that were asked for, as JSON."""
SAME_AS = "slamhive.io/same-as"
"""Annotation of runs that ask for what another run of their Sweep has: its name, whose result they take."""
ARCHIVE_ONLY = "slamhive.io/archive-only"
"""Annotation of runs beyond their Sweep's retention, whose objects are told neither of their end nor of their
result: the archive is, and the objects go."""
OWN_PREFIX = "slamhive.io/"


def run_body(
    sweep: dict[str, Any], point: Point, slot: int, twin: str | None = None, *, archive_only: bool = False
) -> dict[str, Any]:
    """Return the MappingRun of a point.

    Args:
        sweep: the Sweep as the API holds it.
        point: the point.
        slot: number of its place among those in flight.
        twin: name of the run that asks for the same and was done before, if any.
        archive_only: whether it is beyond the retention.
    """
    meta = sweep["metadata"]
    given = (sweep["spec"].get("template") or {}).get("metadata") or {}
    kept = (sweep["spec"].get("retention") or {}).get("files") != "Delete"
    spec = {key: value for key, value in point.spec.items() if key != "cancel"}
    if sweep["spec"].get("priorityClassName"):
        spec["priorityClassName"] = sweep["spec"]["priorityClassName"]
    labels = {
        Label.MANAGED_BY: MANAGER,
        Label.SWEEP: meta["name"],
        Label.POINT: str(point.index),
        Label.SLOT: str(slot),
        Label.ALGORITHM: spec["algorithmRef"]["name"],
        Label.DATASET: spec["datasetRef"]["name"],
    }
    own = {} if kept else {FILES: "Delete"}
    own |= {ASKED: json.dumps(point.asked)} if point.asked else {}
    own |= {SAME_AS: twin} if twin else {}
    own |= {ARCHIVE_ONLY: "true"} if archive_only else {}
    return {
        "apiVersion": Kind.MAPPING_RUN.api_version,
        "kind": str(Kind.MAPPING_RUN),
        "metadata": {
            "name": point.name,
            "namespace": meta["namespace"],
            "labels": _queue(meta)
            | _passed(given.get("labels"))
            | {str(key): value for key, value in labels.items()},
            "annotations": _passed(given.get("annotations")) | own,
            "ownerReferences": [reference(Kind.SWEEP, sweep, controller=True)],
        },
        "spec": spec,
    }


def is_archive_only(run: Mapping[str, Any]) -> bool:
    """Tell whether a run is beyond its Sweep's retention, so that the archive alone will have its result."""
    return annotations_of(run).get(ARCHIVE_ONLY) == "true"


def asked_of(run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the input options that a run was asked for in the place of what its spec holds."""
    text = annotations_of(run).get(ASKED)
    try:
        found = json.loads(text) if text else {}
    except ValueError:  # someone else's words
        return {}
    return found if isinstance(found, dict) else {}


def point_of(run: Mapping[str, Any]) -> int | None:
    """Return the index of the point that a MappingRun belongs to."""
    text = labels_of(run).get(Label.POINT, "")
    return int(text) if text.isdecimal() else None


def state_of(run: Mapping[str, Any]) -> PointState:
    """Return the state of a run's point."""
    phase = phase_of(run.get("status") or {})
    if phase is Phase.SUCCEEDED:
        return PointState.SUCCEEDED
    return PointState.FAILED if phase.is_finished else PointState.ACTIVE


_STILL = {"Accepted": False, "Admitted": False, "ReconcileError": True}


def standing_still(active: Sequence[dict[str, Any]], failing: Mapping[Key, str]) -> str | None:
    """Return the number of runs in flight that don't go on, and what keeps the first; None where all do.

    Args:
        active: runs in flight.
        failing: what keeps objects from going on, also where their statuses can't say it.
    """
    told = ((run, failing.get(key_of(Kind.MAPPING_RUN, run)) or _why_still(run)) for run in active)
    still = [(run["metadata"]["name"], why) for run, why in told if why]
    if not still:
        return None
    name, why = still[0]
    return f"{len(still)} of {len(active)} runs in flight don't go on; {name}: {why}"


def _why_still(run: Mapping[str, Any]) -> str | None:
    status = run.get("status") or {}
    for item in status.get("conditions") or ():
        if item["type"] in _STILL and item["status"] == str(_STILL[item["type"]]):
            return str(item.get("message") or item["reason"])
    told = condition_of(run, "Scheduled") or {}
    held = told.get("status") == "False" and told.get("reason") in {CLASS_NOT_FOUND, PREPARATION_WAITS}
    return str(told.get("message")) if held else None


def lacks_class(run: Mapping[str, Any]) -> bool:
    """Tell whether a run has no pod because its PriorityClass is not there."""
    told = condition_of(run, "Scheduled") or {}
    return told.get("status") == "False" and told.get("reason") == CLASS_NOT_FOUND


def held_back(active: Sequence[dict[str, Any]]) -> str | None:
    """Return the number of runs in flight that wait in a queue, and why the first; None where none does."""
    waiting = [(run["metadata"]["name"], why) for run in active if (why := why_held_back(run))]
    if not waiting:
        return None
    name, why = waiting[0]
    return f"{len(waiting)} of {len(active)} runs in flight wait in a queue; {name}: {why}"


def why_held_back(run: Mapping[str, Any]) -> str | None:
    """Return the reason that a run in flight waits in a queue; None where it waits in none."""
    found = condition_of(run, "Scheduled") or {}
    held = found.get("status") == "False" and found.get("reason") == QUEUE_WAITS
    return str(found.get("message") or QUEUE_WAITS) if held else None


def slots_used(runs: Iterable[Mapping[str, Any]]) -> set[int]:
    """Return the slots of runs in flight."""
    texts = (labels_of(run).get(Label.SLOT, "") for run in runs if state_of(run) is PointState.ACTIVE)
    return {int(text) for text in texts if text.isdecimal()}


def free_slot(used: set[int]) -> int:
    """Return the smallest slot that is free, and take it."""
    # The smallest one, so that Prometheus has as many live series as there are runs at a time, not as many as
    # runs.
    slot = next(number for number in range(len(used) + 1) if number not in used)
    used.add(slot)
    return slot


class Finished(NamedTuple):
    """A finished run, and what it adds to its Sweep's figures.

    Attributes:
        run: the object.
        is_settled: whether nothing more will be written of it.
        reused: 1 where it took an equal run's result, else 0.
        evaluated: 1 where it has a result, else 0.
        cpu_seconds: CPU time that it computed, s.
        best: its error; None where it has none or was not tracked.
    """

    run: dict[str, Any]
    is_settled: bool
    reused: int
    evaluated: int
    cpu_seconds: float
    best: BestRun | None

    @classmethod
    def of(cls, run: dict[str, Any]) -> Finished:
        """Return the sum of one finished run."""
        status = run.get("status") or {}
        results = status.get("results") or ()
        reused = bool((status.get("provenance") or {}).get("reusedFrom"))
        computed = ((status.get("usage") or {}).get("cpu") or {}).get("seconds") or 0.0
        return cls(
            run=run,
            is_settled=is_settled(run),
            reused=int(reused),
            evaluated=int(bool(results)),
            cpu_seconds=0.0 if reused else computed,
            best=_best_entry(run, results[0]) if results else None,
        )


@dataclass
class SweepTally:
    """Figures over a Sweep's finished runs.

    Attributes:
        reused: runs that took an equal run's result.
        evaluated: runs with a result.
        cpu_seconds: CPU time of those that computed.
        best: Tracked runs with the smallest errors.
    """

    reused: int = 0
    evaluated: int = 0
    cpu_seconds: float = 0.0
    best: list[BestRun] = field(default_factory=list)

    def add(self, *runs: Finished) -> None:
        """Count finished runs."""
        self.reused += sum(run.reused for run in runs)
        self.evaluated += sum(run.evaluated for run in runs)
        self.cpu_seconds += sum(run.cpu_seconds for run in runs)
        self.best = best_of([*self.best, *(run.best for run in runs if run.best is not None)])


def best_of(entries: Iterable[BestRun]) -> list[BestRun]:
    """Return the entries with the smallest errors, each run once."""
    by_name = {entry.name: entry for entry in entries}
    return sorted(by_name.values(), key=lambda entry: (entry.ate, entry.name))[:BEST_LENGTH]


def _best_entry(run: Mapping[str, Any], result: Mapping[str, Any]) -> BestRun | None:
    error = rmse_of(result)
    if result.get("outcome") != Outcome.TRACKED or error is None:
        return None
    return BestRun(
        name=run["metadata"]["name"],
        index=point_of(run),
        ate=error,
        coverage=result.get("coverage"),
        algorithm=run["spec"]["algorithmRef"]["name"],
        dataset=run["spec"]["datasetRef"]["name"],
    )


def _queue(meta: Mapping[str, Any]) -> dict[str, str]:
    """Return the labels by which a queue knows what belongs to a Sweep: its own hold for its runs."""
    labels = meta.get("labels") or {}
    return {name: labels[name] for name in (QUEUE_NAME, PRIORITY_CLASS) if name in labels}


def _passed(given: Mapping[str, str] | None) -> dict[str, str]:
    """Return labels or annotations of a template without those that are ours to set.

    A note and tags are the user's words.
    """
    return {
        key: value
        for key, value in (given or {}).items()
        if key in {NOTE, TAGS} or not key.startswith(OWN_PREFIX)
    }


def encode_points(states: bytes | bytearray) -> str:
    """Return states, one a byte, as text; the first point has the lowest bits of the first byte."""
    padded = np.frombuffer(bytes(states) + bytes(-len(states) % 4), np.uint8).reshape(-1, 4)
    return base64.b64encode(np.bitwise_or.reduce(padded << _SHIFTS, axis=1).tobytes()).decode()


def decode_points(text: str | None, total: int) -> bytearray:
    """Return the states that a text holds, one a byte; what it does not say is pending."""
    try:
        packed = base64.b64decode(text or "", validate=True)
    except (binascii.Error, ValueError):
        packed = b""
    pairs = np.frombuffer(packed, np.uint8)[:, np.newaxis] >> _SHIFTS & 3
    states = bytearray(pairs.tobytes())
    return states[:total] + bytearray(max(0, total - len(states)))


_SHIFTS = np.array([0, 2, 4, 6], np.uint8)
