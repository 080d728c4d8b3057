# SPDX-License-Identifier: Apache-2.0
"""Numbers with a decimal comma, as programs of half of Europe write them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive_eval.errors import FileError
from slamhive_eval.formats.column_tables import read_columns
from slamhive_eval.formats.columns import parse_columns
from slamhive_eval.formats.files import read_trajectory

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("split", [";", " ", "\t", "; "])
@pytest.mark.parametrize("form", ["tum", None])
def test_it_is_named_as_such(tmp_path: Path, split: str, form: str | None) -> None:
    path = tmp_path / "a.txt"
    path.write_text("".join(split.join((f"{k},5", "0,1", *"230001")) + "\n" for k in range(3)))
    with pytest.raises(FileError, match=r"line 1: its numbers have a decimal comma; write them with a point"):
        read_trajectory(path, form)


def test_between_values_too_it_is_found_by_their_number(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("".join(f"{k},5," + ",".join(["0,1"] * 7) + "\n" for k in range(3)))
    with pytest.raises(FileError, match="line 1: its numbers have a decimal comma"):
        read_trajectory(path, "tum")
    path.write_text("timestamp,x,y,z,qx,qy,qz,qw\n" + ",".join(["0,5"] * 8) + "\n")
    with pytest.raises(FileError, match="line 2: its numbers have a decimal comma"):
        read_trajectory(path)
    path.write_text("timestamp;x;y;z;qx;qy;qz;qw\n" + ";".join(["0,5"] * 8) + "\n")
    with pytest.raises(FileError, match=r"line 2: '0,5' .* is no number; its numbers have a decimal comma"):
        read_trajectory(path)


def test_a_table_with_it(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("1.5;0,1;2;3;0;0;0;1\n2.5;0,2;2;3;0;0;0;1\n")
    with pytest.raises(
        FileError, match=r"'0,1' in the column tx is no number; its numbers have a decimal comma"
    ):
        read_columns(path, parse_columns("t x y z qx qy qz qw"))


def test_commas_between_values_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("1,0,0,0,0,0,0\n2,0,0,0,0,0,0\n")
    with pytest.raises(FileError, match="found 7 of 8 values"):
        read_trajectory(path, "tum")
