# SPDX-License-Identifier: Apache-2.0
"""API servers, the fake one and a real one: what the operator relies on, in them and in their controllers.

The same assertions run on both, so that tests on the fake are worth something.
"""

from __future__ import annotations

import asyncio
import json
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import pytest
from fakeapi.cluster import FakeCluster
from testcluster.kwok import Kwok, Play
from testcluster.lab import algorithm

from slamhive.kube.api import errors
from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind, Label, key_of, reference
from slamhive.kube.api.transport import Request
from slamhive.kube.served import what_crds_lack
from slamhive.model.base import GROUP, VERSION
from slamhive.model.status import STATUSES

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
    from pathlib import Path

    from testcluster.kwok import Pool

    from slamhive.kube.api.kinds import Object


SPEC = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
DEFAULTS: Object = {
    "budget": {},
    "cachePolicy": "Reuse",
    "evaluation": {
        "alignment": "Auto",
        "association": {"maxDifference": "10ms", "offset": 0},
        "frame": "Estimate",
        "rpe": [{"delta": 1, "pairs": "All", "relTolerance": 0.1, "unit": "m"}],
        "success": {"minCoverage": 0.9},
    },
    "exclude": [],
    "include": [],
    "repetitions": 1,
    "retention": {"files": "Keep", "runs": 1000},
    "search": {
        "aggregate": "Mean",
        "atATime": 4,
        "failing": {"quantile": 0.5},
        "keep": 4,
        "method": "Grid",
        "objectives": [],
        "repetitions": {"first": 1, "promote": 1},
        "seed": 0,
    },
    "suspend": False,
    "weight": 1,
}
SECONDS = 60.0
SWEEP = {"template": {"spec": SPEC}, "matrix": [{"path": "parameters.size", "values": [1, None, {"a": 1}]}]}


@dataclass
class Server:
    """A namespace on an API server."""

    cluster: Any
    namespace: str
    play: Callable[[Play], Pool]
    api: Api

    def run(self, name: str = "one", **metadata: Any) -> Object:
        return {"metadata": {"name": name, "namespace": self.namespace} | metadata, "spec": dict(SPEC)}

    async def make(self, name: str = "one", **metadata: Any) -> Object:
        return await self.api.create(Kind.MAPPING_RUN, self.run(name, **metadata))

    def job(self, name: str = "work", pool: Pool | None = None, **spec: Any) -> Object:
        container = {"name": "algorithm", "image": "algorithm", "resources": {"limits": {"cpu": "2"}}}
        placed = {"nodeSelector": pool.node_selector, "tolerations": pool.tolerations} if pool else {}
        template = {"restartPolicy": "Never", "containers": [container], **placed}
        labels = {Label.ROLE: "run"}
        return {
            "metadata": {"name": name, "namespace": self.namespace},
            "spec": {"backoffLimit": 0, "template": {"metadata": {"labels": labels}, "spec": template}}
            | spec,
        }

    async def pods(self) -> list[Object]:
        return (await self.api.list(Kind.POD, self.namespace))[0]

    async def pod(self, phase: str, *, not_uid: str = "") -> Object:
        """Return the pod that is in a phase, as soon as there is one."""

        async def found() -> Object | None:
            there = await self.pods()
            fitting = [pod for pod in there if pod["status"].get("phase") == phase]
            return next((pod for pod in fitting if pod["metadata"]["uid"] != not_uid), None)

        return await eventually(found)

    async def job_is(self, condition: str, name: str = "work") -> Object:
        """Return a Job as soon as a condition of it holds."""

        async def found() -> Object | None:
            job = await self.api.get(Key(Kind.JOB, self.namespace, name))
            held = job["status"].get("conditions") or ()
            return (
                job if any(item["type"] == condition and item["status"] == "True" for item in held) else None
            )

        return await eventually(found)

    async def gone(self, key: Key) -> bool:
        try:
            await self.api.get(key)
        except errors.NotFound:
            return True
        return False

    @asynccontextmanager
    async def watch(self, version: str, **query: Any) -> AsyncIterator[Callable[[], Awaitable[Object]]]:
        """Watch runs from a version on; gives what returns the next event."""
        asked = {"watch": "true", "resourceVersion": version} | query
        address = (
            f"{self.api._client.configuration.host}{Kind.MAPPING_RUN.path(self.namespace)}?{urlencode(asked)}"
        )
        answer = await self.api._client.rest_client.request("GET", address, _request_timeout=SECONDS)  # type: ignore[no-untyped-call]
        try:

            async def following() -> Object:
                event: Object = json.loads(await answer.response.content.readline())
                return event

            yield following
        finally:
            connection = answer.response.connection
            if connection is not None and connection.transport is not None:
                connection.transport.abort()  # a polite end of TLS would outlast the test
            answer.response.close()


