# SPDX-License-Identifier: Apache-2.0
"""A database that hangs holds nobody up: its last state is shown, and said to be that."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import anyio

from slamhive.archive import Archive
from slamhive.dashboard.sources import archived as sources
from slamhive.dashboard.sources.archived import Workstation

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest


async def test_a_look_that_hangs_is_not_waited_for(
    assorted: str,
    open_app: Callable[..., Any],
    make_run: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    released, real = threading.Event(), sources.load

    def hang(*given: Any, **named: Any) -> Any:
        released.wait(60)
        return real(*given, **named)

    async with open_app(Workstation(assorted)) as client:
        total = (await client.get("/runs"))["total"]
        first = await client.get("")
        assert first["problems"] == []
        monkeypatch.setattr(sources, "load", hang)
        monkeypatch.setattr(sources, "PATIENCE_SECONDS", 0.05)
        monkeypatch.setattr(sources, "LOOK_SECONDS", 0.0)
        try:
            with Archive.open(assorted) as archive:
                archive.put_run(make_run(500))
            deadline = time.monotonic() + 60
            while not (late := await client.get(""))["problems"]:
                assert time.monotonic() < deadline
                await anyio.sleep(0.05)
            assert late["problems"] == ["the archive does not answer at present: its last state is shown"]
            assert late["revision"] != first["revision"]
            assert (await client.get("/runs"))["total"] == total
        finally:
            released.set()
        monkeypatch.setattr(sources, "PATIENCE_SECONDS", 60)
        while (await client.get("/runs"))["total"] == total:
            assert time.monotonic() < deadline
            await anyio.sleep(0.05)
        assert (await client.get(""))["problems"] == []
