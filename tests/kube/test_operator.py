# SPDX-License-Identifier: Apache-2.0
"""The engine room with toy reconcilers and an API of a few dictionaries."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.kube import health, operator
from slamhive.kube.api.errors import Conflict, Forbidden, Invalid, NotFound, ServerFault, StartError
from slamhive.kube.api.kinds import OUR_KINDS, Key, Kind, Label, key_of
from slamhive.kube.cluster import Cluster
from slamhive.kube.loop import SLOW_RETRY_SECONDS
from slamhive.kube.operator import Operator
from slamhive.kube.settings import Settings
from slamhive.kube.status import condition
from slamhive.model.errors import InputError
from slamhive.model.results import Phase
from slamhive.model.status import MappingRunStatus

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable
    from pathlib import Path

RUN = Kind.MAPPING_RUN
KEY = Key(RUN, "lab", "demo")
SETTINGS = Settings.model_validate(
    {
        "namespaces": ["lab"],
        "image": "slamhive",
        "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
        "workers": 2,
    }
)


def thing(name: str = "demo", version: int = 1, phase: str = "", **labels: str) -> dict[str, Any]:
    named = {f"slamhive.io/{label}": value for label, value in labels.items()}
    metadata = {"name": name, "namespace": "lab", "uid": f"uid-{name}", "resourceVersion": str(version)}
    return {"metadata": metadata | {"labels": named}, "spec": {}, "status": {"phase": phase} if phase else {}}


class FakeApi:
    """Objects in dictionaries; ``errors`` are raised one a call."""

    def __init__(self) -> None:
        self.objects: dict[Key, dict[str, Any]] = {}
        self.version = 100
        self.plurals = frozenset(kind.plural for kind in OUR_KINDS)
        self.errors: list[Exception] = []
        self.listed: list[tuple[Kind, str | None]] = []
        self.count: Any = None
        self.told: list[tuple[str, str, str, str]] = []
        self.known: dict[str, Any] = {}

    def have(self, kind: Kind, obj: dict[str, Any]) -> None:
        self.objects[key_of(kind, obj)] = obj

    def _next(self) -> int:
        if self.errors:
            raise self.errors.pop(0)
        self.version += 1
        return self.version

    async def cluster_uid(self) -> str | None:
        return "cluster-1"

    async def served(self, group: str, version: str) -> frozenset[str]:
        return self.plurals

    async def schemas(self, group: str, version: str) -> dict[str, Any]:
        return self.known

    async def list(
        self, kind: Kind, namespace: str, *, labels: str | None, narrow: Callable[[Any], Any]
    ) -> tuple[list[dict[str, Any]], str]:
        version = self._next()
        self.listed.append((kind, labels))
        found = [narrow(obj) for key, obj in self.objects.items() if key[:2] == (kind, namespace)]
        return found, str(version)

    async def get(self, key: Key) -> dict[str, Any]:
        self._next()
        if key not in self.objects:
            raise NotFound("not there")
        return self.objects[key]

    async def create(self, kind: Kind, body: dict[str, Any], namespace: str | None) -> dict[str, Any]:
        version = self._next()
        obj = thing(body["metadata"]["name"], version)
        obj["metadata"]["labels"] = body["metadata"].get("labels", {})
        self.have(kind, obj)
        return obj

    async def patch(self, key: Key, body: dict[str, Any], *, subresource: str | None) -> dict[str, Any]:
        version = self._next()
        if key not in self.objects:
            raise NotFound("not there")
        present = self.objects[key]
        asked = dict(body.get("metadata", {}))
        if (
            asked.get("resourceVersion", present["metadata"]["resourceVersion"])
            != (present["metadata"]["resourceVersion"])
        ):
            raise Conflict("the object has been modified")
        metadata = present["metadata"] | asked | {"resourceVersion": str(version)}
        status = present["status"] | body.get("status", {})
        status = {name: value for name, value in status.items() if value is not None}
        self.objects[key] = present | body | {"metadata": metadata, "status": status}
        return self.objects[key]

    async def delete(self, key: Key, *, uid: str | None, **options: Any) -> None:
        self._next()
        self.objects.pop(key, None)

    async def event(
        self, kind: Kind, regarding: dict[str, Any], event_type: str, reason: str, message: str
    ) -> None:
        self.told.append((regarding["metadata"]["name"], event_type, reason, message))

    async def pod_metrics(self, namespace: str, labels: str) -> list[dict[str, Any]]:
        raise NotFound("no metrics API")


class Toy:
    """A reconciler that does what it is told and remembers what it was asked."""

    def __init__(self) -> None:
        self.seen: list[str] = []
        self.act: Callable[[Cluster, Key], Awaitable[float | None]] | None = None

    async def __call__(self, cluster: Cluster, key: Key) -> float | None:
        self.seen.append(str(key))
        return None if self.act is None else await self.act(cluster, key)


@pytest.fixture
def api() -> FakeApi:
    return FakeApi()


@pytest.fixture
def toy() -> Toy:
    return Toy()


@pytest.fixture
async def op(api: FakeApi, toy: Toy) -> AsyncIterator[Operator]:
    async def never(_: float) -> None:
        await asyncio.Event().wait()

    op = Operator(Cluster(api, SETTINGS), dict.fromkeys(OUR_KINDS, toy), sleep=never)  # type: ignore[arg-type]
    yield op
    await op.stop()


async def settle(op: Operator) -> None:
    async with asyncio.timeout(50):
        while len(op.cluster.queue) or op.cluster.queue.active:  # noqa: ASYNC110 - the workers take turns with us
            await asyncio.sleep(0)


def failing(error: Exception) -> Callable[[Cluster, Key], Awaitable[float | None]]:
    async def act(cluster: Cluster, key: Key) -> float | None:
        raise error

    return act


async def test_nothing_is_reconciled_before_the_first_list(op: Operator, api: FakeApi, toy: Toy) -> None:
    op.cluster.observe(RUN, "ADDED", thing("early", 99999))
    await asyncio.sleep(0)
    assert toy.seen == []
    api.have(RUN, thing("listed"))
    await op.start()
    await settle(op)
    assert sorted(toy.seen) == ["MappingRun lab/early", "MappingRun lab/listed"]


async def test_only_our_jobs_and_pods_are_listed(op: Operator, api: FakeApi) -> None:
    await op.start()
    managed = "app.kubernetes.io/managed-by=slamhive"
    assert set(api.listed) == {(kind, None if kind.is_ours else managed) for kind in Kind}


def held_job(version: int) -> dict[str, Any]:
    return thing("job", version, role="run", run="demo") | {"spec": {"suspend": True}}


async def test_a_job_brings_its_run(op: Operator, toy: Toy) -> None:
    op.cluster.observe(RUN, "ADDED", thing("demo", 99999))
    await op.start()
    await settle(op)
    op.cluster.observe(Kind.JOB, "MODIFIED", held_job(5))
    await settle(op)
    assert toy.seen == ["MappingRun lab/demo", "MappingRun lab/demo"]


async def test_a_job_that_only_begins_brings_nothing(op: Operator, toy: Toy) -> None:
    op.cluster.observe(RUN, "ADDED", thing("demo", 99999))
    await op.start()
    await settle(op)
    op.cluster.observe(Kind.JOB, "ADDED", thing("job", 5, role="run", run="demo"))
    op.cluster.observe(Kind.JOB, "MODIFIED", thing("job", 6, role="run", run="demo"))
    await settle(op)
    assert toy.seen == ["MappingRun lab/demo"]


async def test_a_stale_or_repeated_message_brings_nothing(op: Operator, toy: Toy) -> None:
    await op.start()
    for version in (5, 5, 4):
        op.cluster.observe(RUN, "MODIFIED", thing(version=version))
        await settle(op)
    assert len(toy.seen) == 1


async def test_a_deletion_brings_the_key_and_empties_the_store(op: Operator, toy: Toy) -> None:
    await op.start()
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    op.cluster.observe(RUN, "DELETED", thing(version=6))
    await settle(op)
    assert op.cluster.store.get(KEY) is None
    assert toy.seen == [str(KEY)]


async def test_own_writes_enter_the_store_and_bring_others_but_not_oneself(op: Operator, toy: Toy) -> None:
    await op.start()
    op.cluster.observe(RUN, "ADDED", thing(version=5))

    async def create_once(cluster: Cluster, key: Key) -> float | None:
        if key.kind is RUN:
            labels = {Label.ROLE: "run", Label.RUN: "demo", Label.SWEEP: "s"}
            await cluster.create(Kind.JOB, {"metadata": {"name": "job", "labels": labels}}, "lab")
            cluster.apply(RUN, thing(version=200, sweep="s"))
        return None

    toy.act = create_once
    await settle(op)
    assert op.cluster.store.get(Key(Kind.JOB, "lab", "job")) is not None
    assert toy.seen == [str(KEY), "Sweep lab/s"]


async def test_what_others_wrote_brings_oneself_when_it_is_read_anew(
    op: Operator, api: FakeApi, toy: Toy
) -> None:
    """Its reconciler decided by the older version, and the watch will have nothing new to tell."""
    await op.start()
    api.have(RUN, thing(version=50, phase="Changed"))
    versions: list[str] = []

    async def read_anew(cluster: Cluster, key: Key) -> None:
        decided_by = cluster.store.get(key)
        assert decided_by is not None
        versions.append(decided_by["metadata"]["resourceVersion"])
        await cluster.refresh(key)

    toy.act = read_anew
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    await settle(op)
    assert versions == ["5", "50"]


async def test_what_is_being_created_is_known_until_it_is_there(
    op: Operator, api: FakeApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or two workers would each find the last room for a preparation."""
    begun, answered = asyncio.Event(), asyncio.Event()
    create = api.create

    async def slowly(*words: Any) -> dict[str, Any]:
        begun.set()
        await answered.wait()
        return await create(*words)

    monkeypatch.setattr(api, "create", slowly)
    where = (Kind.JOB, "lab", str(Label.ROLE))
    body = {"metadata": {"name": "job", "namespace": "lab", "labels": {str(Label.ROLE): "prepare"}}}
    creating = asyncio.create_task(op.cluster.create(Kind.JOB, body))
    await begun.wait()
    assert op.cluster.being_created(*where, "prepare") == [body]
    assert op.cluster.being_created(*where, "run") == []
    answered.set()
    await creating
    assert op.cluster.being_created(*where, "prepare") == []


