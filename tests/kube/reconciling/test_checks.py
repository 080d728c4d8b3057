# SPDX-License-Identifier: Apache-2.0
"""Checks of an algorithm on a cluster: what is sent, what comes back, and that nothing of it stays."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import pytest
from testcluster.kwok import run_message
from testcluster.lab import algorithm

from slamhive.conformance import cluster as conformance_cluster
from slamhive.conformance import rows
from slamhive.conformance.cluster import OnCluster
from slamhive.conformance.damaging import Damage
from slamhive.conformance.executors import CheckStart
from slamhive.conformance.workstation import bench_for_checks
from slamhive.kube.user.connecting import connected, find_target
from slamhive.kube.user.run_files import Filed
from slamhive.local.home.catalog import AlgorithmEntry, load_workshop
from slamhive.model.algorithm import Algorithm
from slamhive.model.errors import InputError, SystemFault
from slamhive.model.results import Phase, Reason

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator, Sequence

    from testcluster.lab import Lab

    from slamhive.kube.user.connecting import ConnectedCluster
    from slamhive.kube.user.run_files import Filing, WantedRun
    from slamhive.local.home.folder import Home


@pytest.fixture
def executor(home: Home, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., OnCluster]]:
    """Makes an executor in a lab."""
    monkeypatch.setattr(conformance_cluster, "LOOK_SECONDS", 0.05)
    # A pod that is played sends no files.
    monkeypatch.setattr(conformance_cluster.Filing, "fetch", sent)
    workshop = load_workshop(home)
    item = Algorithm.model_validate(algorithm())
    workshop.algorithm_entries["icp"] = AlgorithmEntry(item, home.path)

    with bench_for_checks(home, workshop) as bench:

        def make(lab: Lab, dataset: str | None = None) -> OnCluster:
            monkeypatch.setenv("KUBECONFIG", str(lab.cluster.kubeconfig))

            @asynccontextmanager
            async def connect() -> AsyncIterator[ConnectedCluster]:
                async with connected(find_target(None, lab.namespace)) as found:
                    yield found

            return OnCluster(bench, "icp", dataset, connect)

        yield make


async def sent(filing: Filing, wanted: Sequence[WantedRun]) -> Filed:
    """Put a trajectory into the folder of each run, as if its files had been sent."""
    for item in wanted:
        folder = filing._folder(item)
        folder.trajectory.parent.mkdir(parents=True)
        folder.trajectory.write_text("1600000000.0 1 2 3 0 0 0 1\n1600000000.1 1 2 4 0 0 0 1\n")
        filing._keep(item, folder)
    return Filed(runs=len(wanted))


def start(executor: OnCluster, number: int = 0, **more: Any) -> CheckStart:
    (mode,) = executor._bench.workshop.algorithm("icp").algorithm.spec.modes
    return CheckStart(mode, timeout=60.0, number=number, **more)


def names(lab: Lab) -> set[str]:
    return {
        item["metadata"]["name"]
        for kind in ("Algorithm", "Dataset", "Sweep", "MappingRun")
        for item in lab.cluster.of(kind, lab.namespace)
    }


async def test_equal_starts_are_runs_of_their_own_and_nothing_stays(
    fake_lab: Lab, executor: Callable[..., OnCluster]
) -> None:
    def check() -> list[Any]:
        with executor(fake_lab) as there:
            assert there.unavailable() is None
            return [there.run(start(there, number)) for number in range(2)]

    before = names(fake_lab)
    async with fake_lab.operator(evaluation={"delaySeconds": 0.1}):
        ended = await asyncio.to_thread(check)
    assert [one.record.phase for one in ended] == [Phase.SUCCEEDED] * 2
    assert len({one.record.uid for one in ended}) == 2
    assert all(one.record.provenance.reused_from is None for one in ended)
    assert names(fake_lab) == before
    assert [len(one.trajectory.stamps) for one in ended] == [2, 2]
    assert "200 MiB" in rows.cost(10.0, ended).found
    assert "equal to the byte" in rows.repeatable("Yes", ended).found


async def test_why_a_run_failed_there_is_told(
    make_fake_lab: Callable[..., Lab], executor: Callable[..., OnCluster]
) -> None:
    lab = make_fake_lab(
        exit_code=3, run=run_message(reason="AlgorithmFailed", message="exit code 3: no map", exit_code=3)
    )

    def check() -> Any:
        with executor(lab) as there:
            return there.run(start(there))

    async with lab.operator():
        ended = await asyncio.to_thread(check)
    assert ended.record.reason is Reason.ALGORITHM_FAILED
    assert "exit code 3: no map" in rows.ran([ended]).found


async def test_what_can_not_be_had_there_is_told_and_nothing_stays(
    fake_lab: Lab, executor: Callable[..., OnCluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conformance_cluster, "_AROUND_SECONDS", -59.9)

    def check() -> None:
        with (
            executor(fake_lab, "far") as there,
            pytest.raises(InputError, match="--dataset far: the cluster"),
        ):
            there.run(start(there))
        with executor(fake_lab) as there, pytest.raises(SystemFault, match="did not finish a run"):
            there.run(start(there))  # no operator is there

    before = names(fake_lab)
    await asyncio.to_thread(check)
    assert names(fake_lab) == before


async def test_where_files_can_not_be_had_figures_are_told_and_poses_are_not(
    fake_lab: Lab, executor: Callable[..., OnCluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def refused(filing: Filing, wanted: Sequence[WantedRun]) -> Filed:
        raise SystemFault("no pod may be made that sends files")

    monkeypatch.setattr(conformance_cluster.Filing, "fetch", refused)

    def check() -> Any:
        with executor(fake_lab) as there:
            return there.run(start(there))

    async with fake_lab.operator(evaluation={"delaySeconds": 0.1}):
        ended = await asyncio.to_thread(check)
    assert ended.record.phase is Phase.SUCCEEDED
    assert (ended.trajectory, ended.absent) == (None, "no pod may be made that sends files")


def test_what_a_cluster_can_not_show_is_said(fake_lab: Lab, executor: Callable[..., OnCluster]) -> None:
    there = executor(fake_lab)
    assert "refuses such a recording" in str(there.objection(start(there, damage=Damage())))
    assert "doesn't tell" in str(there.objection(start(there, stop_after=1.0)))
    assert there.objection(start(there)) is None
