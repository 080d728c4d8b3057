# SPDX-License-Identifier: Apache-2.0
"""The archive: every finished run with configuration, provenance, usage and results."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any, Self, TypeVar

from sqlalchemy import Table, case, delete, exists, func, or_, select, update

from slamhive.archive import documents, schema
from slamhive.archive.connection import connect, insert_into, reading, shown, writing
from slamhive.archive.digests import digests
from slamhive.archive.documents import UNREADABLE, raw
from slamhive.archive.patience import Patience, patient
from slamhive.archive.records import (
    CatalogEntry,
    Cost,
    EarlierRun,
    FinishedPoint,
    ReusableRun,
    SweepRecord,
    Totals,
    catalog_row,
    clean,
    require_parts,
    result_row,
    run_row,
)
from slamhive.archive.remarks import Remarks
from slamhive.archive.rows import read_rows, read_runs, why
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.model.leftout import LeftOut, warn_of
from slamhive.model.results import IntendedEvaluation, Phase, Reason, Result, RunRecord
from slamhive.model.search import SearchRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from sqlalchemy import ColumnElement, Connection, Engine, Select

    from slamhive.archive.digests import ArchiveDigests

Item = TypeVar("Item")

BATCH = 500
"""Runs read or written at a time."""

_ENDS_AT_ONCE = 5000
"""Runs of which the ends alone are read at a time."""

FILTERS = (
    "uid",
    "name",
    "sweep",
    "sweep_uid",
    "algorithm",
    "dataset",
    "sensors",
    "pace",
    "phase",
    "reason",
    "outcome",
)
"""Columns that ``runs`` and ``count`` can select by; everything else is the analysis' business."""

ORIGIN = (
    *("specHash", "algorithmHash", "environment", "imageID", "datasetSha256", "preparation"),
    "preparedBy",
)
"""Fields of a run's provenance that its content hash is made from."""

REMARKS = ("note", "tags", "noted")
"""Columns of what people said of a run."""

FOREIGN = " @"
"""Text in the names of algorithms whose runs somebody else made, between its own and a label."""

_CATALOG = {"Algorithm": schema.algorithms, "Dataset": schema.datasets}
_FINISHED = tuple(phase.value for phase in Phase if phase.is_finished)


