# SPDX-License-Identifier: Apache-2.0
"""Search for why Jobs have no pods: one listing of Events for all, at most its share of the time."""

from __future__ import annotations

import asyncio
from typing import Any

from slamhive.kube.refused_pods import BETWEEN_SECONDS, SHARE, RefusedPods


class Server:
    """An API whose Events take some time to be listed, and the two clocks that see it."""

    def __init__(self, takes: float = 0.0) -> None:
        self.takes = takes
        self.now = 1000.0
        self.listed = 0
        self.told: dict[str, str] = {}

    async def events(self, _namespace: str, reason: str) -> list[dict[str, Any]]:
        assert reason == "FailedCreate"
        self.listed += 1
        self.now += self.takes
        await asyncio.sleep(0)
        return [{"involvedObject": {"uid": uid}, "message": text} for uid, text in self.told.items()]


def asking(server: Server) -> RefusedPods:
    return RefusedPods(server, lambda: server.now, lambda: server.now)  # type: ignore[arg-type]


async def test_one_listing_answers_for_all_jobs_that_ask_at_the_same_time() -> None:
    server = Server()
    server.told = {"job-3": 'Error creating: pods "x" is forbidden'}
    refused = asking(server)
    told = await asyncio.gather(*(refused.message("lab", f"job-{number}") for number in range(64)))
    assert server.listed == 1
    assert [number for number, text in enumerate(told) if text] == [3]


async def test_a_later_refusal_is_found_by_a_later_listing() -> None:
    server = Server()
    refused = asking(server)
    assert await refused.message("lab", "job") is None
    server.told = {"job": "Error creating: no"}
    server.now += BETWEEN_SECONDS
    assert await refused.message("lab", "job") == "Error creating: no"


async def test_the_longer_a_listing_takes_the_later_comes_the_next() -> None:
    server = Server(takes=4.0)
    refused = asking(server)
    for _ in range(SHARE):
        await refused.message("lab", "job")
        server.now += 4.0
    assert server.listed == 1
    await refused.message("lab", "job")
    assert server.listed == 2


async def test_namespaces_are_asked_for_themselves() -> None:
    server = Server()
    refused = asking(server)
    await refused.message("lab", "job")
    await refused.message("other", "job")
    assert server.listed == 2
