# SPDX-License-Identifier: Apache-2.0
"""The operator killed at its side effects in turn: what the next one makes of it is the same."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING

import pytest
from faultlab.arena import AT_ONCE
from faultlab.points import Faults, Point, chosen
from faultlab.scenarios import SCENARIOS

if TYPE_CHECKING:
    from faultlab.arena import Arena, Instance, Outcome


async def undisturbed(instance: Instance) -> tuple[Outcome, list[Point]]:
    faults = Faults()
    return await instance.finish(faults), faults.points


async def killed_at(point: Point, instance: Instance) -> tuple[bool, Outcome]:
    faults = Faults(point)
    async with instance.operator(faults):
        await instance.until(lambda: faults.dead or instance.is_over(), "death or the end")
    faults.dead = True
    return faults.reached, await instance.finish()


@pytest.mark.parametrize("name", SCENARIOS)
async def test_killed_at_every_kind_of_side_effect(
    arena: Arena, name: str, request: pytest.FixtureRequest
) -> None:
    """At one of each kind, drawn by the order's seed; at each single one by `make fuzz-cluster`."""
    scenario = SCENARIOS[name]
    expected, every = await arena.play(scenario, undisturbed)
    points = chosen(every, request.config.option.order_seed)
    room = asyncio.Semaphore(AT_ONCE)  # no namespace is made long before it is used
    problems: list[str] = []
    reached = 0

    async def play(point: Point) -> None:
        nonlocal reached
        async with room:
            try:
                was_reached, found = await arena.play(scenario, partial(killed_at, point))
            except TimeoutError as error:
                problems.append(f"{point}: {error}")
                return
        reached += was_reached
        if found != expected:
            problems.append(f"{point}: {found}")

    await asyncio.gather(*(play(point) for point in points))
    print(f"{name}: killed at {reached} of {len(points)} points, of {len(every)}")  # noqa: T201 - how thorough it was
    assert not problems, "\n".join([f"expected {expected}", *problems])
    # Another time there may be fewer calls of a kind, which weighs more where few are drawn.
    assert reached >= (0.8 if points == every else 0.5) * len(points)
