# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import tracemalloc
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.store import Store, narrow

RUN = Kind.MAPPING_RUN


def run(name: str = "a", version: int = 1, uid: str | None = None, **fields: Any) -> dict[str, Any]:
    metadata = {
        "name": name,
        "namespace": "lab",
        "uid": uid or f"uid-{name}",
        "resourceVersion": str(version),
        "labels": fields.pop("labels", {}),
        "ownerReferences": [{"uid": owner} for owner in fields.pop("owners", ())],
    }
    return {"metadata": metadata, "spec": fields.pop("spec", {}), "status": fields}


def names(objects: list[dict[str, Any]]) -> list[str]:
    return [obj["metadata"]["name"] for obj in objects]


@pytest.fixture
def store() -> Store:
    return Store()


@pytest.mark.parametrize(("version", "news"), [(9, False), (10, False), (11, True)])
def test_an_object_never_goes_back(store: Store, version: int, news: bool) -> None:
    store.put(RUN, run(version=10, phase="Running"))
    assert store.put(RUN, run(version=version, phase="Other")) is news
    stored = store.get(Key(RUN, "lab", "a"))
    assert stored is not None
    assert stored["status"]["phase"] == ("Other" if news else "Running")


def test_versions_are_compared_as_numbers(store: Store) -> None:
    store.put(RUN, run(version=9))
    assert store.put(RUN, run(version=10))


def test_a_late_message_does_not_bring_back_the_deleted(store: Store) -> None:
    store.put(RUN, run(version=5))
    assert store.remove(RUN, "lab", "a", "uid-a")
    assert not store.put(RUN, run(version=7))
    assert store.get(Key(RUN, "lab", "a")) is None
    assert store.put(RUN, run(version=8, uid="another"))


def test_a_deletion_seen_before_the_object_is_remembered(store: Store) -> None:
    assert not store.remove(RUN, "lab", "a", "uid-a")
    assert not store.put(RUN, run(version=3))


def test_a_deletion_of_the_former_leaves_the_later_one(store: Store) -> None:
    store.put(RUN, run(version=8, uid="later"))
    assert not store.remove(RUN, "lab", "a", "former")
    assert len(store.of(RUN, "lab")) == 1


@pytest.mark.parametrize("versions", [(2, 101, 1), (101, 2, 3)])
def test_the_former_object_of_a_name_does_not_come_back(store: Store, versions: tuple[int, ...]) -> None:
    for version in versions[:2]:
        store.put(RUN, run(version=version, uid="later" if version > 100 else "former"))
    store.remove(RUN, "lab", "a", "later")
    assert not store.put(RUN, run(version=versions[2], uid="former"))
    assert len(store.of(RUN, "lab")) == 0


def test_objects_are_found_by_label_and_owner(store: Store) -> None:
    store.put(RUN, run("a", labels={Label.SWEEP: "s"}, owners=["o"]))
    store.put(RUN, run("b", labels={Label.SWEEP: "s"}))
    store.put(RUN, run("c", labels={Label.SWEEP: "t", "own": "x"}))
    assert names(store.select(RUN, "lab", Label.SWEEP, "s")) == ["a", "b"]
    assert names(store.select(RUN, "lab", "own", "x")) == ["c"]
    assert store.select(RUN, "other", Label.SWEEP, "s") == []
    assert [(kind, obj["metadata"]["name"]) for kind, obj in store.owned("o")] == [(RUN, "a")]


def test_indexes_follow_changes_and_deletions(store: Store) -> None:
    store.put(RUN, run("a", 1, labels={Label.SWEEP: "s"}, owners=["o"]))
    store.put(RUN, run("a", 2, labels={Label.SWEEP: "t"}, owners=["p"]))
    assert store.select(RUN, "lab", Label.SWEEP, "s") == []
    assert store.owned("o") == []
    store.remove(RUN, "lab", "a")
    assert store.select(RUN, "lab", Label.SWEEP, "t") == []
    assert store.owned("p") == []


def test_runs_are_found_by_what_they_name(store: Store) -> None:
    store.put(RUN, run("a", spec={"datasetRef": {"name": "d"}, "algorithmRef": {"name": "x"}}))
    assert names(store.referring("lab", Kind.DATASET, "d")) == ["a"]
    assert names(store.referring("lab", Kind.ALGORITHM, "x")) == ["a"]
    assert store.referring("lab", Kind.ALGORITHM, "d") == []


def test_a_full_list_adds_changes_and_takes_away(store: Store) -> None:
    for name, version in [("same", 1), ("changed", 2), ("gone", 3), ("younger", 30)]:
        store.put(RUN, run(name, version))
    listed = [run("same", 1), run("changed", 12), run("new", 13)]
    changed = store.sync(RUN, "lab", listed, "20")
    assert {(key.name, there) for key, _, there in changed} == {
        ("changed", True),
        ("new", True),
        ("gone", False),
    }
    assert sorted(names(store.of(RUN, "lab"))) == ["changed", "new", "same", "younger"]


