# SPDX-License-Identifier: Apache-2.0
"""slamhive-eval as a user calls it."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import Options, RpeOptions, Trajectory, evaluate, read_tum, write_tum
from slamhive_eval.command import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


Files = tuple[str, str]


@pytest.fixture(name="files")
def files_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> tuple[str, str]:
    truth = wander(300)
    rng = np.random.default_rng(2)
    moved = truth.transformed(np.array(((0.0, -1, 0), (1, 0, 0), (0, 0, 1))), np.array((1.0, 2, 3)), 1.1)
    noise = moved.positions + rng.normal(0, 0.02, (300, 3))
    write_tum(tmp_path / "gt.txt", truth)
    write_tum(tmp_path / "est.txt", Trajectory(truth.stamps + 0.001, noise, moved.quaternions))
    return str(tmp_path / "gt.txt"), str(tmp_path / "est.txt")


@pytest.mark.parametrize("method", ["none", "origin", "se3", "sim3", "scale", "yaw"])
def test_ape(files: Files, capsys: pytest.CaptureFixture[str], method: str) -> None:
    assert main(["ape", *files, "--align", method, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    expected = evaluate(*map(read_tum, files), Options(alignment=method)).as_dict()
    assert {name: found[name] for name in expected["ate"]} == expected["ate"]
    assert found["poses"] == 300
    assert found["alignment"]["transform"] == expected["transform"]
    assert found["alignment"]["method"] == method


def test_rpe(files: Files, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--align", "sim3", "--delta", "1", "--unit", "m", "--all-pairs"]
    assert main(["rpe", *files, *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (expected,) = evaluate(*map(read_tum, files), Options(alignment="sim3")).as_dict()["rpe"]
    assert (found["rmse"], found["pairs"]) == (expected["rmse"], expected["count"])
    assert main(["rpe", *files, *words, "--relation", "angle_deg", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rmse"] == expected["rotationDeg"]["rmse"]


def test_defaults_are_those_of_evo(files: Files, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rpe", *files, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    asked = Options(alignment="none", rpe=(RpeOptions(1, "frames", "consecutive"),))
    assert found["rmse"] == evaluate(*map(read_tum, files), asked).rpe[0].statistics.rmse
    assert (found["relation"], found["pairs"]) == ("trans_part", 299)


def test_tables(files: Files, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ape", *files, "--align", "sim3"]) == 0
    out = capsys.readouterr().out
    assert "trans_part [m], alignment sim3" in out
    assert "scale  0.9" in out
    assert main(["rpe", *files, "--delta", "10.0", "--relation", "rot_part", "--pairs-from-reference"]) == 0
    assert "pairs  29" in capsys.readouterr().out


def test_relations(tmp_path: Path, files: Files, capsys: pytest.CaptureFixture[str]) -> None:
    truth = read_tum(files[0])
    file = tmp_path / "r.relations"
    file.write_text(f"{truth.stamps[0]:.6f} {truth.stamps[50]:.6f} 0 0 0 0 0 0\n1 2 0 0 0 0 0 0\n")
    assert main(["relations", str(file), files[0], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["count"], found["missing"]) == (1, 1)
    assert found["translation"]["mean"] == pytest.approx(
        np.linalg.norm(truth.positions[50] - truth.positions[0])
    )
    assert main(["relations", str(file), files[0], "--interpolate", "0.2"]) == 0
    assert "1 of 2 relations" in capsys.readouterr().out
    file.write_text("1 2 0 0 0 0 0 0\n")
    assert main(["relations", str(file), files[0]]) == 2
    assert "none of the 1 relations, 1.000 s to 2.000 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["ape", "{gt}", "nowhere.txt"], "nowhere.txt: can't be read"),
        (["ape", "{gt}", "{est}", "--offset", "1e6"], "no pose of the estimate"),
        (["ape", "{gt}", "{est}", "--relation", "point_distance_error_ratio"], "relative errors only"),
        (["ape", "{gt}", "{est}", "--n-to-align", "0"], "at least 1, not 0"),
        (["ape", "{gt}", "{est}", "--max-diff", "-1"], "≥ 0 s, not -1"),
        (["ape", "{gt}", "{est}", "--times", "{gt}"], "found 8 of 12 values"),
        (["rpe", "{gt}", "{est}", "--delta", "0.5"], "whole number of frames, not 0.5"),
        (["rpe", "{gt}", "{est}", "--delta", "1e6", "--unit", "m"], "form a pair 1e+06 m apart"),
        (["rpe", "{gt}"], "required: EST"),
        (["ape", "{gt}", "{est}", "--align", "SE3"], "invalid choice: 'SE3'"),
        (["fly"], "invalid choice: 'fly'"),
        ([], "required: COMMAND"),
    ],
)
def test_wrong_input_is_one_sentence(
    files: Files, capsys: pytest.CaptureFixture[str], words: list[str], says: str
) -> None:
    words = [word.format(gt=files[0], est=files[1]) for word in words]
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    assert code == 2
    assert says in err
    assert (out, err.count("\n")) == ("", 1)


def test_as_a_program(files: Files) -> None:
    words = [sys.executable, "-m", "slamhive_eval.command", "ape", *files]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "rmse" in done.stdout
    assert done.stderr == ""
