# SPDX-License-Identifier: Apache-2.0
"""Tests of algorithms that are programs of their own: what starts them, what makes another one of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.home.catalog import AlgorithmEntry
from slamhive.model.algorithm import Algorithm
from slamhive.model.results import Phase, Reason

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.local.home.catalog import Workshop
    from slamhive.model.results import RunRecord

PROGRAM = """#!/bin/sh
[ "$1" = "--poses" ] || { echo "no --poses" >&2; exit 3; }
cp assets/truth.txt output/"$2"
"""


@pytest.fixture
def run_program(workshop: Workshop, run_acts: Callable[..., Any], tmp_path: Path) -> Callable[..., RunRecord]:
    """Runs a shell program as an algorithm, and returns its record."""
    actor = workshop.algorithm("actor")
    folder = tmp_path / "shell"
    folder.mkdir()
    (folder / "truth.txt").write_bytes((actor.folder / "truth.txt").read_bytes())
    body = actor.algorithm.as_json()
    body["metadata"]["name"] = "shell"
    body["spec"] |= {
        "local": {"command": ["odometry.sh", "--poses", "poses.txt"]},
        "output": {"frame": "body", "trajectory": {"path": "poses.txt", "format": "Tum"}},
    }
    workshop.algorithm_entries["shell"] = AlgorithmEntry(Algorithm.model_validate(body), folder)

    def run(text: str = PROGRAM, name: str = "acts", mode: int = 0o755) -> RunRecord:
        path = folder / "odometry.sh"
        path.write_text(text)
        path.chmod(mode)
        _, notes = run_acts(["good"], template={"algorithmRef": {"name": "shell"}}, name=name)
        (record,) = notes.records
        return record  # type: ignore[no-any-return]

    return run


def test_a_program_runs_with_its_arguments_and_its_poses_count(run_program: Callable[..., RunRecord]) -> None:
    record = run_program()
    assert record.phase is Phase.SUCCEEDED, record.message
    assert record.results[0].values["ate"]["rmse"] < 1e-6


def test_another_program_is_another_experiment(run_program: Callable[..., RunRecord]) -> None:
    first, same = run_program(name="first"), run_program(name="same")
    other = run_program(PROGRAM + "# built anew\n", name="other")
    assert same.provenance.reused_from == first.name
    assert other.provenance.reused_from is None


def test_what_is_no_program_is_told(run_program: Callable[..., RunRecord]) -> None:
    record = run_program(mode=0o644)
    assert record.reason is Reason.ALGORITHM_UNAVAILABLE
    assert str(record.message).endswith("odometry.sh is no program: chmod +x makes it one")
