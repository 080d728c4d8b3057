# SPDX-License-Identifier: Apache-2.0
"""Starts on a cluster: each is a Sweep of one run, submitted, waited for, fetched and deleted.

Algorithm and Dataset go along under names of the check's own, so that nothing of the namespace is changed.
"""

from __future__ import annotations

import asyncio
import secrets
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.conformance.executors import CheckEnd, CheckStart, read_poses
from slamhive.conformance.recordings import RECORDINGS, asked_of
from slamhive.kube.api.errors import ApiError, NotFound
from slamhive.kube.api.kinds import Kind, Object
from slamhive.kube.user.fetching import Fetcher, put_folder
from slamhive.kube.user.manifests import entry_of
from slamhive.kube.user.queries import is_over, is_stuck, runs_of
from slamhive.kube.user.run_files import Filing
from slamhive.kube.user.submitting import read_catalog, send
from slamhive.model.base import ObjectMeta
from slamhive.model.errors import InputError, SlamHiveError, SystemFault
from slamhive.model.sweep import Sweep

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractAsyncContextManager
    from typing import Self

    from slamhive.conformance.workstation import CheckBench
    from slamhive.kube.user.connecting import ConnectedCluster
    from slamhive.kube.user.manifests import Manifest
    from slamhive.model.base import Resource
    from slamhive.model.results import RunRecord

LOOK_SECONDS = 1.0
_STUCK_SECONDS = 10.0
_AROUND_SECONDS = 1800.0
"""Longest time of pulling an image, preparing and evaluating, besides a run."""


