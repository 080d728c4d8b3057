# SPDX-License-Identifier: Apache-2.0
"""Archiving of finished runs: into the archive as they end; those beyond their Sweep's retention go then.

A Sweep's runs are written together, before its status counts them: whoever deletes it loses none of them.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from slamhive.archive import CatalogEntry
from slamhive.contract.settled import FILES, is_settled
from slamhive.kube.api.errors import Conflict
from slamhive.kube.api.kinds import Key, Kind, Object, annotations_of, key_of
from slamhive.kube.reconciling import variants
from slamhive.kube.reconciling.sweep_runs import decode_points, point_of, state_of
from slamhive.kube.records import record_of, with_evaluations
from slamhive.kube.status import result_field
from slamhive.model.errors import SlamHiveError, SystemFault, UnknownNameError
from slamhive.model.evaluation import EvaluationSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from slamhive.archive import Archive
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.catalogue import Catalogue
    from slamhive.kube.reconciling.sweep_state import SweepMemory
    from slamhive.model.results import RunRecord
    from slamhive.model.sweep import Sweep

_AT_ONCE = 50
_KNOWN = 10_000
_DELETED_AT_ONCE = 16

P = ParamSpec("P")
T = TypeVar("T")


class ArchiveAway(SystemFault):
    """The archive does not do what it is asked: it doesn't answer, is damaged, or is of another version."""


async def in_thread(method: Callable[P, T], *words: P.args, **options: P.kwargs) -> T:
    """Return the result of a method of the archive; it may block.

    Raises:
        ArchiveAway: it can't; the sentence says why.
    """
    try:
        return await asyncio.to_thread(method, *words, **options)
    except SlamHiveError as error:
        raise ArchiveAway(str(error)) from error


async def at_its_end(archive: Archive | None, run: Object) -> Object:
    """Return a run that is gone, with the results that it had in the end.

    Another operator may have measured, archived and removed it since it was last seen here.
    """
    if archive is None or is_settled(run):
        return run
    record = await in_thread(archive.get, run["metadata"]["uid"])
    if record is None:
        return run
    return run | {"status": run["status"] | {"results": [result_field(item) for item in record.results]}}


class Keeper:
    """Keeps finished runs in the archive.

    Args:
        catalogue: Algorithms and Datasets, of which the archive keeps what runs used.
        archive: where runs go.
    """

    def __init__(self, catalogue: Catalogue, archive: Archive) -> None:
        self._catalogue = catalogue
        self._archive = archive

    async def keep(
        self, cluster: Cluster, runs: list[Object], settings: EvaluationSettings, kept: dict[str, str]
    ) -> None:
        """Write runs into the archive, and what versions of them were written into ``kept``, by UID.

        Raises:
            ArchiveAway: the archive does not answer.
        """
        for start in range(0, len(runs), _AT_ONCE):
            batch = runs[start : start + _AT_ONCE]
            records = [self._records(cluster, settings, run) for run in batch]
            await in_thread(self._archive.put_used, records)
            kept.update(map(_identity, batch))

    async def keep_single(self, cluster: Cluster, run: Object, kept: dict[str, str]) -> None:
        """Write a run that belongs to no Sweep into the archive, once nothing more will be written of it."""
        if not is_settled(run) or is_kept(run, kept):
            return
        if len(kept) >= _KNOWN:
            kept.clear()  # it is looked up again
        uid, version = _identity(run)
        known = None if uid in kept else await in_thread(self._archive.get, uid)
        if known is not None and known.results == record_of(run).results:
            kept[uid] = version
        else:
            await self.keep(cluster, [run], EvaluationSettings(), kept)

    async def forget(self, uids: Iterable[str]) -> None:
        """Remove runs from the archive, of which there are later ones."""
        if gone := [*uids]:
            await in_thread(self._archive.remove_runs, gone)

    async def retire(
        self, cluster: Cluster, key: Key, sweep: Sweep, memory: SweepMemory, settled: list[Object]
    ) -> list[float]:
        """Archive and delete the oldest settled runs beyond the retention.

        Args:
            cluster: the cluster.
            key: address of the Sweep.
            sweep: the Sweep.
            memory: what is remembered of it.
            settled: its runs that have objects and of which nothing more will be written.

        Returns:
            After how many seconds to come back.
        """
        surplus = len(settled) - sweep.spec.retention.runs
        if surplus <= 0:
            return []
        body = cluster.store.get(key)
        if body is None:
            return []
        settled = sorted(settled, key=lambda run: run["status"].get("completionTime") or "")
        written = decode_points(body["status"].get("points"), len(memory.states))
        # Only what the status says to be done may go: the bit is what remains of a run here.
        going = [run for run in settled[:surplus] if written[point_of(run) or 0] == state_of(run)][:_AT_ONCE]
        # All are in the archive before the first is deleted: a crash in between leaves them in both, and the
        # next look deletes.
        fresh = [run for run in going if not is_kept(run, memory.kept)]
        await self.keep(cluster, fresh, sweep.spec.evaluation, memory.kept)
        limit = asyncio.Semaphore(_DELETED_AT_ONCE)

        async def delete(run: Object) -> bool:
            async with limit:
                gone = await _is_deleted(cluster, run)
            if gone:
                memory.retired.add(run["metadata"]["uid"])
            return gone

        told = await asyncio.gather(*(delete(run) for run in going))
        left = surplus - sum(told)
        return [cluster.settings.sweep_write_seconds] if left else []

    def _records(
        self, cluster: Cluster, settings: EvaluationSettings, run: Object
    ) -> tuple[RunRecord, CatalogEntry | None, CatalogEntry | None]:
        namespace, spec = run["metadata"]["namespace"], run["spec"]
        algorithm = dataset = found = None
        attributes: Object = {}
        try:
            algorithm = CatalogEntry.of(
                self._catalogue.algorithm(cluster.store, namespace, spec["algorithmRef"]["name"])
            )
            found = self._catalogue.dataset(cluster.store, namespace, spec["datasetRef"]["name"])
            dataset = CatalogEntry.of(found)
            variant = run["status"].get("variant") or ""
            known = variants.described(cluster, Key(Kind.DATASET, namespace, found.name), variant) or {}
            attributes = known.get("attributes") or found.spec.known_attributes
        except UnknownNameError:  # deleted from the catalog meanwhile
            pass
        record = record_of(run, attributes=attributes).replace(cluster=cluster.identity)
        record = with_evaluations(record, settings, found)
        if annotations_of(run).get(FILES):
            record = record.replace(folder=None)  # the collector removes it
        return record, algorithm, dataset


def is_kept(run: Object, kept: Mapping[str, str]) -> bool:
    """Tell whether a run is in the archive as it is now; ``kept`` has the versions there by UID."""
    uid, version = _identity(run)
    return kept.get(uid) == version


def _identity(run: Object) -> tuple[str, str]:
    """Return a run's UID and version."""
    return run["metadata"]["uid"], run["metadata"]["resourceVersion"]


async def _is_deleted(cluster: Cluster, run: Object) -> bool:
    """Delete an archived run; False where someone wrote to it: the archive gets the newer state next time."""
    meta, key = run["metadata"], key_of(Kind.MAPPING_RUN, run)
    try:
        await cluster.delete(key, uid=meta["uid"], resource_version=meta["resourceVersion"])
    except Conflict:
        await cluster.refresh(key)
        return False
    return True
