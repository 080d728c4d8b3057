# SPDX-License-Identifier: Apache-2.0
"""The table of bad input: what is read all the same, and the sentence for what isn't."""

from __future__ import annotations

import bz2
import gzip
import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import (
    FileError,
    OptionError,
    Options,
    RpeOptions,
    Trajectory,
    TrajectoryError,
    associate,
    evaluate,
    find_pairs,
    read_euroc,
    read_kitti,
    read_relations,
    read_trajectory,
    read_tum,
    rpe_errors,
    write_tum,
)
from slamhive_eval.formats import textfiles
from slamhive_eval.formats.files import read_estimate

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import Any

    import numpy.typing as npt

GOOD = "1.0 1 2 3 0 0 0 1\n2.0 4 5 6 0 0 0 1\n"


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        "# stamp tx\n\n" + GOOD + "\n\n",
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("\n", "\r"),
        GOOD.replace(" ", "   \t"),
        "  " + GOOD.replace("\n", "  \n  "),
        GOOD.replace(" ", ", "),
        GOOD.replace(" ", ","),
        GOOD.rstrip("\n"),
        "\ufeff" + GOOD,
        "1e0 1.0 +2 3E0 0 0 0 1 # first\n2 4 5 6 -0 0.0 0 2\n",
    ],
)
@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress])
def test_what_is_read_all_the_same(tmp_path: Path, text: str, pack: Callable[[bytes], bytes]) -> None:
    file = tmp_path / "trajectory.txt"
    file.write_bytes(pack(text.encode()))
    found = read_trajectory(file)
    np.testing.assert_array_equal(found.stamps, (1, 2))
    np.testing.assert_array_equal(found.positions, ((1, 2, 3), (4, 5, 6)))
    np.testing.assert_array_equal(found.quaternions, ((0, 0, 0, 1), (0, 0, 0, 1)))


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("", None, "holds no poses"),
        ("# only\n\n", None, "holds no poses"),
        (GOOD + "3.0 1 2 3 0 0 0\n", 3, "found 7 of 8 values; expected timestamp tx ty tz qx qy qz qw"),
        ("# c\n" + GOOD + "3.0 1 2 3 0 0 0 1 9\n", 4, "found 9 of 8 values"),
        (GOOD + "3.0 1 2 3 0 0", 3, "found 6 of 8 values"),
        (GOOD + "3.0 1 2 x 0 0 0 1\n", 3, "'x' is no number"),
        (GOOD + "3.0 1 2 1_0 0 0 0 1\n", 3, "'1_0' is no number"),
        (GOOD + "\n3.0 inf 2 3 0 0 0 1\n", 4, "tx is inf; every value must be a finite number"),
        ("3.0 nan 2 3 0 0 0 1\n# c\nnan 0 0 0 0 0 0 0\n", None, "all 2 rows hold NaN: no pose"),
        ("3.0 1 2 3 0 0 0 nan\n", None, "its only row holds NaN: no pose"),
        ("nan 0 0 0 0 0 0 1\n" + GOOD + "# c\n1.5 1 2 3 0 0 0 1\n", 5, "1.500000000 s comes before"),
        (GOOD + "3.0 1 2 3 0 0 0 inf\n", 3, "qw is inf"),
        (GOOD + "# c\n1.5 1 2 3 0 0 0 1\n", 4, "1.500000000 s comes before the one above it, 2.000000000 s"),
        (GOOD + "3.0 1 2 3 0 0 0 0\n", 3, "the quaternion is zero"),
        (GOOD + "1403636579758555392 1 2 3 0 0 0 1\n", 3, "nanoseconds perhaps"),
        (GOOD + "3.0 1 2,3 0 0 0 1\n", 3, "'2,3' is no number"),
        (GOOD + "3.0 1e200 2 3 0 0 0 1\n", 3, "beyond 1e+30 m"),
        (GOOD + ",\n3.0 1 2 3 0 0 0 x\n", 3, "found 0 of 8 values"),
        (",", 1, "no known format"),
        ("1 2 3\n", 1, "found 3 values a line, which is no known format"),
        ("hello there, world\n", 1, "no known format"),
        ("PK\0\1", None, "is no text file"),
        ("PK\3\4\0", None, "is a ZIP archive; unpack it, and name the files in it"),
        ("\x1f\x8bbroken", None, "cut off"),
    ],
)
def test_what_is_wrong_is_named_by_line(tmp_path: Path, text: str, line: int | None, says: str) -> None:
    file = tmp_path / "trajectory.txt"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(FileError) as caught:
        read_trajectory(file)
    assert says in str(caught.value)
    assert str(caught.value).startswith(f"{file}, line {line}:" if line else f"{file}: ")
    assert "\n" not in str(caught.value)
    assert caught.value.line == line