async def test_the_watch_s_echo_of_an_own_write_is_no_news(op: Operator, api: FakeApi, toy: Toy) -> None:
    await op.start()
    api.have(RUN, thing(version=5))
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    await settle(op)
    await op.cluster.patch(KEY, {"status": {"phase": "Running"}}, subresource="status")
    await settle(op)
    before = len(toy.seen)
    op.cluster.observe(RUN, "MODIFIED", api.objects[KEY])
    await settle(op)
    assert len(toy.seen) == before


async def test_writes_to_what_is_gone_take_it_out_of_the_store(op: Operator, api: FakeApi) -> None:
    await op.start()
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    with pytest.raises(NotFound):
        await op.cluster.patch(KEY, {"status": {}}, subresource="status")
    assert op.cluster.store.get(KEY) is None


async def test_a_conflict_is_solved_by_reading_anew(op: Operator, api: FakeApi) -> None:
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    api.have(RUN, thing(version=9, phase="Running"))
    refreshed = await op.cluster.refresh(KEY)
    assert refreshed is not None
    assert op.cluster.store.get(KEY) == refreshed | {"status": {"phase": "Running"}}
    api.objects.clear()
    assert await op.cluster.refresh(KEY) is None
    assert op.cluster.store.get(KEY) is None


async def test_a_status_is_written_for_the_version_that_was_seen(op: Operator, api: FakeApi) -> None:
    seen = thing(version=5, phase="Running")
    op.cluster.observe(RUN, "ADDED", seen)
    api.have(RUN, thing(version=6, phase="Succeeded"))
    with pytest.raises(Conflict):
        await op.cluster.write_status(RUN, seen, MappingRunStatus(phase=Phase.FAILED))
    assert api.objects[KEY]["status"] == {"phase": "Succeeded"}


