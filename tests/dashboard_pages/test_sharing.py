# SPDX-License-Identifier: Apache-2.0
"""Work that a site's building shares with processes beside it is all done, whatever becomes of these."""

from __future__ import annotations

import fcntl
import os
from functools import partial
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("fastapi")

from slamhive.dashboard.publishing import sharing
from slamhive.dashboard.publishing.sharing import shared

if TYPE_CHECKING:
    from collections.abc import Callable


def test_each_work_is_done_in_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2})
    begun: list[int] = []
    found, beside = shared([partial(int, number) for number in range(200)], lambda: begun.append(1))
    assert found == list(range(200))
    assert begun == [1]
    assert set(beside) <= set(range(200))


def test_a_short_pipe_keeps_nobody_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    def short(flags: int, pipe: Callable[[int], tuple[int, int]] = os.pipe2) -> tuple[int, int]:
        ends = pipe(flags)
        fcntl.fcntl(ends[1], fcntl.F_SETPIPE_SZ, 4096)
        return ends

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(os, "pipe2", short)
    found, _ = shared([partial(int, number) for number in range(1500)], lambda: None)
    assert found == list(range(1500))


def test_what_a_process_took_that_ended_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    here = os.getpid()

    def work(number: int) -> int:
        if os.getpid() != here:
            os._exit(1)
        return number

    def until_it_ended() -> None:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT)

    found, beside = shared([partial(work, number) for number in range(sharing.LEAST)], until_it_ended)
    assert found == list(range(sharing.LEAST))
    assert beside == []
