# SPDX-License-Identifier: Apache-2.0
"""Sweeps that share a cluster: by weight, within the room that is felt, quotas and budgets; what they say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from testcluster.kwok import Play, moment_of
from testcluster.lab import algorithm, condition_of, dataset, manifest, sweep, until

from slamhive.archive import Archive
from slamhive.kube.api.kinds import Key, Kind, Label
from slamhive.kube.pods import live_pods
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from testcluster.lab import Lab

    from slamhive.kube.operator import Operator

BOTH = ("lab", "other")


def shared(make_lab: Callable[..., Lab], **play: Any) -> Lab:
    """Return a lab with a second namespace, which has the same catalog."""
    lab = make_lab(**play)
    lab.cluster.make_namespace("other")
    lab.cluster.apply(algorithm(), dataset(), namespace="other")
    return lab


def status_in(op: Operator, namespace: str, name: str = "study") -> dict[str, Any]:
    body = op.cluster.store.get(Key(Kind.SWEEP, namespace, name))
    return (body or {}).get("status") or {}


def in_flight(op: Operator, namespace: str, name: str = "study") -> int:
    runs = op.cluster.store.select(Kind.MAPPING_RUN, namespace, Label.SWEEP, name)
    return sum(run["status"].get("phase") not in {"Succeeded", "Failed", "Cancelled"} for run in runs)


def pods_of(op: Operator, namespace: str, name: str = "study") -> list[dict[str, Any]]:
    return [*live_pods(op.cluster.store.select(Kind.POD, namespace, Label.SWEEP, name))]  # type: ignore[list-item]


async def end_some(lab: Lab, op: Operator, namespace: str, name: str = "study", count: int = 1) -> None:
    """Have some runs of a Sweep end well."""

    def running() -> list[str]:
        pods = pods_of(op, namespace, name)
        names = [pod["metadata"]["name"] for pod in pods if pod["status"]["phase"] == "Running"]
        return names[:count] if len(names) >= count else []

    names = {*await until(running, "pods to run")}
    for pod in names:
        lab.cluster.end_pod(pod, namespace, moment_of(Play(), "run"))  # type: ignore[union-attr]
    await until(
        lambda: names.isdisjoint(pod["metadata"]["name"] for pod in pods_of(op, namespace, name)),
        "their ends",
    )


async def test_namespaces_share_slots_by_weight(make_fake_lab: Callable[..., Lab]) -> None:
    lab = shared(make_fake_lab, hold=True)
    sharing = {"slots": 8, "namespaces": {"lab": {"weight": 3}}}
    async with lab.operator(namespaces=BOTH, sharing=sharing) as op:
        lab.cluster.apply(
            *(sweep(sizes=40, parallelism=20, suspend=True), sweep("late", sizes=40, suspend=True)),
            namespace="lab",
        )
        lab.cluster.apply(sweep(sizes=40, parallelism=20, suspend=True), namespace="other")
        await until(lambda: all(status_in(op, space).get("phase") for space in BOTH), "all to be known")
        for space in BOTH:
            lab.cluster.patch("sweep", "study", {"spec": {"suspend": False}}, space)
        await until(lambda: sum(in_flight(op, space) for space in BOTH) == 8, "all slots to be taken")
        # Whoever came first may have taken more: each end brings it nearer to 6 and 2.
        for _ in range(20):
            if in_flight(op, "lab") == 6:
                break
            ahead = "lab" if in_flight(op, "lab") > 6 else "other"
            before = in_flight(op, ahead)
            await end_some(lab, op, ahead)
            await until(lambda a=ahead, b=before: in_flight(op, a) < b, "its end to be seen")
            await until(lambda: sum(in_flight(op, space) for space in BOTH) == 8, "the slot to be taken")
        assert [in_flight(op, space) for space in BOTH] == [6, 2]
        status = await until(
            lambda: (found := status_in(op, "other")).get("share", {}).get("fair") == 2 and found, "its share"
        )
        share = status["share"]
        assert (share["of"], share["sweeps"], share["namespaces"]) == (8, 2, 2)
        assert share["limit"] == (
            "sharing.slots of the chart (8), shared with one other Sweep (1 other namespace)"
        )
        assert "a larger spec.weight (now 1)" in share["sooner"]
        # A Sweep that is gone leaves its slots to the other.
        lab.delete("sweep", "study")
        await until(lambda: in_flight(op, "other") == 8, "the other one to have all")


async def test_an_edit_of_the_weight_takes_effect(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(hold=True)
    async with lab.operator(sharing={"slots": 4}) as op:
        lab.apply(sweep("first", sizes=30, parallelism=10))
        await until(lambda: in_flight(op, "lab", "first") == 4, "the first to have all")
        lab.apply(sweep("second", sizes=30, parallelism=10, weight=1000, cachePolicy="Rerun"))
        waiting = await until(
            lambda: (found := status_in(op, "lab", "second").get("share")) and found.get("place") and found,
            "it to be in the line",
        )
        assert waiting["place"] == 1
        assert "or the end of" not in waiting["sooner"]  # nothing is known of how long the first one takes
        assert "spec.weight" not in waiting["sooner"]  # a larger one than 1000 is refused
        await end_some(lab, op, "lab", "first", 3)
        await until(lambda: in_flight(op, "lab", "second") == 3, "it to get what becomes free")
        lab.patch("sweep", "second", {"spec": {"weight": 1}})
        lab.patch("sweep", "first", {"spec": {"weight": 3}})
        await until(
            lambda: (
                status_in(op, "lab", "second")["share"].get("fair") == 1
                and status_in(op, "lab", "first")["share"].get("fair") == 3
            ),
            "new shares",
        )
        await end_some(lab, op, "lab", "second", 2)
        await until(
            lambda: (in_flight(op, "lab", "first"), in_flight(op, "lab", "second")) == (3, 1), "these shares"
        )
        # What a Sweep has before it is not foreseen while it is suspended, though its runs are in flight.
        lab.patch("sweep", "first", {"spec": {"suspend": True}})
        await until(
            lambda: status_in(op, "lab", "first")["share"]["forecast"] == "none: nothing starts now",
            "it to say so",
        )


@pytest.mark.parametrize("waiting", [1, 3])
async def test_a_full_cluster_is_felt_and_few_pods_wait(
    waiting: int, make_fake_lab: Callable[..., Lab]
) -> None:
    lab = make_fake_lab(hold=True)
    lab.cluster.patch("node", "played-0", {"status": {"allocatable": {"pods": "12"}}}, "", "status")
    async with lab.operator(sharing={"waitingPods": waiting}) as op:
        lab.apply(sweep(sizes=90, parallelism=64))

        def found() -> bool:
            waits = [pod for pod in pods_of(op, "lab") if not pod["spec"].get("nodeName")]
            return len(pods_of(op, "lab")) - len(waits) == 12 and bool(waits)

        await until(found, "the node to be full")
        share = await until(
            lambda: (told := status_in(op, "lab").get("share", {})) and "no room" in told["limit"] and told,
            "the Sweep to say so",
        )
        assert in_flight(op, "lab") < 64
        assert "more nodes" in share["sooner"]
        while len(pods_of(op, "lab")) - 12 > waiting:
            await end_some(lab, op, "lab")
            await until(found, "the next one to run")
        # Those that the beginning made are used up: so many wait from then on.
        await until(lambda: 0 <= in_flight(op, "lab") - 12 - waiting <= 1, "few to wait")
        lab.cluster.patch("node", "played-0", {"status": {"allocatable": {"pods": "40"}}}, "", "status")
        await until(
            lambda: sum(bool(pod["spec"].get("nodeName")) for pod in pods_of(op, "lab")) == 40, "more"
        )


@pytest.mark.parametrize("priority", [{}, {"priorityClassName": "urgent"}])
async def test_pods_that_fit_nowhere_keep_no_other_sweep_waiting(
    priority: dict[str, Any], make_fake_lab: Callable[..., Lab]
) -> None:
    lab = make_fake_lab()
    lab.cluster.apply(priority_class("urgent", 1000))
    async with lab.operator(sharing={"readPriorityClasses": True}) as op:
        lab.apply(sweep(sizes=1))  # the recording is prepared
        await until(lambda: status_in(op, "lab").get("phase") == "Complete", "the first to be done")
        lab.cluster.patch("node", "played-0", {"status": {"allocatable": {"pods": "0"}}}, "", "status")
        lab.apply(sweep("stuck", sizes=90, parallelism=4, cachePolicy="Rerun", **priority))
        await until(lambda: len(pods_of(op, "lab", "stuck")) == 4, "its pods")
        await until(
            lambda: ": 4 of its runs" in status_in(op, "lab", "stuck").get("share", {}).get("limit", ""),
            "it to know that they wait",
        )
        for pod in pods_of(op, "lab", "stuck"):
            name = pod["metadata"]["name"]
            lab.cluster.patch("pod", name, {"spec": {"nodeSelector": {"there": "is none"}}}, "lab")
        lab.cluster.patch("node", "played-0", {"status": {"allocatable": {"pods": "90"}}}, "", "status")
        # The scheduler tries pods again after some seconds: that newer ones pass them over counts later.
        op.cluster.clock = _later(op, 60)
        lab.apply(sweep("other", sizes=5, parallelism=30))
        await until(lambda: status_in(op, "lab", "other").get("phase") == "Complete", "the other to be done")
        assert in_flight(op, "lab", "stuck") == 4


async def test_a_quota_of_nothing_is_waited_for_by_its_name(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab()
    lab.apply(manifest("ResourceQuota", "none", hard={"pods": "0"}) | {"apiVersion": "v1"})
    async with lab.operator() as op:
        lab.apply(sweep())
        status = await until(
            lambda: condition_of(found := status_in(op, "lab"), "Blocked").get("status") == "True" and found,
            "it to say so",
        )
        told = condition_of(status, "Blocked")
        assert told["reason"] == "QuotaExceeded"
        assert "quota none (pods: 0 of 0 used)" in told["message"]
        assert in_flight(op, "lab") == 0
        assert "limit" not in status["share"]  # the condition says it
        lab.delete("resourcequota", "none")
        lab.patch("sweep", "study", {"metadata": {"labels": {"look": "again"}}})
        op.cluster.clock = _later(op, 60)
        await until(lambda: status_in(op, "lab").get("phase") == "Complete", "it to go on")


async def test_quotas_that_may_not_be_seen_are_felt(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab()
    hard = {"count/pods": "0"}
    lab.apply(manifest("ResourceQuota", "none", hard=hard) | {"apiVersion": "v1"})
    _refuse(lab, "resourcequotas")
    async with lab.operator() as op:
        lab.apply(sweep(sizes=50, parallelism=40))
        await until(lambda: in_flight(op, "lab") == 8, "a few to be tried")
    assert lab.calls.count(("create", "mappingruns.slamhive.io")) == 8


def _refuse(lab: Lab, resource: str) -> None:
    from fakeapi.refusals import Refusal, forbidden

    def refusing(_verb: str, of: str, _body: dict[str, Any]) -> Refusal | None:
        text = f'User "operator" cannot list resource "{resource}" in API group ""'
        return forbidden(resource, "", text) if of == resource else None

    lab.cluster.refuse(refusing)  # type: ignore[union-attr]


def _later(op: Operator, seconds: float) -> Callable[[], float]:
    clock = op.cluster.clock
    return lambda: clock() + seconds


async def test_a_budget_that_is_used_up_starts_nothing_more(
    make_fake_lab: Callable[..., Lab], tmp_path: Path
) -> None:
    lab = make_fake_lab()
    # Each run takes 8 s of CPU time.
    few = {"namespaces": {"lab": {"cpuHours": 16 / 3600}}}
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        async with lab.operator(archive, sharing=few) as op:
            lab.apply(sweep("before", sizes=2))
            await until(lambda: status_in(op, "lab", "before").get("phase") == "Complete", "the first two")
            lab.delete("sweep", "before")
            await until(lambda: not status_in(op, "lab", "before"), "it to be gone")
        async with lab.operator(archive, sharing=few) as op:  # what was used is known after a restart
            lab.apply(sweep(sizes=3))
            status = await until(
                lambda: (
                    condition_of(found := status_in(op, "lab"), "Blocked").get("status") == "True" and found
                ),
                "it to say so",
            )
            told = condition_of(status, "Blocked")
            assert told["reason"] == "CpuBudgetUsedUp"
            assert "its runs took 0.004444 of 0.004444 CPU hours" in told["message"]
            assert "sharing.namespaces.lab.cpuHours" in told["message"]
            assert in_flight(op, "lab") == 0
        more = {"namespaces": {"lab": {"cpuHours": 1}}}
        async with lab.operator(archive, sharing=more) as op:
            await until(lambda: status_in(op, "lab").get("phase") == "Complete", "it to go on")


async def test_an_end_is_foreseen_by_what_has_ended(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(delay_milliseconds=300)
    async with lab.operator() as op:
        lab.apply(sweep(sizes=400, parallelism=2))
        share = await until(
            lambda: (told := status_in(op, "lab").get("share", {})).get("end") and told, "a forecast"
        )
        assert share["end"].startswith(("within", "in about"))
        assert "of its own that ended" in share["forecast"]
        assert share["limit"] == "its spec.parallelism (2)"


async def test_what_takes_how_long_is_known_from_the_archive(
    make_fake_lab: Callable[..., Lab], tmp_path: Path
) -> None:
    lab = make_fake_lab()
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        async with lab.operator(archive) as op:
            lab.apply(sweep("before", sizes=2))
            await until(lambda: status_in(op, "lab", "before").get("phase") == "Complete", "runs to know of")
            lab.cluster.play_from_now(lab.pool, Play(hold=True))  # type: ignore[union-attr]
            matrix = [{"path": "parameters.size", "range": {"from": 11, "to": 370, "step": 1}}]
            lab.apply(sweep(matrix=matrix, parallelism=1))
            share = await until(
                lambda: (told := status_in(op, "lab").get("share", {})).get("end") and told, "a forecast"
            )
    assert share["end"] == "in about 1 h"  # 360 runs, 10 s each
    assert share["forecast"] == "from 2 runs of the same kinds in the archive, if no other Sweep comes"


async def test_an_operator_that_starts_keeps_to_what_others_hold(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(hold=True)
    sharing = {"slots": 6}
    async with lab.operator(sharing=sharing) as op:
        lab.apply(sweep("first", sizes=30, parallelism=3), sweep("second", sizes=30, parallelism=3))
        await until(
            lambda: (
                status_in(op, "lab", "first").get("running") == 3
                and status_in(op, "lab", "second").get("running") == 3
            ),
            "half each",
        )
    lab.patch("sweep", "first", {"spec": {"parallelism": 20}})
    async with lab.operator(sharing=sharing) as op:
        await until(
            lambda: (
                status_in(op, "lab", "first").get("share", {}).get("limit", "").startswith("sharing.slots")
            ),
            "it to look",
        )
        assert in_flight(op, "lab", "first") == 3
    assert lab.calls.count(("create", "mappingruns.slamhive.io")) == 6


def priority_class(name: str, value: int, **more: Any) -> dict[str, Any]:
    meta = {"metadata": {"name": name}, "value": value}
    return {"apiVersion": "scheduling.k8s.io/v1", "kind": "PriorityClass"} | meta | more


def classes_of(op: Operator, namespace: str) -> list[str]:
    runs = op.cluster.store.select(Kind.MAPPING_RUN, namespace, Label.SWEEP, "study")
    flying = [run for run in runs if run["status"].get("phase") not in {"Succeeded", "Failed", "Cancelled"}]
    return sorted(run["spec"].get("priorityClassName", "") for run in flying)


async def test_sweeps_of_a_higher_priority_class_come_first(make_fake_lab: Callable[..., Lab]) -> None:
    lab = shared(make_fake_lab, hold=True)
    lab.cluster.apply(priority_class("urgent", 1000), priority_class("usual", 10, globalDefault=True))
    sharing = {"slots": 6, "readPriorityClasses": True}
    async with lab.operator(namespaces=BOTH, sharing=sharing) as op:
        lab.apply(sweep(sizes=40, parallelism=20, weight=1000))
        await until(lambda: in_flight(op, "lab") == 6, "the first to have all")
        lab.cluster.apply(
            sweep(sizes=4, parallelism=20, priorityClassName="urgent", cachePolicy="Rerun"),
            namespace="other",
        )
        await until(lambda: status_in(op, "other").get("share", {}).get("place") == 1, "it to be in the line")
        await end_some(lab, op, "lab", count=4)
        # All of the urgent ones, whatever the weights.
        await until(lambda: (in_flight(op, "lab"), in_flight(op, "other")) == (2, 4), "it to have these")
        await until(lambda: classes_of(op, "other") == ["urgent"] * 4, "their class")
        share = await until(
            lambda: (told := status_in(op, "lab")["share"]).get("fair") == 2 and told, "the first to say so"
        )
        assert share["priority"] == "10 (PriorityClass usual, the cluster's default)"
        assert share["limit"].endswith("1 of them come first by a PriorityClass of a higher value")
        assert share["sooner"].startswith("a PriorityClass of a higher value, ")
        assert "spec.weight" not in share["sooner"]
        assert status_in(op, "other")["share"]["priority"] == "1,000 (PriorityClass urgent)"
        # The class may be another one while it runs: its runs from then on have it.
        lab.patch("sweep", "study", {"spec": {"priorityClassName": "urgent"}})
        key = Key(Kind.SWEEP, "lab", "study")
        await until(
            lambda: "priorityClassName" in (op.cluster.store.get(key) or {"spec": ()})["spec"],
            "the operator to hear of it",
        )
        await end_some(lab, op, "lab", count=1)
        await until(lambda: classes_of(op, "lab") == ["", "urgent"], "its next one to have it")


async def test_without_the_right_to_read_classes_weights_alone_decide(
    make_fake_lab: Callable[..., Lab],
) -> None:
    lab = make_fake_lab(hold=True)
    lab.cluster.apply(priority_class("urgent", 1000))
    async with lab.operator(sharing={"slots": 4}) as op:
        lab.apply(sweep("first", sizes=40, parallelism=20, weight=3))
        await until(lambda: in_flight(op, "lab", "first") == 4, "the first to have all")
        lab.apply(sweep("second", sizes=40, parallelism=20, priorityClassName="urgent", cachePolicy="Rerun"))
        share = await until(
            lambda: (told := status_in(op, "lab", "second").get("share", {})).get("fair") and told, "a share"
        )
        assert share["fair"] == 1
        assert share["priority"] == (
            "PriorityClass urgent: not known, so weights alone decide: the operator may not read "
            "PriorityClasses (sharing.readPriorityClasses of the chart)"
        )


@pytest.mark.parametrize("reads", [True, False])
async def test_a_priority_class_that_is_not_there_is_waited_for(
    reads: bool, make_fake_lab: Callable[..., Lab]
) -> None:
    lab = make_fake_lab()
    lab.cluster.apply(priority_class("low", 1))
    # Nobody's runs are given up, however long it takes.
    settings: dict[str, Any] = {
        "sharing": {"slots": 2, "readPriorityClasses": reads},
        "refusalGraceSeconds": 0,
    }
    async with lab.operator(**settings) as op:
        lab.apply(sweep(sizes=6, parallelism=4, priorityClassName="urgent"))
        op.cluster.clock = _later(op, 30)
        status = await until(
            lambda: condition_of(found := status_in(op, "lab"), "Blocked").get("status") == "True" and found,
            "it to say so",
            60,
        )
        told = condition_of(status, "Blocked")
        # Where classes can't be read, one run finds out.
        assert in_flight(op, "lab") == (0 if reads else 1)
        assert told["reason"] == ("PriorityClassNotFound" if reads else "RunsStandStill")
        seen, refused = "there is no PriorityClass 'urgent'", "no PriorityClass with name urgent was found"
        assert (seen if reads else refused) in told["message"]
        # Its run without a pod holds no slot that others could have.
        lab.apply(sweep("other", sizes=3, parallelism=2, cachePolicy="Rerun"))
        await until(lambda: status_in(op, "lab", "other").get("phase") == "Complete", "the other to be done")
        lab.cluster.apply(priority_class("urgent", 1000))
        lab.patch("sweep", "study", {"metadata": {"labels": {"look": "again"}}})
        op.cluster.clock = _later(op, 60)
        await until(lambda: status_in(op, "lab").get("phase") == "Complete", "it to go on")
        assert status_in(op, "lab")["succeeded"] == 6
        runs = op.cluster.store.select(Kind.MAPPING_RUN, "lab", Label.SWEEP, "study")
        assert {run["spec"]["priorityClassName"] for run in runs} == {"urgent"}


async def test_a_class_that_is_there_holds_nothing_back(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(hold=True)
    lab.cluster.apply(priority_class("urgent", 1000))
    async with lab.operator() as op:  # which may not read classes
        lab.apply(sweep(sizes=6, parallelism=4, priorityClassName="urgent"))
        await until(lambda: in_flight(op, "lab") == 4, "all to start that may", 30)


async def test_a_class_that_was_misspelt_may_be_mended(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab()
    lab.cluster.apply(priority_class("urgent", 1000))
    async with lab.operator() as op:
        lab.apply(sweep(sizes=6, parallelism=4, priorityClassName="urgnt"))
        op.cluster.clock = _later(op, 30)
        await until(
            lambda: condition_of(status_in(op, "lab"), "Blocked").get("status") == "True", "it to say so"
        )
        lab.patch("sweep", "study", {"spec": {"priorityClassName": "urgent"}})
        # Its run that found out about the class waits for it no longer.
        await until(lambda: status_in(op, "lab").get("phase") == "Complete", "all to be done")
    status = status_in(op, "lab")
    assert (status["succeeded"], status.get("deleted")) == (6, None)
    [event] = [one for one in lab.cluster.of("event", "lab") if one["reason"] == "RunsMadeAnew"]  # type: ignore[union-attr]
    told = "made anew with PriorityClass urgent: 1 run that had no pod for want of urgnt"
    assert event["message"] == told


async def test_a_sweep_that_a_new_operator_refuses_keeps_no_slots(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(hold=True)
    lab.apply(sweep("first", sizes=9, template={"algorithmRef": {"name": "gone"}}))
    # As an operator left it that saw runs at work, before they and their Algorithm went.
    lab.patch("sweep", "first", {"status": {"running": 3, "pending": 6}}, subresource="status")
    async with lab.operator(sharing={"slots": 3}) as op:
        lab.apply(sweep("second", sizes=9, parallelism=9))
        await until(lambda: in_flight(op, "lab", "second") == 3, "the other one to have all")


async def test_two_sweeps_of_80000_write_for_their_slots_alone(make_fake_lab: Callable[..., Lab]) -> None:
    lab = make_fake_lab(hold=True)
    matrix = [{"path": "parameters.size", "range": {"from": 1, "to": 80_000, "step": 1}}]
    async with lab.operator(maxRunsWithoutArchive=80_000, sharing={"slots": 6}) as op:
        lab.apply(*(sweep(name, matrix=matrix, parallelism=64) for name in ("one", "other")))
        for name in ("one", "other"):
            await until(lambda name=name: status_in(op, "lab", name).get("share"), "both to be told")
        await until(
            lambda: len(pods_of(op, "lab", "one")) + len(pods_of(op, "lab", "other")) == 6, "all slots"
        )
    assert lab.calls.count(("create", "mappingruns.slamhive.io")) == 6
    assert lab.calls.count(("patch", "sweeps.slamhive.io/status")) <= 10


@pytest.mark.parametrize(
    ("sharing", "told"),
    [
        ({"namespaces": {"nowhere": {"weight": 2}}}, "'nowhere' is none of this operator's namespaces"),
        ({"namespaces": {"lab": {"weight": 0}}}, "greater than or equal to 1"),
        ({"namespaces": {"lab": {"weight": 1_000_000}}}, "less than or equal to 1000"),
        ({"namespaces": {"lab": {"cpuHours": -1}}}, "greater than or equal to 0"),
        ({"slots": 0}, "greater than or equal to 1"),
    ],
)
def test_settings_that_make_no_sense_are_refused(
    sharing: dict[str, Any], told: str, fake_lab: Lab, tmp_path: Path
) -> None:
    import yaml

    from slamhive.kube.settings import load

    path = tmp_path / "operator.yaml"
    content = fake_lab.settings().as_json() | {"sharing": sharing}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(InputError, match=told) as error:
        load(path)
    assert "sharing" in str(error.value)
