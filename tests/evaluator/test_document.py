# SPDX-License-Identifier: Apache-2.0
"""Tests of docs/evaluation.md: its commands work, and its table of degenerate input holds."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import Trajectory, write_trajectory, write_tum
from slamhive_eval.command import main
from slamhive_eval.subcommands import COMMANDS

if TYPE_CHECKING:
    from collections.abc import Callable

DOCUMENT = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL)


@pytest.fixture
def desk(tmp_path: Path, wander: Callable[..., Trajectory], monkeypatch: pytest.MonkeyPatch) -> Path:
    truth = wander(400, seed=6)
    write_tum(tmp_path / "groundtruth.txt", truth)
    for k, name in enumerate("abc"):
        noise = np.random.default_rng(k).normal(0, 0.01, (400, 3))
        write_tum(
            tmp_path / f"{name}.txt", Trajectory(truth.stamps, truth.positions + noise, truth.quaternions)
        )
    rows = zip(truth.stamps.tolist(), truth.positions.tolist(), truth.quaternions.tolist(), strict=True)
    lines = [",".join(map(str, (int(t), round(t % 1 * 1e9), *p, *q))) for t, p, q in rows]
    (tmp_path / "registered_poses.csv").write_text("\n".join(["#sec,nsec", *lines]))
    points = np.column_stack((truth.stamps, truth.positions))[::40].tolist()
    (tmp_path / "points.txt").write_text("\n".join(" ".join(map(str, row)) for row in points))
    said = [f"{stamp},{k % 7},ok" for k, stamp in enumerate(truth.stamps.tolist())]
    (tmp_path / "health.csv").write_text("\n".join(["stamp,value,flag", *said]))
    np.savetxt(tmp_path / "T_lidar_imu.txt", np.eye(4))
    for folder in ("poses", "estimates"):
        (tmp_path / folder).mkdir()
        write_trajectory(tmp_path / folder / "00.txt", truth, "kitti")
    for folder, source in (("points_2022", "points.txt"), ("estimates_2022", "a.txt")):
        (tmp_path / folder).mkdir()
        shutil.copy(tmp_path / source, tmp_path / folder / "exp07_long_corridor.txt")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_commands(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for block in blocks("text") for line in block.splitlines()]
    assert len(lines) == 16
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "slamhive-eval"
        assert main(words) == 0, line
        assert capsys.readouterr().out
    assert {path.name for path in desk.iterdir()} >= {"results", "table.csv", "table.tex", "report.html"}
    assert len(list((desk / "results").glob("*.zip"))) == 2


def test_python() -> None:
    (code,) = blocks("python")
    exec(compile(code, "evaluation.md", "exec"), {})  # noqa: S102 - it is ours


def test_every_command_is_named() -> None:
    table = DOCUMENT.partition("| command | what |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(\w+)`", table))
    assert named <= set(COMMANDS)
    assert {"ape", "rpe", "kitti", "drift", "repeated", "relations", "map", "report"} <= named
