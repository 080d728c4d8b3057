# SPDX-License-Identifier: Apache-2.0
"""CSV: nothing in it is a formula, and everything in it can be read back."""

from __future__ import annotations

import csv
import io
import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive_eval.formats.csv_writing import csv_blocks, csv_text, write_csv

ROOT = Path(__file__).parents[3]
SIGNS = ("=", "+", "-", "@", "\t", "\r", "\n")


def read(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text, newline="")))


@pytest.mark.parametrize(
    "text", ['=HYPERLINK("http://x","y")', "+1+2", "-2+3", "@SUM(A1)", "\t=1", "\r=1", "-inf"]
)
def test_texts_that_a_spreadsheet_would_compute_are_defused(text: str) -> None:
    assert read(csv_text({text: [text]})) == [["'" + re.sub(r"\s", " ", text)], [f"'{text}"]]


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (-0.1, "-0.1"),
        (-1e-300, "-1e-300"),
        (-5, "-5"),
        ("-5", "-5"),
        ("+1.5e-3", "+1.5e-3"),
        (math.nan, ""),
        (-math.inf, ""),
        (None, ""),
        (True, "true"),
        (["=1"], '["=1"]'),
        ("a=b", "a=b"),
        ("–", "–"),
    ],
)
def test_numbers_and_other_values_stay_as_they_are(value: object, written: str) -> None:
    assert read(csv_text({"x": [value, 1]}))[1] == [written]


@given(st.lists(st.text(st.sampled_from([*SIGNS, "'", ",", '"', "1", "a"])), min_size=1, max_size=5))
def test_all_texts_are_had_back(texts: list[str]) -> None:
    """By the rule of the documentation: one ``'`` goes from what begins with such signs behind ``'``."""
    columns = csv_text({"x": [1] * len(texts), "text": texts})
    found = [row[1] for row in read(columns)[1:]]
    assert [re.sub(r"^'(?='*[=+\-@\t\r\n])", "", text) for text in found] == texts
    assert not any(text.startswith(SIGNS) and not re.fullmatch(r"[+-][\d.]+", text) for text in found)


_VALUES = (st.none(), st.booleans(), st.integers(), st.floats(), st.text(st.sampled_from("=-1a,")))
_COLUMN = st.one_of(st.lists(kind, min_size=4, max_size=4) for kind in (*_VALUES, st.one_of(*_VALUES)))


@given(st.lists(_COLUMN, min_size=1, max_size=4))
def test_a_table_is_the_same_by_columns_by_rows_and_in_blocks(columns: list[list[object]]) -> None:
    names = [f"c{number}" for number in range(len(columns))]
    by_rows = io.StringIO()
    write_csv(by_rows, names, zip(*columns, strict=True))
    assert csv_text(dict(zip(names, columns, strict=True))) == by_rows.getvalue()
    halves = [[column[:2] for column in columns], [column[2:] for column in columns]]
    assert "".join(csv_blocks(names, halves)) == by_rows.getvalue()


def test_no_other_code_writes_tables() -> None:
    files = [*ROOT.glob("operator/slamhive/**/*.py"), *ROOT.glob("evaluator/**/*.py")]
    writing = [path.name for path in files if re.search(r"csv\.(writer|DictWriter)\(", path.read_text())]
    assert writing == ["csv_writing.py"]
