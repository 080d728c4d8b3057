# SPDX-License-Identifier: Apache-2.0
"""Archiving of finished runs: into the archive as they end; those beyond their Sweep's retention go then.

A Sweep's runs are written together, before its status counts them: whoever deletes it loses none of them.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from slamhive.analysis.measuring import settings_hash
from slamhive.archive.remarks import Remarks
from slamhive.contract.settled import FILES, is_settled
from slamhive.kube.api.errors import Conflict
from slamhive.kube.api.kinds import Key, Kind, Object, annotations_of, key_of
from slamhive.kube.reconciling import variants
from slamhive.kube.reconciling.evaluation_status import is_owed
from slamhive.kube.reconciling.run_status import archived_status
from slamhive.kube.reconciling.sweep_runs import decode_points, is_archive_only, point_of, state_of
from slamhive.kube.records import record_of, with_evaluations
from slamhive.kube.status import result_field
from slamhive.model.errors import SlamHiveError, SystemFault, UnknownNameError
from slamhive.model.evaluation import EvaluationSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from slamhive.archive import Archive, CatalogEntry
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.catalogue import Catalogue
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


@dataclass
class KeptRuns:
    """Runs that are known to be in the archive, those of a Sweep or those of none.

    Attributes:
        versions: their versions there, by UID.
        retired: UIDs of those that were deleted here, as they are beyond the retention.
    """

    versions: dict[str, str] = field(default_factory=dict)
    retired: set[str] = field(default_factory=set)

    def has(self, run: Object) -> bool:
        """Tell whether a run is there as it is now."""
        return self.versions.get(run["metadata"]["uid"]) == _version_of(run)

    def add(self, run: Object) -> None:
        """Note that a run is there as it is now."""
        self.versions[run["metadata"]["uid"]] = _version_of(run)


def _version_of(run: Object) -> str:
    """Return the version of a run, of which the API may not be told each result."""
    return f"{run['metadata']['resourceVersion']}/{len(run['status'].get('results') or ())}"


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
        self, cluster: Cluster, runs: list[Object], settings: EvaluationSettings, kept: KeptRuns
    ) -> None:
        """Write those of some runs into the archive that are not there as they are now.

        Raises:
            ArchiveAway: the archive does not answer.
        """
        fresh = [run for run in runs if not kept.has(run)]
        for start in range(0, len(fresh), _AT_ONCE):
            batch = fresh[start : start + _AT_ONCE]
            records = [self._records(cluster, settings, run) for run in batch]
            await in_thread(self._archive.put_used, records)
            for run in batch:
                kept.add(run)

    async def keep_single(self, cluster: Cluster, run: Object, kept: KeptRuns) -> None:
        """Write a run that belongs to no Sweep into the archive, once nothing more will be written of it."""
        if not is_settled(run) or kept.has(run):
            return
        if len(kept.versions) >= _KNOWN:
            kept.versions.clear()  # they are looked up again
        uid = run["metadata"]["uid"]
        known = None if uid in kept.versions else await in_thread(self._archive.get, uid)
        said = known is not None and Remarks.of(known).covers(annotations_of(run))
        if known is not None and said and known.results == record_of(run).results:
            kept.add(run)
        await self.keep(cluster, [run], EvaluationSettings(), kept)

    async def recall(self, cluster: Cluster, runs: list[Object]) -> None:
        """Have runs that are in the archive, and whose objects were not told so, the statuses that they had.

        An operator that ended between the two leaves them behind.
        """
        untold = {run["metadata"]["uid"]: run for run in runs if is_archive_only(run) and not is_settled(run)}
        for record in await in_thread(lambda: [*self._archive.by_uids(untold)]):
            status, told = archived_status(record)
            run = untold[record.uid]
            await cluster.write_status(Kind.MAPPING_RUN, run, status, told, untold=True)

    async def forget(self, uids: Iterable[str]) -> None:
        """Remove runs from the archive, of which there are later ones."""
        if gone := [*uids]:
            await in_thread(self._archive.remove_runs, gone)

    async def retire(
        self, cluster: Cluster, sweep: Sweep, body: Object, settled: list[Object], kept: KeptRuns
    ) -> list[float]:
        """Archive and delete settled runs beyond the retention: those made to be, then the oldest.

        Args:
            cluster: the cluster.
            sweep: the Sweep.
            body: the object, as it was last written.
            settled: its runs that have objects and of which nothing more will be written.
            kept: those that are in the archive.

        Returns:
            After how many seconds to come back.
        """
        told = [run for run in settled if not is_archive_only(run)]
        told.sort(key=lambda run: run["status"].get("completionTime") or "")
        evaluations = cluster.store.of(Kind.EVALUATION, sweep.metadata.namespace or "")
        own = settings_hash(sweep.spec.evaluation)
        due = [
            run
            for run in settled
            if is_archive_only(run)
            and not is_owed(run, own if run["spec"].get("evaluate", True) else None, evaluations)
        ]
        due += told[: max(0, len(told) - sweep.spec.retention.runs)]
        if not due:
            return []
        total = 1 + max(point_of(run) or 0 for run in settled)
        written = decode_points(body["status"].get("points"), total)
        # Only what the status says to be done may go: the bit is what remains of a run here.
        going = [run for run in due if written[point_of(run) or 0] == state_of(run)][:_AT_ONCE]
        # All are in the archive before the first is deleted: a crash in between leaves them in both, and the
        # next look deletes.
        await self.keep(cluster, going, sweep.spec.evaluation, kept)
        limit = asyncio.Semaphore(_DELETED_AT_ONCE)

        async def delete(run: Object) -> bool:
            async with limit:
                gone = await _is_deleted(cluster, run)
            if gone:
                kept.retired.add(run["metadata"]["uid"])
            return gone

        gone = await asyncio.gather(*(delete(run) for run in going))
        left = len(due) - sum(gone)
        return [cluster.settings.sweep_write_seconds] if left else []

    def _records(
        self, cluster: Cluster, settings: EvaluationSettings, run: Object
    ) -> tuple[RunRecord, CatalogEntry | None, CatalogEntry | None]:
        namespace, spec = run["metadata"]["namespace"], run["spec"]
        algorithm = dataset = found = None
        attributes: Object = {}
        try:
            program = self._catalogue.algorithm(cluster.store, namespace, spec["algorithmRef"]["name"])
            algorithm = self._catalogue.entry(program)
            found = self._catalogue.dataset(cluster.store, namespace, spec["datasetRef"]["name"])
            dataset = self._catalogue.entry(found)
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


async def _is_deleted(cluster: Cluster, run: Object) -> bool:
    """Delete an archived run; False where someone wrote to it: the archive gets the newer state next time."""
    meta, key = run["metadata"], key_of(Kind.MAPPING_RUN, run)
    try:
        await cluster.delete(key, uid=meta["uid"], resource_version=meta["resourceVersion"])
    except Conflict:
        await cluster.refresh(key)
        return False
    return True
