# SPDX-License-Identifier: Apache-2.0
"""``slamhive results suspects`` on the runs of the original paper: with its truth, and with a wrong one."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from slamhive.cli import results
from slamhive_eval import Trajectory, read_tum, write_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_a_truth_that_is_wrong_for_a_while_is_suspected(
    paper_home: Callable[..., Path], tmp_path: Path
) -> None:
    home = tmp_path / "home"
    shutil.copytree(paper_home("sim3", "se3"), home)

    def call(*words: str) -> str:
        environment = {"SLAMHIVE_HOME": str(home), "SLAMHIVE_ARCHIVE": ""}
        outcome = CliRunner().invoke(results.app, words, env=environment)
        assert outcome.exit_code == 0, outcome.output
        return outcome.stdout

    one = ("suspects", "--where", "dataset == 'mh-01-easy'", "--json")
    [clean] = json.loads(call(*one))
    assert clean["found"]["systems"] == ["orb-slam2", "orb-slam3", "vins-fusion", "vins-mono"]
    assert clean["found"]["stretches"] == []

    path = home / "groundtruth" / "mh-01-easy.txt"
    truth = read_tum(path)
    inside = (truth.stamps > truth.stamps[0] + 60) & (truth.stamps < truth.stamps[0] + 66)
    moved = truth.positions.copy()
    moved[inside, 1] += 0.8
    path.chmod(0o644)
    write_tum(path, Trajectory(truth.stamps, moved, truth.quaternions))
    [found] = json.loads(call(*one))
    [stretch] = found["found"]["stretches"]
    assert stretch["begin"] == pytest.approx(truth.stamps[0] + 60, abs=1)
    assert stretch["end"] == pytest.approx(truth.stamps[0] + 66, abs=1)
    assert stretch["metres"] == pytest.approx(0.8, abs=0.15)
    text = call("suspects")
    assert "mh-01-easy: 1 suspect in" in text
    assert "not compared" in text, "two systems on fr2/desk are too few"