async def test_a_status_is_written_where_it_changes_and_keeps_what_others_wrote(
    op: Operator, api: FakeApi
) -> None:
    theirs = condition("Theirs", True, "Known") | {"lastTransitionTime": "2026-01-02T03:04:05Z"}
    seen = thing(version=5, phase="Running")
    seen["status"] |= {"reason": "Odd", "later": {"x": 1}, "conditions": [theirs]}
    api.have(RUN, seen)
    told = [condition("Accepted", True, "Accepted")]
    answer = await op.cluster.write_status(
        RUN, seen, MappingRunStatus(phase=Phase.RUNNING, reason=None), told
    )
    assert answer is not None
    assert answer == op.cluster.store.get(KEY)
    assert {name: answer["status"][name] for name in ("phase", "later")} == {
        "phase": "Running",
        "later": {"x": 1},
    }
    assert "reason" not in answer["status"]
    assert [item["type"] for item in answer["status"]["conditions"]] == ["Theirs", "Accepted"]
    written = api.version
    assert (
        await op.cluster.write_status(RUN, answer, MappingRunStatus(phase=Phase.RUNNING, reason=None), told)
        is None
    )
    assert api.version == written


async def test_amending_starts_from_the_newest_version(op: Operator, api: FakeApi) -> None:
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    api.have(RUN, thing(version=6, phase="Succeeded"))

    def change(seen: dict[str, Any]) -> dict[str, Any]:
        return {"status": {"message": f"was {seen['status'].get('phase')}"}}

    await op.cluster.amend(KEY, "uid-demo", change, subresource="status")
    assert api.objects[KEY]["status"] == {"phase": "Succeeded", "message": "was Succeeded"}
    assert await op.cluster.amend(KEY, "uid-of-another", change, subresource="status") is None
    api.errors = [Conflict("newer"), *[ServerFault("down")]]
    with pytest.raises(ServerFault):
        await op.cluster.amend(KEY, "uid-demo", change, subresource="status")
    api.objects.clear()
    assert await op.cluster.amend(KEY, "uid-demo", change, subresource="status") is None
    assert op.cluster.store.get(KEY) is None


