# SPDX-License-Identifier: Apache-2.0
"""Tests of the command `slamhive algorithm check`: what it prints, its exit codes, what it refuses."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import pytest

from slamhive.cli import checking as cli
from slamhive.cli import main

from .conftest import NAME, behaving

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home


pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def command(
    home: Home,
    workshop_of: Callable[[Home], Workshop],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Callable[..., tuple[int, str, str]]:
    """Runs the command, and returns exit code, output and what it says besides."""
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    monkeypatch.setenv("KUBECONFIG", str(home.path / "none"))
    monkeypatch.setattr(cli, "load_workshop", workshop_of)

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["slamhive", "algorithm", "check", *words])
        code = 0
        try:
            main.main()
        except SystemExit as end:
            code = int(end.code or 0)
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


def test_a_failure_is_exit_code_1_and_rows_are_told_as_json(
    home: Home, command: Callable[..., tuple[int, str, str]]
) -> None:
    behaving(home, {"never"})
    code, out, _ = command(NAME, "--dataset", "tiny", "--format", "json")
    rows = {row["check"]: row for row in json.loads(out)}
    assert code == 1
    assert rows["parameters"]["answer"] == "pass"
    assert rows["runs"] == {
        "executor": "process",
        "mode": "lidar",
        "check": "runs",
        "did": "started once on tiny",
        "found": "1 of 1 failed: AlgorithmFailed: exit code 1: the licence has run out",
        "answer": "fail",
        "help": "end with exit code 0 when the program ran, tracked or not",
    }


def test_a_table_says_what_was_done_what_was_found_and_what_helps(
    home: Home, command: Callable[..., tuple[int, str, str]]
) -> None:
    behaving(home, {"crashes"})
    code, out, _ = command(NAME, "--dataset", "tiny")
    assert code == 1
    text = " ".join(out.split())
    assert "process, lidar" in text
    assert "started on a recording without a message it crashed: ended by signal 11 (SIGSEGV)" in text
    assert "fail process, lidar, no data: end with an exit code other than 0" in text
    assert ", 1 fail" in text


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["behavng"], "unknown algorithm 'behavng'; did you mean 'behaving'?"),
        ([NAME, "--dataset", "tinny"], "unknown dataset 'tinny'; did you mean 'tiny'?"),
        ([NAME, "--timeout", "soon"], "--timeout soon: expected a duration of at least 1s"),
        ([NAME, "--timeout", "0s"], "--timeout 0s: expected a duration of at least 1s"),
        ([NAME, "--on", "process", "--image", "x:1"], "--image: a process has no image"),
        ([NAME, "--on", "moon"], "--on"),
    ],
)
def test_wrong_input_is_exit_code_2_and_a_sentence(
    words: list[str], told: str, home: Home, command: Callable[..., tuple[int, str, str]]
) -> None:
    behaving(home, set())
    code, _, err = command(*words)
    assert code == 2
    assert told in " ".join(err.split())


def test_an_algorithm_that_nothing_here_can_start_is_told_why(
    home: Home, command: Callable[..., tuple[int, str, str]]
) -> None:
    behaving(home, set(), local=None, image="example.org/far:1")
    code, _, err = command(NAME, "--on", "process")
    assert code == 2
    assert "has a container image only" in err