class Archive:
    """Finished runs, their results, and the sweeps and catalog entries they belong to.

    Each method is one transaction: when it returns, what it wrote survives the end of the process.
    Several processes may write at the same time; they wait for each other. All methods raise
    SystemFault when the database doesn't answer, and those that write InputError when another slamhive has
    brought it to another version meanwhile.

    Runs, sweeps and catalog entries that can't be read are left out of what is returned, with a
    LeftOutWarning that names them.

    Attributes:
        left_out: those that were met so far, by what they are.
        patience: how long a server that is away is waited for; None where it is not.
    """

    def __init__(self, engine: Engine) -> None:
        self.left_out: dict[str, LeftOut] = {}
        self.patience: Patience | None = None
        self._engine = engine
        self._statements: dict[tuple[str, tuple[str, ...]], Any] = {}

    @classmethod
    def open(cls, url: str, *, read_only: bool = False) -> Self:
        """Open the archive at a database URL.

        Args:
            url: the database's URL.
            read_only: write nothing. Otherwise it is made where it isn't there yet.

        Raises:
            InputError: the URL can't be used, its file is no database, is damaged or, to be read, not there,
                or another version of slamhive wrote it (`upgrade` brings it up to date).
        """
        return cls(connect(url, read_only=read_only))

    def close(self) -> None:
        """Let go of the database's connections."""
        self._engine.dispose()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def location(self) -> str:
        """Address of the archive, fit to be shown: its file's path, or its URL without the password."""
        return shown(self._engine.url)

    @property
    def identity(self) -> str:
        """UUID that tells this archive from every other one."""
        with reading(self._engine) as connection:
            return str(connection.execute(select(schema.schema_version.c.identity)).scalar_one())

    def digests(self) -> ArchiveDigests:
        """Return digests of its content, which differ where anything in it does."""
        with reading(self._engine) as connection:
            return digests(connection)

    def put_run(
        self, record: RunRecord, algorithm: CatalogEntry | None = None, dataset: CatalogEntry | None = None
    ) -> None:
        """Write a run, in the place of what was there of its UID.

        Its results are written too; results of other evaluations stay.

        Args:
            record: the run.
            algorithm: the Algorithm as the run used it.
            dataset: the Dataset as the run used it.
        """
        self.put_used([(record, algorithm, dataset)])

    @patient
    def put_used(self, items: Iterable[tuple[RunRecord, CatalogEntry | None, CatalogEntry | None]]) -> None:
        """Write runs with the Algorithms and Datasets as they used them, all or none; else as ``put_run``.

        Args:
            items: at most some hundreds.
        """
        known, rows, records = {}, [], []
        for record, algorithm, dataset in items:
            row = run_row(record)
            for column, entry in (("algorithm_hash", algorithm), ("dataset_hash", dataset)):
                if entry is not None:
                    row[column] = entry.content_hash
                    known[entry.kind, entry.name, entry.content_hash] = entry
            rows.append(row)
            records.append(record)
        with writing(self._engine) as connection:
            for entry in known.values():
                self._put_entry(connection, entry)
            self._put(connection, records, rows)

    def put_runs(self, records: Iterable[RunRecord]) -> int:
        """Write many runs, in transactions of 500, and return their number."""
        iterator, total = iter(records), 0
        while batch := list(islice(iterator, BATCH)):
            self.put_used([(record, None, None) for record in batch])
            total += len(batch)
        return total

    @patient
    def put_result(self, uid: str, result: Result) -> None:
        """Write a result of a run, in the place of an earlier one of the same evaluation.

        Raises:
            UnknownNameError: no run has this UID.
        """
        with writing(self._engine) as connection:
            found = connection.execute(select(schema.runs.c.id).where(schema.runs.c.uid == uid)).scalar()
            if found is None:
                raise UnknownNameError("run UID", uid, [], f"archive {self.location}")
            row = result_row(found, result)
            documents.store(connection, ("results", [row]))
            self._upsert_results(connection, [row])

    @patient
    def put_sweep(self, sweep: SweepRecord) -> None:
        """Write a sweep, in the place of what was there of its UID; what its search tried stays."""
        row = {name: clean(value) for name, value in sweep.model_dump(exclude={"search"}).items()}
        row["search"] = None if sweep.search is None else _search_document(sweep.search)
        with writing(self._engine) as connection:
            self._upsert(connection, schema.sweeps, [row], ("uid",))

    def put_search(self, uid: str, record: SearchRecord) -> None:
        """Write what a sweep's search tried, in the place of what was there.

        Raises:
            UnknownNameError: no sweep has this UID.
        """
        self.change_search(uid, lambda _: record)

    @patient
    def change_search(self, uid: str, change: Callable[[SearchRecord], SearchRecord]) -> SearchRecord:
        """Change what a sweep's search tried, while nobody else does.

        Args:
            uid: the sweep's.
            change: returns of what is there what is to be there.

        Returns:
            What is there now.

        Raises:
            UnknownNameError: no sweep has this UID.
            InputError: what is there can't be read.
        """
        columns = schema.sweeps.c
        with writing(self._engine) as connection:
            query = select(columns.uid, raw(connection, columns.search)).where(columns.uid == uid)
            rows = [dict(row) for row in connection.execute(query.with_for_update()).mappings()]
            if not rows:
                raise UnknownNameError("sweep UID", uid, [], f"archive {self.location}")
            ((wrong,),) = documents.opened(connection, (schema.sweeps, rows))
            try:
                if wrong is not None:
                    raise wrong
                before = SearchRecord.model_validate(rows[0]["search"] or {})
            except UNREADABLE as error:
                raise InputError(
                    f"archive {self.location}: what sweep {uid} tried can't be read: {why(error)}"
                ) from None
            after = change(before)
            if after != before:
                told = _search_document(after)
                connection.execute(update(schema.sweeps).where(columns.uid == uid).values(search=told))
        return after

    def settle(self, cluster: str, namespaces: Iterable[str]) -> int:
        """Say of records of namespaces that name no cluster, as of an earlier slamhive, that they are of one.

        Returns:
            The number of runs.
        """
        changed = 0
        with writing(self._engine) as connection:
            for table in (schema.sweeps, schema.runs):
                columns = table.c
                unknown = columns.cluster.is_(None) & columns.namespace.in_(list(namespaces))
                changed = connection.execute(update(table).where(unknown).values(cluster=cluster)).rowcount
        return changed

    def put_catalog(self, *entries: CatalogEntry) -> None:
        """Write Algorithms and Datasets as they are now; equal ones are stored once."""
        with writing(self._engine) as connection:
            for entry in entries:
                self._put_entry(connection, entry)

    @patient
    def remove_run(self, uid: str) -> bool:
        """Remove a run with its results, and tell whether it was there."""
        with writing(self._engine) as connection:
            return connection.execute(delete(schema.runs).where(schema.runs.c.uid == uid)).rowcount > 0

    def remove_runs(self, uids: Iterable[str]) -> None:
        """Remove runs with their results, 500 in a transaction; those that aren't there are no fault."""
        iterator = iter(uids)
        while batch := list(islice(iterator, BATCH)):
            with writing(self._engine) as connection:
                connection.execute(delete(schema.runs).where(schema.runs.c.uid.in_(batch)))

    @patient
    def put_evaluations(self, uid: str, evaluations: Iterable[IntendedEvaluation]) -> None:
        """Add intended evaluations to a run; they replace earlier ones of their names.

        Raises:
            UnknownNameError: no run has this UID.
        """
        runs = schema.runs.c
        with writing(self._engine) as connection:
            query = select(raw(connection, runs.evaluations)).where(runs.uid == uid)
            row = dict(connection.execute(query).mappings().one_or_none() or {})
            if not row:
                raise UnknownNameError("run UID", uid, [], f"archive {self.location}")
            try:
                ((wrong,),) = documents.opened(connection, (schema.runs, [row]))
                if wrong is not None:
                    raise wrong
                known = {item["evaluation"]: item for item in row["evaluations"]}
            except UNREADABLE as error:
                raise InputError(f"archive {self.location}: run {uid} can't be read: {why(error)}") from None
            wanted = known | {one.evaluation: clean(one.as_json()) for one in evaluations}
            row["evaluations"] = list(wanted.values())
            documents.store(connection, ("runs", [row]))
            connection.execute(update(schema.runs).where(runs.uid == uid).values(**row))

    @patient
    def annotate(
        self, uids: Collection[str], change: Callable[[Remarks], Remarks]
    ) -> dict[str, tuple[Remarks, Remarks]]:
        """Change notes and tags of runs, 500 in a transaction; runs that aren't there are no fault.

        Args:
            uids: the runs'.
            change: returns of what a run has what it is to have; what says the same is not written.

        Returns:
            Before and after, by UID, of the runs that are there.

        Raises:
            InputError: a run can't be read, or ``change`` refuses.
        """
        runs, iterator = schema.runs.c, iter(uids)
        found: dict[str, tuple[Remarks, Remarks]] = {}
        while batch := list(islice(iterator, BATCH)):
            with writing(self._engine) as connection:
                query = select(*(raw(connection, runs[name]) for name in ("uid", *REMARKS)))
                asked = connection.execute(query.where(runs.uid.in_(batch)).with_for_update())
                rows = [dict(row) for row in asked.mappings()]
                (wrong,) = documents.opened(connection, (schema.runs, rows))
                for row, fault in zip(rows, wrong, strict=True):
                    if fault is not None:
                        raise InputError(f"archive {self.location}: run {row['uid']}: {why(fault)}")
                    before = Remarks.of_row(row)
                    after = change(before)
                    found[row["uid"]] = before, after
                    if not after.says_same(before):
                        changed = update(schema.runs).where(runs.uid == row["uid"])
                        connection.execute(changed.values(**after.row))
        return found

    @patient
    def rename_run(self, record: RunRecord, uid: str) -> None:
        """Write a record in the place of the run of another UID, which thereby is called otherwise.

        Args:
            record: what is to stand there.
            uid: what the run was called so far.
        """
        row = _without_remarks(record)
        with writing(self._engine) as connection:
            documents.store(connection, ("runs", [row]))
            connection.execute(update(schema.runs).where(schema.runs.c.uid == uid).values(**row))

    def rewrite_runs(self, records: Iterable[RunRecord]) -> None:
        """Write records in the places of those of their UIDs, 500 in a transaction; results stay."""
        iterator = iter(records)
        while batch := [_without_remarks(record) for record in islice(iterator, BATCH)]:
            with writing(self._engine) as connection:
                documents.store(connection, ("runs", batch))
                for row in batch:
                    connection.execute(
                        update(schema.runs).where(schema.runs.c.uid == row["uid"]).values(**row)
                    )

    def rename_dataset(self, old: str, new: str) -> None:
        """Give the stored versions of a Dataset a name; those of the old one stay while a run has it."""
        columns = schema.datasets.c
        with writing(self._engine) as connection:
            rows = connection.execute(select(schema.datasets).where(columns.name == old)).mappings().all()
            if rows:
                copies = [dict(row) | {"name": new} for row in rows]
                connection.execute(
                    insert_into(connection.dialect, schema.datasets).on_conflict_do_nothing(), copies
                )
            if not connection.execute(select(schema.runs.c.id).where(schema.runs.c.dataset == old)).first():
                connection.execute(delete(schema.datasets).where(columns.name == old))

    def rename_sweep(self, uids: Iterable[str], new: str) -> int:
        """Give sweeps and their runs a name, and return the number of the runs."""
        wanted, sweeps, runs = list(uids), schema.sweeps, schema.runs
        with writing(self._engine) as connection:
            connection.execute(update(sweeps).where(sweeps.c.uid.in_(wanted)).values(name=new))
            change = update(runs).where(runs.c.sweep_uid.in_(wanted)).values(sweep=new)
            return connection.execute(change).rowcount

    def remove_sweeps(self, uids: Iterable[str]) -> None:
        """Remove sweeps, not their runs."""
        with writing(self._engine) as connection:
            connection.execute(delete(schema.sweeps).where(schema.sweeps.c.uid.in_(list(uids))))

    @patient
    def get(self, uid: str) -> RunRecord | None:
        """Return a run by its UID."""
        return next(self.runs({"uid": uid}), None)

    def by_uids(self, uids: Iterable[str]) -> Iterator[RunRecord]:
        """Return the runs of these UIDs; those that aren't there are no fault."""
        iterator = iter(dict.fromkeys(uids))
        while batch := list(islice(iterator, BATCH)):
            yield from self.runs({"uid": batch})

    def by_names(self, names: Iterable[str]) -> list[RunRecord]:
        """Return the runs of these names in the order of being stored; a name may stand for several."""
        iterator = iter(dict.fromkeys(names))
        records: list[RunRecord] = []
        while batch := list(islice(iterator, BATCH)):
            records += self.runs({"name": batch})
        return records

    def runs(
        self,
        where: Mapping[str, str | Iterable[str]] | None = None,
        *,
        sweep: str | None = None,
        limit: int | None = None,
    ) -> Iterator[RunRecord]:
        """Go through runs with their results, in the order of being stored first.

        Reads 500 at a time, so that neither memory nor a transaction grows with their number; a run that
        is written meanwhile is seen as it was or as it is.

        Args:
            where: values to be equal by name (one of FILTERS); several values of a name are alternatives.
            sweep: only runs of the sweep of this name.
            limit: at most so many.

        Raises:
            UnknownNameError: ``where`` holds another name.
        """
        conditions = _conditions(where, sweep)
        return self._stream(conditions, limit)

    def count(
        self, where: Mapping[str, str | Iterable[str]] | None = None, *, sweep: str | None = None
    ) -> int:
        """Return the number of runs; arguments as for ``runs``."""
        query = select(func.count()).select_from(schema.runs).where(*_conditions(where, sweep))
        with reading(self._engine) as connection:
            return connection.execute(query).scalar_one()

    def finished(self, sweep_uid: str) -> Iterator[tuple[str, FinishedPoint]]:
        """Go through the ends of a sweep's finished runs by UID, in the order of being stored.

        Reads 5,000 at a time, so that memory doesn't grow with their number.

        Args:
            sweep_uid: the sweep's identity; two sweeps may have one name.
        """
        after: int | None = 0
        while after is not None:
            points, after = self._some_finished(sweep_uid, after)
            yield from points

    @patient
    def _some_finished(
        self, sweep_uid: str, after: int
    ) -> tuple[list[tuple[str, FinishedPoint]], int | None]:
        """Return the ends of some runs behind a row, and the row behind which there may be more."""
        runs, results = schema.runs.c, schema.results.c
        mine = runs.sweep_uid == sweep_uid, runs.phase.in_(_FINISHED), runs.id > after
        ids = select(runs.id).where(*mine).order_by(runs.id)
        with reading(self._engine) as connection:
            last = connection.execute(ids.offset(_ENDS_AT_ONCE - 1).limit(1)).scalar()
        measured = select(func.count()).where(results.run_id == runs.id).scalar_subquery().label("results")
        query = (
            select(runs.uid, runs.point, runs.phase, runs.reason, measured, *(runs[name] for name in REMARKS))
            .where(*mine, *(() if last is None else (runs.id <= last,)))
            .order_by(runs.id)
        )
        points = self._some(
            query,
            lambda row: (
                row["uid"],
                FinishedPoint(
                    row["point"],
                    Phase(row["phase"]),
                    Reason(row["reason"]) if row["reason"] else None,
                    row["results"],
                    Remarks.of_row(row),
                ),
            ),
        )
        return points, last

    @patient
    def earlier(self, sweep: str) -> list[EarlierRun]:
        """Return the finished runs of all versions of a workstation's sweep, in the order of being stored."""
        runs = schema.runs.c
        query = (
            select(
                *(runs.uid, runs.sweep_uid, runs.point, runs.phase, runs.reason, runs.finished),
                *(runs.wall_seconds, runs.content_hash),
                runs.provenance,
            )
            .where(runs.sweep == sweep, runs.phase.in_(_FINISHED), runs.namespace.is_(None))
            .order_by(runs.id)
        )
        return self._some(query, _earlier)

    @patient
    def reusable(self, algorithms: Iterable[str], datasets: Iterable[str]) -> set[str]:
        """Return the content hashes of runs of some algorithms on some datasets that others may take over."""
        runs = schema.runs.c
        query = select(runs.content_hash).where(
            runs.algorithm.in_(list(algorithms)),
            runs.dataset.in_(list(datasets)),
            runs.content_hash.is_not(None),
            *_may_be_taken_over(),
        )
        with reading(self._engine) as connection:
            return set(connection.execute(query).scalars())

    @patient
    def reusable_runs(self, algorithms: Iterable[str], datasets: Iterable[str]) -> dict[str, ReusableRun]:
        """Return the runs of some algorithms on some datasets that others may take over.

        Returns:
            By content hash; of equal ones the latest.
        """
        runs = schema.runs.c
        query = (
            select(runs.uid, runs.content_hash, runs.spec)
            .where(
                runs.algorithm.in_(list(algorithms)),
                runs.dataset.in_(list(datasets)),
                runs.content_hash.is_not(None),
                *_may_be_taken_over(),
            )
            .order_by(runs.id)
        )
        found = self._some(query, lambda row: (row["content_hash"], ReusableRun(row["uid"], row["spec"])))
        return dict(found)

    @patient
    def costs(
        self, algorithms: Iterable[str], datasets: Iterable[str], each: int = 60, most: int = 6_000
    ) -> list[Cost]:
        """Return the costs of runs of some algorithms, or on some datasets, the latest first.

        Those that took over a result are left out, and those that somebody else made.

        Args:
            algorithms: names of algorithms.
            datasets: names of datasets.
            each: at most so many of an algorithm on a dataset.
            most: at most so many in all.
        """
        runs = schema.runs.c
        place = func.row_number().over(partition_by=(runs.algorithm, runs.dataset), order_by=runs.id.desc())
        numbered = (
            select(runs.id, place.label("place"))
            .where(
                or_(runs.algorithm.in_(list(algorithms)), runs.dataset.in_(list(datasets))),
                runs.phase.in_((Phase.SUCCEEDED.value, Phase.FAILED.value)),
                runs.algorithm.is_not(None) & runs.dataset.is_not(None),
                or_(
                    *(
                        one.is_not(None)
                        for one in (runs.cpu_seconds, runs.wall_seconds, runs.memory_peak_bytes)
                    )
                ),
                runs.reused_from.is_(None),
                runs.algorithm.not_like(f"%{FOREIGN}%"),
            )
            .subquery()
        )
        query = (
            select(
                *(runs.uid, runs.algorithm, runs.dataset, runs.spec, runs.reason, runs.cpu_seconds),
                *(runs.wall_seconds, runs.memory_peak_bytes, runs.cpu_model),
                *(runs.content_hash, runs.folder, runs.provenance),
                case((runs.namespace.is_(None), runs.created)).label("created"),
                *(runs.started, runs.sweep_uid),
            )
            .where(runs.id.in_(select(numbered.c.id).where(numbered.c.place <= each)))
            .order_by(runs.id.desc())
            .limit(most)
        )
        return self._some(query, _cost)

    @patient
    def cpu_seconds(self, sweep_uid: str) -> float:
        """Return the CPU time of a sweep's finished runs in s, those left out that took over a result."""
        runs = schema.runs.c
        query = select(func.sum(runs.cpu_seconds)).where(
            runs.sweep_uid == sweep_uid, runs.reused_from.is_(None)
        )
        with reading(self._engine) as connection:
            return float(connection.execute(query).scalar() or 0.0)

    @patient
    def namespace_cpu_seconds(
        self, namespace: str, cluster: str | None, without: Iterable[str] = ()
    ) -> float:
        """Return the CPU time of a namespace's finished runs in s, those left out that took over a result.

        Args:
            namespace: the namespace.
            cluster: what tells its cluster from others; None: where that could not be seen.
            without: UIDs of runs to leave out, at most some thousands.
        """
        runs = schema.runs.c
        query = select(func.sum(runs.cpu_seconds)).where(
            runs.namespace == namespace,
            runs.cluster.is_not_distinct_from(cluster),
            runs.reused_from.is_(None),
            runs.uid.not_in(list(without)),
        )
        with reading(self._engine) as connection:
            return float(connection.execute(query).scalar() or 0.0)

    def totals(self, sweep_uid: str, without: Iterable[str] = ()) -> Totals:
        """Return sums over the finished runs of a sweep.

        Args:
            sweep_uid: the sweep's identity.
            without: UIDs of runs to leave out, at most some thousands.
        """
        runs, results = schema.runs.c, schema.results.c
        computed = runs.reused_from.is_(None)
        evaluated = exists().where(results.run_id == runs.id)
        query = select(
            func.count(),
            func.sum(case((computed, 0), else_=1)),
            func.sum(case((evaluated, 1), else_=0)),
            func.sum(case((computed, runs.cpu_seconds))),
        ).where(runs.sweep_uid == sweep_uid, runs.phase.in_(_FINISHED), runs.uid.not_in(list(without)))
        with reading(self._engine) as connection:
            count, reused, measured, cpu = connection.execute(query).one()
        return Totals(count, int(reused or 0), int(measured or 0), float(cpu or 0.0))

    @patient
    def find_reusable(self, content_hash: str) -> RunRecord | None:
        """Return a run whose result another one of the same content may take over.

        It succeeded and its trajectory was judged (tracked, partial, lost or diverged): what a fault of
        the machine left is never reused. Runs that were computed come before those that were reused
        themselves, the latest first. Whether its usage may be taken over (same CPU model) is for the
        caller to decide.
        """
        runs = schema.runs.c
        query = (
            select(schema.runs)
            .where(runs.content_hash == content_hash, *_may_be_taken_over())
            .order_by(runs.reused_from.is_not(None), runs.finished.desc().nulls_last(), runs.id.desc())
            .limit(1)
        )
        with reading(self._engine) as connection:
            found = read_runs(connection, query)
        self._leave_out(found.left_out)
        return next(iter(found.records), None)

    def sweep(
        self, name: str, *, namespace: str | None = None, cluster: str | None = None
    ) -> SweepRecord | None:
        """Return the sweep of a name in its place, the latest one of several; no place is a workstation."""
        place = (name, namespace, cluster)
        found = (one for one in reversed(self.sweeps()) if (one.name, one.namespace, one.cluster) == place)
        return next(found, None)

    @patient
    def sweeps(self) -> list[SweepRecord]:
        """Return all sweeps in the order of their creation."""
        columns = schema.sweeps.c
        query = select(schema.sweeps).order_by(columns.created.asc().nulls_first(), columns.uid)
        return self._some(query, SweepRecord.model_validate, schema.sweeps)

    def catalog(self, kind: str) -> list[CatalogEntry]:
        """Return the stored Algorithms or Datasets by name, versions of a name in the order of storing."""
        table = _CATALOG[kind]
        query = select(table).order_by(table.c.name, table.c.stored, table.c.content_hash)
        fields = ("name", "labels", "attributes", "spec")
        return self._some(
            query,
            lambda row: CatalogEntry.model_validate({"kind": kind} | {key: row[key] for key in fields}),
            table,
        )

    def used(self, uids: Iterable[str]) -> dict[str, tuple[str | None, str | None]]:
        """Return the content hashes of the Algorithm and the Dataset that runs used, by UID."""
        runs, iterator = schema.runs.c, iter(uids)
        found: dict[str, tuple[str | None, str | None]] = {}
        while batch := list(islice(iterator, BATCH)):
            query = select(runs.uid, runs.algorithm_hash, runs.dataset_hash).where(runs.uid.in_(batch))
            with reading(self._engine) as connection:
                found |= {uid: (algorithm, dataset) for uid, algorithm, dataset in connection.execute(query)}
        return found

    def _stream(self, conditions: list[ColumnElement[bool]], limit: int | None) -> Iterator[RunRecord]:
        last, left = 0, limit
        while left is None or left > 0:
            size = BATCH if left is None else min(BATCH, left)
            query = (
                select(schema.runs)
                .where(*conditions, schema.runs.c.id > last)
                .order_by(schema.runs.c.id)
                .limit(size)
            )
            with reading(self._engine) as connection:
                found = read_runs(connection, query)
            self._leave_out(found.left_out)
            yield from found.records
            if found.met < size:
                return
            last = found.last
            left = None if left is None else left - found.met

    def _some(
        self, query: Select[Any], make: Callable[[dict[str, Any]], Item], table: Table = schema.runs
    ) -> list[Item]:
        """Return the items made of rows; arguments as for ``read_rows``."""
        with reading(self._engine) as connection:
            found, left_out = read_rows(connection, query, table, make)
        self._leave_out(left_out)
        return found

    def _leave_out(self, left_out: Iterable[LeftOut]) -> None:
        new = [one for one in left_out if one.what not in self.left_out]
        self.left_out |= {one.what: one for one in new}
        warn_of(new, self.location)

    def _put(self, connection: Connection, records: list[RunRecord], rows: list[dict[str, Any]]) -> None:
        measured = [[result_row(0, result) for result in record.results] for record in records]
        documents.store(connection, ("runs", rows), ("results", [row for each in measured for row in each]))
        # What a row doesn't name stays as it is: rows that name the same are written together.
        by_names: dict[tuple[str, ...], list[dict[str, Any]]] = {}
        for row in rows:
            by_names.setdefault(tuple(row), []).append(row)
        for alike in by_names.values():
            self._upsert(connection, schema.runs, alike, ("uid",))
        columns = schema.runs.c
        query = select(columns.uid, columns.id).where(columns.uid.in_([row["uid"] for row in rows]))
        ids = {row.uid: row.id for row in connection.execute(query)}
        found = [
            row | {"run_id": ids[record.uid]}
            for record, each in zip(records, measured, strict=True)
            for row in each
        ]
        self._upsert_results(connection, found)

    def _put_entry(self, connection: Connection, entry: CatalogEntry) -> None:
        table = _CATALOG[entry.kind]
        connection.execute(
            insert_into(connection.dialect, table).on_conflict_do_nothing(), catalog_row(entry)
        )

    def _upsert_results(self, connection: Connection, rows: list[dict[str, Any]]) -> None:
        if rows:
            self._upsert(connection, schema.results, rows, ("run_id", "evaluation"))

    def _upsert(
        self, connection: Connection, table: Table, rows: list[dict[str, Any]], key: tuple[str, ...]
    ) -> None:
        connection.execute(self._upserting(table, tuple(rows[0]), key), rows)

    def _upserting(self, table: Table, names: tuple[str, ...], key: tuple[str, ...]) -> Any:
        """Return the statement that writes rows of some columns; made once, as that takes most of a write."""
        known = self._statements.get((table.name, names))
        if known is not None:
            return known
        statement = insert_into(self._engine.dialect, table)
        changes = {name: statement.excluded[name] for name in names if name not in key}
        if "noted" in changes:
            # Who writes a run again may have read it before somebody put a note on it.
            later = statement.excluded.noted > table.c.noted
            for name in REMARKS:
                changes[name] = case(
                    (or_(table.c.noted.is_(None), later), changes[name]), else_=table.c[name]
                )
        if "cluster" in changes:
            # Not all who write know it: `slamhive fetch` may not see what the operator sees.
            changes["cluster"] = func.coalesce(changes["cluster"], table.c.cluster)
        if "search" in changes:
            # Who asks for a sweep again doesn't say what it has tried so far.
            changes["search"] = func.coalesce(changes["search"], table.c.search)
        made = statement.on_conflict_do_update(index_elements=list(key), set_=changes)
        self._statements[table.name, names] = made
        return made


