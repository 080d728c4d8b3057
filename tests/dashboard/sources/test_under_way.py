# SPDX-License-Identifier: Apache-2.0
"""Runs of a workstation that are at work, on the pages: told by the machine's processes."""

from __future__ import annotations

import platform
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.dashboard.sources import underway
from slamhive.dashboard.sources.archived import Workstation
from slamhive.local.home.underway import runs_under_way

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@contextmanager
def supervised(folder: Path, *, spec: str = "supervisor.json") -> Iterator[None]:
    """Have a process that looks like a supervisor of a run."""
    folder.mkdir(parents=True, exist_ok=True)
    words = ["slamhive.monitor", "--spec", str(folder / spec)]
    code = [sys.executable, "-c", "print(flush=True); input()", *words]
    with subprocess.Popen(code, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()  # before it runs, /proc may have no words of it
        try:
            yield
        finally:
            process.kill()


@pytest.fixture(autouse=True)
def _looks_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(underway, "LOOK_SECONDS", 0.0)


async def test_pages_say_what_is_at_work(open_app: Callable[..., Any], assorted: str, tmp_path: Path) -> None:
    async with open_app(Workstation(assorted, tmp_path)) as client:
        before = await client.get("")
        with supervised(tmp_path / "runs/study/run-a"), supervised(tmp_path / "runs/study/run-b"):
            during = await client.get("")
            sweeps = (await client.get("/sweeps"))["items"]
        after = await client.get("")
    assert [found["counts"]["live"] for found in (before, during, after)] == [0, 2, 0]
    assert len({found["revision"] for found in (before, during, after)}) == 3
    first = sweeps[0]
    assert (first["name"], first["live"], first["phases"]["Running"]) == ("study", True, 2)
    assert first["phases"]["Succeeded"] > 0
    assert [item["live"] for item in sweeps[1:]] == [False] * (len(sweeps) - 1)


async def test_a_sweep_whose_first_run_goes_on_is_there_already(
    open_app: Callable[..., Any], url: str, tmp_path: Path
) -> None:
    async with open_app(Workstation(url, tmp_path)) as client:
        with supervised(tmp_path / "runs/fresh/run-a"):
            (item,) = (await client.get("/sweeps"))["items"]
            found = await client.get("/sweeps/fresh")
    assert (item["name"], item["live"], item["runs"]) == ("fresh", True, 0)
    assert found["live"]


async def test_the_timeline_has_runs_that_go_on(
    open_app: Callable[..., Any], assorted: str, tmp_path: Path
) -> None:
    folder = tmp_path / "runs/study/run-a"
    (folder / "run").mkdir(parents=True)
    (folder / "attempt.json").write_text('{"uid": "new-1", "contentHash": "c"}')
    (folder / "supervisor.json").write_text('{"cpus": [1, 0]}')
    (folder / "process.json").write_text("{}")
    told = "algorithm: icp\nmode: lidar\ndataset: {name: hall}\nparameters: {voxel: 0.5}\n"
    (folder / "run/config.yaml").write_text(told)
    async with open_app(Workstation(assorted, tmp_path)) as client:
        before = await client.get("/analysis/timeline")
        with supervised(folder):
            during = await client.get("/analysis/timeline")
            chosen = await client.get("/analysis/timeline?parameters.voxel=0.5")
            others = await client.get("/analysis/timeline?algorithm=nobody")
        after = await client.get("/analysis/timeline")
    assert [found["live"] for found in (before, during, chosen, others, after)] == [0, 1, 1, 0, 0]
    assert during["runs"] == before["runs"] + 1
    assert chosen["bars"]["uid"] == ["new-1"]
    assert chosen["lanes"] == [f"{platform.node()}, cores 0,1"]
    assert chosen["bars"]["end"][0] >= chosen["bars"]["start"][0] >= chosen["bars"]["begin"][0]


def test_runs_of_other_homes_and_players_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "home")
    with ExitStack() as stack:
        stack.enter_context(supervised(tmp_path / "home/runs/study/run-a"))
        stack.enter_context(supervised(tmp_path / "home/runs/study/run-a/player"))
        stack.enter_context(supervised(tmp_path / "home/check/runs/check/run-a"))
        stack.enter_context(supervised(tmp_path / "other/runs/study/run-b"))
        assert runs_under_way(tmp_path / "home/runs") == {("study", "run-a")}
        assert runs_under_way(tmp_path / "link/runs") == {("study", "run-a")}
    assert runs_under_way(tmp_path / "home/runs") == set()


def test_processes_that_end_meanwhile_are_no_trouble(tmp_path: Path) -> None:
    proc = tmp_path / "proc"
    for number, words in (
        ("1", b""),
        ("2", b"slamhive.monitor\0--spec"),
        ("3", b"slamhive.monitor\0--spec\0/x\0"),
    ):
        (proc / number).mkdir(parents=True)
        (proc / number / "cmdline").write_bytes(words)
    (proc / "4").mkdir()
    (proc / "self").mkdir()
    assert runs_under_way(tmp_path / "runs", proc) == set()
