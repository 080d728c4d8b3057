# SPDX-License-Identifier: Apache-2.0
"""Submission of manifests to a cluster: all of them or, if one can't be accepted, none.

First everything is checked: here against the catalog, there against the objects that exist and, in a trial
without effect, by the API server itself. Only then is anything made.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from slamhive.kube.api.errors import AlreadyExists, Conflict, Invalid, NotFound
from slamhive.kube.api.kinds import Kind, Object
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.user.manifests import Manifest, ManifestDifference, bounded, compare, entry_of
from slamhive.kube.user.together import together
from slamhive.model.algorithm import Algorithm
from slamhive.model.base import Choice
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError
from slamhive.plan import FixedCatalog

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.kube.user.connecting import ConnectedCluster
    from slamhive.model.base import Resource
    from slamhive.plan import Plan


_AT_ONCE = 16
_ORDER = (Kind.ALGORITHM, Kind.DATASET, Kind.SWEEP, Kind.MAPPING_RUN, Kind.EVALUATION)


class Deed(Choice):
    """Outcomes for an object whose manifest is sent to a cluster."""

    CREATED = "created"
    CHANGED = "changed"
    UNCHANGED = "unchanged"


@dataclass(frozen=True)
class Sent:
    """Result of sending a manifest to a cluster: what was done about its object, or would be in a trial.

    Attributes:
        manifest: the manifest.
        deed: what was done.
        changes: what was changed, as sentences.
        uid: the object's identity; None after a trial.
    """

    manifest: Manifest
    deed: Deed
    changes: list[str] = field(default_factory=list)
    uid: str | None = None


@dataclass(frozen=True)
class ClusterCatalog:
    """The Algorithms and Datasets of a namespace.

    Attributes:
        bodies: the objects by kind and name.
        items: those that follow the language, as records.
    """

    bodies: Mapping[tuple[Kind, str], Object]
    items: FixedCatalog

    def has(self, kind: Kind, name: str) -> bool:
        """Tell whether an entry is there."""
        return (kind, name) in self.bodies


async def read_catalog(cluster: ConnectedCluster) -> ClusterCatalog:
    """Return the catalog of a cluster's namespace."""
    models: dict[Kind, type[Resource]] = {Kind.ALGORITHM: Algorithm, Kind.DATASET: Dataset}
    lists = await together(cluster.api.list(kind, cluster.namespace) for kind in models)
    bodies: dict[tuple[Kind, str], Object] = {}
    items: list[Resource] = []
    for (kind, model), (found, _) in zip(models.items(), lists, strict=True):
        for body in found:
            bodies[kind, body["metadata"]["name"]] = body
            try:
                items.append(parse(model, body))
            except InputError:  # runs that name it are told so by the operator
                continue
    return ClusterCatalog(bodies, FixedCatalog.of(items))


def missing_entries(
    plans: Iterable[Plan], catalog: ClusterCatalog, given: Sequence[Manifest], local: Mapping[str, Resource]
) -> list[Manifest]:
    """Return the entries of the catalog here that runs name and the cluster lacks.

    Args:
        plans: the runs.
        catalog: what the cluster has.
        given: the manifests that are to be sent anyway.
        local: entries of the catalog here, by ``KIND NAME``.
    """
    there = {str(manifest) for manifest in given}
    names: dict[str, tuple[Kind, str]] = {}
    for plan in plans:
        names |= {f"Algorithm {name}": (Kind.ALGORITHM, name) for name in plan.algorithm_names()}
        names |= {f"Dataset {name}": (Kind.DATASET, name) for name in plan.dataset_names()}
    return [
        entry_of(local[title], "the catalog here")
        for title, (kind, name) in names.items()
        if title not in there and not catalog.has(kind, name) and title in local
    ]


def unable(plans: Iterable[tuple[str, Plan]], catalog: Mapping[str, Algorithm]) -> list[str]:
    """Return a sentence for each algorithm that a cluster cannot run."""
    return [
        f"{title}: Algorithm {name!r} names no image (spec.image), which a cluster needs"
        for title, plan in plans
        for name in plan.algorithm_names()
        if name in catalog and not catalog[name].spec.image
    ]


