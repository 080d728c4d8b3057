# SPDX-License-Identifier: Apache-2.0
"""Many instances of a scenario at once, each with a namespace, operators and an archive of its own."""

from __future__ import annotations

import asyncio
import itertools
import zlib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

from faultlab.namespaces import Namespaces
from faultlab.points import FaultyArchive
from faultlab.recorder import recording
from faultlab.scenarios import PASSING
from testcluster.lab import Lab

from slamhive.analysis.measuring import SETTINGS_KEY, settings_hash
from slamhive.archive import Archive
from slamhive.jobs.lines import encode_all
from slamhive.jobs.requests import EvaluateRequest
from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Kind, Label, Object
from slamhive.kube.api.transport import Request

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
    from contextlib import AbstractAsyncContextManager
    from pathlib import Path

    from faultlab.points import Faults
    from faultlab.recorder import Recorder
    from faultlab.scenarios import Scenario
    from testcluster.access import Cluster
    from testcluster.kwok import Play, Pool

    from slamhive.kube.operator import Operator
    from slamhive.kube.settings import Settings
    from slamhive.model.results import RunRecord

T = TypeVar("T")

SECONDS = 240.0
"""Against hanging: eight are played at once, and all else may go on beside them."""
AT_ONCE = 8
QUICK: Object = {
    "evaluation": {"delaySeconds": 0.1},
    "sweepWriteSeconds": 0.1,
    "relistSeconds": 5,
    "workers": 4,
}
_KINDS = {"Algorithm": Kind.ALGORITHM, "Dataset": Kind.DATASET, "MappingRun": Kind.MAPPING_RUN}
_KINDS |= {"Sweep": Kind.SWEEP, "Evaluation": Kind.EVALUATION}
_NUMBERS = itertools.count()


async def played_logs(api: Api, namespace: str, pod: str, container: str, **_: Any) -> str:
    """Return the log that a played pod's evaluator would have written, in the place of its kubelet.

    Everything else of an evaluation is real. The figures follow from the runs' uids.
    """
    request = await evaluation_of(api, namespace, pod, container)
    return evaluator_log(request, lambda run: error_of(run["uid"]))


async def evaluation_of(api: Api, namespace: str, pod: str, container: str) -> EvaluateRequest:
    """Return the request of an evaluator's pod."""
    path = f"/api/v1/namespaces/{namespace}/pods/{pod}"
    body = await api.json(Request("get", "pods/log", f"{namespace}/{pod}/{container}", "GET", path))
    return EvaluateRequest.model_validate_json(body["metadata"]["annotations"]["slamhive.io/request"])


def evaluator_log(request: EvaluateRequest, error: Callable[[Object], float]) -> str:
    """Return the log of an evaluator that found an ATE for each run, m."""
    hashed = settings_hash(request.settings)
    records = [
        {
            "uid": run["uid"],
            "name": run["name"],
            "result": {
                "evaluation": request.evaluation or "se3",
                "outcome": "Tracked",
                "coverage": 1.0,
                "values": {"ate": {"rmse": error(run)}, SETTINGS_KEY: hashed},
            },
        }
        for run in request.runs
    ]
    return "".join(encode_all(records))


def error_of(uid: str) -> float:
    """Return the ATE that a run is played to have, m."""
    return zlib.crc32(uid.encode()) % 1000 / 1000