async def test_what_keeps_changing_is_tried_again_later(op: Operator, api: FakeApi) -> None:
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    api.have(RUN, thing(version=5))

    async def overtaken(key: Key, body: dict[str, Any], **_: Any) -> dict[str, Any]:
        raise Conflict("newer")

    api.patch = overtaken  # type: ignore[method-assign]
    with pytest.raises(Conflict, match="keeps changing"):
        await op.cluster.amend(KEY, "uid-demo", lambda _: {"status": {"phase": "x"}}, subresource="status")


async def test_delete_means_the_very_object_in_the_store(op: Operator, api: FakeApi) -> None:
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    assert await op.cluster.delete(KEY) is None
    assert op.cluster.store.get(KEY) is None
    op.cluster.observe(RUN, "ADDED", thing("other", 6))
    api.errors = [Conflict("another uid")]
    assert await op.cluster.delete(Key(RUN, "lab", "other")) is None
    assert op.cluster.store.get(Key(RUN, "lab", "other")) is None


async def test_a_reconciler_says_when_to_look_again(op: Operator, toy: Toy) -> None:
    async def later(cluster: Cluster, key: Key) -> float | None:
        return 30.0

    toy.act = later
    await op.start()
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    await settle(op)
    assert op.cluster.queue.delayed == 1


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (ServerFault("500"), (logging.WARNING, 1)),
        (Conflict("changed"), (logging.DEBUG, 1)),
        (Invalid("refused"), (logging.WARNING, 1)),
        (InputError("unknown parameter"), (logging.ERROR, 0)),
        (ZeroDivisionError("oops"), (logging.ERROR, 1)),
    ],
)
async def test_failures_are_tried_again_and_told(
    op: Operator, toy: Toy, caplog: pytest.LogCaptureFixture, error: Exception, expected: tuple[int, int]
) -> None:
    level, failures = expected
    caplog.set_level(logging.DEBUG, "slamhive.operator")
    toy.act = failing(error)
    await op.start()
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    await settle(op)
    assert op.cluster.queue.delayed == 1
    assert op.cluster.queue.failures(KEY) == failures
    record = next(record for record in caplog.records if str(KEY) in record.getMessage())
    assert record.levelno == level
    assert (record.exc_info is not None) is isinstance(error, ZeroDivisionError)
    if not failures:
        assert f"again in {SLOW_RETRY_SECONDS:.1f} s" in record.getMessage()
    assert op.failed_tasks == []


async def look(op: Operator, key: Key, times: int = 1) -> None:
    for _ in range(times):
        while len(op.cluster.queue):
            op.cluster.queue.done(await op.cluster.queue.get())
        await op.loop.handle(key)


