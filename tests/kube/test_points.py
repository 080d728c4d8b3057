# SPDX-License-Identifier: Apache-2.0
"""The two bits a point of a Sweep's status."""

from __future__ import annotations

import base64

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.engine import PointState
from slamhive.kube.reconciling.sweep_runs import decode_points, encode_points
from slamhive.model.status import SweepStatus
from slamhive.model.sweep import MAX_POINTS


@given(st.lists(st.sampled_from(list(PointState)), max_size=50))
def test_states_come_back(states: list[PointState]) -> None:
    assert decode_points(encode_points(bytes(states)), len(states)) == bytes(states)


def test_the_first_point_has_the_lowest_bits() -> None:
    assert base64.b64decode(encode_points(bytes([3, 0, 0, 0, 1]))) == bytes([0b11, 0b01])


@pytest.mark.parametrize("text", [None, "", "no base64!"])
def test_what_is_not_said_is_pending(text: str | None) -> None:
    assert decode_points(text, 3) == bytes(3)


def test_the_largest_sweep_fits_its_field() -> None:
    assert SweepStatus(points=encode_points(bytes(MAX_POINTS))).points
