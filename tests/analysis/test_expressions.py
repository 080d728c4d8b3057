# SPDX-License-Identifier: Apache-2.0
"""Conditions: what they mean, and what they say when they can't be understood."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.analysis import ExpressionError, Frame, expressions, parse_where
from slamhive.analysis.columns import Column

ROW = {
    "run": 126,
    "algorithm": "orb-slam2",
    "ate.rmse": 0.0125,
    "rpe[0].rmse": 0.5,
    "parameters.nFeatures": 1000,
    "parameters.ORBextractor.nLevels": 8,
    "parameters.loop": True,
    "parameters.min-dist": 30,
    "label.run": "126",
    "message": "it's",
    "tags": "robust_kernel, v2",
    "scale": None,
    "unset": None,
}


def frame_of(row: dict[str, Any]) -> Frame:
    return Frame({name: Column.of([value]) for name, value in row.items()}, 1)


def holds(text: str) -> bool:
    return bool(parse_where(text, ROW).mask(frame_of(ROW))[0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("run in (126, 141)", True),
        ("run not in (126, 141,)", False),
        ("run in (1, 'x', null)", False),
        ("label.run in (126, 141)", True),
        ("label.run == 126 and label.run < 127", True),
        ("label.run == '126'", True),
        ("parameters.nFeatures < 1000", False),
        ("500 < parameters.nFeatures <= 1e3", True),
        ("500 < parameters.nFeatures < 900", False),
        ("rpe[0].rmse >= .5", True),
        ("parameters.ORBextractor.nLevels == 8", True),
        ("`parameters.min-dist` = 30", True),
        ("algorithm == 'orb-slam2' AND NOT run == 5", True),
        ('algorithm <> "kiss-icp"', True),
        (r"message == 'it\'s'", True),
        ("run == 5 or run == 126 and algorithm == 'x'", False),
        ("(run == 126 or run == 5) and algorithm != 'x'", True),
        ("not (run == 5)", True),
        ('algorithm contains SLAM2 and message contains "T\'S"', True),
        ("(algorithm not contains slam)", False),
        ("run contains 26 and not scale contains 1", True),
        ("tags contains robust or tags contains 'v2, Robust'", False),
        ("tags contains ROBUST_KERNEL and tags contains v2", True),
        ("not run == 5 and run == 126", True),
        ("parameters.loop", True),
        ("parameters.loop == true", True),
        ("scale < 5 or scale >= 5", False),
        ("scale == null and scale is null", True),
        ("scale is not null", False),
        ("scale != 5", True),
        ("run > -1", True),
        ("ate.rmse < parameters.nFeatures", True),
        ("algorithm < 5", False),
        ("  run==126\n", True),
    ],
)
def test_meaning(text: str, expected: bool) -> None:
    assert holds(text) is expected


def test_a_column_that_a_row_lacks_is_null() -> None:
    condition = parse_where("scale is null", ["scale"])
    assert condition.mask(Frame({}, 1)).tolist() == [True]
    assert condition.mask(frame_of({"scale": 1})).tolist() == [False]


def test_the_last_part_of_a_name_is_enough_where_it_is_clear() -> None:
    rows = frame_of(ROW)
    for text in ("nFeatures == 1000", "nLevels == 8 and loop", "`min-dist` == 30"):
        assert parse_where(text, ROW).mask(rows).tolist() == [True]
    twice = {**ROW, "metrics.nFeatures": 5}
    assert parse_where("nFeatures == 1000", twice).mask(frame_of(twice)).tolist() == [True]  # a setting first
    with pytest.raises(ExpressionError, match=r"'rmse' may be ate.rmse, rpe.0..rmse; write which"):
        parse_where("rmse < 1", ROW)


@pytest.mark.parametrize(
    ("text", "position", "problem"),
    [
        ("", 0, "expected a column, a number or a text in quotes, found the end"),
        ("parameters.nFeature < 5", 0, "unknown column 'parameters.nFeature'; did you mean"),
        ("algorithm == orbslam", 13, "unknown column 'orbslam'"),
        ("algorithm == zzz", 13, "a text stands in quotes"),
        ("run in (1, abc)", 11, "expected a number or a text in quotes, found the name 'abc'"),
        ("run in ()", 8, r"found '\)'"),
        ("run in 5", 7, r"expected '\(', found '5'"),
        ("run in (5", 9, r"expected '\)', found the end"),
        ("(run == 5", 9, r"expected '\)', found the end"),
        ("run == 5)", 8, "expected 'and', 'or' or the end"),
        ("run not 5", 8, "expected 'in' or 'contains' after 'not'"),
        ("algorithm contains", 18, "expected a word or a text in quotes after 'contains'"),
        ("algorithm contains (x)", 19, "expected a word or a text in quotes after 'contains'"),
        ("algorithm contains orb-slam", 19, "more than letters, digits and _ stands in quotes"),
        ("scale is 5", 9, "expected 'null' after 'is'"),
        ("run == 5 run", 9, "expected 'and', 'or' or the end"),
        ("algorithm == 'x", 13, "the quote ' is never closed"),
        ("run == 5x", 7, "not a number"),
        ("run @ 5", 4, "unexpected '@'"),
        ("parameters.min-dist > 1", 0, "unknown column 'parameters.min'"),
        ("run == --5", 8, "expected a column"),
        ("run == -'x'", 8, "expected a column"),
        ("__import__('os').system('true')", 16, r"unexpected '\.'"),
        ("__import__('os')", 0, "unknown column '__import__'"),
        ("run == (1)", 7, "expected a column"),
        ("(" * 60 + "run", 50, "nested more than 50 deep"),
        ("not " * 60 + "run", 200, "nested more than 50 deep"),
        ("x" * 10_001, 0, "may have 10000 characters"),
    ],
)
def test_mistakes_are_named_where_they_are(text: str, position: int, problem: str) -> None:
    with pytest.raises(ExpressionError, match=problem) as caught:
        parse_where(text, ROW)
    assert caught.value.position == position
    if len(text) < 60:
        sentence, line, caret = str(caught.value).split("\n")
        assert f"character {position + 1}:" in sentence
        assert line == f"  {text}"
        assert caret.index("^") == position + 2


@given(st.text(alphabet="run().'\"<=>!andoritn 0123456789,-`[]\\é\n", max_size=40))
def test_any_text_is_a_condition_or_a_mistake(text: str) -> None:
    try:
        condition = parse_where(text, ROW)
    except ExpressionError:
        return
    assert condition.mask(frame_of(ROW)).tolist() in ([True], [False])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("run == " + "1" * 5000, "a number may have 300 digits, this one has 5000"),
        ("1" * 9999 + "x", "not a number"),
        ("run in (" + "9," * 500 + "9)", "a condition may hold 500 numbers and texts"),
        ("run == 1" + " or run == 1" * 500, "a condition may"),
        ("run" + " or run" * 500, "a condition may name columns 500 times"),
    ],
)
def test_what_would_cost_too_much_is_refused(text: str, words: str) -> None:
    with pytest.raises(ExpressionError, match=words):
        parse_where(text, ROW)


def test_five_hundred_literals_are_allowed() -> None:
    assert holds("run in (" + ", ".join(str(k) for k in range(500)) + ")")


def test_a_long_number_is_read_in_linear_time(monkeypatch: pytest.MonkeyPatch) -> None:
    # In quadratic time this would take hours.
    monkeypatch.setattr(expressions, "MAX_LENGTH", 10**7)
    for text in ("1" * 2_000_000 + "x", "1." + "1" * 2_000_000 + "x", "1e" + "1" * 2_000_000 + "x"):
        with pytest.raises(ExpressionError, match="not a number"):
            parse_where(text, ROW)
