# SPDX-License-Identifier: Apache-2.0
"""Queries over the Sweeps, runs and Evaluations of a namespace.

The cluster commands show and act on what they return.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.contract.settled import is_settled
from slamhive.kube.api.errors import NotFound
from slamhive.kube.api.kinds import Kind, Label, Object, labels_of
from slamhive.kube.builders.common import label_value
from slamhive.kube.status import holds, moment, phase_of
from slamhive.kube.user.together import together
from slamhive.model.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.kube.user.connecting import ConnectedCluster


SEEN = (Kind.SWEEP, Kind.MAPPING_RUN, Kind.EVALUATION)
"""Kinds that commands take by name, in this order."""

_UNNOTICED_SECONDS = 20.0
_RETIRED = "a run beyond its Sweep's retention is in the archive alone: slamhive results show NAME"
_BAD = {
    "Accepted": ("False", "not accepted"),
    "Blocked": ("True", "blocked"),
    "ArchiveUnavailable": ("True", "the archive is away"),
    "Suspended": ("True", "suspended"),
    "Admitted": ("False", "refused by the cluster"),
    "Scheduled": ("False", "not scheduled"),
    "Evaluated": ("False", "not evaluated"),
    "EvaluationError": ("True", "can't be evaluated"),
    "ReconcileError": ("True", "the operator can't go on"),
    "LiveUsage": ("False", "no live usage"),
    "UsageSuspect": ("True", "usage suspect"),
}
"""Conditions that people should hear of: the status at which, and the words."""


@dataclass(frozen=True)
class NamespacePicture:
    """Objects of a namespace that a command shows.

    Attributes:
        sweeps: Sweeps.
        runs: MappingRuns that belong to no Sweep, or that were asked for by name.
        evaluations: Evaluations.
        failed: failed runs of the Sweeps that were asked for by name, by its name.
    """

    sweeps: list[Object] = field(default_factory=list)
    runs: list[Object] = field(default_factory=list)
    evaluations: list[Object] = field(default_factory=list)
    failed: Mapping[str, list[Object]] = field(default_factory=dict)

    @property
    def objects(self) -> list[tuple[Kind, Object]]:
        """Return all but failed runs, with their kinds."""
        return [
            (kind, body)
            for kind, bodies in zip(SEEN, (self.sweeps, self.runs, self.evaluations), strict=True)
            for body in bodies
        ]

    @property
    def is_over(self) -> bool:
        """Tell whether nothing more will happen to any of them."""
        return all(is_over(kind, body) for kind, body in self.objects)


async def look_around(cluster: ConnectedCluster) -> NamespacePicture:
    """Return the picture of all that is in the namespace."""
    lists = await together(
        (
            cluster.api.list(Kind.SWEEP, cluster.namespace),
            cluster.api.list(Kind.MAPPING_RUN, cluster.namespace, labels=f"!{Label.SWEEP}"),
            cluster.api.list(Kind.EVALUATION, cluster.namespace),
        )
    )
    sweeps, runs, evaluations = (sorted(items, key=_by_age) for items, _ in lists)
    return NamespacePicture(sweeps, runs, evaluations)


async def look_at(
    cluster: ConnectedCluster, names: Sequence[str], before: NamespacePicture | None = None
) -> NamespacePicture:
    """Return the picture of all of some names, with the failed runs of Sweeps.

    Args:
        cluster: where.
        names: names of Sweeps, MappingRuns or Evaluations.
        before: an earlier picture: runs are listed again only where a Sweep has more failures now.

    Raises:
        InputError: nothing has one of the names.
    """
    found = await find(cluster, names)
    by_kind: dict[Kind, list[Object]] = {kind: [] for kind in SEEN}
    for kind, body in found:
        by_kind[kind].append(body)
    known = {name_of(body): body for body in (before.sweeps if before else ())}
    failed = {}
    for sweep in by_kind[Kind.SWEEP]:
        name = name_of(sweep)
        count = status_of(sweep).get("failed", 0)
        # A large Sweep's runs are megabytes: they are listed when there is another failure, not at each look.
        if before is not None and name in known and status_of(known[name]).get("failed", 0) == count:
            failed[name] = before.failed.get(name, [])
        elif count:
            failed[name] = [run for run in await runs_of(cluster, sweep) if has_failed(run)]
    return NamespacePicture(by_kind[Kind.SWEEP], by_kind[Kind.MAPPING_RUN], by_kind[Kind.EVALUATION], failed)


async def find(
    cluster: ConnectedCluster, names: Sequence[str], kinds: Sequence[Kind] = SEEN
) -> list[tuple[Kind, Object]]:
    """Return the objects of some names; one name may be that of several kinds.

    Raises:
        InputError: nothing has one of the names.
    """
    found: list[tuple[Kind, Object]] = []
    for name in dict.fromkeys(names):
        bodies = await together(_get(cluster, kind, name) for kind in kinds)
        there = [(kind, body) for kind, body in zip(kinds, bodies, strict=True) if body is not None]
        if not there:
            lists = await together(cluster.api.list(kind, cluster.namespace) for kind in kinds)
            known = [name_of(body) for items, _ in lists for body in items]
            what = " or ".join(str(kind) for kind in kinds)
            error = UnknownNameError(what, name, known, f"namespace {cluster.namespace}")
            if Kind.MAPPING_RUN in kinds and any(name.startswith(f"{other}-") for other in known):
                raise InputError(f"{error}; {_RETIRED}")
            raise error
        found += there
    return found


async def runs_of(cluster: ConnectedCluster, sweep: Mapping[str, Any]) -> list[Object]:
    """Return the MappingRuns of a Sweep that the cluster holds, by point."""
    selector = f"{Label.SWEEP}={label_value(name_of(sweep))}"
    runs, _ = await cluster.api.list(Kind.MAPPING_RUN, cluster.namespace, labels=selector)
    # A label can be cut short or set by anybody: the owner's uid decides.
    own = [run for run in runs if owner_uid(run) == sweep["metadata"]["uid"]]
    return sorted(own, key=lambda run: int(labels_of(run).get(Label.POINT, "0")))


def troubles(kind: Kind, body: Mapping[str, Any], now: float) -> list[str]:
    """Return sentences about what is not as it should be.

    Args:
        kind: kind of the object.
        body: the object.
        now: s since 1970.
    """
    status = status_of(body)
    conditions = status.get("conditions") or ()
    age = now - (moment(body["metadata"].get("creationTimestamp")) or now)
    # An operator takes notice within a second: without one an object waits for ever and says nothing. Runs of
    # a Sweep were made by an operator, and nothing is written of them until their programs run or can't.
    is_unnoticed = not conditions and Label.SWEEP not in labels_of(body)
    if is_unnoticed and age > _UNNOTICED_SECONDS:
        return ["no operator has taken notice of it; is one installed for this namespace?"]
    ended = kind is Kind.MAPPING_RUN and phase_of(status).is_finished
    passed = {"Accepted", "Admitted", "Scheduled"} if ended else set()
    passed |= {"LiveUsage"} if is_over(kind, body) else set()
    sentences = []
    if status.get("deleted"):
        sentences.append(f"runs deleted by hand: {status['deleted']}")
    for item in conditions:
        bad, words = _BAD.get(item["type"], ("", ""))
        if item["status"] != bad or item["type"] in passed:
            continue
        message = item.get("message") or ""
        sentences.append(f"{words}: {message}" if message else words)
    return sentences


def is_over(kind: Kind, body: Mapping[str, Any]) -> bool:
    """Tell whether nothing more will happen to an object."""
    status = status_of(body)
    if kind is Kind.MAPPING_RUN:
        return is_settled(body)
    return holds(status, "Complete") is True


def is_stuck(kind: Kind, body: Mapping[str, Any]) -> str | None:
    """Return the reason that an object will not go on unless someone does something; None when it does."""
    status = status_of(body)
    if holds(status, "Accepted") is False and not is_over(kind, body):
        return "; ".join(troubles(kind, body, 0.0))
    if holds(status, "Suspended") and not status.get("running"):
        return "suspended"
    if kind is Kind.EVALUATION:
        reasons = {item["type"]: item.get("reason") for item in status.get("conditions") or ()}
        return "no run is selected" if reasons.get("Complete") == "NoRuns" else None
    return None


def has_failed(run: Mapping[str, Any]) -> bool:
    """Tell whether a run has ended without success."""
    phase = phase_of(status_of(run))
    return phase.is_finished and phase != "Succeeded"


def name_of(body: Mapping[str, Any]) -> str:
    """Return an object's name."""
    return str(body["metadata"]["name"])


def status_of(body: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return an object's status, empty when nobody has written one."""
    return body.get("status") or {}


def extent(found: Mapping[str, Any]) -> tuple[int, int]:
    """Return the numbers of runs of a Sweep, all and those done; of a search those of its settings.

    Args:
        found: its status.
    """
    search = found.get("search") or {}
    if search.get("most"):
        return search["most"], search.get("decided") or 0
    return found.get("total") or 0, found.get("succeeded", 0) + found.get("failed", 0)


def owner_uid(run: Mapping[str, Any]) -> str | None:
    """Return the identity of the Sweep that a run belongs to."""
    owners: Iterable[Mapping[str, Any]] = run["metadata"].get("ownerReferences") or ()
    return next((owner["uid"] for owner in owners if owner["kind"] == Kind.SWEEP), None)


async def _get(cluster: ConnectedCluster, kind: Kind, name: str) -> Object | None:
    try:
        return await cluster.api.get(cluster.key(kind, name))
    except NotFound:
        return None


def _by_age(body: Object) -> tuple[str, str]:
    return str(body["metadata"].get("creationTimestamp", "")), name_of(body)
