# SPDX-License-Identifier: Apache-2.0
"""Every row of the table of degenerate input in docs/evaluation.md, by what the commands do."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from slamhive_eval import Options, Trajectory, evaluate, write_tum
from slamhive_eval.command import main

DOCUMENT = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()
TABLE = DOCUMENT.partition("## Degenerate input")[2].partition("\n## ")[0]
ROWS = re.findall(r"^\| ([^|]+) \| [^|]+ \|$", TABLE, re.MULTILINE)[1:]

Make = Callable[[Trajectory], object]
"""Changes ground truth of 50 poses, 1 s apart, into an estimate or the text of its file."""


def text(change: Callable[[list[str]], list[str]]) -> Make:
    """Change the lines of the file."""

    def made(truth: Trajectory) -> bytes:
        columns = np.column_stack((truth.stamps, truth.positions, truth.quaternions))
        lines = change([" ".join(map(repr, row)) for row in columns.tolist()])
        return ("\n".join(lines) + "\n").encode()

    return made


def replaced(line: int, column: int, word: str) -> Make:
    def change(lines: list[str]) -> list[str]:
        words = lines[line - 1].split()
        words[column] = word
        return [*lines[: line - 1], " ".join(words), *lines[line:]]

    return text(change)


def some(*index: int) -> Make:
    return lambda truth: truth.select(np.array(index))


def bare(truth: Trajectory) -> bytes:
    rows = [
        f"{t!r},{x!r},{y!r},{z!r}"
        for t, (x, y, z) in zip(truth.stamps.tolist(), truth.positions.tolist(), strict=True)
    ]
    return "\n".join(["time,x,y,z", *rows]).encode()


def cut(truth: Trajectory) -> bytes:
    whole = text(list)(truth)
    assert isinstance(whole, bytes)
    return whole[: whole.index(b"\n", 2000) + 30]


def cut_million(_: Trajectory) -> bytes:
    whole = b"".join(b"%d 0.25 1.5 0 0 0 0 1\n" % k for k in range(1_000_000))
    return whole[: whole.index(b"\n", len(whole) // 2) + 12]


STRAIGHT = Trajectory(
    np.arange(50.0),
    np.column_stack((np.arange(50.0), np.zeros((50, 2)))),
    np.tile((0.0, 0.0, 0.0, 1.0), (50, 1)),
)
AXES = b"".join(b"property float %s\n" % axis for axis in (b"x", b"y", b"z"))
CLOUD = b"ply\nformat ascii 1.0\nelement vertex 4\n" + AXES + b"%send_header\n"
MESH = CLOUD % b"element face 1\nproperty list uchar int vertex_indices\n"
POINTS = b"0 0 0\n1 0 0\n0 1 0\n%s 1 1\n"
ALIGN = ["ape", "--align", "sim3"]
NONE: list[str] = ["ape"]

CASES: list[tuple[str, Make, list[str], int, str]] = [
    ("positions on a line", lambda _: STRAIGHT, ALIGN, 0, "the orientations determined the rotation"),
    ("two poses", some(0, 1), ALIGN, 0, "lie on a line"),
    ("two poses", some(0, 1), ["rpe"], 0, "pairs  1"),
    ("two poses", some(0, 1), ["repeated"], 0, "Lost"),
    ("one pose", some(0), ALIGN, 0, "determine a scale"),
    ("one pose", some(0), ["rpe"], 2, "form a pair"),
    ("one pose", some(0), ["kitti"], 0, "0 segments"),
    ("one pose", some(0), ["drift"], 0, "in 0 windows"),
    ("one pose", some(0), ["repeated"], 0, "Lost"),
    (
        "an estimate that stands still",
        lambda truth: truth.transformed(np.eye(3), np.zeros(3), 0.0),
        ALIGN,
        0,
        "no common motion",
    ),
    (
        "an estimate that stands still",
        lambda truth: truth.transformed(np.eye(3), np.zeros(3), 0.0),
        ["repeated"],
        0,
        "Diverged",
    ),
    ("no common time", lambda truth: truth.shifted(1000.0), NONE, 2, "1000.000 s to 1049.000 s"),
    ("no common time", lambda truth: truth.shifted(1000.0), ["repeated"], 0, "Lost"),
    ("rows of NaN", replaced(7, 2, "nan"), NONE, 0, "note: 1 of 50 rows holds NaN and was left out"),
    (
        "rows of NaN",
        text(lambda lines: [f"{k} 0 0 0 0 0 0 nan" for k, _ in enumerate(lines)]),
        NONE,
        2,
        "all",
    ),
    ("infinity", replaced(7, 0, "inf"), NONE, 2, "line 7: time stamp is inf"),
    (
        "stamps in nanoseconds before the columns of TUM, as ORB-SLAM3 writes them",
        text(lambda lines: [f"{k + 10**6}000000000 {one.split(' ', 1)[1]}" for k, one in enumerate(lines)]),
        NONE,
        2,
        "1000000.000 s to 1000049.000 s",
    ),
    (
        "units in names of columns, also in a comment above, `x [mm]`, `roll [°]`",
        text(lambda lines: ["# time [fortnights] x [mm] y [mm] z [mm] qx qy qz qw", *lines]),
        NONE,
        2,
        "fortnights",
    ),
    (
        "a stamp and a 3×4 matrix a line",
        text(lambda lines: [f"{k + 10**6}000000000,1,0,0,{k},0,1,0,0,0,0,1,0" for k, _ in enumerate(lines)]),
        NONE,
        2,
        "line 1: found a time stamp and a 3×4 pose matrix",
    ),
    ("equal stamps", some(0, 1, 1, 2, 2, 3), NONE, 0, "poses  4"),
    ("equal stamps", some(0, 1, 1, 2, 2, 3), NONE, 0, "note: 2 poses of the estimate have the stamp"),
    ("equal stamps", some(*[0] * 9), NONE, 0, "note: 1 of 9 poses have a partner of their own"),
    ("decreasing stamps", replaced(7, 0, "3"), NONE, 2, "line 7: time stamp 3.000000000 s comes before"),
    ("decreasing stamps", replaced(7, 0, "3"), ["ape", "--sort"], 0, "rmse"),
    (
        "zero quaternion",
        text(lambda lines: [*lines[:4], lines[4].rsplit(" ", 4)[0] + " 0 0 0 0"]),
        NONE,
        2,
        "line 5: the quaternion is zero",
    ),
    (
        "zero quaternion",
        text(lambda lines: [f"{one.rsplit(' ', 4)[0]} 0 0 0 7" for one in lines]),
        NONE,
        0,
        "rmse",
    ),
    (
        "values missing or too many, no number",
        text(lambda lines: [*lines[:4], lines[4] + " 1"]),
        NONE,
        2,
        "line 5: found 9",
    ),
    ("values missing or too many, no number", replaced(5, 3, "x"), NONE, 2, "line 5: 'x' is no number"),
    ("a file cut within a line", cut, NONE, 2, "of 8 values"),
    ("a million lines, cut within the last", cut_million, NONE, 2, "line 502138: found 2 of 8"),
    (
        "a compressed file cut anywhere",
        lambda truth: gzip.compress(cut(truth) * 9)[:-100],
        NONE,
        2,
        "broken or cut off",
    ),
    ("no pose: an empty file, or comments alone", lambda _: b"# no pose\n", NONE, 2, "holds no poses"),
    ("no orientations (a tracker, GNSS)", bare, ["ape", "--align", "se3"], 0, "rmse"),
    ("no orientations (a tracker, GNSS)", bare, ["rpe"], 2, "orientations"),
    ("no orientations (a tracker, GNSS)", bare, ["ape", "--relation", "angle_deg"], 2, "orientations"),
    (
        "control points, fewer than three of them met, or on a line",
        some(0, 1),
        ["ape", "--reference-format", "control-points"],
        2,
        "2 of 50",
    ),
    ("ground truth shorter than every length", lambda truth: truth, ["kitti"], 0, "0 segments"),
    (
        "ground truth shorter than every length",
        lambda truth: truth,
        ["kitti", "--json"],
        0,
        '"translationPercent": null',
    ),
    *(
        (
            "a KITTI frame index that is no whole number, negative, there twice or beyond the ground truth",
            lambda _, frame=frame: b"".join(b"%s 1 0 0 1 0 1 0 0 0 0 1 0\n" % one for one in (b"0", frame)),
            NONE,
            2,
            says,
        )
        for frame, says in (
            (b"0.5", "line 2: the frame index is 0.5"),
            (b"-1", "line 2: the frame index is -1"),
            (b"0", "line 2: frame 0 is there twice"),
        )
    ),
    (
        "a decreasing frame index",
        lambda _: b"7 1 0 0 1 0 1 0 0 0 0 1 0\n5 1 0 0 1 0 1 0 0 0 0 1 0\n",
        NONE,
        2,
        "line 2: frame 5 comes after frame 7",
    ),
    (
        "a decreasing frame index",
        lambda _: b"7 1 0 0 1 0 1 0 0 0 0 1 0\n5 1 0 0 1 0 1 0 0 0 0 1 0\n",
        [*NONE, "--sort"],
        0,
        "poses  2",
    ),
    (
        "clouds with points that aren't finite",
        lambda _: CLOUD % b"" + POINTS % b"nan",
        ["map"],
        0,
        "3 points",
    ),
    (
        "meshes that name corners they lack; cut clouds",
        lambda _: MESH + POINTS % b"1" + b"3 0 1 9\n",
        ["map"],
        2,
        "corner",
    ),
    (
        "meshes that name corners they lack; cut clouds",
        lambda _: CLOUD % b"" + b"0 0 0\n",
        ["map"],
        2,
        "of 4",
    ),
]


@pytest.mark.parametrize(("row", "make", "words", "code", "says"), CASES)
def test_rows(  # noqa: PLR0917 - a case has so many parts
    tmp_path: Path,
    wander: Callable[..., Trajectory],
    capsys: pytest.CaptureFixture[str],
    row: str,
    make: Make,
    words: list[str],
    code: int,
    says: str,
) -> None:
    assert row in ROWS
    truth = wander(50, start=0.0, rate=1.0)
    reference, estimate = tmp_path / "gt.txt", tmp_path / ("est.ply" if words[0] == "map" else "est.txt")
    write_tum(reference, truth)
    made = make(truth)
    if isinstance(made, Trajectory):
        write_tum(estimate, made)
    else:
        assert isinstance(made, bytes)
        estimate.write_bytes(made)
    if words[0] == "map":
        reference.write_bytes(CLOUD % b"" + POINTS % b"1")
        reference = reference.rename(tmp_path / "gt.ply")
        words = [*words, str(estimate), "--reference", str(reference)]
    else:
        words = [words[0], str(reference), str(estimate), *words[1:]]
    assert main(words) == code
    printed = "".join(capsys.readouterr())
    assert says in printed
    assert code == 0 or printed.count("\n") == 1


def test_zero_errors_of_repeated_runs(
    tmp_path: Path, wander: Callable[..., Trajectory], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "zero error among few repeated runs" in ROWS
    write_tum(tmp_path / "gt.txt", STRAIGHT)
    words = ["repeated", *(str(tmp_path / "gt.txt"),) * 4, "--align", "none", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["interval"] is None


def test_no_row_is_left_out() -> None:
    shown = {row for row, *_ in CASES} | {"zero error among few repeated runs"}
    assert set(ROWS) == shown


def test_a_run_of_few_poses_is_lost(wander: Callable[..., Trajectory]) -> None:
    truth = wander(50)
    found = evaluate(truth, truth.select(slice(0, 2)), Options())
    assert (found.outcome, found.ate) == ("Lost", None)
