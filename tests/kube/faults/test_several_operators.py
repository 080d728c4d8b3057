# SPDX-License-Identifier: Apache-2.0
"""Operators that overlap, that sleep, and that are processes of their own, killed by the kernel."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from faultlab.points import THOROUGH, Faults
from faultlab.proxy import Proxy, Trouble, proxied
from faultlab.scenarios import SCENARIOS, Scenario
from testcluster.kwok import Play
from testcluster.lab import run, sweep

from slamhive.archive import Archive
from slamhive.kube.api.kinds import Key, Kind

if TYPE_CHECKING:
    from faultlab.arena import Arena, Instance, Outcome

    from slamhive.kube.api.kinds import Object

HERE = Path(__file__).parent
EACH = 1 if THOROUGH else 2
"""Of the moments at which something happens, each second one is played; all by `make fuzz-cluster`."""
PATHS = os.pathsep.join(map(str, (HERE, HERE.parents[1] / "cluster")))


@pytest.mark.parametrize("after", [2, 7, 12, 17, 22, 27][::EACH])
async def test_one_begins_before_the_other_is_killed(arena: Arena, after: int) -> None:
    expected = await arena.undisturbed(SCENARIOS["study"])

    async def course(instance: Instance) -> Outcome:
        first = Faults()
        async with instance.operator(first):
            await instance.until(lambda: len(first.points) >= 2 * after or instance.is_over(), "some calls")
            async with instance.operator():
                await instance.until(
                    lambda: len(first.points) >= 2 * after + 10 or instance.is_over(), "some more calls"
                )
                first.dead = True
                await instance.until(instance.is_over, "the end")
        return instance.outcome()

    assert await arena.play(SCENARIOS["study"], course) == expected


@pytest.mark.parametrize("name", ["study", "single", "stopped", "failing", "faulty"])
async def test_two_work_side_by_side(arena: Arena, name: str) -> None:
    expected = await arena.undisturbed(SCENARIOS[name])

    async def course(instance: Instance) -> Outcome:
        async with instance.operator(), instance.operator():
            await instance.until(instance.is_over, "the end")
        return instance.outcome()

    found = await arena.play(SCENARIOS[name], course)
    if name == "stopped":
        # A Job that one operator deletes as the Sweep has stopped leaves its name free: the other one, which
        # hasn't heard of the stop yet, may make it again, and deletes it in its turn.
        expected, found = (replace(one, created=_names(one.created)) for one in (expected, found))
    assert found == expected


def _names(created: Object) -> Object:
    """Return the names of the objects there were, however often."""
    return {kind: sorted(objects) for kind, objects in created.items()}


@pytest.mark.parametrize("after", [None, 5, 15, 25][::EACH])
async def test_namespaces_share_an_archive(arena: Arena, tmp_path: Path, after: int | None) -> None:
    """Sweeps of the same name, points and settings; both operators die after some calls, or none does."""
    expected = await arena.undisturbed(SCENARIOS["study"])

    async def course(instance: Instance) -> Outcome:
        if after is not None:
            first = Faults()
            async with instance.operator(first):
                await instance.until(
                    lambda: len(first.points) >= 2 * after or instance.is_over(), "some calls"
                )
                first.dead = True
        return await instance.finish()

    with Archive.open(f"sqlite:///{tmp_path / 'shared.sqlite'}") as archive:
        both = [arena.play(SCENARIOS["study"], course, archive=archive) for _ in range(2)]
        assert await asyncio.gather(*both) == [expected, expected]
        uids = {record.sweep_uid for record in archive.runs()}
    assert len(uids) == 2


async def test_an_operator_that_slept_while_things_were_deleted(arena: Arena, tmp_path: Path) -> None:
    """Its watches are silent and say nothing of the deletions; its next list does."""
    scenario = Scenario("slept", (sweep(), run("alone"), run("stays")), Play(hold=True))

    async def course(instance: Instance) -> None:
        namespace, admin, seen = instance.namespace, instance.arena.admin, instance.arena.seen

        def running() -> int:
            runs = seen.alive("mappingruns", namespace)
            return sum((body.get("status") or {}).get("phase") == "Running" for body in runs)

        async with instance.operator(relistSeconds=2) as op:
            await instance.until(lambda: running() == 4, "all to run")
            proxies[0].trouble = Trouble(silent_after=0)
            for kind, name in ((Kind.SWEEP, "study"), (Kind.MAPPING_RUN, "alone"), (Kind.JOB, "stays-1")):
                instance.arena.order(admin.delete(Key(kind, namespace, name)))
            await instance.until(
                lambda: (
                    [body["metadata"]["name"] for body in op.cluster.store.of(Kind.MAPPING_RUN, namespace)]
                    == ["stays"]
                ),
                "the deletions to be noticed",
                120,
            )
            status: dict[str, Any] = {}

            def again() -> bool:
                body = seen.named("mappingruns", namespace, "stays") or {}
                status.update(body.get("status") or {})
                return status.get("attempts") == 2

            await instance.until(again, "another attempt of the run whose Job is gone", 120)
            assert not op.cluster.store.of(Kind.SWEEP, namespace)

    proxies: list[Proxy] = []
    async with proxied(arena.admin, Trouble(), tmp_path / "kubeconfig") as proxy:
        proxies.append(proxy)
        await arena.play(scenario, course, kubeconfig=tmp_path / "kubeconfig")


def settings_file(instance: Instance, folder: Path) -> Path:
    url = folder / "url"
    url.write_text(f"sqlite:///{instance.archive.location}" if instance.archive else "")
    settings = instance.settings().as_json() | {"archiveUrlFile": str(url)}
    for part in ("metrics", "health"):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            settings[part] = settings.get(part, {}) | {"port": probe.getsockname()[1]}
    path = folder / "operator.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


@pytest.mark.parametrize("calls", [3, 9, 16, 25][::EACH])
async def test_a_process_killed_by_the_kernel(arena: Arena, tmp_path: Path, calls: int) -> None:
    expected = await arena.undisturbed(SCENARIOS["study"])

    async def course(instance: Instance) -> tuple[int, Outcome]:
        command = [
            *(sys.executable, "-P", "-m", "faultlab.killed_operator"),
            *("--settings", str(settings_file(instance, tmp_path))),
            *("--kubeconfig", str(instance.lab.cluster.kubeconfig)),
        ]
        first = await start(command, calls)
        try:
            await instance.until(lambda: first.poll() is not None, "its death")
        finally:
            first.kill()
        second = await start(command, 0)
        try:
            await instance.until(instance.is_over, "the end")
        finally:
            second.terminate()
            code = await asyncio.to_thread(second.wait, 30)
        assert code == 0
        return first.returncode, instance.outcome()

    async def start(command: list[str], death: int) -> subprocess.Popen[bytes]:
        environment = os.environ | {"SLAMHIVE_TEST_DEATH": str(death), "PYTHONPATH": PATHS}
        return await asyncio.to_thread(subprocess.Popen, command, env=environment)

    code, found = await arena.play(SCENARIOS["study"], course)
    assert code == -signal.SIGKILL
    assert found == expected
