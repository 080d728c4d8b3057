# SPDX-License-Identifier: Apache-2.0
"""The data of a cluster: live objects of the Kubernetes API over what the archive holds."""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from slamhive.analysis.derived import SweepVersion, with_derived
from slamhive.analysis.flattening import bound, stack
from slamhive.analysis.frame import Frame
from slamhive.dashboard.sources.archived import ArchiveData, Snapshot
from slamhive.dashboard.sources.live import (
    LiveObjects,
    catalog_entry,
    columns_of_live,
    narrow_other,
    narrow_run,
    sweep_in_short,
)
from slamhive.kube.api.client import Api
from slamhive.kube.api.errors import ApiError, NotFound
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.api.watching import Follower, open_session
from slamhive.kube.records import record_of
from slamhive.model.search import choosing_method
from slamhive.runfiles.artifacts import ArtifactFolder
from slamhive.runfiles.ground_truth import DatasetTruths
from slamhive.storage.state import OffloadingWatch

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from concurrent.futures import Executor
    from pathlib import Path

    from aiohttp import ClientSession

    from slamhive.archive.records import CatalogEntry, SweepRecord
    from slamhive.dashboard.sources.live import LiveRun
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.ground_truth import DatasetTruth
    from slamhive.runfiles.stored import Shelf

_OTHERS = (Kind.ALGORITHM, Kind.DATASET, Kind.EVALUATION, Kind.SWEEP)
_REST = 4.0
_LEAST_REST_SECONDS = 1.0
_DETAIL_SECONDS = 10.0
_AGAIN_SECONDS = 30.0
MAX_LIVE_COLUMNS = 300
"""Columns that live runs may add to those of the archive: they choose the names of their metrics."""