class OnCluster:
    """Starts in a namespace of a cluster; a context manager that deletes what it made.

    Args:
        bench: where runs are fetched to, and what the recordings are compared with.
        name: the algorithm.
        dataset: a dataset by name; None: the generated one for each mode.
        connect: the way to the cluster.
    """

    name = "cluster"

    def __init__(
        self,
        bench: CheckBench,
        name: str,
        dataset: str | None,
        connect: Callable[[], AbstractAsyncContextManager[ConnectedCluster]],
    ) -> None:
        self._bench = bench
        self._algorithm = name
        self._dataset = dataset
        self._connect = connect
        self._token = secrets.token_hex(3)
        self._made: list[tuple[Kind, str]] = []

    def unavailable(self) -> str | None:
        """Say why nothing can be started there, None where it can."""
        if self._bench.workshop.algorithm(self._algorithm).algorithm.spec.image is None:
            return "names no image (spec.image), which a cluster needs"

        async def look() -> None:
            async with self._connect():
                pass

        try:
            asyncio.run(look())
        except SlamHiveError as error:
            return str(error)
        return None

    def objection(self, start: CheckStart) -> str | None:
        """Say why something can't be started like this there, None where it can."""
        if start.damage is not None:
            return "a cluster refuses such a recording when it prepares it, before the algorithm is started"
        if start.stop_after is not None:
            return "a cluster doesn't tell whether a pod ended by itself or was killed"
        return None

    def run(self, start: CheckStart) -> CheckEnd:
        """Submit a run, and wait for its end.

        Raises:
            SlamHiveError: it can't be run there.
        """
        return asyncio.run(self._run(start))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._made:
            asyncio.run(self._remove())

    async def _run(self, start: CheckStart) -> CheckEnd:
        async with self._connect() as cluster:
            sweep = self._sweep(start)
            await self._send(cluster, [*await self._entries(cluster, sweep), entry_of(sweep, "the check")])
            try:
                body = await self._wait(cluster, sweep.name, start.timeout + _AROUND_SECONDS)
                record, why = await self._fetch(cluster, body)
            finally:
                await self._delete(cluster, Kind.SWEEP, sweep.name)
        text, trajectory = b"", None
        if record.trajectory is not None and not why:
            text, trajectory = read_poses(Path(record.trajectory.path))
        # Whoever looks at it knows the names of the catalog here.
        asked = asked_of(self._algorithm, start, self._dataset, self._bench.workshop).spec.template.spec
        names = {name: asked[name] for name in ("algorithmRef", "datasetRef")}
        record = record.replace(spec=record.spec | names)
        return CheckEnd(record=record, text=text, trajectory=trajectory, absent=why)

    def _sweep(self, start: CheckStart) -> Sweep:
        """Return the sweep of one run, with names of the check's own in it."""
        asked = asked_of(self._algorithm, start, self._dataset, self._bench.workshop).as_json()
        asked["metadata"] = {"name": f"check-{self._token}-{start.mode.name}-{start.number}"}
        asked["spec"]["cachePolicy"] = "Rerun"  # three equal runs are three runs
        template = asked["spec"]["template"]["spec"]
        template["algorithmRef"] = {"name": f"check-{self._token}"}
        if self._dataset is None:
            template["datasetRef"] = {"name": f"{template['datasetRef']['name']}-{self._token}"}
        return Sweep.model_validate(asked)

    async def _entries(self, cluster: ConnectedCluster, sweep: Sweep) -> list[Manifest]:
        """Return the Algorithm and the Dataset that a sweep names, as far as they have to be sent."""
        workshop, spec = self._bench.workshop, sweep.spec.template.spec
        items: list[Resource] = [
            _renamed(workshop.algorithm(self._algorithm).algorithm, spec["algorithmRef"]["name"])
        ]
        name = spec["datasetRef"]["name"]
        own = {f"{item.name}-{self._token}": item for item in RECORDINGS}
        if name in own:
            items.append(_renamed(own[name], name))
        elif not (await read_catalog(cluster)).has(Kind.DATASET, name):
            raise InputError(
                f"--dataset {name}: the cluster has none of this name; slamhive submit sends one, "
                "and its files have to be on the data volume"
            )
        return [entry_of(item, "the check") for item in items]

    async def _send(self, cluster: ConnectedCluster, manifests: Sequence[Manifest]) -> None:
        for one in manifests:
            if one.kind is not Kind.SWEEP and (one.kind, one.name) not in self._made:
                self._made.append((one.kind, one.name))  # before: it may be there though the answer was lost
        await send(cluster, manifests)

    async def _wait(self, cluster: ConnectedCluster, name: str, patience: float) -> Object:
        """Return the Sweep when its run has ended and been evaluated.

        Raises:
            SystemFault: it does not come to its end.
        """
        key, loop = cluster.key(Kind.SWEEP, name), asyncio.get_running_loop()
        deadline = loop.time() + patience
        stuck_at: float | None = None
        while loop.time() < deadline:
            try:
                body = await cluster.api.get(key)
                stuck = is_stuck(Kind.SWEEP, body)
                runs = await runs_of(cluster, body) if is_over(Kind.SWEEP, body) else []
            except NotFound:
                raise SystemFault("the Sweep was deleted by someone") from None
            except ApiError as error:
                if not error.retryable:
                    raise
                continue
            if runs and all(is_over(Kind.MAPPING_RUN, run) for run in runs):
                return body
            stuck_at = None if stuck is None else stuck_at or loop.time()
            if stuck_at is not None and loop.time() - stuck_at >= _STUCK_SECONDS:
                raise SystemFault(f"the cluster does not run it: {stuck}")
            await asyncio.sleep(LOOK_SECONDS)
        raise SystemFault(f"the cluster did not finish a run within {patience / 60:.0f} minutes")

    async def _fetch(self, cluster: ConnectedCluster, body: Object) -> tuple[RunRecord, str]:
        """Return the run of a finished Sweep, and why its files are not here, empty where they are."""
        bench = self._bench
        catalog = await read_catalog(cluster)
        fetcher = Fetcher(cluster, catalog, bench.archive, lambda _done, _total: None)
        fetched = await fetcher.sweep(body)
        why = ""
        filing = Filing(
            cluster,
            bench.home.folder("runs"),
            keep=partial(put_folder, bench.archive),
            step=lambda _done, _total, _size: None,
            tell=lambda _: None,
        )
        try:
            why = "; ".join((await filing.fetch(fetcher.absent)).problems)
        except SlamHiveError as error:
            why = str(error)
        records = list(bench.archive.runs(sweep=fetched.stored))
        if not records:
            raise SystemFault("the cluster has no run of the Sweep")
        return records[0], why

    async def _delete(self, cluster: ConnectedCluster, kind: Kind, name: str) -> None:
        with suppress(NotFound):
            await cluster.api.delete(cluster.key(kind, name))

    async def _remove(self) -> None:
        async with self._connect() as cluster:
            while self._made:
                await self._delete(cluster, *self._made[-1])
                self._made.pop()


def _renamed(item: Any, name: str) -> Any:
    """Return an entry of the catalog under another name."""
    return item.replace(metadata=ObjectMeta(name=name))
