# SPDX-License-Identifier: Apache-2.0
"""Homes of earlier versions, with a sweep half done: this version opens them and goes on."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest
from make_home import HELD, HOMES, PROGRAM, journal, surroundings, unpack

if TYPE_CHECKING:
    from pathlib import Path

NUMBERS = (0, 1, HELD, 2)


def call(home: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, *arguments]
    result = subprocess.run(
        command, env=surroundings(home), cwd=home, capture_output=True, text=True, check=False
    )
    assert "Traceback" not in result.stderr
    return result


def rows(home: Path) -> dict[str, dict[str, Any]]:
    """Return what is known of the runs, by name."""
    columns = "run,phase,reason,outcome,ate.rmse,started,parameters.number,parameters.act,sweep"
    result = call(home, "results", "list", "--format", "json", "--columns", columns)
    assert result.returncode == 0, result.stderr
    return {row["run"]: row for row in json.loads(result.stdout)}


@pytest.fixture(params=sorted(HOMES.glob("*.tar.xz")), ids=lambda path: path.name.removesuffix(".tar.xz"))
def old(request: pytest.FixtureRequest, tmp_path: Path, environments: Path, tiny: Path) -> Path:
    """A home as an earlier version left it."""
    home = tmp_path / "home"
    unpack(request.param, home)
    (home / "environments").symlink_to(environments)
    (home / "datasets").symlink_to(tiny)
    return home


def test_a_sweep_that_was_cut_off_goes_on(old: Path) -> None:
    begun = journal(old)
    copy = old.with_name("copy")
    shutil.copytree(old, copy, symlinks=True)
    refused = call(copy, "results", "list")
    assert (refused.returncode, "slamhive archive upgrade" in refused.stderr) == (2, True)
    assert call(copy, "archive", "upgrade").returncode == 0
    before = rows(copy)
    assert len(before) == 4
    result = call(old, "run", "sweep.yaml", "--parallelism", "1")
    assert result.returncode == 1, result.stderr  # for the crashes
    after = rows(old)
    assert {name: after[name] for name in before} == before
    expected = {
        (number, act): ("Succeeded", None) if act == "noted" else ("Failed", "AlgorithmFailed")
        for number in NUMBERS
        for act in ("noted", "crash")
    }
    assert {
        (row["parameters.number"], row["parameters.act"]): (row["phase"], row["reason"])
        for row in after.values()
    } == expected
    assert len(after) == len(expected)
    assert all(row["ate.rmse"] < 1e-9 for row in after.values() if row["phase"] == "Succeeded")
    assert {row["sweep"] for row in after.values()} == {"halfway"}
    started = Counter(journal(old))
    assert started == Counter(begun) + Counter({begun[-1]: 1, journal(old)[-1]: 1})
    assert sorted(started.values()) == [1, 1, 1, 2]
    call(old, "run", "sweep.yaml")
    assert Counter(journal(old)) == started
    assert rows(old) == after