async def eventually(condition: Callable[[], Awaitable[Any]]) -> Any:
    async with asyncio.timeout(SECONDS):
        while not (value := await condition()):  # noqa: ASYNC110 - controllers of a real cluster take their time
            await asyncio.sleep(0.05)
    return value


@pytest.fixture(params=["fake", pytest.param("real", marks=[pytest.mark.cluster, pytest.mark.timeout(900)])])
def place(request: pytest.FixtureRequest) -> tuple[Any, str, Callable[[Play], Pool]]:
    """A cluster, a namespace on it, and nodes to play."""
    found: tuple[Any, str, Callable[[Play], Pool]] = request.getfixturevalue(f"{request.param}_place")
    return found


@pytest.fixture
def fake_place(tmp_path: Path) -> Iterator[tuple[Any, str, Callable[[Play], Pool]]]:
    with ExitStack() as stack:
        cluster = stack.enter_context(FakeCluster(tmp_path))
        cluster.make_namespace("lab")
        yield cluster, "lab", lambda how: stack.enter_context(cluster.play(how, pool="contract"))


@pytest.fixture
def real_place(request: pytest.FixtureRequest) -> Iterator[tuple[Any, str, Callable[[Play], Pool]]]:
    cluster, namespace = request.getfixturevalue("crds"), request.getfixturevalue("namespace")
    cluster.kubectl("label", "ns", namespace, "pod-security.kubernetes.io/enforce-", "--overwrite")
    with ExitStack() as stack:
        yield cluster, namespace, lambda how: stack.enter_context(Kwok(cluster).play(how, pool="contract"))


@pytest.fixture
async def server(place: tuple[Any, str, Callable[[Play], Pool]]) -> AsyncIterator[Server]:
    cluster, namespace, play = place
    api = await Api.connect(cluster.kubeconfig)
    yield Server(cluster, namespace, play, api)
    await api.close()


async def test_what_is_made_has_an_identity_defaults_and_no_status(server: Server) -> None:
    body = server.run()
    body["spec"]["nonsense"] = 1
    made = await server.api.create(Kind.MAPPING_RUN, body | {"status": {"phase": "Running"}})
    assert made["kind"] == "MappingRun"
    assert made["metadata"]["generation"] == 1
    assert made["metadata"]["uid"]
    assert made["metadata"]["resourceVersion"].isdecimal()
    assert made["metadata"]["creationTimestamp"].endswith("Z")
    assert "nonsense" not in made["spec"]
    assert "status" not in made
    assert made == await server.api.get(key_of(Kind.MAPPING_RUN, made))
    with pytest.raises(errors.AlreadyExists, match=r'mappingruns.slamhive.io "one" already exists'):
        await server.make()


async def test_defaults_of_the_schema_are_filled_in(server: Server) -> None:
    metadata = {"name": "study", "namespace": server.namespace}
    spec = (await server.api.create(Kind.SWEEP, {"metadata": metadata, "spec": SWEEP}))["spec"]
    assert spec["matrix"] == SWEEP["matrix"]
    filled = {name: value for name, value in spec.items() if name not in {"matrix", "template"}}
    # As text: whole numbers have no fraction, whatever the CRD writes.
    assert json.dumps(filled, sort_keys=True) == json.dumps(DEFAULTS, sort_keys=True)
    assert spec["template"] == SWEEP["template"] | {"metadata": {"annotations": {}, "labels": {}}}


