# SPDX-License-Identifier: Apache-2.0
"""What docs/evaluation.md shows works, and its table of degenerate input holds."""

from __future__ import annotations

import gzip
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import Trajectory, write_tum
from slamhive_eval.command import main
from slamhive_eval.subcommands import COMMANDS

if TYPE_CHECKING:
    from collections.abc import Callable

    Change = Callable[[Trajectory], Trajectory]
    Call = Callable[[Change, list[str]], tuple[int, str]]

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
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_commands(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for block in blocks("text") for line in block.splitlines()]
    assert len(lines) == 9
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


@pytest.fixture
def call(
    tmp_path: Path,
    wander: Callable[..., Trajectory],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> Call:
    """Run a command on an estimate made from 50 poses of ground truth."""
    monkeypatch.chdir(tmp_path)

    def run(change: Change, words: list[str]) -> tuple[int, str]:
        truth = wander(50, start=0.0, rate=1.0)
        write_tum("gt.txt", truth)
        write_tum("est.txt", change(truth))
        return main(words), "".join(capsys.readouterr())

    return run


LINE = np.column_stack((np.arange(50.0), np.zeros((50, 2))))
NO_TURN = np.tile((0.0, 0, 0, 1), (50, 1))
STRAIGHT = Trajectory(np.arange(50.0), LINE, NO_TURN)
ALIGN = ["ape", "gt.txt", "est.txt", "--align", "sim3"]


@pytest.mark.parametrize(
    ("change", "words", "code", "says"),
    [
        (lambda _: STRAIGHT, ALIGN, 0, "lie on a line; the orientations determined the rotation"),
        (lambda truth: truth.select(slice(0, 2)), ALIGN, 0, "lie on a line"),
        (lambda truth: truth.select(slice(0, 2)), ["repeated", "gt.txt", "est.txt"], 0, "Lost"),
        (lambda truth: truth.select(slice(0, 1)), ALIGN, 0, "determine a scale"),
        (lambda truth: truth.select(slice(0, 1)), ["rpe", "gt.txt", "est.txt"], 2, "form a pair"),
        (lambda truth: truth.select(slice(0, 1)), ["kitti", "gt.txt", "est.txt"], 0, "0 segments"),
        (lambda truth: truth.select(slice(0, 1)), ["drift", "gt.txt", "est.txt"], 0, "in 0 windows"),
        (lambda truth: truth.transformed(np.eye(3), np.zeros(3), 0.0), ALIGN, 0, "no common motion"),
        (lambda truth: truth.select(np.repeat(np.arange(50), 2)), ALIGN, 0, "rmse"),
        (lambda truth: truth, ["kitti", "gt.txt", "est.txt"], 0, "0 segments"),
    ],
)
def test_degenerate_trajectories(call: Call, change: Change, words: list[str], code: int, says: str) -> None:
    found, printed = call(change, words)
    assert found == code
    assert says in printed


def test_a_cut_file(tmp_path: Path, wander: Callable[..., Trajectory]) -> None:
    write_tum(tmp_path / "gt.txt", wander(50))
    whole = (tmp_path / "gt.txt").read_bytes()
    middle = whole.index(b"\n", 2000) + 30
    for name, data in (("cut.txt", whole[:middle]), ("cut.gz", gzip.compress(whole)[:-100])):
        (tmp_path / name).write_bytes(data)
        assert main(["ape", str(tmp_path / "gt.txt"), str(tmp_path / name)]) == 2
