# SPDX-License-Identifier: Apache-2.0
"""``segments.csv`` and what ``slamhive-eval segments`` makes of it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import (
    FileError,
    Options,
    Piece,
    Trajectory,
    TrajectoryError,
    evaluate_pieces,
    number_poses,
    read_segments,
    read_tum,
    write_tum,
)
from slamhive_eval.command import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

FILE = "start,end,map,reason\n0,9.9,0,start\n12,24.9,1,lost\n26,39.9,0,merged\n"


@pytest.fixture(name="run")
def run_fixture(tmp_path: Path, wander: Callable[..., Trajectory]) -> Path:
    """Map 0 before and after map 1, which is in another frame; poses between them in neither."""
    truth = wander(400, start=0.0)
    moved = truth.positions.copy()
    moved[120:250] += (5.0, 0.0, 0.0)
    write_tum(tmp_path / "gt.txt", truth)
    write_tum(tmp_path / "est.txt", Trajectory(truth.stamps, moved, truth.quaternions))
    (tmp_path / "segments.csv").write_text(FILE)
    return tmp_path


@pytest.mark.parametrize("words", [[], ["--segments", "{run}/segments.csv"]])
def test_maps(run: Path, capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    command = ["segments", f"{run}/gt.txt", f"{run}/est.txt", *(word.format(run=run) for word in words)]
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["mainSegment"], found["posesOutside"]) == (0, 30)
    first, second = found["segments"]
    assert [first["map"], first["reason"], second["map"], second["reason"]] == ["0", "start", "1", "lost"]
    assert (first["poses"], second["poses"]) == (240, 130)
    assert first["ate"]["rmse"] < 1e-9
    assert second["ate"]["rmse"] < 1e-9
    assert second["ateInMainFrame"]["rmse"] == pytest.approx(5.0)
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "30 poses are in none of them" in printed
    assert "*0" in printed


def test_restarts(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["segments", f"{run}/gt.txt", f"{run}/est.txt", "--restarts", "12", "25", "--json"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["poses"] for one in found["segments"]] == [120, 130, 150]
    (run / "segments.csv").unlink()
    assert main(words[:3]) == 2
    assert "no segments.csv beside it" in capsys.readouterr().err


def test_numbers(tmp_path: Path) -> None:
    (tmp_path / "s").write_text('# by a program\r\nreason,end,start\n"a, b",2,1\nc,4,3\n')
    pieces = read_segments(tmp_path / "s")
    assert [(piece.start, piece.end, piece.map, piece.reason) for piece in pieces] == [
        (1.0, 2.0, "piece 0", "a, b"),
        (3.0, 4.0, "piece 1", "c"),
    ]
    stamps = np.array([0.5, 1.0, 2.0, 2.5, 3.0, 4.5])
    still = Trajectory(stamps, np.zeros((6, 3)), np.tile((0, 0, 0, 1.0), (6, 1)))
    numbers, maps = number_poses(still, pieces)
    assert numbers.tolist() == [-1, 0, 0, -1, 1, -1]
    assert maps == ["piece 0", "piece 1"]
    with pytest.raises(TrajectoryError, match="is in a segment; those are from 1"):
        number_poses(still.shifted(10.0), pieces)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty; its first line names the columns"),
        ("start,map\n1,2\n", "line 1: the first line must name"),
        ("start,end,end\n1,2,3\n", "line 1: the first line must name"),
        ("start,end\n", "holds no segments"),
        ("start,end\n1\n", "line 2: found 1 of 2 columns"),
        ("start,end\n1,x\n", "line 2: end is 'x', which is no time"),
        ("start,end\nnan,1\n", "line 2: start is 'nan'"),
        ("start,end\n2,1\n", "line 2: ends at 1.000 s before it starts"),
        ("start,end\n1,3\n2,4\n", "line 3: a segment begins before the one above"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "segments.csv").write_text(text)
    with pytest.raises(FileError, match=says):
        read_segments(tmp_path / "segments.csv")


def test_batch_measures_map_by_map(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["batch", str(run), "--reference", f"{run}/gt.txt", "--align", "se3"]
    command = ["segments", f"{run}/gt.txt", f"{run}/est.txt", "--align", "se3", "--json"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert main(command) == 0
    alone = json.loads(capsys.readouterr().out)
    for name in ("mainSegment", "posesOutside", "ate", "coverage", "poses", "scale"):
        assert found[name] == alone[name], name
    maps = ["segment", "map", "reason", "poses", "ate", "ateInMainFrame"]
    assert [[one[name] for name in maps] for one in found["segments"]] == [
        [one[name] for name in maps] for one in alone["segments"]
    ]
    assert found["ate"]["rmse"] < 1e-9
    assert main([*words, "--no-segments"]) == 0
    assert json.loads(capsys.readouterr().out)["ate"]["rmse"] > 1
    (run / "segments.csv").write_text("start,end\n2,1\n")
    assert main([*words, "--pattern", "*.*"]) == 1
    assert "line 2: ends at 1.000 s before" in json.loads(capsys.readouterr().out)["error"]


def test_one_clock_for_all_maps(run: Path, wander: Callable[..., Trajectory]) -> None:
    truth, estimate = wander(400, start=0.0), read_tum(run / "est.txt").shifted(-0.3)
    pieces = [
        Piece(piece.start - 0.3, piece.end - 0.3, piece.map) for piece in read_segments(run / "segments.csv")
    ]
    options = Options(clock="offset", matching="interpolate")
    found = evaluate_pieces(truth, estimate, pieces, options)
    assert found["clock"]["offsetSeconds"] == pytest.approx(0.3, abs=0.01)
    assert found["segments"][1]["ateInMainFrame"]["rmse"] == pytest.approx(5.0, abs=0.1)
    assert found["segments"][0]["metres"] > found["segments"][1]["metres"] > 1


def test_only_the_longest_maps_are_measured(run: Path) -> None:
    truth, estimate = read_tum(run / "gt.txt"), read_tum(run / "est.txt")
    pieces = [Piece(float(k), k + 0.95, f"map {k}") for k in range(40)]
    found = evaluate_pieces(truth, estimate, pieces, most=5)
    metres = [one["metres"] for one in evaluate_pieces(truth, estimate, pieces)["segments"]]
    assert sorted(one["metres"] for one in found["segments"]) == sorted(metres)[-5:]
    assert found["segmentsLeftOut"] == 35