async def test_a_name_can_be_generated(server: Server) -> None:
    path = Kind.MAPPING_RUN.path(server.namespace)
    body = {"apiVersion": f"{GROUP}/{VERSION}", "kind": "MappingRun", "spec": SPEC}
    body["metadata"] = {"generateName": "run-"}
    made = await server.api.json(Request("create", "runs", "one", "POST", path, body=body))
    assert made["metadata"]["name"].startswith("run-")
    assert len(made["metadata"]["name"]) > len("run-")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"retries": 99},
            "spec.retries: Invalid value: 99: spec.retries in body should be less than or equal",
        ),
        ({"timeout": "soon"}, "spec.timeout: Invalid value: "),
        ({"evaluate": "yes"}, 'spec.evaluate in body must be of type boolean: "string"'),
        ({"algorithmRef": None}, "spec.algorithmRef: Required value"),
        ({"sensors": "Sonar"}, 'spec.sensors: Unsupported value: "Sonar": supported values: '),
        ({"input": {"frameRate": 0}}, "spec.input.frameRate in body should be greater than 0"),
    ],
)
async def test_what_does_not_fit_the_schema_is_refused_by_field(
    server: Server, change: Object, sentence: str
) -> None:
    body = server.run()
    body["spec"] = {key: value for key, value in (SPEC | change).items() if value is not None}
    with pytest.raises(errors.Invalid) as caught:
        await server.api.create(Kind.MAPPING_RUN, body)
    assert sentence in str(caught.value)
    assert "<nil>" not in str(caught.value)


async def test_what_never_changes_is_kept_by_a_rule(server: Server) -> None:
    metadata = {"name": "icp", "namespace": server.namespace}
    made = await server.api.create(Kind.ALGORITHM, algorithm() | {"metadata": metadata})
    key = key_of(Kind.ALGORITHM, made)
    with pytest.raises(errors.Invalid, match=r"cannot change once created"):
        await server.api.patch(key, {"spec": {"version": "2"}})
    await server.api.patch(key, {"status": {"imageID": "a@sha256:1"}}, subresource="status")


async def test_spec_and_status_are_written_apart(server: Server) -> None:
    made = await server.make()
    key = key_of(Kind.MAPPING_RUN, made)
    change = {
        "metadata": {"labels": {"a": "b"}},
        "spec": {"cancel": True},
        "status": {"phase": "Running", "reason": "Pending"},
    }
    changed = await server.api.patch(key, change, subresource="status")
    assert changed["spec"] == made["spec"]
    assert "labels" not in changed["metadata"]
    assert changed["metadata"]["generation"] == 1
    assert int(changed["metadata"]["resourceVersion"]) > int(made["metadata"]["resourceVersion"])
    assert changed["status"]["phase"] == "Running"
    changed = await server.api.patch(key, change | {"status": {"phase": "Failed"}})
    assert changed["status"] == {"phase": "Running", "reason": "Pending"}
    assert changed["spec"]["cancel"] is True
    assert changed["metadata"]["labels"] == {"a": "b"}
    assert changed["metadata"]["generation"] == 2
    changed = await server.api.patch(key, {"metadata": {"labels": {"a": None, "c": "d"}}})
    assert changed["metadata"]["labels"] == {"c": "d"}
    assert changed["metadata"]["generation"] == 2
    changed = await server.api.patch(key, {"status": {"reason": None}}, subresource="status")
    assert changed["status"] == {"phase": "Running"}
    changed = await server.api.patch(key, {"status": None}, subresource="status")
    assert not changed.get("status")


async def test_a_status_is_checked_too(server: Server) -> None:
    key = key_of(Kind.MAPPING_RUN, await server.make())
    with pytest.raises(errors.Invalid, match=r"status.attempts"):
        await server.api.patch(key, {"status": {"attempts": "two"}}, subresource="status")


async def test_what_changes_nothing_is_no_new_version(server: Server) -> None:
    made = await server.make()
    key = key_of(Kind.MAPPING_RUN, made)
    assert await server.api.patch(key, {"spec": dict(SPEC)}) == made