@dataclass
class Instance:
    """A namespace in which a scenario is played."""

    arena: Arena
    scenario: Scenario
    lab: Lab
    archive: Archive | None

    @property
    def namespace(self) -> str:
        """Return the namespace."""
        return self.lab.namespace

    def operator(
        self, faults: Faults | None = None, **settings: Any
    ) -> AbstractAsyncContextManager[Operator]:
        """Return a running operator as a context."""
        archive: Any = self.archive
        if faults is not None and archive is not None:
            archive = FaultyArchive(archive, faults)
        return self.lab.operator(archive, faults, **(QUICK | settings))

    def settings(self) -> Settings:
        """Return the settings of an operator for this namespace."""
        return self.lab.settings(**QUICK)

    def is_over(self) -> bool:
        """Tell whether all is done, and all is gone that is to go."""
        scenario = self.scenario
        # What is in memory first: this is asked many times a second.
        return (
            scenario.is_over(self.arena.seen, self.namespace)
            and len(self.records()) == (scenario.archived or 0)
            and not self._orphans()
        )

    async def until(self, condition: Callable[[], Any], what: str, seconds: float = SECONDS) -> None:
        """Wait for a condition.

        Raises:
            TimeoutError: it does not come.
        """
        try:
            async with asyncio.timeout(seconds):
                while not condition():
                    victim = self.scenario.victim(self.arena.seen, self.namespace)
                    if victim is not None:
                        self.arena.order(self.arena.admin.delete(victim))
                    await asyncio.sleep(0.05)
        except TimeoutError:
            raise TimeoutError(f"waited {seconds:g} s for {what}; there is {self.outcome()}") from None

    async def finish(self, faults: Faults | None = None, **settings: Any) -> Outcome:
        """Let an operator bring all to its end, and return what came of it."""
        async with self.operator(faults, **settings):
            await self.until(self.is_over, "the end")
        return self.outcome()

    def records(self) -> list[RunRecord]:
        """Return the archived runs of this namespace; others may share the archive."""
        runs = self.archive.runs() if self.archive else ()
        return [record for record in runs if record.namespace == self.namespace]

    def outcome(self) -> Outcome:
        """Return the outcome by now, in a form that is the same whenever all went the same way."""
        seen, namespace = self.arena.seen, self.namespace
        alive = {run["metadata"]["uid"]: run for run in seen.alive("mappingruns", namespace)}
        ends = [(_place(run), _end(run)) for run in alive.values()]
        records = self.records()
        objects = seen.ever["mappingruns", namespace]
        for record in records:
            if record.uid in alive:
                continue
            cpu = record.usage.cpu.seconds if record.usage else None
            results = tuple(
                (item.evaluation, item.values["ate"]["rmse"] == error_of(record.uid))
                for item in record.results
            )
            # The archive has no conditions; those of its object, as last seen, are still what came of it. One
            # beyond the retention is not told of its end.
            told = objects[record.uid].get("status") or {}
            conditions = _conditions(told) if told.get("completionTime") else ()
            end = (str(record.phase), record.reason, record.attempts, 0, cpu, results, conditions)
            ends.append((str(record.index), end))
        ends += [("sweep", _standing(obj)) for obj in seen.alive("sweeps", namespace)]
        return Outcome(
            ends=tuple(sorted(ends, key=lambda end: end[0])),
            created=self._created(),
            archived=len(records),
            orphans=self._orphans(),
        )

    def _created(self) -> Object:
        """Return the number of objects there ever were of each sort that may be made once."""
        seen = self.arena.seen
        runs = Counter(_place(run) for run in seen.ever["mappingruns", self.namespace].values())
        jobs: Counter[str] = Counter()
        for job in seen.ever["jobs", self.namespace].values():
            labels = job["metadata"]["labels"]
            if labels[Label.ROLE] == "run":
                run = seen.ever["mappingruns", self.namespace].get(_owner(job))
                jobs[f"{_place(run) if run else '?'}-{labels[Label.ATTEMPT]}"] += 1
            elif labels[Label.ROLE] == "prepare":
                jobs["prepare"] += 1
        return {"runs": dict(sorted(runs.items())), "jobs": dict(sorted(jobs.items()))}

    def _orphans(self) -> tuple[str, ...]:
        seen, namespace = self.arena.seen, self.namespace
        kinds = ("mappingruns", "sweeps", "jobs", "pods")
        uids = {obj["metadata"]["uid"] for kind in kinds for obj in seen.alive(kind, namespace)}
        return tuple(
            f"{kind} {obj['metadata']['name']}"
            for kind in ("jobs", "pods")
            for obj in seen.alive(kind, namespace)
            if obj["metadata"].get("ownerReferences")
            and not uids & {owner["uid"] for owner in obj["metadata"]["ownerReferences"]}
        )


@dataclass(frozen=True)
class Outcome:
    """Outcome of a scenario: how its runs and its Sweep ended, and which objects there were.

    Attributes:
        ends: how each run ended with its point, live ones and archived ones, and where the Sweep stands, each
            with its conditions.
        created: how many objects there were of each point and attempt.
        archived: rows of the archive.
        orphans: Jobs and pods whose owner is gone; they go by themselves after a moment.
    """

    ends: tuple[tuple[str, tuple[Any, ...]], ...]
    created: Object
    archived: int
    orphans: tuple[str, ...] = field(compare=False)