def test_missing_and_truncated_files(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="can't be read: No such file"):
        read_tum(tmp_path / "none.txt")
    with pytest.raises(FileError, match="can't be read: Is a directory"):
        read_tum(tmp_path)
    cut = tmp_path / "cut.gz"
    cut.write_bytes(gzip.compress(GOOD.encode() * 1000)[:-20])
    with pytest.raises(FileError, match="broken or cut off"):
        read_tum(cut)


ROW = "{} 1 2 3 0 0 0 1"
MATRIX = "1 0 0 {} 0 1 0 0 0 0 1 0"


@pytest.mark.parametrize(
    ("lines", "stamps", "positions"),
    [
        ([ROW.format(1), ROW.format(2).replace("3", "NaN"), ROW.format(3)], [1, 3], [1, 1]),
        ([ROW.format("nan"), "#", ROW.format(2), "3 1 2 3 nan nan nan nan", ROW.format(4)], [2, 4], [1, 1]),
        (["t,x,y,yaw_deg", "1,1,2,90", "2,1,2,nan", "3,1,2,0"], [1, 3], [1, 1]),
        ([MATRIX.format(k) for k in (5, "nan", 7, 8)], [0, 2, 3], [5, 7, 8]),
        ([f"{k} {MATRIX.format(x)}" for k, x in ((0, 5), (2, "nan"), (6, 7))], [0, 6], [5, 7]),
    ],
)
def test_rows_of_nan_are_left_out_and_counted(
    tmp_path: Path, lines: list[str], stamps: list[float], positions: list[float]
) -> None:
    file = tmp_path / "t"
    file.write_text("\n".join(lines) + "\n")
    found = read_trajectory(file)
    assert (found.stamps.tolist(), found.positions[:, 0].tolist()) == (stamps, positions)
    total = len([line for line in lines if not line.startswith(("#", "t,"))])
    assert found.nan_rows == total - len(stamps)
    assert found.notes[0].startswith(f"{found.nan_rows} of {total} rows hold")
    assert found.select(slice(1, None)).transformed(np.eye(3), np.ones(3)).nan_rows == found.nan_rows


def test_frames_of_nan_keep_the_others_their_places(tmp_path: Path) -> None:
    """Line k is frame k, with stamp k of the times, whatever lines hold NaN; the last one too."""
    poses, times, truth = tmp_path / "poses", tmp_path / "times", tmp_path / "truth"
    truth.write_text("\n".join(MATRIX.format(k) for k in range(5)))
    poses.write_text("\n".join(MATRIX.format(k if k in {0, 2, 3} else "nan") for k in range(5)))
    times.write_text("\n".join(str(10 + k) for k in range(5)))
    assert read_kitti(poses, times).stamps.tolist() == [10, 12, 13]
    reference = read_kitti(truth)
    estimate = read_estimate(poses, reference, truth)
    assert evaluate(reference, estimate, Options(alignment="none")).ate.max == 0
    (tmp_path / "few").write_text("10\n11\n12\n13\n")
    with pytest.raises(FileError, match="has 4 stamps for the 5 poses"):
        read_kitti(poses, tmp_path / "few")