async def test_a_change_that_was_decided_on_an_older_version_is_refused(server: Server) -> None:
    made = await server.make()
    key = key_of(Kind.MAPPING_RUN, made)
    version = made["metadata"]["resourceVersion"]
    checked = {"metadata": {"resourceVersion": version}, "status": {"phase": "Running"}}
    await server.api.patch(key, checked, subresource="status")
    with pytest.raises(errors.Conflict, match=r"the object has been modified"):
        await server.api.patch(key, checked, subresource="status")
    with pytest.raises(errors.Conflict, match=r"the UID in the precondition"):
        await server.api.delete(key, uid="00000000-0000-0000-0000-000000000000")
    with pytest.raises(errors.Conflict, match=r"the ResourceVersion in the precondition"):
        await server.api.delete(key, resource_version=version)
    with pytest.raises(errors.Invalid, match=r"metadata.uid: Invalid value: .* field is immutable"):
        await server.api.patch(key, {"metadata": {"uid": "00000000-0000-0000-0000-000000000000"}})
    assert await server.api.delete(key, uid=made["metadata"]["uid"]) is None
    assert await server.api.delete(key) is None
    with pytest.raises(errors.NotFound, match=r'mappingruns.slamhive.io "one" not found'):
        await server.api.patch(key, {"spec": {"cancel": True}})


async def test_an_object_with_finalizers_ends_when_they_are_gone(server: Server) -> None:
    made = await server.make(finalizers=["slamhive.io/keep"])
    key = key_of(Kind.MAPPING_RUN, made)
    ending = await server.api.delete(key)
    assert ending is not None
    assert ending["metadata"]["deletionTimestamp"].endswith("Z")
    assert ending["metadata"]["generation"] == 2
    again = await server.api.delete(key)
    assert again is not None
    assert again["metadata"]["resourceVersion"] == ending["metadata"]["resourceVersion"]
    await server.api.patch(key, {"status": {"phase": "Failed"}}, subresource="status")
    last = await server.api.patch(key, {"metadata": {"finalizers": None}})
    assert last["metadata"]["deletionTimestamp"] == ending["metadata"]["deletionTimestamp"]
    assert await server.gone(key)


async def test_nothing_is_made_in_a_namespace_that_is_not_there(server: Server) -> None:
    with pytest.raises(errors.NotFound, match=r'namespaces "nowhere" not found'):
        await server.api.create(Kind.MAPPING_RUN, server.run() | {"metadata": {"name": "a"}}, "nowhere")
    places = (server.namespace, "nowhere", server.namespace)
    lists = [await server.api.list(Kind.MAPPING_RUN, place) for place in places]
    assert lists[1][0] == []
    versions = [int(version) for _, version in lists]
    assert versions == sorted(versions)  # others write to the cluster meanwhile


