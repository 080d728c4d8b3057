# SPDX-License-Identifier: Apache-2.0
"""Calls made at the same time, none of which outlives the others."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Awaitable, Iterable

T = TypeVar("T")


async def together(works: Iterable[Awaitable[T]]) -> list[T]:
    """Return the results of several works, in their order, when all of them have ended.

    ``asyncio.gather`` raises the first error at once, and the other works go on while whoever asked for them
    closes the connection that they use.

    Raises:
        BaseException: the error of the first work, in their order, that raised one.
    """
    ended = await asyncio.gather(*works, return_exceptions=True)
    results: list[T] = []
    for one in ended:
        if isinstance(one, BaseException):
            raise one
        results.append(one)
    return results
