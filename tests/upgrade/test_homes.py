# SPDX-License-Identifier: Apache-2.0
"""Homes of earlier versions, with a sweep half done: this version opens them and goes on."""

from __future__ import annotations

import json
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from make_home import HELD, HOMES, journal, surroundings, unpack

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

sys.path.append(str(Path(__file__).parents[1] / "faults"))

from forking import Forks

NUMBERS = (0, 1, HELD, 2)
IMPORTED = (
    "make_home:make_environments_equal",
    "slamhive.cli.main",
    "slamhive.cli.running",
    "slamhive.cli.results",
    "slamhive.archive.upgrading",
)


@pytest.fixture
def call(tmp_path: Path) -> Iterator[Callable[..., tuple[int, str, str]]]:
    """Runs a command in a home; returns exit code, standard output and standard error."""
    forks = Forks(IMPORTED, surroundings(tmp_path))

    def called(home: Path, *arguments: str) -> tuple[int, str, str]:
        out, err = tmp_path / "out", tmp_path / "err"
        code = forks.call(
            module="slamhive.cli.main",
            function="main",
            arguments=(),
            words=arguments,
            env=surroundings(home),
            cwd=str(home),
            out=str(out),
            err=str(err),
        )
        assert "Traceback" not in err.read_text()
        return code, out.read_text(), err.read_text()

    yield called
    forks.close()


@pytest.fixture
def rows(call: Callable[..., tuple[int, str, str]]) -> Callable[[Path], dict[str, dict[str, Any]]]:
    """Return a function that lists a home's runs by name."""

    def known(home: Path) -> dict[str, dict[str, Any]]:
        columns = "run,phase,reason,outcome,ate.rmse,started,parameters.number,parameters.act,sweep"
        code, out, err = call(home, "results", "list", "--format", "json", "--columns", columns)
        assert code == 0, err
        return {row["run"]: row for row in json.loads(out)}

    return known


@pytest.fixture(params=sorted(HOMES.glob("*.tar.xz")), ids=lambda path: path.name.removesuffix(".tar.xz"))
def old(request: pytest.FixtureRequest, tmp_path: Path, environments: Path, tiny: Path) -> Path:
    """A home as an earlier version left it."""
    home = tmp_path / "home"
    unpack(request.param, home)
    (home / "environments").symlink_to(environments)
    (home / "datasets").symlink_to(tiny)
    return home


@pytest.mark.slow
def test_a_sweep_that_was_cut_off_goes_on(
    old: Path,
    call: Callable[..., tuple[int, str, str]],
    rows: Callable[[Path], dict[str, dict[str, Any]]],
) -> None:
    begun = journal(old)
    copy = old.with_name("copy")
    shutil.copytree(old, copy, symlinks=True)
    code, _, err = call(copy, "results", "list")
    assert (code, "slamhive archive upgrade" in err) == (2, True)
    assert call(copy, "archive", "upgrade")[0] == 0
    before = rows(copy)
    assert len(before) == 4
    code, _, err = call(old, "run", "sweep.yaml", "--parallelism", "1")
    assert code == 1, err  # for the crashes
    after = rows(old)
    different = {
        (key, one[key], after[name][key])
        for name, one in before.items()
        for key in one
        if one[key] != (pytest.approx(after[name][key], abs=1e-12) if key == "ate.rmse" else after[name][key])
    }
    assert different <= {("evaluationVersion", 1, 2)}, "no more than measured anew as figures are today"
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
