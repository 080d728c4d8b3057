# SPDX-License-Identifier: Apache-2.0
"""etcd out of space: nothing can be written, not even a status. The operator waits and says so in its log."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from faultlab.points import Faults, Point
from faultlab.scenarios import SCENARIOS

from slamhive.kube.api.kinds import Kind

if TYPE_CHECKING:
    import pytest
    from faultlab.arena import Arena, Instance, Outcome
    from testcluster.local import Local

REFUSAL = "database space exceeded"
FIRST_RUN = Point("create", Kind.MAPPING_RUN.resource, 1, "after")


def alarm(local: Local, action: str) -> None:
    """Have etcd refuse all writes but deletions, or no longer, by the alarm that it raises at its quota."""
    local.tell_etcd("maintenance/alarm", [{"memberID": "0", "alarm": "NOSPACE", "action": action}])


async def test_a_full_etcd_is_waited_for_and_nothing_is_lost(
    arena: Arena, local_control_plane: Local, caplog: pytest.LogCaptureFixture
) -> None:
    scenario = SCENARIOS["study"]
    expected = await arena.undisturbed(scenario)
    faults = Faults(FIRST_RUN, lambda: alarm(local_control_plane, "ACTIVATE"))

    def told() -> list[str]:
        return [line for record in caplog.records if REFUSAL in (line := record.getMessage())]

    async def course(instance: Instance) -> Outcome:
        async with instance.operator(faults):
            try:
                await instance.until(
                    lambda: any("study" in line for line in told()), "it to say why it waits"
                )
            finally:
                alarm(local_control_plane, "DEACTIVATE")
            await instance.until(instance.is_over, "the end")
        return instance.outcome()

    with caplog.at_level(logging.WARNING, "slamhive.operator"):
        assert await arena.play(scenario, course) == expected
    assert faults.reached
    assert all(record.exc_info is None for record in caplog.records)
