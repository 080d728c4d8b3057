# SPDX-License-Identifier: Apache-2.0
"""Many pairs at once."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import (
    FileError,
    OptionError,
    Options,
    Trajectory,
    batch,
    evaluate,
    find_support,
    read_tum,
    write_tum,
)
from slamhive_eval.command import main

if TYPE_CHECKING:
    from collections.abc import Callable

Results = list[dict[str, Any]]


@pytest.fixture(name="runs")
def runs_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> Path:
    """Two folders of six runs with a ground truth each, one of them beside the runs, one above."""
    for k, folder in enumerate(("a", "b")):
        truth = wander(100, seed=k)
        place = tmp_path / folder
        for n in range(6):
            run = place / f"run{n}" if k else place
            run.mkdir(parents=True, exist_ok=True)
            write_tum(run / f"estimate{n}.txt", wander(100, seed=10 * n + k + 1))
        write_tum(place / ("groundtruth.txt" if k else "gt.tum"), truth)
    (tmp_path / "notes.md").write_text("none of these")
    return tmp_path


def by_estimate(results: Results) -> dict[str, dict[str, Any]]:
    return {result["estimate"]: result for result in results}


@pytest.mark.parametrize("processes", [1, 2])
def test_a_folder(runs: Path, processes: int) -> None:
    pairs = batch.find_pairs(runs)
    assert len(pairs) == 12
    options = [Options(alignment="se3"), Options(alignment="sim3")]
    found = list(batch.evaluate_pairs(pairs, options, processes=processes))
    assert len(found) == 24
    for pair in pairs:
        assert pair.reference == str(runs / ("b/groundtruth.txt" if "/b/" in pair.estimate else "a/gt.tum"))
        files = read_tum(pair.reference), read_tum(pair.estimate)
        for one in options:
            expected = evaluate(*files, one).as_dict() | {"support": find_support(*files).as_dict()}
            assert {"reference": pair.reference, "estimate": pair.estimate, **expected} in found
    assert not batch._shared


def test_one_ground_truth_for_all(runs: Path) -> None:
    pairs = batch.find_pairs(runs, runs / "b" / "groundtruth.txt", "estimate[01].txt")
    assert [pair.estimate.rsplit("/", 1)[1] for pair in pairs] == [f"estimate{n}.txt" for n in (0, 1, 0, 1)]
    assert {pair.reference for pair in pairs} == {str(runs / "b" / "groundtruth.txt")}


def test_a_folder_of_rpg_trajectory_evaluation(tmp_path: Path, wander: Callable[..., Trajectory]) -> None:
    names = ["stamped_traj_estimate0.txt", "stamped_traj_estimate1.txt"]
    for name in ("stamped_groundtruth.txt", *names):
        write_tum(tmp_path / name, wander(20))
    (tmp_path / "eval_cfg.yaml").write_text("align_type: se3\nalign_num_frames: -1\n")
    pairs = batch.find_pairs(tmp_path)
    assert [(Path(pair.reference).name, Path(pair.estimate).name) for pair in pairs] == [
        ("stamped_groundtruth.txt", name) for name in names
    ]


def test_each_shared_ground_truth_is_read_once(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = []
    real = batch.read_trajectory
    monkeypatch.setattr(batch, "read_trajectory", lambda path, **how: read.append(path) or real(path, **how))
    list(batch.evaluate_pairs(batch.find_pairs(runs), [Options()], processes=1))
    assert len(read) == len(set(read)) == 2


@pytest.mark.parametrize("processes", [1, 2])
def test_what_is_wrong_with_one_does_not_stop_the_rest(
    runs: Path, monkeypatch: pytest.MonkeyPatch, processes: int
) -> None:
    (runs / "a" / "estimate2.txt").write_text("1 2 3\n")
    (runs / "a" / "estimate3.txt").write_text("5 0 0 0 0 0 0 1\n")
    pairs = [
        *batch.find_pairs(runs),
        *[batch.Pair(str(runs / "none"), str(runs / "a" / "estimate0.txt"))] * 2,
    ]
    real = batch.evaluate

    def odd(reference: Trajectory, estimate: Trajectory, options: Options) -> Any:
        if len(estimate) == 1:
            raise ZeroDivisionError("as nobody foresaw")
        return real(reference, estimate, options)

    monkeypatch.setattr(batch, "evaluate", odd)
    found = list(batch.evaluate_pairs(pairs, [Options()], processes=processes))
    assert len(found) == 14
    errors = {(one["reference"], one["estimate"]): one["error"] for one in found if "error" in one}
    assert len(errors) == 3
    said = sorted(errors.values())
    assert "estimate2.txt, line 1: found 3 values" in said[0]
    assert "none: can't be read" in said[1]
    assert said[2] == "ZeroDivisionError: as nobody foresaw"


def test_a_process_that_dies_does_not_stop_the_rest(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = batch.read_estimate
    parent = os.getpid()

    def deadly(path: str, *truth: Any, **how: Any) -> Trajectory:
        if path.endswith("estimate4.txt") and os.getpid() != parent:
            os._exit(9)
        return real(path, *truth, **how)

    monkeypatch.setattr(batch, "read_estimate", deadly)
    found = by_estimate(list(batch.evaluate_pairs(batch.find_pairs(runs), [Options()], processes=2)))
    assert len(found) == 12
    assert sum("error" in result for result in found.values()) == 2
    assert "died" in found[str(runs / "a" / "estimate4.txt")]["error"]


@pytest.mark.parametrize(
    ("text", "pairs"),
    [
        ("# two\ngt e1\n\n'g t' \"e 2\" # last\n", [("gt", "e1"), ("g t", "e 2")]),
        ('{"reference": "gt", "estimate": "/e1", "more": 1}\n', [("gt", "/e1")]),
        ("run.bag:/truth run.bag:/odom\n", [("run.bag:/truth", "run.bag:/odom")]),
    ],
)
def test_lists(tmp_path: Path, text: str, pairs: list[tuple[str, str]]) -> None:
    (tmp_path / "list").write_text(text)
    expected = [batch.Pair(*(str(tmp_path / name) for name in pair)) for pair in pairs]
    assert batch.read_pairs(tmp_path / "list") == expected


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "names no pairs"),
        ("gt est\ngt\n", "line 2: expected GT EST, or JSON with reference and estimate .found 1 names"),
        ("gt 'est\n", "No closing quotation"),
        ('{"reference": 1}\n', "line 1: expected"),
        ("{reference}\n", "line 1: expected"),
    ],
)
def test_lists_that_are_none(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "list").write_text(text)
    with pytest.raises(FileError, match=says):
        batch.read_pairs(tmp_path / "list")


def test_command(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--align", "sim3", "auto", "--delta", "1", "--unit", "m", "--all-pairs"]
    assert main(["batch", str(runs), *words]) == 0
    out, err = capsys.readouterr()
    found = [json.loads(line) for line in out.splitlines()]
    assert sorted({one["alignment"] for one in found}) == ["se3", "sim3"]
    assert (len(found), err) == (24, "")
    assert found[0]["rpe"][0]["pairs"] == "all"
    (runs / "a" / "estimate2.txt").write_text("1 2 3\n")
    assert main(["batch", str(runs / "a"), "--unscaled", "--align", "auto", "--jobs", "2"]) == 1
    out, err = capsys.readouterr()
    assert err == "slamhive-eval: 1 of 6 pairs could not be evaluated\n"
    found = [json.loads(line) for line in out.splitlines()]
    assert {one.get("alignment") for one in found} == {"sim3", None}


@pytest.mark.parametrize(
    "words",
    [
        ["--match", "unique", "--max-diff", "0.02"],
        ["--match", "forward"],
        ["--match", "interpolate", "--max-gap", "0.5"],
        ["--align", "se3", "--robust", "trimmed", "--keep", "0.5"],
        ["--align", "yaw", "--n-to-align", "20", "--offset", "0.05", "--max-diff", "0.06"],
        ["--align", "sim3", "--offset", "auto"],
        ["--align", "se3", "--hand-eye"],
    ],
)
def test_batch_measures_as_ape_does(runs: Path, capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    place = runs / "a"
    truth = read_tum(place / "gt.tum")
    noise = np.random.default_rng(3).normal(0, 0.01, (100, 3))
    late = Trajectory(truth.stamps + 0.001, truth.positions + noise, truth.quaternions)
    write_tum(place / "estimate0.txt", late)
    assert main(["batch", str(place), "--pattern", "estimate0.txt", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert main(["ape", str(place / "gt.tum"), str(place / "estimate0.txt"), *words, "--json"]) == 0
    expected = json.loads(capsys.readouterr().out)
    assert found["ate"]["rmse"] == expected["rmse"]
    assert found["poses"] == expected["poses"]
    assert found.get("clock") == expected.get("clock")


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_control_points(runs: Path, capsys: pytest.CaptureFixture[str], jobs: str) -> None:
    place = runs / "a"
    truth = read_tum(place / "gt.tum")
    rows = np.column_stack((truth.stamps * 1e3, truth.positions))[5::10]
    (place / "gt.tum").unlink()
    np.savetxt(place / "groundtruth.csv", rows, delimiter=",", header="ms,x,y,z")
    for n in range(6, 10):  # enough for processes
        write_tum(place / f"estimate{n}.txt", truth)
    words = ["--reference-format", "control-points", "--columns", "t,x,y,z", "--time-unit", "ms"]
    assert main(["batch", str(place), *words, "--align", "se3", "none", "--jobs", jobs]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(found) == 20
    same = [one["ate"]["rmse"] for one in found if one["estimate"].endswith("estimate7.txt")]
    # Between poses a straight line is taken.
    assert 0 < max(same) < 0.02
    assert {one["points"]["met"] for one in found} == {10}
    estimate = place / "estimate2.txt"
    assert (
        main(["ape", str(place / "groundtruth.csv"), str(estimate), *words, "--align", "se3", "--json"]) == 0
    )
    expected = json.loads(capsys.readouterr().out)
    (one,) = (one for one in found if (one["estimate"], one["alignment"]) == (str(estimate), "se3"))
    assert one["ate"]["rmse"] == expected["rmse"]
    assert one["pointErrors"] == expected["pointErrors"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["{runs}", "--reference-format", "table"], "--reference-format table needs --columns"),
        (
            ["{runs}", "--reference-format", "control-points", "--hand-eye", "--align", "se3"],
            "--hand-eye and --offset auto or drift need more than control points",
        ),
        (["{runs}/nowhere"], "nowhere: can't be read"),
        (
            ["{runs}", "--pattern", "*.csv"],
            "has no estimate *.csv with a ground truth (groundtruth.*, gt.*, stamped_groundtruth.*)",
        ),
        (["{runs}/a/gt.tum", "--reference", "x"], "--reference goes with a folder"),
        (["{runs}", "--delta", "0.5"], "whole number of frames, not 0.5"),
        (["{runs}", "--max-diff", "-1"], "must be ≥ 0 s, not -1"),
        (["{runs}", "--jobs", "0"], "at least one process, not 0"),
        (["{runs}", "--min-coverage", "90"], "within 0 and 1, not 90"),
    ],
)
def test_wrong_input(runs: Path, capsys: pytest.CaptureFixture[str], words: list[str], says: str) -> None:
    assert main(["batch", *(word.format(runs=runs) for word in words)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert says in err


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="is no folder"):
        batch.find_pairs(tmp_path / "nowhere")
    with pytest.raises(OptionError):
        list(batch.evaluate_pairs([], [Options()], processes=-1))
