# SPDX-License-Identifier: Apache-2.0
"""Tables whose columns are known beforehand, in the forms in which data sets are published."""

from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval import (
    FileError,
    NoPosesError,
    OptionError,
    TableFormat,
    Trajectory,
    read_columns,
    rotation,
)
from slamhive_eval.formats.columns import parse_columns

TURN = 0.38268343236508984, 0.9238795325112867
"""Sine and cosine of half of 45°."""
MATRIX = "0.7071067811865476 -0.7071067811865476 0 1 0.7071067811865476 0.7071067811865476 0 2 0 0 1 3"
QUATERNION = f"{TURN[0]} {TURN[1]}"
POSE = "tx ty tz qx qy qz qw"


def read(folder: Path, text: str, words: str, times: Path | None = None, **settings: Any) -> Trajectory:
    path = folder / "truth.csv"
    path.write_text(text)
    return read_columns(path, parse_columns(words, **settings), times)


@pytest.mark.parametrize(
    ("line", "words", "settings"),
    [
        # Newer College, and its parkland_mound
        (f"1600000000,123456789,1,2,3,0,0,{TURN[0]},{TURN[1]}", f"sec nsec {POSE}", {}),
        (f"1600000000 123456789  1 2 3 0 0 {QUATERNION}", f"sec nsec {POSE}", {}),
        # MCD
        (f"num,t,x,y,z\n0,1600000000.123456789,1,2,3,0,0,{TURN[0]},{TURN[1]}", f"_ t {POSE}", {"skip": 1}),
        # TUM lines, and quaternions with w first
        (f"# comment\n\n1600000000.123456789 1 2 3 0 0 {QUATERNION}", f"t {POSE}", {}),
        (f"1600000000123456789;1;2;3;{TURN[1]};0;0;{TURN[0]}", "t x y z qw qx qy qz", {"time_unit": "ns"}),
        # MulRan
        ("1600000000123456789," + MATRIX.replace(" ", ","), "t matrix", {"time_unit": "ns"}),
        # NCLT
        ("1600000000123456.789,1,2,3,0,0,0.7853981633974483", "t x y z roll pitch yaw", {"time_unit": "us"}),
        # Boreas: velocities between, and the rotation the other way round
        (
            "t,x\n1600000000123456.789,1,2,3,9,9,9,0,0,-0.7853981633974483,7,7,7",
            "t x y z _ _ _ roll pitch yaw",
            {"time_unit": "us", "skip": 1, "rotation": "Inverse"},
        ),
        (
            "1600000000123.456789 1 2 3 0 0 45",
            "t x y z roll pitch yaw",
            {"time_unit": "ms", "angle_unit": "deg"},
        ),
        # ENWIDE writes stamps in this way
        (f"1.600000000123456789e+09\t1\t2\t3\t0\t0\t{TURN[0]}\t{TURN[1]}", f"t {POSE}", {}),
    ],
)
def test_published_forms_give_one_pose(tmp_path: Path, line: str, words: str, settings: Any) -> None:
    found = read(tmp_path, line + "\n", words, **settings)
    assert found.stamps.tolist() == [1600000000.123456789]
    assert found.positions.tolist() == [[1, 2, 3]]
    assert found.oriented
    turned = rotation.rotate(found.quaternions, np.array([[1.0, 0.0, 0.0]]))
    assert turned[0] == pytest.approx([0.5**0.5, 0.5**0.5, 0], abs=1e-12)
    if found.rotations is not None:
        assert found.rotations[0] @ (1, 0, 0) == pytest.approx(turned[0], abs=1e-12)


def test_positions_alone_and_fillers_are_no_orientations(tmp_path: Path) -> None:
    found = read(tmp_path, "1 4 5 6 0 0 0 1\n2 4 5 6 0 0 0 1\n", "t x y z")
    assert not found.oriented
    assert found.positions.tolist() == [[4, 5, 6]] * 2