@dataclass
class Arena:
    """Control plane on which instances of scenarios are played, each in a namespace of its own."""

    cluster: Cluster
    plays: Callable[[Play], Pool]
    folder: Path
    admin: Api
    seen: Recorder
    threads: ThreadPoolExecutor
    loop: asyncio.AbstractEventLoop
    namespaces: Namespaces

    async def play(
        self,
        scenario: Scenario,
        course: Callable[[Instance], Awaitable[T]],
        kubeconfig: Path | None = None,
        archive: Archive | None = None,
    ) -> T:
        """Give a scenario a namespace with its objects in it, and return what a course of events comes to.

        The archive is the namespace's own unless one is given.

        The course runs in a thread and loop of its own: kopf cancels all tasks of a loop that it leaves.
        """
        name = await self.namespaces.take()
        cluster = replace(self.cluster, kubeconfig=kubeconfig or self.cluster.kubeconfig)
        lab = Lab(cluster, name, self.plays(scenario.play))
        loop = asyncio.get_running_loop()
        with ExitStack() as stack:
            if scenario.archived is not None and archive is None:
                file = self.folder / f"{name}-{next(_NUMBERS)}.sqlite"
                archive = stack.enter_context(Archive.open(f"sqlite:///{file}"))
            instance = Instance(self, scenario, lab, archive)
            for obj in (*scenario.catalog, *scenario.objects):
                await self.admin.create(_KINDS[obj["kind"]], obj, name)
            try:
                return await loop.run_in_executor(self.threads, lambda: asyncio.run(course(instance)))
            finally:
                self.namespaces.give_back(name)

    async def undisturbed(self, scenario: Scenario) -> Outcome:
        """Return the outcome of a scenario without any trouble; it is played once a session."""

        async def course(instance: Instance) -> Outcome:
            return await instance.finish()

        if scenario.name not in _UNDISTURBED:
            _UNDISTURBED[scenario.name] = await self.play(scenario, course)
        return _UNDISTURBED[scenario.name]

    def order(self, action: Coroutine[Any, Any, T]) -> T:
        """Carry out a call of the administrator's for an instance, which waits."""
        return asyncio.run_coroutine_threadsafe(action, self.loop).result(SECONDS)


@asynccontextmanager
async def arena_on(cluster: Cluster, plays: Callable[[Play], Pool], folder: Path) -> AsyncIterator[Arena]:
    """Open an arena on a cluster."""
    admin = await Api.connect(cluster.kubeconfig)
    try:
        async with recording(admin) as seen:
            with ThreadPoolExecutor(AT_ONCE) as threads:
                namespaces = Namespaces(admin, seen)
                loop = asyncio.get_running_loop()
                try:
                    yield Arena(cluster, plays, folder, admin, seen, threads, loop, namespaces)
                finally:
                    await namespaces.clear()
    finally:
        await admin.close()


_UNDISTURBED: dict[str, Outcome] = {}


def _place(run: Object) -> str:
    """Return the point of a run, or its name where it has none."""
    meta = run["metadata"]
    return str((meta.get("labels") or {}).get(Label.POINT) or meta["name"])


def _owner(obj: Object) -> str:
    return str(obj["metadata"]["ownerReferences"][0]["uid"])


def _end(run: Object) -> tuple[Any, ...]:
    status, uid = run.get("status") or {}, run["metadata"]["uid"]
    usage = (status.get("usage") or {}).get("cpu") or {}
    results = tuple(
        sorted(
            (item["evaluation"], item["ate"]["rmse"] == error_of(uid)) for item in status.get("results") or ()
        )
    )
    return (
        status.get("phase"),
        status.get("reason"),
        status.get("attempts", 0),
        status.get("faults", 0),
        usage.get("seconds"),
        results,
        _conditions(status),
    )


_FREE = ("Blocked", "False")


def _conditions(status: Object) -> tuple[tuple[str, str, str], ...]:
    """Return the conditions without their sentences and times, and without trouble on the way.

    Nor whether the metrics API answers: that stands in a Sweep that is written after it was asked. Nor that
    it stood still for a while, as it does where a machine is slow.
    """
    return tuple(
        sorted(
            (item["type"], item["status"], item["reason"])
            for item in status.get("conditions") or ()
            if item["type"] not in {*PASSING, "LiveUsage"} and (item["type"], item["status"]) != _FREE
        )
    )


def _standing(sweep: Object) -> tuple[Any, ...]:
    status = sweep.get("status") or {}
    fields = ("phase", "total", "pending", "running", "succeeded", "failed", "reused", "evaluated")
    figures = tuple(status.get(name) for name in (*fields, "cpuSeconds", "progress", "points"))
    best = sorted(item["index"] for item in status.get("best") or ())
    times = (bool(status.get("startTime")), bool(status.get("completionTime")))
    return (*figures, tuple(best), *times, _conditions(status))