def test_an_evaluation_counts_rows_of_nan(tmp_path: Path, wander: Callable[..., Trajectory]) -> None:
    truth = wander()
    file = tmp_path / "t"
    write_tum(file, truth)
    lines = file.read_text().splitlines()
    file.write_text(
        "\n".join(line.rsplit(" ", 1)[0] + " nan" if k % 10 else line for k, line in enumerate(lines))
    )
    found = evaluate(truth, read_tum(file), Options()).as_dict()
    assert (found["nanRows"], found["estimatePoses"], found["poses"]) == (180, 20, 20)
    assert found["notes"] == ["180 of 200 rows hold NaN and were left out"]
    assert found["coverage"] < 1
    assert "nanRows" not in evaluate(truth, truth, Options()).as_dict()


def test_unsorted_poses_are_sorted_on_request_only(tmp_path: Path) -> None:
    file = tmp_path / "t.txt"
    file.write_text("2 2 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n3 3 0 0 0 0 0 1\n2 4 0 0 0 0 0 1\n")
    with pytest.raises(FileError, match="line 2: time stamp"):
        read_tum(file)
    np.testing.assert_array_equal(read_tum(file, unsorted="sort").positions[:, 0], (1, 2, 4, 3))
    file.write_text("".join(f"{k % 2} {k} 0 0 0 0 0 1\n" for k in range(100)))
    np.testing.assert_array_equal(read_tum(file, unsorted="sort").positions[:50, 0], np.arange(0, 100, 2))
    file.write_text("2 2 0 0 0 0 0 1\n0 nan 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n1 inf 0 0 0 0 0 1\n")
    with pytest.raises(FileError, match="line 4: tx is inf"):
        read_tum(file, unsorted="sort")


def test_euroc(tmp_path: Path) -> None:
    file = tmp_path / "data.csv"
    row = "1403636580838555648,4.6,-1.7,0.7,0.5,-0.1,-0.8,-0.08,-0.02,0.03,0.8,0,0,0,0.1,0.2,0.3\n"
    file.write_text("#timestamp, p_RS_R_x [m], …\n" + row)
    for found in (read_trajectory(file), read_euroc(file)):
        assert found.stamps[0] == 1403636580838555648 / 1e9
        np.testing.assert_allclose(found.quaternions[0, 3] / found.quaternions[0, 1], 0.5 / -0.8)
    file.write_text(row + "1403636580843555648,4.6,-1.7\n")
    with pytest.raises(FileError, match="line 2: found 3 of 8 values"):
        read_euroc(file)


@pytest.mark.parametrize(
    ("poses", "times", "says"),
    [
        ("1 0 0 0 0 1 0 0 0 0 1\n", "0\n", "poses, line 1: found 11 of 12 values"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "0\n", "poses, line 1: the left 3×3 part is no rotation"),
        ("2 0 0 0 0 2 0 0 0 0 2 0\n", "0\n", "no rotation"),
        ("1 0 0 inf 0 1 0 0 0 0 1 0\n", "0\n", "must be a finite number"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0\n", "0\n", "poses: its only row holds NaN"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0\n2 0 0 0 0 1 0 0 0 0 1 0\n", "0\n1\n", "poses, line 2: the left"),
        ("1 0 0 5 0 1 0 0 0 0 1 0\n" * 2, "0\n", "times: has 1 stamps for the 2 poses of"),
        ("1 0 0 5 0 1 0 0 0 0 1 0\n" * 2, "1\n0\n", "times, line 2: time stamp"),
        ("1 0 0 5 0 1 0 0 0 0 1 0\n" * 2, "1\nx\n", "times, line 2: 'x' is no number"),
    ],
)
def test_kitti(tmp_path: Path, poses: str, times: str, says: str) -> None:
    (tmp_path / "poses").write_text("1 0 0 5 0 0 -1 6 0 1 0 7\n")
    (tmp_path / "times").write_text("3.5\n")
    good = read_kitti(tmp_path / "poses", tmp_path / "times")
    np.testing.assert_allclose(good.quaternions, [[np.sqrt(0.5), 0, 0, np.sqrt(0.5)]])
    np.testing.assert_array_equal(good.positions, [[5, 6, 7]])
    assert good.stamps == [3.5]
    assert read_trajectory(tmp_path / "poses").stamps == [0.0]
    (tmp_path / "poses").write_text(poses)
    (tmp_path / "times").write_text(times)
    with pytest.raises(FileError, match=says):
        read_kitti(tmp_path / "poses", tmp_path / "times")


