# SPDX-License-Identifier: Apache-2.0
"""etcd out of space: nothing can be written, not even a status. The operator waits and says so in its log."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from faultlab.scenarios import SCENARIOS
from testcluster.local import Local

if TYPE_CHECKING:
    from collections.abc import Iterator

    from faultlab.arena import Arena, Instance, Outcome

REFUSAL = "database space exceeded"


@pytest.fixture
def local(arena: Arena) -> Local:
    """The cluster as one whose etcd can be told something."""
    if arena.cluster.instance is None:
        pytest.skip("only a local cluster's etcd can be told that it is full")
    return Local.named(arena.cluster.instance)


@contextmanager
def full(local: Local) -> Iterator[None]:
    """Have etcd refuse all writes but deletions, by the alarm that it raises itself at its quota."""
    alarm = {"memberID": "0", "alarm": "NOSPACE"}
    local.tell_etcd("maintenance/alarm", [alarm | {"action": "ACTIVATE"}])
    try:
        yield
    finally:
        local.tell_etcd("maintenance/alarm", [alarm | {"action": "DEACTIVATE"}])


async def test_a_full_etcd_is_waited_for_and_nothing_is_lost(
    arena: Arena, local: Local, caplog: pytest.LogCaptureFixture
) -> None:
    scenario = SCENARIOS["study"]
    expected = await arena.undisturbed(scenario)

    async def course(instance: Instance) -> Outcome:
        async with instance.operator():
            seen = instance.arena.seen
            await instance.until(lambda: seen.alive("mappingruns", instance.namespace), "a run")
            with full(local):
                await instance.until(lambda: REFUSAL in caplog.text, "the operator to say why it waits")
            await instance.until(instance.is_over, "the end")
        return instance.outcome()

    with caplog.at_level(logging.WARNING, "slamhive.operator"):
        assert await arena.play(scenario, course) == expected
    told = [record.getMessage() for record in caplog.records if REFUSAL in record.getMessage()]
    assert all(record.exc_info is None for record in caplog.records)
    assert any("study" in line for line in told), told