def test_frames_get_times_by_rate_or_file(tmp_path: Path) -> None:
    indexed, plain = "1 0 0 0\n3 1 0 0\n", "0 0 0\n1 0 0\n2 0 0\n"
    assert read(tmp_path, indexed, "frame x y z", rate=30, start_time=5).stamps.tolist() == [5 + 1 / 30, 5.1]
    assert read(tmp_path, plain, "x y z", rate=10).stamps.tolist() == [0, 0.1, 0.2]
    times = tmp_path / "times.txt"
    times.write_text("10\n11\n12\n13.5\n")
    assert read(tmp_path, indexed, "frame x y z", times).stamps.tolist() == [11, 13.5]
    with pytest.raises(FileError, match=r"truth.csv, line 2: frame 4 has no stamp; .*times.txt has 4"):
        read(tmp_path, "0 0 0 0\n4 0 0 0\n", "frame x y z", times)
    with pytest.raises(FileError, match=r"line 1: the frame index is 0.5"):
        read(tmp_path, "0.5 0 0 0\n", "frame x y z", rate=1)
    with pytest.raises(OptionError, match="name t or sec, or give the rate"):
        read(tmp_path, plain, "x y z")


def test_poses_too_close_in_time_are_dropped(tmp_path: Path) -> None:
    stamps = [1600000000 + k * 0.01 for k in range(5)] + [1600000000.043, 1600000000.049, 1600000000.06]
    text = "".join(f"{stamp:.9f} 0 0 0\n" for stamp in stamps)
    kept = read(tmp_path, text, "t x y z", min_interval=0.01).stamps - 1600000000
    assert kept == pytest.approx([0, 0.01, 0.02, 0.03, 0.04, 0.06], abs=1e-6)


@given(
    st.lists(st.integers(0, 2 * 10**18), min_size=1, max_size=20, unique=True).map(sorted),
    st.sampled_from(["s", "ms", "us", "ns", "sec nsec"]),
)
def test_times_are_the_nearest_float_however_they_are_written(
    tmp_path_factory: pytest.TempPathFactory, nanoseconds: list[int], unit: str
) -> None:
    folder = tmp_path_factory.mktemp("exact")
    if unit == "sec nsec":
        words, settings = [f"{one // 10**9} {one % 10**9}" for one in nanoseconds], {}
    else:
        shift = {"s": 9, "ms": 6, "us": 3, "ns": 0}[unit]
        words = [f"{Decimal(one).scaleb(-shift):f}" for one in nanoseconds]
        settings = {"time_unit": unit}
    columns = f"{unit if ' ' in unit else 't'} x y z"
    found = read(folder, "".join(f"{word} 1 2 3\n" for word in words), columns, **settings)
    assert found.stamps.tolist() == [float(f"{one // 10**9}.{one % 10**9:09}") for one in nanoseconds]