@pytest.mark.parametrize(
    ("labels", "names"),
    [
        ("kind=even", ["run-0", "run-2", "run-4"]),
        ("kind!=even,kind", ["run-1"]),
        ("kind in (odd,even),last", ["run-4"]),
        ("kind notin (even)", ["run-1", "run-3"]),
        ("!kind", ["run-3"]),
        ("last=", ["run-4"]),
    ],
)
async def test_pages_make_one_list_of_what_is_selected(
    server: Server, labels: str, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.kube.api.client.PAGE", 2)
    for number in range(5):
        given = {"kind": "odd" if number % 2 else "even"} if number != 3 else {}
        await server.make(f"run-{number}", labels=given | ({"last": ""} if number == 4 else {}))
    items, version = await server.api.list(Kind.MAPPING_RUN, server.namespace, labels=labels)
    assert [obj["metadata"]["name"] for obj in items] == names
    assert int(version) >= max(int(obj["metadata"]["resourceVersion"]) for obj in items)


async def test_a_list_is_that_of_its_first_page(server: Server) -> None:
    for name in "abc":
        await server.make(name)
    path = Kind.MAPPING_RUN.path(server.namespace)

    async def page(**query: Any) -> Object:
        return await server.api.json(Request("list", "runs", "all", "GET", path, query=query))

    first = await page(limit=2)
    assert first["metadata"]["remainingItemCount"] == 1
    await server.api.delete(Key(Kind.MAPPING_RUN, server.namespace, "c"))
    second = await page(limit=2, **{"continue": first["metadata"]["continue"]})
    assert [item["metadata"]["name"] for item in second["items"]] == ["c"]
    assert second["metadata"]["resourceVersion"] == first["metadata"]["resourceVersion"]
    assert not second["metadata"].get("continue")
    assert [item["metadata"]["name"] for item in (await page())["items"]] == ["a", "b"]


async def test_a_watch_tells_what_happened_since_a_version(server: Server) -> None:
    _, version = await server.api.list(Kind.MAPPING_RUN, server.namespace)
    key = key_of(Kind.MAPPING_RUN, await server.make())
    await server.api.patch(key, {"status": {"phase": "Running"}}, subresource="status")
    async with server.watch(version) as following:
        seen = [await following(), await following()]
        await server.api.delete(key)
        seen.append(await following())
    assert [event["type"] for event in seen] == ["ADDED", "MODIFIED", "DELETED"]
    assert {event["object"]["kind"] for event in seen} == {"MappingRun"}
    versions = [int(event["object"]["metadata"]["resourceVersion"]) for event in seen]
    assert versions == sorted({*versions})
    assert seen[2]["object"]["status"] == {"phase": "Running"}


async def test_a_watch_without_a_version_begins_with_what_is_there(server: Server) -> None:
    await server.make()
    async with server.watch("0") as following:
        event = await following()
    assert (event["type"], event["object"]["metadata"]["name"]) == ("ADDED", "one")


async def test_what_is_selected_no_more_goes_for_those_who_watch(server: Server) -> None:
    _, version = await server.api.list(Kind.MAPPING_RUN, server.namespace)
    await server.make("other")
    key = key_of(Kind.MAPPING_RUN, await server.make(labels={"a": "b"}))
    async with server.watch(version, labelSelector="a=b") as following:
        for value in ("c", "b"):
            await server.api.patch(key, {"metadata": {"labels": {"a": value}}})
        seen = [await following() for _ in range(3)]
    assert [event["type"] for event in seen] == ["ADDED", "DELETED", "ADDED"]
    assert {event["object"]["metadata"]["name"] for event in seen} == {"one"}


async def test_a_watch_from_a_version_that_nobody_knows_any_more_says_so(server: Server) -> None:
    await server.make()
    async with server.watch("1") as following:
        event = await following()
    assert event["type"] == "ERROR"
    assert (event["object"]["code"], event["object"]["reason"]) == (410, "Expired")


async def test_a_watch_ends_with_a_bookmark(server: Server) -> None:
    made = await server.make()
    version = made["metadata"]["resourceVersion"]
    async with server.watch(version, timeoutSeconds="6", allowWatchBookmarks="true") as following:
        # A server that has seen no change since it began to follow a kind sends none.
        await server.api.patch(key_of(Kind.MAPPING_RUN, made), {"metadata": {"labels": {"a": "b"}}})
        changed, event = await following(), await following()
    assert [changed["type"], event["type"]] == ["MODIFIED", "BOOKMARK"]
    assert event["object"]["kind"] == "MappingRun"
    assert int(event["object"]["metadata"]["resourceVersion"]) >= int(version)


async def test_what_nobody_owns_any_more_goes(server: Server) -> None:
    first, second = await server.make("first"), await server.make("second")
    owners = [reference(Kind.MAPPING_RUN, owner) for owner in (first, second)]
    both = key_of(Kind.MAPPING_RUN, await server.make("both", ownerReferences=owners))
    await server.make("child", ownerReferences=owners[:1])
    await server.make("never", ownerReferences=[owners[0] | {"uid": "00000000-0000-0000-0000-000000000000"}])
    await server.api.delete(key_of(Kind.MAPPING_RUN, first))

    async def names() -> set[str]:
        items, _ = await server.api.list(Kind.MAPPING_RUN, server.namespace)
        return {item["metadata"]["name"] for item in items}

    async def settled() -> bool:
        return await names() == {"second", "both"}

    await eventually(settled)

    async def owned_by_one() -> bool:
        return (await server.api.get(both))["metadata"]["ownerReferences"] == owners[1:]

    await eventually(owned_by_one)
    await server.api.delete(key_of(Kind.MAPPING_RUN, second))

    async def empty() -> bool:
        return not await names()

    await eventually(empty)


async def test_an_object_has_one_controller_at_most(server: Server) -> None:
    owner = await server.make()
    twice = [reference(Kind.MAPPING_RUN, owner, controller=True) for _ in range(2)]
    twice[1]["name"], twice[1]["uid"] = "other", "00000000-0000-0000-0000-000000000000"
    with pytest.raises(errors.Invalid, match=r"Only one reference can have Controller set to true"):
        await server.make("child", ownerReferences=twice)


@pytest.mark.parametrize(("exit_code", "condition"), [(0, "Complete"), (3, "Failed")])
async def test_a_job_makes_a_pod_and_ends_with_it(server: Server, exit_code: int, condition: str) -> None:
    pool = server.play(Play(exit_code=exit_code))
    made = await server.api.create(Kind.JOB, server.job(pool=pool))
    assert made["metadata"]["generation"] == 1
    ended = await server.job_is(condition)
    [pod] = await server.pods()
    labels = pod["metadata"]["labels"]
    uid = made["metadata"]["uid"]
    assert labels["batch.kubernetes.io/controller-uid"] == labels["controller-uid"] == uid
    assert labels["batch.kubernetes.io/job-name"] == "work"
    assert labels[Label.ROLE] == "run"
    [owner] = pod["metadata"]["ownerReferences"]
    assert (owner["kind"], owner["uid"], owner["controller"]) == ("Job", uid, True)
    assert pod["metadata"]["name"].startswith("work-")
    assert pod["spec"]["nodeName"] in pool.nodes
    [state] = [item["state"] for item in pod["status"]["containerStatuses"]]
    assert state["terminated"]["exitCode"] == exit_code
    status = ended["status"]
    assert status["succeeded" if exit_code == 0 else "failed"] == 1
    assert not status.get("active")
    assert status["startTime"] >= made["metadata"]["creationTimestamp"]
    reason = next(item["reason"] for item in status["conditions"] if item["type"] == condition)
    assert reason == ("CompletionsReached" if exit_code == 0 else "BackoffLimitExceeded")
    assert await server.api.delete(key_of(Kind.JOB, made)) is None

    async def empty() -> bool:
        return not await server.pods()

    await eventually(empty)


async def test_a_job_replaces_what_a_disruption_took(server: Server) -> None:
    rule = {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]}
    policy = {"podReplacementPolicy": "Failed", "podFailurePolicy": {"rules": [rule]}}
    await server.api.create(Kind.JOB, server.job(pool=server.play(Play(hold=True)), **policy))
    first = await server.pod("Running")
    taken = {"type": "DisruptionTarget", "status": "True", "reason": "PreemptionByScheduler"}
    name = first["metadata"]["name"]
    key = Key(Kind.POD, server.namespace, name)
    conditions = [*first["status"]["conditions"], taken]
    await server.api.patch(
        key, {"status": {"phase": "Failed", "conditions": conditions}}, subresource="status"
    )
    second = await server.pod("Running", not_uid=first["metadata"]["uid"])
    await server.api.delete(Key(Kind.POD, server.namespace, second["metadata"]["name"]))
    third = await server.pod("Running", not_uid=second["metadata"]["uid"])
    job = await server.api.get(Key(Kind.JOB, server.namespace, "work"))
    assert not {"Complete", "Failed"} & {item["type"] for item in job["status"].get("conditions") or ()}
    assert third["metadata"]["uid"] not in {first["metadata"]["uid"], second["metadata"]["uid"]}


