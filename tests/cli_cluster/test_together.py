# SPDX-License-Identifier: Apache-2.0
"""Calls made at the same time: whoever gets an error knows that no other call is under way."""

from __future__ import annotations

import asyncio

import pytest

from slamhive.kube.user.together import together


async def test_results_have_the_order_of_the_works() -> None:
    first = asyncio.Event()

    async def late() -> str:
        await first.wait()
        return "late"

    async def early() -> str:
        first.set()
        return "early"

    assert await together([late(), early()]) == ["late", "early"]


async def test_an_error_is_raised_when_all_works_have_ended() -> None:
    ended = []

    async def fails() -> None:
        raise ValueError("forbidden")

    async def goes_on() -> None:
        for _ in range(20):
            await asyncio.sleep(0)
        ended.append("the other")

    with pytest.raises(ValueError, match="forbidden"):
        await together([fails(), goes_on()])
    assert ended == ["the other"]