@pytest.mark.parametrize(
    ("stamps", "positions", "quaternions", "says"),
    [
        ([], np.zeros((0, 3)), np.zeros((0, 4)), "no poses"),
        ([1.0], np.zeros((2, 3)), np.ones((1, 4)), r"not \(1,\), \(2, 3\) and \(1, 4\)"),
        ([1.0, np.nan], np.zeros((2, 3)), np.ones((2, 4)), "pose 1 of 2: time stamp is nan"),
        ([1.0, 0.5], np.zeros((2, 3)), np.ones((2, 4)), "pose 1 of 2: time stamp 0.5"),
        ([1.0], np.zeros((1, 3)), np.zeros((1, 4)), "pose 0 of 1: the quaternion is zero"),
    ],
)
def test_arrays_that_are_no_trajectory(
    stamps: list[float], positions: npt.NDArray[np.float64], quaternions: npt.NDArray[np.float64], says: str
) -> None:
    with pytest.raises(TrajectoryError, match=says):
        Trajectory(np.array(stamps), positions, quaternions)


def test_a_trajectory_cannot_be_changed_from_outside() -> None:
    stamps = np.array([1.0, 2.0])
    found = Trajectory(stamps, np.zeros((2, 3)), np.full((2, 4), 7.0))
    stamps[0] = 9.0
    assert found.stamps[0] == 1.0
    np.testing.assert_allclose(np.linalg.norm(found.quaternions, axis=1), 1.0)
    with pytest.raises(ValueError, match="read-only"):
        found.positions[0] = 1.0