class ClusterSource:
    """Live objects of some namespaces, and the archive behind them.

    A run that is in both is shown as it is live, or as it ended where its object is not told of that. When
    either does not answer, what was known of it last is shown on, and a sentence says so.

    Args:
        namespaces: which.
        archive_url: the archive's database URL; None for none.
        results: the results volume; None when it isn't mounted.
        ground_truth: folder of ground truth by dataset; None when it isn't mounted.
        cache: folder in which the archive's table is kept for the next start; None to keep none.
        name: the cluster's name.
        shelf: object storage that run folders were moved to; None for none.
        connect: returns the API.
    """

    def __init__(
        self,
        namespaces: list[str],
        *,
        archive_url: str | None = None,
        results: Path | None = None,
        ground_truth: Path | None = None,
        cache: Path | None = None,
        name: str = "",
        shelf: Shelf | None = None,
        connect: Callable[[], Awaitable[Api]] = Api.connect,
    ) -> None:
        self._namespaces = namespaces
        self._archive = ArchiveData(archive_url, cache) if archive_url else None
        self._results = results
        self._truths = DatasetTruths(ground_truth)
        self._name = name
        self._shelf = shelf
        self._offloading = OffloadingWatch(results)
        self._identity: str | None = name or None
        self._connect = connect
        self._cluster = LiveObjects()
        self._troubles: dict[tuple[Kind, str], str | None] = {}
        self._numbers: dict[str, int] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._snapshot = Snapshot()
        self._built: tuple[Any, ...] = ()
        self._next_build = 0.0
        self._dropped: str | None = None
        self._nonce = secrets.token_hex(4)
        self._count = 0
        self._lock = asyncio.Lock()
        self._api: Api | None = None
        self._watches: ClientSession | None = None
        self._executor: Executor | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    async def start(self, executor: Executor) -> None:
        """Begin to follow the objects.

        Raises:
            StartError: no cluster is known.
        """
        self._executor = executor
        self._loop = asyncio.get_running_loop()
        self._api = await self._connect()
        self._watches = open_session()
        self._tasks.append(asyncio.create_task(self._know_cluster(self._api), name="know the cluster"))
        for namespace in self._namespaces:
            for kind in (Kind.MAPPING_RUN, *_OTHERS):
                follower = self._follower(self._api, self._watches, kind, namespace)
                self._tasks.append(asyncio.create_task(follower.run(), name=f"follow {kind} {namespace}"))

    async def _know_cluster(self, api: Api) -> None:
        """Find out which cluster this is, as the operator does, however long the API is away."""
        while True:
            try:
                self._identity = await api.cluster_uid() or self._identity
            except ApiError:
                await asyncio.sleep(_AGAIN_SECONDS)
            else:
                self._cluster.changes += 1
                return

    async def stop(self) -> None:
        """End."""
        # Connections first: see open_session.
        for connections in (self._watches, self._api):
            if connections is not None:
                await connections.close()
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            ended, _ = await asyncio.wait(self._tasks, timeout=5)
            for task in ended:
                if not task.cancelled():
                    task.exception()  # what it says of closed connections is of no interest
        if self._archive is not None:
            await self._archive.stop()

    async def fresh(self) -> Snapshot:
        """Return the data as they are now."""
        async with self._lock:
            loop = asyncio.get_running_loop()
            removed, self._cluster.removed = self._cluster.removed, False
            if self._archive is not None:
                await self._archive.follow(self._executor, again=removed)
            archived = self._archive.revision if self._archive else ""
            state = (self._cluster.changes, archived, self._problems(), self._listed)
            if state != self._built and time.monotonic() >= self._next_build:
                begun = time.monotonic()
                sweeps = {_address(obj): sweep_in_short(obj) for obj in self._cluster.of(Kind.SWEEP)}
                datasets = {_address(obj): obj["spec"] for obj in self._cluster.of(Kind.DATASET)}
                taken = (self._cluster.all_runs(), datasets, sweeps)
                frame = await loop.run_in_executor(self._executor, partial(self._build, *taken))
                self._count += 1
                revision = f"{self._nonce}-{self._count}"
                asked = self._archive.asked if self._archive is not None else frozenset()
                problems = (*state[2], *((self._dropped,) if self._dropped else ()))
                self._snapshot = Snapshot(frame, revision, problems, sweeps, asked)
                self._built = state
                took = time.monotonic() - begun
                if self.ready:  # until then every piece is news
                    self._next_build = begun + max(_LEAST_REST_SECONDS, _REST * took)
            return self._snapshot

    @property
    def ready(self) -> bool:
        """True if the data shown were built after all kinds were listed once and the archive was read."""
        return bool(self._built) and bool(self._built[-1])

    @property
    def _listed(self) -> bool:
        """True if all kinds of objects were listed once, and the archive was read or its trouble is known."""
        listed = len(self._troubles) == len(self._namespaces) * (len(_OTHERS) + 1)
        known = listed and len(self._cluster.runs) == len(self._namespaces)
        return known and (self._archive is None or self._archive.loaded_once or bool(self._archive.problem))

    def describe(self) -> dict[str, Any]:
        """Say which cluster this is."""
        return {"kind": "cluster", "name": self._name or None, "namespaces": self._namespaces}

    def record(self, uid: str) -> RunRecord | None:
        """Return a run: as it is live, else from the archive."""
        for run in self._cluster.all_runs():
            if run.uid == uid:
                if run.live and self._archived and (ended := self._archived_run(uid)) is not None:
                    return ended
                obj = self._fetch(Key(Kind.MAPPING_RUN, run.namespace, run.name))
                if obj is not None and obj["metadata"].get("uid") == uid:
                    held = self._cluster.others.get((Kind.DATASET, run.namespace), {})
                    dataset = held.get(run.dataset or "", {"spec": {}})
                    record = record_of(obj, attributes=dataset["spec"].get("attributes"))
                    return record.replace(cluster=self._identity)
        return self._archived_run(uid)

    def _archived_run(self, uid: str) -> RunRecord | None:
        return self._archive.archive().get(uid) if self._archive is not None else None

    def sweeps(self) -> list[SweepRecord]:
        """Return the sweeps in the archive."""
        return self._archive.archive().sweeps() if self._archive and self._archived else []

    def catalog(self, kind: str) -> list[CatalogEntry]:
        """Return the catalog as archived runs used it, then as it is now."""
        word: Literal["Algorithm", "Dataset"] = "Algorithm" if kind == "Algorithm" else "Dataset"
        archived = self._archive.archive().catalog(kind) if self._archive and self._archived else []
        return [*archived, *(catalog_entry(word, obj) for obj in self._cluster.of(Kind(kind)))]

    def place(self, record: RunRecord) -> ArtifactFolder | None:
        """Return the folder of a run on the results volume, or in object storage."""
        parts = tuple((record.folder or "").split("/"))
        wrong = len(parts) < 2 or parts[0] != "runs" or any(part in {"", ".", ".."} for part in parts)
        if wrong:
            return None
        if self._results is not None and self._results.joinpath(*parts).is_dir():
            return ArtifactFolder(self._results, parts)
        return self._shelf.place(parts) if self._shelf is not None else None

    def absence(self, record: RunRecord) -> str | None:  # noqa: ARG002 - a workstation's source needs it
        """Return None: a cluster's collector leaves no word of what it removed."""
        return None

    def truth(self, dataset: str, label: str | None) -> DatasetTruth | None:
        """Return the ground truth of a dataset, if its volume is mounted."""
        return self._truths.find(dataset, label)

    def variants(self) -> Path | None:
        """Return None: the data volume is not mounted here."""
        return None

    def home(self) -> Path | None:
        """There is no home on a cluster."""
        return None

    def live_runs(self) -> int:
        """Return the number of runs that have not finished."""
        return sum(run.live for run in self._cluster.all_runs())

    @property
    def _archived(self) -> bool:
        return self._archive is not None and self._archive.is_open

    def _problems(self) -> tuple[str, ...]:
        sentences = [sentence for sentence in self._troubles.values() if sentence]
        if self._archive is not None:
            sentences += self._archive.said
        if self._shelf is not None and (told := self._offloading.sentence()):
            sentences.append(told)
        return tuple(dict.fromkeys(sentences[:3]))

    def _build(
        self,
        runs: list[LiveRun],
        datasets: dict[tuple[str, str], dict[str, Any]],
        sweeps: dict[tuple[str, str], dict[str, Any]],
    ) -> Frame:
        archived = self._archive.frame if self._archive is not None else Frame({}, 0)
        if len(archived):
            uids = archived.column("uid")
            ended = {*archived.select(uids.among(run.uid for run in runs if run.live)).column("uid").tolist()}
            runs = [run for run in runs if run.uid not in ended]
        if not runs:
            self._dropped = None
            return archived
        for run in runs:
            self._numbers.setdefault(run.uid, -1 - len(self._numbers))
        settings = {sweep["uid"]: sweep["settings"] for sweep in sweeps.values() if sweep["settings"]}
        parts = [columns_of_live(runs, self._numbers, datasets, settings, self._identity)]
        self._dropped = _dropped_sentence(bound(parts, archived.stored, MAX_LIVE_COLUMNS))
        if len(archived):
            kept = archived.select(~uids.among({run.uid for run in runs}))
            parts.append(({name: kept.column(name) for name in kept.stored}, len(kept)))
        columns, length = stack([part for part in parts if part[1]])
        # A Sweep that the cluster holds is the current one of its name, whenever it was made.
        current = [
            SweepVersion(
                sweep["uid"], name, self._identity, namespace, math.inf, choosing_method(sweep["spec"])
            )
            for (namespace, name), sweep in sweeps.items()
        ]
        known = {one.uid for one in current}
        earlier = self._archive.sweeps if self._archive is not None else ()
        versions = [*current, *(one for one in earlier if one.uid not in known)]
        return with_derived(columns, length, versions).declaring(archived.declared)

    def _follower(self, api: Api, watches: ClientSession, kind: Kind, namespace: str) -> Follower:
        def trouble(sentence: str | None) -> None:
            self._troubles[kind, namespace] = sentence

        cluster = self._cluster
        if kind is Kind.MAPPING_RUN:
            return Follower(
                api,
                watches,
                kind,
                namespace,
                reset=lambda items, _: cluster.reset_runs(namespace, items),
                change=partial(cluster.change_run, namespace),
                trouble=trouble,
                narrow=narrow_run,
            )
        return Follower(
            api,
            watches,
            kind,
            namespace,
            reset=lambda items, _: cluster.reset_others(kind, namespace, items),
            change=partial(cluster.change_other, kind, namespace),
            trouble=trouble,
            narrow=narrow_other,
        )

    def _fetch(self, key: Key) -> dict[str, Any] | None:
        """Return an object, asked for from a thread that is not the loop's."""
        if self._api is None or self._loop is None:
            return None
        future = asyncio.run_coroutine_threadsafe(self._api.get(key), self._loop)
        try:
            return future.result(_DETAIL_SECONDS)
        except NotFound:
            return None
        except (ApiError, TimeoutError):
            future.cancel()
            return None


def _dropped_sentence(names: list[str]) -> str | None:
    """Say which columns of live runs are left out; None where none is."""
    if not names:
        return None
    columns = "1 column" if len(names) == 1 else f"{len(names):,} columns"
    shown = ", ".join(name[:60] for name in names[:3])
    return (
        f"live runs have more than {MAX_LIVE_COLUMNS} columns that no archived run has: "
        f"{columns} that few of them have ({shown}{', …' if len(names) > 3 else ''}) are left out"
    )


def _address(obj: dict[str, Any]) -> tuple[str, str]:
    return obj["metadata"].get("namespace", ""), obj["metadata"]["name"]
