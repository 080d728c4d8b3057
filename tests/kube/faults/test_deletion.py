# SPDX-License-Identifier: Apache-2.0
"""`kubectl delete sweep` at each moment: nothing is left that nobody else needs."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import TYPE_CHECKING

import pytest
from faultlab.arena import AT_ONCE
from faultlab.points import ARCHIVE, Faults, Point, chosen
from faultlab.scenarios import SCENARIOS, Scenario
from testcluster.kwok import Play, Pool
from testcluster.lab import run, sweep

from slamhive.kube.api.kinds import Key, Kind

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from faultlab.arena import Arena, Instance

SECONDS = 120.0
"""A new cluster's garbage collector notices our kinds only after half a minute."""
QUIET_SECONDS = 1.5
KINDS = ("mappingruns", "jobs", "pods")
SWEPT = {
    "ending": Scenario("ending", SCENARIOS["study"].objects, retained=1, archived=3, evaluated=1),
    "running": Scenario("running", (sweep(),), Play(hold=True)),
}


def left(instance: Instance) -> list[str]:
    seen = instance.arena.seen
    return [obj["metadata"]["name"] for kind in KINDS for obj in seen.alive(kind, instance.namespace)]


def sweep_key(instance: Instance) -> Key:
    return Key(Kind.SWEEP, instance.namespace, "study")


def goes_no_further(instance: Instance) -> bool:
    """Tell whether all has ended, or where runs never do, whether as many run as may."""
    jobs = instance.arena.seen.alive("jobs", instance.namespace)
    running = [job for job in jobs if (job.get("status") or {}).get("active")]
    return instance.is_over() if instance.archive else len(running) == 2


async def undisturbed(instance: Instance) -> list[Point]:
    faults = Faults()
    async with instance.operator(faults):
        await instance.until(lambda: goes_no_further(instance), "the end")
    # After a call is before the next one.
    return [point for point in faults.points if point.verb != ARCHIVE and point.moment == "before"]


class Lasting:
    """Tells whether something has held for a while: a call that was on its way may come late."""

    def __init__(self, condition: Callable[[], Any]) -> None:
        self._condition = condition
        self._since = time.monotonic()

    def __call__(self) -> bool:
        if not self._condition():
            self._since = time.monotonic()
        return time.monotonic() - self._since > QUIET_SECONDS


async def deleted_at(point: Point, instance: Instance) -> list[str] | None:
    arena = instance.arena
    faults = Faults(point, lambda: arena.order(arena.admin.delete(sweep_key(instance))))
    async with instance.operator(faults):
        over = Lasting(lambda: goes_no_further(instance))
        await instance.until(lambda: faults.reached or over(), "the moment")
        if not faults.reached:
            return None  # this time there were fewer calls of that sort
        try:
            await instance.until(Lasting(lambda: not left(instance)), "all to go", SECONDS)
        except TimeoutError:
            return left(instance)
    return []


@pytest.mark.parametrize("name", SWEPT)
async def test_nothing_is_left_whenever_a_sweep_is_deleted(
    arena: Arena, name: str, request: pytest.FixtureRequest
) -> None:
    """Before a call of each kind, drawn by the order's seed; before each by `make fuzz-cluster`."""
    every = await arena.play(SWEPT[name], undisturbed)
    points = chosen(every, request.config.option.order_seed)
    room = asyncio.Semaphore(AT_ONCE)
    problems: list[str] = []
    reached = 0

    async def play(point: Point) -> None:
        nonlocal reached
        async with room:
            found = await arena.play(SWEPT[name], partial(deleted_at, point))
        reached += found is not None
        if found:
            problems.append(f"{point}: {found}")

    await asyncio.gather(*(play(point) for point in points))
    print(f"{name}: deleted at {reached} of {len(points)} points, of {len(every)}")  # noqa: T201 - how thorough it was
    assert not problems, "\n".join(problems)
    # Another time there may be fewer calls of a kind, which weighs more where few are drawn.
    assert reached >= (0.8 if points == every else 0.5) * len(points)


async def test_a_preparation_stays_while_someone_needs_it(arena: Arena) -> None:
    scenario = Scenario("shared", (sweep(), sweep("other"), run("alone")))

    def preparations(instance: Instance) -> list[dict[str, Any]]:
        return instance.arena.seen.alive("jobs", instance.namespace)

    def owner_counts(instance: Instance) -> list[int]:
        return [len(job["metadata"]["ownerReferences"]) for job in preparations(instance)]

    async def course(instance: Instance) -> None:
        delete, namespace = instance.arena.admin.delete, instance.namespace
        instance.lab.pool = Pool("nowhere", ())  # where no pod ever runs
        async with instance.operator():
            await instance.until(lambda: owner_counts(instance) == [3], "three owners")
            for kind, name in ((Kind.SWEEP, "study"), (Kind.SWEEP, "other"), (Kind.MAPPING_RUN, "alone")):
                [job] = preparations(instance)
                assert job["metadata"]["uid"] not in instance.arena.seen.gone
                instance.arena.order(delete(Key(kind, namespace, name)))
                owners = len(job["metadata"]["ownerReferences"]) - 1
                wanted = [owners] if owners else []
                await instance.until(
                    lambda n=wanted: owner_counts(instance) == n, f"{owners} owners", SECONDS
                )
            await instance.until(lambda: not left(instance), "all to go", SECONDS)

    await arena.play(scenario, course)