async def test_a_suspended_job_has_no_pod(server: Server) -> None:
    await server.api.create(Kind.JOB, server.job(suspend=True))
    job = await server.job_is("Suspended")
    assert not job["status"].get("startTime")
    assert not await server.pods()


async def test_a_job_that_is_suspended_gives_its_pod_away_uncounted_and_gets_another_later(
    server: Server,
) -> None:
    policy = {"podReplacementPolicy": "Failed"}
    await server.api.create(Kind.JOB, server.job(pool=server.play(Play(hold=True)), **policy))
    first = await server.pod("Running")
    key = Key(Kind.JOB, server.namespace, "work")
    await server.api.patch(key, {"spec": {"suspend": True}})
    await server.job_is("Suspended")

    async def none() -> bool:
        return not await server.pods()

    await eventually(none)
    await server.api.patch(key, {"spec": {"suspend": False}})
    await server.pod("Running", not_uid=first["metadata"]["uid"])
    job = await server.api.get(key)
    [told] = job["status"]["conditions"]
    assert (told["type"], told["status"], told["reason"]) == ("Suspended", "False", "JobResumed")
    assert told["lastTransitionTime"] == job["status"]["startTime"]
    assert not job["status"].get("failed")


async def test_a_pod_without_a_node_waits_and_goes_at_once(server: Server) -> None:
    job = server.job()
    job["spec"]["template"]["spec"]["nodeSelector"] = {"nobody": "has-this"}
    await server.api.create(Kind.JOB, job)

    async def waiting() -> Object | None:
        for pod in await server.pods():
            for item in pod["status"].get("conditions") or ():
                if item["type"] == "PodScheduled" and item.get("reason") == "Unschedulable":
                    return pod
        return None

    pod = await eventually(waiting)
    assert pod["status"]["phase"] == "Pending"