def conditions(api: FakeApi, key: Key) -> dict[str, tuple[str, str, str]]:
    found = api.objects[key]["status"].get("conditions") or ()
    return {item["type"]: (item["status"], item["reason"], item["message"]) for item in found}


@pytest.mark.parametrize(
    ("error", "looks"),
    [(KeyError("lidar"), 5), (ServerFault("500"), 5), (Conflict("newer"), 5), (Invalid("refused"), 1)],
)
async def test_what_keeps_failing_says_so_itself_until_it_goes_on(
    op: Operator, api: FakeApi, toy: Toy, error: Exception, looks: int
) -> None:
    other = {"type": "Accepted", "status": "True", "reason": "Accepted", "message": ""}
    body = thing(version=5) | {"status": {"conditions": [other]}}
    api.have(RUN, body)
    op.cluster.observe(RUN, "ADDED", body)
    toy.act = failing(error)
    await look(op, KEY, looks - 1)
    assert "ReconcileError" not in conditions(api, KEY)
    await look(op, KEY, 3)
    word = type(error).__name__
    assert conditions(api, KEY)["ReconcileError"] == ("True", word, f"{word}: {error}")
    assert api.told == [("demo", "Warning", "ReconcileError", f"{word}: {error}")]
    toy.act = None
    await look(op, KEY)
    assert conditions(api, KEY) == {
        "Accepted": ("True", "Accepted", ""),
        "ReconcileError": ("False", "Recovered", ""),
    }


@pytest.mark.parametrize(("name", "kind"), [("sweep:demo", Kind.SWEEP), ("run:demo", RUN)])
async def test_a_failing_measurement_is_told_at_what_asks_for_it(
    op: Operator, api: FakeApi, toy: Toy, name: str, kind: Kind
) -> None:
    api.have(kind, thing(version=5))
    op.cluster.observe(kind, "ADDED", thing(version=5))
    toy.act = failing(Invalid("refused"))
    await look(op, Key(Kind.EVALUATION, "lab", name))
    assert conditions(api, Key(kind, "lab", "demo"))["EvaluationError"][0] == "True"


async def test_an_object_that_cannot_be_written_is_no_further_failure(
    op: Operator, api: FakeApi, toy: Toy
) -> None:
    api.have(RUN, thing(version=5))
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    toy.act = failing(Invalid("refused"))
    api.errors = [Conflict("newer"), Forbidden("no right")]
    await look(op, KEY)
    assert not conditions(api, KEY)
    assert api.told == [("demo", "Warning", "ReconcileError", "Invalid: refused")]
    await look(op, KEY)
    assert conditions(api, KEY)["ReconcileError"][1] == "Invalid"
    toy.act = None
    api.errors = [ServerFault("down")]
    await look(op, KEY)
    assert op.cluster.queue.delayed == 1
    await look(op, KEY)
    assert conditions(api, KEY)["ReconcileError"][0] == "False"


