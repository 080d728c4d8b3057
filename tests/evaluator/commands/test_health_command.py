# SPDX-License-Identifier: Apache-2.0
"""``health.csv``, ``covariances.csv`` and what ``slamhive-eval health`` makes of them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import FileError, Trajectory, read_covariances, read_health, write_tum
from slamhive_eval.command import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture(name="run")
def run_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> Path:
    """An estimate that stands still for five seconds, and says so a second before."""
    truth = wander(600, start=0.0)
    steps = np.diff(truth.positions, axis=0, prepend=truth.positions[:1])
    steps[300:350] = 0.0
    noise = np.random.default_rng(1).normal(0, 0.01, (600, 3))
    estimate = Trajectory(truth.stamps, np.cumsum(steps, axis=0) + noise, truth.quaternions)
    write_tum(tmp_path / "gt.txt", truth)
    write_tum(tmp_path / "est.txt", estimate)
    flags = ["lost" if 290 <= k < 350 else "ok" for k in range(600)]
    rows = [f"{stamp},{k % 2},{flags[k]}" for k, stamp in enumerate(truth.stamps.tolist())]
    (tmp_path / "health.csv").write_text("\n".join(["stamp,value,flag", *rows, ""]))
    rows = [f"{stamp},1e-4,1e-4,1e-4" for stamp in truth.stamps.tolist()]
    (tmp_path / "covariances.csv").write_text("\n".join(["stamp,cov_xx,cov_yy,cov_zz", *rows]))
    return tmp_path


@pytest.mark.parametrize("words", [[], ["--health", "{run}/health.csv"]])
def test_files_beside_an_estimate(run: Path, capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    command = ["health", f"{run}/gt.txt", f"{run}/est.txt", *(word.format(run=run) for word in words)]
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (loss,) = found["healthLosses"]
    assert loss["begin"] - loss["lead"] == pytest.approx(29.0)
    assert found["health"]["auc"] == pytest.approx(0.5, abs=0.02)
    assert found["health"]["nees"]["position"]["count"] == 600
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "lost once" in printed
    assert "s before" in printed
    assert "NEES of position" in printed


def test_nothing_is_said(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("health.csv", "covariances.csv"):
        (run / name).unlink()
    assert main(["health", f"{run}/gt.txt", f"{run}/est.txt"]) == 2
    assert "neither health.csv nor covariances.csv beside it" in capsys.readouterr().err
    assert main(["health", f"{run}/gt.txt", f"{run}/est.txt", "--window", "0"]) == 2
    assert "window of a loss must be a positive number, not 0.0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty; its first line names the columns: stamp,value,flag"),
        ("stamp,value,flag\n", "has no row below the names of the columns"),
        (
            "time,value\n1,2\n",
            "line 1: the first line must name the columns, as in stamp,value,flag, not 'time,va",
        ),
        ("stamp,inliers\n1,2\n", "line 1: the first line must be stamp,value,flag, not stamp,inliers"),
        ("stamp,value,flag\n1,2,ok\n2,3\n", "line 3: found 2 of 3 columns: stamp,value,flag"),
        ("stamp,value,flag\n1,nan,ok\n", "line 2: value is 'nan', which is no finite number"),
        (
            "stamp,value,flag\n1,,fine\n",
            "line 2: flag is 'fine'; it must be one of ok, degraded, lost, or empty",
        ),
        ("stamp,value,flag\n2,1,\n1,1,\n", "line 3: stamp 1.000000000 s comes before the one above it, 2.00"),
        ("stamp,value,flag\n1e18,1,\n", "line 2: stamp 1e18 is no number of seconds (nanoseconds perhaps?)"),
    ],
)
def test_confidence_that_is_wrong(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "health.csv").write_text(text)
    with pytest.raises(FileError) as error:
        read_health(tmp_path / "health.csv")
    assert told in str(error.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty; its first line names the columns: stamp,cov_xx,cov_xy"),
        ("stamp,cov_xx,cov_yy\n1,2,3\n", "line 1: the first line must name the columns, as in stamp,cov_xx,"),
        ("stamp,cov_xx,cov_yy,cov_zz,speed\n1,2,3,4,5\n", "line 1: the first line must name the columns"),
        ("stamp,cov_xx,cov_yy,cov_zz\n1,2,3\n", "line 2: found 3 of 4 values; expected stamp,cov_xx,cov_yy"),
        ("stamp,cov_xx,cov_yy,cov_zz\n1,2,3,x\n", "line 2: 'x' is no number"),
        ("stamp,cov_xx,cov_yy,cov_zz\n2,1,1,1\n1,1,1,1\n", "line 3: stamp is 1, which is no time in s after"),
        ("stamp,cov_xx,cov_yy,cov_zz\n1,0,0,0\n", "holds zeros alone"),
    ],
)
def test_covariances_that_are_wrong(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "covariances.csv").write_text(text)
    with pytest.raises(FileError) as error:
        read_covariances(tmp_path / "covariances.csv")
    assert told in str(error.value)


def test_a_column_may_be_left_out_and_words_be_empty(tmp_path: Path) -> None:
    (tmp_path / "health.csv").write_text("# of a tracker\r\nflag,stamp\r\nok,1\r\n,1.5\r\nlost,1.5\r\n")
    said = read_health(tmp_path / "health.csv")
    assert said.stamps.tolist() == [1.0, 1.5, 1.5]
    assert said.flags.tolist() == [0, -1, 2]
    assert np.isnan(said.values).all()


def test_one_triangle_of_a_covariance_is_enough(tmp_path: Path) -> None:
    (tmp_path / "covariances.csv").write_text("stamp,cov_xx,cov_xy,cov_yy,cov_zz\n1,2,0.5,3,4\n")
    stamps, found = read_covariances(tmp_path / "covariances.csv")
    assert stamps.tolist() == [1.0]
    assert found.tolist() == [[[2, 0.5, 0], [0.5, 3, 0], [0, 0, 4]]]
