# SPDX-License-Identifier: Apache-2.0
"""Ground truth in tables and as control points, from the command line."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from slamhive_eval import ControlPoints, Options, evaluate_points, read_tum
from slamhive_eval.command import main

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive_eval import Trajectory


@pytest.fixture(name="desk")
def desk_fixture(trajectories: Path, tmp_path: Path) -> dict[str, Any]:
    truth = read_tum(trajectories / "fr2_desk_groundtruth.txt")
    points = truth.select(slice(250, None, 500))
    rows = zip(points.stamps.tolist(), points.positions.tolist(), strict=True)
    (tmp_path / "points.txt").write_text(
        "".join(f"{t!r} {x!r} {y!r} {z!r} 0 0 0 1\n" for t, (x, y, z) in rows)
    )
    lines = [
        f"{round(t * 1e9)};7;{q[3]!r};{q[0]!r};{q[1]!r};{q[2]!r};{p[0]!r};{p[1]!r};{p[2]!r}"
        for t, p, q in zip(
            truth.stamps.tolist(), truth.positions.tolist(), truth.quaternions.tolist(), strict=True
        )
    ]
    (tmp_path / "table.csv").write_text("names of columns\n" + "\n".join(lines) + "\n")
    estimate = trajectories / "fr2_desk_ORB.txt"
    return {
        "folder": tmp_path,
        "truth": trajectories / "fr2_desk_groundtruth.txt",
        "estimate": str(estimate),
    } | {"points": points}


def told(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    assert main([str(word) for word in words]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("command", [["ape", "--align", "se3"], ["rpe", "--delta", "1", "--unit", "m"]])
def test_a_table_gives_what_the_usual_file_gives(
    capsys: pytest.CaptureFixture[str], desk: dict[str, Any], command: list[str]
) -> None:
    name, *options = command
    usual = told(capsys, name, desk["truth"], desk["estimate"], *options, "--json")
    table = ("--columns", "t,_,qw,qx,qy,qz,x,y,z", "--skip", 1, "--time-unit", "ns")
    found = told(capsys, name, desk["folder"] / "table.csv", desk["estimate"], *options, *table, "--json")
    assert found["rmse"] == pytest.approx(usual["rmse"], rel=1e-9)
    assert found["poses"] == usual["poses"]


def test_control_points(capsys: pytest.CaptureFixture[str], desk: dict[str, Any]) -> None:
    points: Trajectory = desk["points"]
    words = ("ape", desk["folder"] / "points.txt", desk["estimate"], "--align", "se3")
    form = ("--reference-format", "control-points")
    wanted = evaluate_points(ControlPoints.of(points), read_tum(desk["estimate"]), Options())
    found = told(capsys, *words, *form, "--json", "--csv", desk["folder"] / "table.csv")
    assert wanted.ate is not None
    assert found["rmse"] == wanted.ate.rmse > 0
    assert found["points"] == wanted.as_dict()["points"]
    assert found["points"]["met"] == len(found["pointErrors"]) > 30
    assert main([str(word) for word in (*words, *form, "--details")]) == 0
    printed = capsys.readouterr().out
    assert f"{found['points']['met']} of {len(points)} control points met" in printed
    assert "drift and jumps between them are not seen" in printed
    assert printed.count("\n1311868") == found["points"]["met"]
    assert main([str(word) for word in words]) == 0  # as poses: those that happen to be near
    assert json.loads(json.dumps(found)) == found


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("rpe", "POINTS", "EST", "--reference-format", "control-points"), "only ape measures against them"),
        (("ape", "POINTS", "EST", "--skip", "1"), "--skip needs --columns"),
        (("ape", "POINTS", "EST", "--reference-format", "table"), "--reference-format table needs --columns"),
        (("ape", "POINTS", "EST", "--columns", "t,x,y"), "columns: a position is needed"),
        (
            ("ape", "POINTS", "EST", "--columns", "t,x,y,z", "--reference-format", "tum"),
            "--columns is for tables",
        ),
        (("ape", "POINTS", "EST", "--columns", "x,y,z"), "name t or sec, or give the rate"),
        (
            ("ape", "POINTS", "EST", "--reference-format", "control-points", "--relation", "full"),
            "control points have no orientations, which the relation full needs",
        ),
        (
            ("ape", "POINTS", "POINTS2", "--reference-format", "control-points"),
            "POINTS2: 0 of 4. control points",
        ),
    ],
)
def test_what_does_not_fit_is_refused(
    capsys: pytest.CaptureFixture[str], desk: dict[str, Any], words: tuple[str, ...], message: str
) -> None:
    (desk["folder"] / "POINTS2").write_text("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n")
    names = {"POINTS": desk["folder"] / "points.txt", "EST": desk["estimate"]}
    names["POINTS2"] = desk["folder"] / "POINTS2"
    assert main([str(names.get(word, word)) for word in words]) == 2
    error = capsys.readouterr().err
    with pytest.raises(ValueError, match=message):
        raise ValueError(error)