async def test_a_failure_is_taken_back_though_the_answer_to_its_telling_was_lost(
    op: Operator, api: FakeApi, toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Written by the API server, but neither its answer nor the watch has reached the operator."""
    api.have(RUN, thing(version=5))
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    toy.act = failing(Invalid("refused"))
    patch = api.patch

    async def lose_the_answer(*args: Any, **options: Any) -> dict[str, Any]:
        await patch(*args, **options)
        raise ServerFault("reset")

    monkeypatch.setattr(api, "patch", lose_the_answer)
    await look(op, KEY)
    monkeypatch.undo()
    assert conditions(api, KEY)["ReconcileError"][0] == "True"
    toy.act = None
    api.errors = [ServerFault("down")]
    await look(op, KEY)
    assert op.cluster.queue.delayed == 1, "tried again"
    await look(op, KEY)
    assert conditions(api, KEY)["ReconcileError"][0] == "False"


async def test_the_same_mistake_is_told_once(
    op: Operator, api: FakeApi, toy: Toy, caplog: pytest.LogCaptureFixture
) -> None:
    toy.act = failing(InputError("unknown parameter"))
    api.have(RUN, thing(version=5))
    await op.start()
    for version in (5, 1006, 2007):
        op.cluster.observe(RUN, "MODIFIED", thing(version=version))
        await settle(op)
    assert len(toy.seen) == 3
    assert len([record for record in caplog.records if "unknown parameter" in record.message]) == 1


async def test_a_relist_finds_what_the_watches_missed(op: Operator, api: FakeApi, toy: Toy) -> None:
    api.have(RUN, thing("stays", 5))
    api.have(RUN, thing("goes", 6))
    await op.start()
    await settle(op)
    toy.seen.clear()
    del api.objects[Key(RUN, "lab", "goes")]
    api.have(RUN, thing("comes", 150))
    await op.relist()
    await settle(op)
    assert sorted(toy.seen) == ["MappingRun lab/comes", "MappingRun lab/goes"]


async def test_missing_crds_end_the_start_with_a_sentence(op: Operator, api: FakeApi) -> None:
    api.plurals = frozenset({"algorithms", "datasets", "evaluations", "mappingruns"})
    with pytest.raises(StartError, match=r"does not know sweeps\.slamhive\.io .*helm install slamhive-crds"):
        await op.start()
    assert not op.ready


async def test_a_missing_right_ends_the_start_with_a_sentence(op: Operator, api: FakeApi) -> None:
    api.errors = [Forbidden("cannot list sweeps.slamhive.io lab: no", verb="list", resource="sweeps")]
    with pytest.raises(StartError, match=r"needs the right to list sweeps in each of its namespaces \(lab\)"):
        await op.start()


async def test_a_server_that_is_not_up_yet_is_waited_for(api: FakeApi, toy: Toy) -> None:
    waits: list[float] = []

    async def wait(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) > 2:
            await asyncio.Event().wait()

    op = Operator(Cluster(api, SETTINGS), {RUN: toy}, sleep=wait)  # type: ignore[arg-type]
    api.errors = [ServerFault("refused"), ServerFault("refused")]
    await op.start()
    await op.stop()
    assert op.ready
    assert waits[:2] == [1.0, 2.0]


async def test_sweeps_are_woken_when_live_figures_are_missing(op: Operator, api: FakeApi, toy: Toy) -> None:
    api.have(Kind.SWEEP, thing("s"))
    await op.start()
    async with asyncio.timeout(50):
        while op.cluster.usage.available is None:  # noqa: ASYNC110 - its task takes turns with us
            await asyncio.sleep(0)
    await settle(op)
    assert op.cluster.usage.available is False
    assert "Sweep lab/s" in toy.seen


async def test_what_was_seen_of_a_pod_goes_with_it(op: Operator) -> None:
    forgotten: list[str] = []
    op.cluster.usage.forget = forgotten.append  # type: ignore[method-assign]
    op.cluster.observe(Kind.POD, "ADDED", thing("p", 5, role="run", run="demo"))
    op.cluster.observe(Kind.POD, "DELETED", thing("p", 6))
    assert forgotten == ["uid-p"]


async def test_health_tells_a_dead_part(op: Operator) -> None:
    await op.start()
    assert health.problem(op) == ""
    op._tasks[0].cancel()
    await asyncio.wait(op._tasks[:1])
    assert health.problem(op) == "ended: worker-0"


async def test_a_part_that_breaks_is_noticed(op: Operator, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(key: Key) -> None:
        raise MemoryError

    monkeypatch.setattr(op.loop, "handle", broken)
    op.cluster.observe(RUN, "ADDED", thing(version=5))
    await op.start()
    async with asyncio.timeout(50):
        await op.broken.wait()
    assert op.failed_tasks == ["worker-0"]


async def test_older_crds_are_told_once_in_the_log_and_at_the_operators_pod(
    op: Operator, api: FakeApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: Any
) -> None:
    place = tmp_path / "namespace"
    place.write_text("lab\n")
    monkeypatch.setattr(operator, "NAMESPACE_OF_POD", place)
    monkeypatch.setattr(operator, "gethostname", lambda: "operator-x")
    api.have(Kind.POD, thing("operator-x"))
    caplog.set_level(logging.INFO, "slamhive.operator")
    await op._compare_crds()
    assert caplog.messages.pop() == "all fields and words of this version can't be seen by this account"
    api.known = {str(kind): {} for kind in OUR_KINDS}
    await op.start()
    await op._compare_crds()
    [warning] = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert warning.getMessage().startswith("the CRDs are older than this version and don't know Algorithm.")
    assert api.told == [("operator-x", "Warning", "OldCRDs", warning.getMessage())]
    assert op.ready