def test_what_is_written_is_read_back_exactly(tmp_path: Path, wander: Callable[..., Trajectory]) -> None:
    write_tum(tmp_path / "t.txt", wander(50))
    again = read_tum(tmp_path / "t.txt")
    np.testing.assert_array_equal(again.stamps, wander(50).stamps)
    np.testing.assert_array_equal(again.positions, wander(50).positions)
    np.testing.assert_allclose(again.quaternions, wander(50).quaternions, atol=1e-15)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"alignment": "SE3"}, "unknown alignment 'SE3'"),
        ({"min_coverage": 90}, "within 0 and 1, not 90"),
        ({"max_ate": 0}, "positive number of metres, not 0"),
        ({"max_difference_seconds": -1}, "must be ≥ 0 s, not -1"),
        ({"offset_seconds": np.nan}, "finite number of seconds, not nan"),
        ({"window": (2, 1)}, "must begin before it ends"),
        ({"extrinsic": np.eye(3)}, "4×4 matrix, not of shape"),
        ({"extrinsic": 2 * np.eye(4)}, "last row 0 0 0 1"),
        ({"extrinsic": np.diag((1.0, 1.0, -1.0, 1.0))}, "no rotation"),
        ({"rpe": (RpeOptions(0),)}, "delta must be a positive number, not 0"),
        ({"rpe": (RpeOptions(1.5, "frames"),)}, "whole number of frames, not 1.5"),
        ({"rpe": (RpeOptions(200, "deg"),)}, "at most 180 deg, not 200"),
        ({"rpe": (RpeOptions(1, "miles"),)}, "unknown unit 'miles'"),
        ({"rpe": (RpeOptions(rel_tolerance=-1),)}, "must be ≥ 0, not -1"),
    ],
)
def test_wrong_options(wander: Callable[..., Trajectory], arguments: Any, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        evaluate(wander(), wander(), Options(**arguments))


@pytest.mark.parametrize("relation", ["distance", ""])
def test_unknown_relation(wander: Callable[..., Trajectory], relation: str) -> None:
    pairs = find_pairs(wander(), 1, "frames", all_pairs=True)
    with pytest.raises(OptionError, match="unknown relation"):
        rpe_errors(wander(), wander(), pairs, relation)


def still(n: int) -> Trajectory:
    return Trajectory(1.6e9 + np.arange(n) / 10, np.zeros((n, 3)), np.tile((0.0, 0, 0, 1), (n, 1)))


@pytest.mark.parametrize(
    ("make", "outcome", "says"),
    [
        (lambda truth: truth.select(slice(0, 1)), "Lost", "1 of 1 poses of the estimate"),
        (lambda truth: truth.select(slice(0, 2)), "Lost", "an error needs at least 3"),
        (lambda truth: truth.select(slice(0, 60)), "Lost", "of the ground truth's path"),
        (
            lambda truth: Trajectory(truth.stamps + 1e3, truth.positions, truth.quaternions),
            "Lost",
            "lies within",
        ),
        (lambda truth: still(len(truth)), "Diverged", "stands still while the ground truth moves"),
        (lambda truth: truth.transformed(np.eye(3), np.zeros(3), 3.0), "Diverged", "the scale is 0.3333"),
        (lambda truth: truth.select(slice(0, 150)), "Partial", "90% were asked"),
        (lambda truth: truth, "Tracked", ""),
    ],
)
@pytest.mark.parametrize("alignment", ["none", "origin", "se3", "sim3", "scale", "yaw"])
def test_a_poor_estimate_is_a_result_with_a_sentence(
    wander: Callable[..., Trajectory],
    make: Callable[[Trajectory], Trajectory],
    outcome: str,
    says: str,
    alignment: str,
) -> None:
    truth = wander()
    found = evaluate(truth, make(truth), Options(alignment=alignment, max_ate=1e-3))
    assert found.outcome == outcome
    assert says in found.message
    result = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert result["outcome"] == outcome
    assert (result["ate"] is None) == (result["poses"] < 3)


def test_no_overlap_names_both_ranges(wander: Callable[..., Trajectory]) -> None:
    late = wander(start=1.7e9)
    message = evaluate(wander(), late).message
    assert "1700000000.000 s to 1700000019.900 s" in message
    assert "1600000000.000 s to 1600000019.900 s" in message


def test_standing_still_is_no_divergence_where_nothing_moved() -> None:
    found = evaluate(still(50), still(50))
    assert (found.outcome, found.coverage.share, found.scale) == ("Tracked", 1.0, None)
    assert found.as_dict()["rpe"][0] | {"rmse": None, "count": 0} == found.as_dict()["rpe"][0]


def test_equal_stamps_are_accepted(wander: Callable[..., Trajectory]) -> None:
    double = wander().select(np.repeat(np.arange(200), 2))
    assert len(associate(wander(), double)) == 200
    assert evaluate(double, wander()).ate.max < 1e-9


def test_relations_file(tmp_path: Path) -> None:
    file = tmp_path / "r"
    file.write_text("1 2 0 0 0 0 0 0\n1 2 0 0 0 0 0\n")
    with pytest.raises(FileError, match="line 2: found 7 of 8 values; expected t1 t2 x y z roll pitch yaw"):
        read_relations(file)
    file.write_text(",")
    with pytest.raises(FileError, match="line 1: found 0 of 8 values"):
        read_relations(file)
    file.write_text("1 2 0 0 0 0 0 0\n# c\n1 2 0 0 nan 0 0 0\n")
    with pytest.raises(FileError, match="line 3: every value must be a finite number"):
        read_relations(file)


def test_files_of_many_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Text is turned into numbers block by block; nothing of that shows."""
    monkeypatch.setattr(textfiles, "_BLOCK", 40)
    lines = [f"{k}.5 {k} 2 3 0 0 0 1{' # odd' * (k % 2)}" for k in range(50)]
    file = tmp_path / "t.txt"
    file.write_text("# c\n" * 30 + "\n".join(lines[:30]) + "\n" * 60 + "\n".join(lines[30:]))
    np.testing.assert_array_equal(read_tum(file).positions[:, 0], np.arange(50))
    file.write_text("\n".join(line.replace(" ", ",") for line in lines) + "\n# end\n")
    np.testing.assert_array_equal(read_tum(file).stamps, np.arange(50) + 0.5)
    for bad in ("7", "7 1 2", "50 1 2 3 0 0 0 x"):
        file.write_text("\n".join([*lines[:40], *[bad] * 20]))
        with pytest.raises(FileError, match="line 41"):
            read_tum(file)