def left_behind(manifests: Iterable[Manifest]) -> list[str]:
    """Return a sentence for each Dataset whose files the cluster has to have by other ways."""
    sentences = []
    for manifest in manifests:
        item = manifest.item
        if not isinstance(item, Dataset):
            continue
        paths = [file.path for file in item.spec.recording.files or () if not file.url]
        if paths:
            sentences.append(
                f"{manifest}: a manifest carries no recording; the cluster looks for {', '.join(paths[:3])}"
                f"{', …' if len(paths) > 3 else ''} under datasets/{item.name}/ on its data volume"
            )
    return sentences


async def send(
    cluster: ConnectedCluster, manifests: Sequence[Manifest], *, trial: bool = False
) -> list[Sent]:
    """Make or change objects so that they are as manifests say; what is equal is left alone.

    Args:
        cluster: where.
        manifests: what is to be there.
        trial: whether to check alone.

    Raises:
        InputError: something is there with other contents that may not change, or the server refuses an
            object; then nothing was made.
        ApiError: see ``slamhive.kube.api.errors``.
    """
    ordered = sorted(manifests, key=lambda item: _ORDER.index(item.kind))
    limit = asyncio.Semaphore(_AT_ONCE)

    async def look(manifest: Manifest) -> tuple[Object | None, ManifestDifference]:
        async with limit:
            try:
                present = await cluster.api.get(cluster.key(manifest.kind, manifest.name))
            except NotFound:
                return None, ManifestDifference()
        return present, compare(manifest, present)

    async def attempt(
        manifest: Manifest, present: Object | None, difference: ManifestDifference
    ) -> str | None:
        async with limit:
            try:
                if present is None:
                    await cluster.api.try_create(manifest.kind, cluster.namespace, manifest.body)
                elif difference.patch:
                    key = cluster.key(manifest.kind, manifest.name)
                    await cluster.api.try_patch(key, difference.patch)
            except Invalid as error:
                return f"{manifest.source}: {manifest}: the cluster refuses it: {error}"
        return None

    seen = await together(map(look, ordered))
    _raise(
        f"{manifest.source}: {manifest} is in the cluster already with other contents, which can't change "
        f"(cluster → here): {bounded(difference.frozen)}; delete it there, or give this one another name"
        for manifest, (_, difference) in zip(ordered, seen, strict=True)
        if difference.frozen
    )
    # The server checks all of them by dry runs before the first is made: either all go or none.
    tried = await together(attempt(item, *found) for item, found in zip(ordered, seen, strict=True))
    _raise(problem for problem in tried if problem)
    return [await _do(cluster, item, *found, trial) for item, found in zip(ordered, seen, strict=True)]


async def _do(
    cluster: ConnectedCluster,
    manifest: Manifest,
    present: Object | None,
    difference: ManifestDifference,
    trial: bool,
) -> Sent:
    if present is not None:
        uid = present["metadata"]["uid"]
        if not difference.patch:
            return Sent(manifest, Deed.UNCHANGED, uid=uid)
        if not trial:
            key = cluster.key(manifest.kind, manifest.name)
            await cluster.api.patch(key, difference.patch)
        return Sent(manifest, Deed.CHANGED, difference.changes, uid)
    if trial:
        return Sent(manifest, Deed.CREATED)
    try:
        made = await cluster.api.create(manifest.kind, manifest.body, cluster.namespace)
    except AlreadyExists:  # by this very call, whose first answer was lost, or by someone else just now
        made = await cluster.api.get(cluster.key(manifest.kind, manifest.name))
        now = compare(manifest, made)
        if now.frozen or now.patch:
            raise Conflict(f"{manifest}: someone else has just made another object of that name") from None
    return Sent(manifest, Deed.CREATED, uid=made["metadata"]["uid"])


def _raise(problems: Iterable[str]) -> None:
    told = [*problems]
    if told:
        raise InputError("\n".join(told))