@given(st.data())
def test_what_is_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Any order of the columns, any delimiter and lines to skip give the same poses."""
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    n = data.draw(st.integers(1, 10))
    values = dict(zip(("tx", "ty", "tz"), random.normal(0, 1e3, (3, n)).tolist(), strict=True))
    values |= dict(zip(("qx", "qy", "qz", "qw"), random.normal(size=(4, n)).tolist(), strict=True))
    values |= {"t": np.cumsum(random.uniform(0.01, 1, n)).tolist(), "_": random.normal(size=n).tolist()}
    columns = data.draw(st.permutations(list(values)))
    delimiter = data.draw(st.sampled_from([",", ";", "\t", " ", ", "]))
    skip = data.draw(st.integers(0, 3))
    rows = zip(*(values[name] for name in columns), strict=True)
    text = "some words\n" * skip + "".join(delimiter.join(map(repr, row)) + "\n" for row in rows)
    given_ = None if data.draw(st.booleans()) else delimiter.strip() or delimiter
    found = read(tmp_path_factory.mktemp("back"), text, " ".join(columns), skip=skip, delimiter=given_)
    assert found.stamps.tolist() == values["t"]
    assert found.positions.T.tolist() == [values[name] for name in ("tx", "ty", "tz")]
    quaternions = np.column_stack([values[name] for name in ("qx", "qy", "qz", "qw")])
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, np.newaxis]
    assert np.abs((found.quaternions * quaternions).sum(axis=1)) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    ("words", "settings", "message"),
    [
        ("t x y", {}, "a position is needed"),
        ("t x y z qxx", {}, "unknown column 'qxx'; did you mean 'qx'"),
        ("t x y z x", {}, "tx is there 2 times"),
        ("t frame x y z", {}, "the time is either t, sec"),
        ("nsec x y z", {}, "the time is either"),
        ("t x y z qx qy qz", {}, "all of them, not qx, qy, qz"),
        ("t x y z qx qy qz qw yaw", {}, "either qx, qy, qz, qw or roll, pitch, yaw"),
        ("t x matrix", {}, "matrix is position and rotation"),
        ("t x y z", {"rate": 30}, "rate: only for frames"),
        ("x y z", {"rate": 0}, "rate: expected a positive number"),
        ("t x y z", {"delimiter": "|"}, "delimiter: expected a comma"),
        ("t x y z", {"skip": -1}, "skip: expected"),
        ("t x y z", {"min_interval": -1}, "minInterval: expected"),
    ],
)
def test_contradictory_formats_are_refused(words: str, settings: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        parse_columns(words, **settings)


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        ("t x y z\n1 2 3 4\n", "t x y z", r"line 1: 't' in the column t is no number; .* skip 1"),
        ("1 a 3 4\n", "t x y z", r"line 1: 'a' in the column tx is no number"),
        ("1 2 3 4\n\n2 2 3\n", "t x y z", r"line 3: found 3 columns of the 4 that t, tx, ty, tz need"),
        ("2 0 0 0\n1 0 0 0\n", "t x y z", r"line 2: time stamp 1\..* comes before"),
        ("1 0 0 inf\n", "t x y z", r"line 1: tz is inf"),
        ("1 0 0 nan\n", "t x y z", r"its only row holds NaN"),
        ("1 0 0 nan\n3 0 0 0\n\n2 0 0 0\n", "t x y z", r"line 4: time stamp 2\..* comes before"),
        ("1 0 0 0 0 0 0 0\n", "t x y z qx qy qz qw", r"line 1: the quaternion is zero"),
        ("1 2 0 0 0 0 1 0 0 0 0 1 0\n", "t matrix", r"line 1: the left 3×3 part is no rotation"),
        ("1 0 0 0 0 0 90\n", "t x y z roll pitch yaw", r"line 1: an angle of 90 rad is beyond a turn"),
        ("1600000000123456789 0 0 0\n", "t x y z", r"line 1: time stamp .*\(nanoseconds perhaps"),
    ],
)
def test_bad_lines_are_named(tmp_path: Path, text: str, words: str, message: str) -> None:
    with pytest.raises(FileError, match=message):
        read(tmp_path, text, words)


def test_rows_of_nan_are_left_out_and_counted(tmp_path: Path) -> None:
    found = read(tmp_path, "1 0 0 0\n2 0 nan 0\n3 4 0 0\n3.1 9 0 0\n", "t x y z", min_interval=0.5)
    assert (found.stamps.tolist(), found.positions[:, 0].tolist()) == ([1, 3], [0, 4])
    assert (found.nan_rows, found.notes) == (1, ("1 of 4 rows holds NaN and was left out",))


def test_a_table_without_rows(tmp_path: Path) -> None:
    with pytest.raises(NoPosesError):
        read(tmp_path, "# only this\n1 2 3 4\n", "t x y z", skip=2)
    with pytest.raises(FileError, match="can't be read"):
        read_columns(tmp_path / "none", TableFormat(("t", "tx", "ty", "tz")))