async def test_a_refused_pod_is_told_by_an_event(server: Server) -> None:
    limits = {"limits": [{"type": "Container", "max": {"cpu": "1500m"}}]}
    body = {"apiVersion": "v1", "kind": "LimitRange", "metadata": {"name": "small"}, "spec": limits}
    server.cluster.apply(body, namespace=server.namespace)
    made = await server.api.create(Kind.JOB, server.job())

    async def told() -> list[Object]:
        return await server.api.events(server.namespace, "FailedCreate", made["metadata"]["uid"])

    message = (await eventually(told))[-1]["message"]
    assert message.startswith('Error creating: pods "work-')
    assert message.endswith('" is forbidden: maximum cpu usage per Container is 1500m, but limit is 2')
    assert not await server.pods()


async def test_a_used_up_quota_is_known(server: Server) -> None:
    hard = {"hard": {"count/jobs.batch": "0"}}
    body = {"apiVersion": "v1", "kind": "ResourceQuota", "metadata": {"name": "none"}, "spec": hard}
    server.cluster.apply(body, namespace=server.namespace)

    async def refused() -> errors.Forbidden | None:
        try:
            await server.api.create(Kind.JOB, server.job(suspend=True))
        except errors.Forbidden as error:
            return error
        await server.api.delete(Key(Kind.JOB, server.namespace, "work"))
        return None

    error = await eventually(refused)  # a real server counts a moment after the quota was made
    assert error.is_quota
    assert 'jobs.batch "work" is forbidden: exceeded quota: none, requested: count/jobs.batch=1' in str(error)


async def test_events_are_counted_and_found_by_what_they_are_about(server: Server) -> None:
    made, other = await server.make(), await server.make("other")
    for _ in range(3):
        assert await server.api.event(Kind.MAPPING_RUN, made, "Warning", "Unschedulable", "no node has a GPU")
    assert await server.api.event(Kind.MAPPING_RUN, other, "Warning", "Unschedulable", "no node has a GPU")
    [event] = await server.api.events(server.namespace, "Unschedulable", made["metadata"]["uid"])
    assert event["count"] == 3
    assert not await server.api.events(server.namespace, "FailedCreate", made["metadata"]["uid"])


async def test_the_server_says_what_it_serves(server: Server) -> None:
    served = await server.api.served(GROUP, VERSION)
    assert {"algorithms", "datasets", "evaluations", "mappingruns", "sweeps"} <= served
    assert "jobs" in await server.api.served("batch", "v1")
    assert not await server.api.served("nobody.example.test", "v1")
    assert (await server.api.server_version()).startswith("v1.")
    assert await server.api.cluster_uid() == await server.api.cluster_uid() is not None


async def test_the_crds_know_all_of_this_version_and_older_ones_are_noticed(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def told() -> bool:  # a real server publishes them some seconds after it has taken them
        return await what_crds_lack(server.api) == ""

    await eventually(told)
    newer = STATUSES["Sweep"].model_json_schema(by_alias=True)
    newer["properties"]["phase"] = {"enum": ["Resting"]}
    newer["properties"]["later"] = {"type": "object", "properties": {"a": {}, "b": {}}}
    monkeypatch.setattr(STATUSES["Sweep"], "model_json_schema", lambda **_: newer)
    assert (await what_crds_lack(server.api) or "").startswith(
        "the CRDs are older than this version and don't know "
        "Sweep.status.later, Sweep.status.later.a, Sweep.status.later.b and 1 more; bring them"
    )
