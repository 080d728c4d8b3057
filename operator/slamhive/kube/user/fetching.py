# SPDX-License-Identifier: Apache-2.0
"""Import of a cluster's finished runs, with their results, into an archive here, for ``slamhive fetch``."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.archive import CatalogEntry, SweepRecord
from slamhive.kube.api.kinds import Kind, Object
from slamhive.kube.reconciling.catalogue import parse
from slamhive.kube.records import record_of, with_evaluations
from slamhive.kube.status import phase_of, variant_of
from slamhive.kube.user.queries import is_over, name_of, owner_uid, runs_of, status_of
from slamhive.kube.user.run_files import WantedRun
from slamhive.model.errors import InputError
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.search import SearchRecord
from slamhive.model.status import SweepStatus
from slamhive.model.sweep import Sweep
from slamhive.plan import resolve

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from slamhive.archive import Archive
    from slamhive.kube.user.connecting import ConnectedCluster
    from slamhive.kube.user.run_files import RunFolder
    from slamhive.kube.user.submitting import ClusterCatalog
    from slamhive.model.dataset import Dataset
    from slamhive.model.results import RunRecord


@dataclass(frozen=True)
class Fetched:
    """Result of fetching a Sweep or a run from a cluster: numbers of runs copied and left out.

    Attributes:
        kind: its kind.
        name: its name in the cluster.
        stored: what the sweep of its runs is called in the archive here.
        runs: runs that were copied.
        waiting: runs among them that are not evaluated yet.
        unfinished: runs that have not ended.
        elsewhere: finished runs whose objects the cluster no longer holds.
    """

    kind: Kind
    name: str
    stored: str
    runs: int
    waiting: int = 0
    unfinished: int = 0
    elsewhere: int = 0


class Fetcher:
    """Copies finished runs into an archive; doing it again brings them up to date.

    Args:
        cluster: where they are.
        catalog: its Algorithms and Datasets.
        archive: where they go.
        step: called with (done, of how many) after each.
    """

    def __init__(
        self,
        cluster: ConnectedCluster,
        catalog: ClusterCatalog,
        archive: Archive,
        step: Callable[[int, int], None],
    ) -> None:
        self._cluster = cluster
        self._catalog = catalog
        self._archive = archive
        self._step = step
        self._settings: dict[str, EvaluationSettings] = {}
        self.absent: list[WantedRun] = []
        """The runs that were copied and whose files are not here, with the sweep that each belongs to."""

    async def sweep(self, body: Object) -> Fetched:
        """Copy a Sweep's finished runs."""
        name, meta, status = name_of(body), body["metadata"], status_of(body)
        runs = await runs_of(self._cluster, body)
        spec = parse(Sweep, body).spec
        search = SweepStatus.of(body).search
        self._archive.put_sweep(
            SweepRecord(
                uid=meta["uid"],
                name=name,
                namespace=meta["namespace"],
                labels=meta.get("labels") or {},
                spec=spec.as_json(),
                evaluation=spec.evaluation.as_json(),
                created=meta.get("creationTimestamp"),
                search=search and SearchRecord(trials=search.trials or [], spared=search.spared or 0),
            )
        )
        self._settings[meta["uid"]] = spec.evaluation
        finished = [run for run in runs if phase_of(status_of(run)).is_finished]
        self._keep(finished, name, meta["uid"])
        done = status.get("succeeded", 0) + status.get("failed", 0)
        total = status.get("total", len(runs))
        return Fetched(
            kind=Kind.SWEEP,
            name=name,
            stored=self._address(name, meta),
            runs=len(finished),
            waiting=sum(not is_over(Kind.MAPPING_RUN, run) for run in finished),
            unfinished=max(0, total - max(done, len(finished))),
            elsewhere=max(0, done - len(finished)),
        )

    def run(self, body: Object) -> Fetched:
        """Copy a run; one that belongs to no Sweep becomes a sweep of one, as on a workstation."""
        meta, record = body["metadata"], record_of(body)
        owner = owner_uid(body)
        sweep, uid = (record.sweep, owner) if record.sweep and owner else (name_of(body), meta["uid"])
        finished = phase_of(status_of(body)).is_finished
        if finished:
            self._keep([body], sweep, uid)
        waiting = int(finished and not is_over(Kind.MAPPING_RUN, body))
        stored = self._address(sweep, meta)
        return Fetched(Kind.MAPPING_RUN, name_of(body), stored, int(finished), waiting, int(not finished))

    def _address(self, sweep: str, meta: Object) -> str:
        """Return the name of a sweep in the archive here, with its namespace where that is needed."""
        places = {record.namespace for record in self._archive.runs(sweep=sweep)}
        return f"{meta['namespace']}/{sweep}" if places - {meta["namespace"]} else sweep

    def _keep(self, runs: Sequence[Object], sweep: str, uid: str) -> None:
        known = self._archive.runs({"sweep_uid": uid})
        here = {record.uid: record for record in known if _is_here(record)}
        for number, run in enumerate(runs, 1):
            record, algorithm, dataset = self._records(run, sweep, uid)
            # Its files are here already: the cluster's path of them means nothing on this machine.
            if before := here.get(record.uid):
                record = record.replace(folder=before.folder, trajectory=before.trajectory)
            else:
                self.absent.append(WantedRun(run, sweep))
            self._archive.put_run(record, algorithm, dataset)
            self._step(number, len(runs))

    def _records(
        self, run: Object, sweep: str, uid: str
    ) -> tuple[RunRecord, CatalogEntry | None, CatalogEntry | None]:
        spec = run["spec"]
        algorithm = self._catalog.items.algorithms.get(spec["algorithmRef"]["name"])
        dataset = self._catalog.items.datasets.get(spec["datasetRef"]["name"])
        with suppress(InputError):  # the spec of a run that was refused is recorded as it stands
            spec = resolve({key: spec[key] for key in spec if key != "cancel"}, algorithm, None)
        record = record_of(run, spec, self._attributes(run, dataset)).replace(sweep=sweep, sweep_uid=uid)
        settings = self._settings.get(uid) or (EvaluationSettings() if uid == record.uid else None)
        record = with_evaluations(record, settings, dataset)
        return (
            record,
            CatalogEntry.of(algorithm) if algorithm else None,
            CatalogEntry.of(dataset) if dataset else None,
        )

    def _attributes(self, run: Object, dataset: Dataset | None) -> Object:
        """Return the free attributes of a run's dataset, those of its preparation if they are still known."""
        if dataset is None:
            return {}
        body = self._catalog.bodies[Kind.DATASET, dataset.name]
        entry = variant_of(body, status_of(run).get("variant") or "")
        known = (entry.description if entry else None) or {}
        return known.get("attributes") or dict(dataset.spec.known_attributes)