def test_a_list_does_not_bring_back_what_was_deleted_since(store: Store) -> None:
    store.put(RUN, run("a", 5))
    store.remove(RUN, "lab", "a", "uid-a")
    assert store.sync(RUN, "lab", [run("a", 5)], "10") == []


def test_a_list_leaves_other_namespaces_and_kinds_alone(store: Store) -> None:
    store.put(Kind.JOB, run("j"))
    assert store.sync(RUN, "lab", [], "10") == []
    assert len(store.of(Kind.JOB, "lab")) == 1


def test_a_pod_is_narrowed_to_what_matters() -> None:
    pod = {
        "metadata": {"name": "p", "annotations": {"big": "x"}, "managedFields": [1], "labels": {"a": "b"}},
        "spec": {"nodeName": "n", "containers": [{}]},
        "status": {
            "phase": "Running",
            "podIPs": [],
            "containerStatuses": [{"name": "algorithm", "state": {}, "volumeMounts": []}],
        },
    }
    assert narrow(Kind.POD, pod) == {
        "metadata": {"name": "p", "labels": {"a": "b"}},
        "spec": {"nodeName": "n"},
        "status": {"phase": "Running", "containerStatuses": [{"name": "algorithm", "state": {}}]},
    }


def test_a_job_loses_its_template_and_a_sweep_nothing_but_bookkeeping() -> None:
    applied = {"kubectl.kubernetes.io/last-applied-configuration": "{}", "own": "kept"}
    obj = {"metadata": {"name": "x", "annotations": applied}, "spec": {"template": 1, "suspend": True}}
    assert narrow(Kind.JOB, obj)["spec"] == {"suspend": True}
    assert narrow(Kind.SWEEP, obj) == {
        "metadata": {"name": "x", "annotations": {"own": "kept"}},
        "spec": {"template": 1, "suspend": True},
        "status": {},
    }


MESSAGES = st.lists(
    st.tuples(st.sampled_from(["a", "b"]), st.integers(0, 2), st.integers(1, 12), st.booleans()), max_size=25
)


@given(MESSAGES)
@example([("a", 0, 2, False), ("a", 1, 1, False), ("a", 1, 1, True), ("a", 0, 1, False)])
def test_any_order_of_messages_ends_with_the_newest(messages: list[tuple[str, int, int, bool]]) -> None:
    store = Store()
    deleted: set[str] = set()
    for name, life, step, is_deletion in messages:
        uid = f"{name}{life}"
        if is_deletion:
            deleted.add(uid)
            store.remove(RUN, "lab", name, uid)
        else:
            store.put(RUN, run(name, 100 * life + step, uid))
    for obj in store.of(RUN, "lab"):
        metadata = obj["metadata"]
        assert metadata["uid"] not in deleted
        seen = [
            100 * life + step
            for name, life, step, is_deletion in messages
            if name == metadata["name"] and not is_deletion and f"{name}{life}" == metadata["uid"]
        ]
        assert int(metadata["resourceVersion"]) == max(seen)


def test_thousands_of_finished_runs_are_cheap() -> None:
    def finished(number: int) -> dict[str, Any]:
        error = {word: number * 0.1 + len(word) for word in ("rmse", "mean", "median", "std", "min", "max")}
        return run(
            f"run-{number}",
            labels={Label.SWEEP: "big", Label.POINT: str(number)},
            spec={"parameters": {f"p{index}": index * 0.5 for index in range(8)}, "timeout": "1h"},
            phase="Succeeded",
            conditions=[{"type": word, "status": "True", "reason": "Done"} for word in ("A", "B", "C")],
            results=[{"evaluation": "default", "outcome": "Tracked", "ate": error, "rpe": [dict(error)]}],
            provenance={"contentHash": f"{number:064d}", "specHash": f"{number:064d}"},
        )

    tracemalloc.start()
    try:
        store = Store()
        for number in range(1000):
            store.put(RUN, finished(number))
        each = tracemalloc.get_traced_memory()[0] / 1000
    finally:
        tracemalloc.stop()
    assert each < 12 * 1024


def test_words_of_what_has_gone_take_no_room() -> None:
    """On Python 3.12, too, which keeps all that it was asked to share."""
    tracemalloc.start()
    try:
        for number in range(20_000):
            own = {"start": f"{number} s", "end": f"{number} e", "node": f"n-{number}"}
            narrow(RUN, run(f"run-{number}", number, **own))
        left = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert left < 6 * 2**20
