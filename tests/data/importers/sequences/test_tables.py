# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest

from slamhive.data.importers.scans import XYZI, make_points
from slamhive.data.importers.tables import ascending, nanoseconds, read_table
from slamhive.model.errors import DataError


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("1599813125.123456789", "s", 1_599_813_125_123_456_789),
        ("1.599813125123456789e+09", "s", 1_599_813_125_123_456_789),
        ("1.0373590e-01", "s", 103_735_900),
        ("1606417097528152", "us", 1_606_417_097_528_152_000),
        ("1561000444390857630", "ns", 1_561_000_444_390_857_630),
        ("0", "s", 0),
    ],
)
def test_times_are_exact(text: str, unit: str, expected: int) -> None:
    assert nanoseconds(text, unit) == expected


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "1e400", "²", "1_0e"])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(ValueError, match="is not a time"):
        nanoseconds(text, "s")


@pytest.mark.parametrize(
    "text",
    [
        "#timestamp [ns],p_x [m], p_y [m]\n5,1,2\n7,3,4\n",
        "time stamp, x position\n5 1 2 9\n\n7 3 4 9\n",
        "5.0e+00, 1.0,\t2\r\n7.0e+00, 3.0, 4\r\n",
    ],
)
def test_heads_and_separators(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text, newline="")
    table = read_table(tmp_path / "a.csv", 2, "t x y", stamp="ns")
    assert table.stamps.tolist() == [5, 7]
    assert table.values.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no rows in it"),
        ("t x y\n", "no rows in it"),
        ("1 2 3\n4 5\n", "line 2: 2 of 3 values; each line must have t x y"),
        ("1 2 3\n4 x 5\n", "line 2: could not convert"),
        ("1 2 3\n4 nan 5\n", "line 2: a value is not a finite number"),
        ("1 2 3\nx 1 5\n", "line 2: 'x' is not a time"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DataError, match=rf"a\.csv.*{words}"):
        read_table(tmp_path / "a.csv", 2, "t x y", stamp="s")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe1")
    with pytest.raises(DataError, match="not a text file"):
        read_table(tmp_path / "b.csv", 2, "t x y")


def test_stamps_that_repeat_or_step_back_are_left_out() -> None:
    stamps, notes = np.arange(40), []
    stamps[[5, 20]] = 4, 0
    kept = ascending(stamps, "a.csv", "poses", notes)
    assert kept.tolist() == [k for k in range(40) if k not in {5, 20}]
    assert notes == [
        (
            "a.csv: 2 of 40 stamps of poses aren't later than those before (the first is number 6): these "
            "poses were left out"
        )
    ]
    stamps[1] = 1000
    with pytest.raises(DataError, match=r"38 of 40 stamps of poses .* stamps must ascend"):
        ascending(stamps, "a.csv", "poses", [])


def test_points_without_a_place_or_a_return_are_left_out() -> None:
    points = np.zeros(5, dtype=XYZI)
    points["x"] = [1, np.nan, 0, np.inf, 3e38]
    points["y"][4] = 3e38
    assert make_points(points)["x"].tolist() == [1]