def put_folder(archive: Archive, item: WantedRun, folder: RunFolder) -> None:
    """Note where the files of a run are here."""
    record = archive.get(item.uid)
    if record is None:
        return
    trajectory = record.trajectory
    if trajectory is not None:
        trajectory = trajectory.replace(path=str(folder.trajectory))
    archive.put_run(record.replace(folder=str(folder.path), trajectory=trajectory))


def remarks(fetched: Fetched) -> Iterator[str]:
    """Yield sentences about what was not, or not simply, copied."""
    if "/" in fetched.stored:
        yield f"another sweep has this name here; --sweep {fetched.stored} means that of the cluster"
    if fetched.unfinished:
        yield f"{fetched.name}: {fetched.unfinished} not finished yet; fetch again later"
    if fetched.waiting:
        yield f"{fetched.name}: {fetched.waiting} not evaluated yet; fetch again later"
    if fetched.elsewhere:
        yield (
            f"{fetched.name}: {fetched.elsewhere} more are in the cluster's own archive alone "
            "(spec.retention.runs); SLAMHIVE_ARCHIVE set to its address shows them"
        )


def _is_here(record: RunRecord) -> bool:
    """Tell whether a run's files were fetched before: on a cluster its folder is a path on a volume."""
    return record.folder is not None and Path(record.folder).is_absolute() and Path(record.folder).is_dir()
