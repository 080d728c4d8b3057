# SPDX-License-Identifier: Apache-2.0
"""Laying out runs over time and cores, as the wall time of a plan is forecast."""

from __future__ import annotations

import pytest

from slamhive.local.running.forecast import makespan


@pytest.mark.parametrize(
    ("walls", "cores", "slots", "room", "end"),
    [
        ([], [], 1, 2, 0.0),
        ([3, 2, 1], [1, 1, 1], 1, None, 6.0),
        ([3, 2, 1], [1, 1, 1], 2, None, 3.0),
        ([1, 1, 5], [1, 1, 1], 2, None, 6.0),  # the longest comes last
        ([2, 2, 2, 2], [1, 1, 1, 1], 4, 2, 4.0),  # four at a time on two cores
        ([2, 2, 2], [2, 1, 1], 4, 2, 4.0),  # one that needs both, then two beside each other
        ([2, 2], [8, 8], 4, 2, 4.0),  # more than there are: all of them
        ([4, 1, 1, 1], [1, 1, 1, 1], 2, 2, 4.0),
    ],
)
def test_runs_begin_as_soon_as_there_is_room(
    walls: list[float], cores: list[int], slots: int, room: int | None, end: float
) -> None:
    assert makespan(walls, cores, slots, room) == end