def _earlier(row: dict[str, Any]) -> EarlierRun:
    return EarlierRun(
        uid=row["uid"],
        sweep_uid=row["sweep_uid"],
        index=row["point"],
        phase=Phase(row["phase"]),
        reason=Reason(row["reason"]) if row["reason"] else None,
        finished=row["finished"],
        wall_seconds=row["wall_seconds"],
        content_hash=row["content_hash"],
        origin={name: row["provenance"].get(name) for name in ORIGIN},
    )


def _cost(row: dict[str, Any]) -> Cost:
    require_parts(row["spec"])
    origin = row.pop("provenance")
    return Cost(
        memory_bytes=row.pop("memory_peak_bytes"),
        **row,
        prepared=origin.get("prepared"),
        algorithm_hash=origin.get("algorithmHash"),
        dataset_sha256=origin.get("datasetSha256"),
    )


def _search_document(record: SearchRecord) -> Any:
    """Return a search as the archive holds it: a value that is tried may be, or contain, null."""
    return clean(record.model_dump(mode="json", by_alias=True))


def _without_remarks(record: RunRecord) -> dict[str, Any]:
    """Return a run's columns but for notes and tags: those that are there stay."""
    return {name: value for name, value in run_row(record).items() if name not in REMARKS}


def _may_be_taken_over() -> tuple[ColumnElement[bool], ...]:
    """Return the conditions on runs whose results others may take over."""
    runs, results = schema.runs.c, schema.results.c
    return runs.phase == Phase.SUCCEEDED.value, exists().where(results.run_id == runs.id)


def _conditions(
    where: Mapping[str, str | Iterable[str]] | None, sweep: str | None
) -> list[ColumnElement[bool]]:
    conditions: list[ColumnElement[bool]] = []
    for name, given in (where or {}).items():
        if name not in FILTERS:
            raise UnknownNameError("filter", name, FILTERS)
        values = [given] if isinstance(given, str) else list(given)
        if name == "outcome":
            results = schema.results.c
            conditions.append(exists().where(results.run_id == schema.runs.c.id, results.outcome.in_(values)))
        else:
            conditions.append(schema.runs.c[name].in_(values))
    if sweep is not None:
        conditions.append(schema.runs.c.sweep == sweep)
    return conditions
