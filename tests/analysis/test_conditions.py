# SPDX-License-Identifier: Apache-2.0
"""A condition means the same for a table of one row and for a large one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.analysis.columns import Column, ColumnKind, times
from slamhive.analysis.conditions import Membership, Name
from slamhive.analysis.expressions import parse_where
from slamhive.analysis.frame import Frame

TABLE: dict[str, list[Any]] = {
    "number": [1.5, None, -2.0, 0.0, 1e300],
    "integer": [1, 2, None, 0, 1000],
    "flag": [True, False, None, True, False],
    "text": ["a", "1", None, "", "1e3"],
    "mixed": [1, "1", True, None, [1, 2]],
    "nothing": [None, None, None, None, None],
}
LITERALS = ("1", "1.5", "-2", "0", "1e3", "'a'", "'1'", "''", "'1.5'", "true", "false", "null", "1e300")

operands = st.sampled_from([*TABLE, *LITERALS])
comparisons = st.one_of(
    st.tuples(operands, st.sampled_from(["==", "!=", "<", "<=", ">", ">="]), operands).map(" ".join),
    st.tuples(operands, st.sampled_from(["is null", "is not null"])).map(" ".join),
    st.tuples(
        operands, st.sampled_from(["in", "not in"]), st.lists(st.sampled_from(LITERALS), min_size=1)
    ).map(lambda parts: f"{parts[0]} {parts[1]} ({', '.join(parts[2])})"),
    operands,
    st.lists(operands, min_size=3, max_size=3).map(" < ".join),
)
conditions = st.recursive(
    comparisons,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(" ".join),
        inner.map(lambda text: f"not ({text})"),
    ),
    max_leaves=5,
)


def frame() -> Frame:
    return Frame({name: Column.of(values) for name, values in TABLE.items()}, 5)


@given(conditions)
def test_a_mask_is_what_each_row_says(text: str) -> None:
    node = parse_where(text, TABLE)
    rows = [Frame({name: Column.of([values[k]]) for name, values in TABLE.items()}, 1) for k in range(5)]
    assert node.mask(frame()).tolist() == [bool(node.mask(row)[0]) for row in rows]


@given(st.sampled_from([*TABLE]), st.lists(st.sampled_from(LITERALS), min_size=1))
def test_being_one_of_several_is_to_equal_one(name: str, literals: list[str]) -> None:
    one_of = parse_where(f"{name} in ({', '.join(literals)})", TABLE)
    equal = parse_where(" or ".join(f"{name} == {literal}" for literal in literals), TABLE)
    assert one_of.mask(frame()).tolist() == equal.mask(frame()).tolist()


class Counted(float):
    """A number that counts how often it is compared."""

    count = 0
    __hash__ = float.__hash__

    def __eq__(self, other: object) -> bool:
        Counted.count += 1
        return float.__eq__(self, other)  # type: ignore[arg-type]


def test_values_are_looked_up_and_not_compared_with_each() -> None:
    held = Frame({"seed": Column.of([k + 0.5 for k in range(1000)])}, 1000)
    node = Membership(Name("seed"), tuple(Counted(k + 0.25) for k in range(500)), negated=False)
    assert not node.mask(held).any()
    assert Counted.count < 10_000


def test_times_compare_as_their_texts() -> None:
    column = times(["2026-01-02T03:04:05.25", None])
    held = Frame({"started": column}, 2)
    for text, expected in (("started > '2026-01-02'", [True, False]), ("started is null", [False, True])):
        assert parse_where(text, held.names).mask(held).tolist() == expected


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([1, None, 3], ColumnKind.INTEGER),
        ([1, 2.5, None], ColumnKind.NUMBER),
        ([True, None], ColumnKind.BOOLEAN),
        (["a", None, "b", "a"], ColumnKind.TEXT),
        ([1, "a"], ColumnKind.OTHER),
        ([1, True, 1.0], ColumnKind.OTHER),
        ([[1], [1], {"a": 1}, None], ColumnKind.OTHER),
        ([2**60, 1], ColumnKind.OTHER),
        ([None, None], ColumnKind.NUMBER),
        ([], ColumnKind.NUMBER),
    ],
)
def test_columns_give_back_what_they_got(values: list[Any], kind: ColumnKind) -> None:
    column = Column.of(values)
    assert column.kind is kind
    assert column.tolist() == values
    if kind is not ColumnKind.NUMBER:
        assert list(map(type, column.tolist())) == list(map(type, values))
    half = len(values) // 2
    both = Column.concatenate([Column.of(values[:half]), Column.missing(1), Column.of(values[half:])])
    assert both.tolist() == [*values[:half], None, *values[half:]]
    if values:
        assert column.take(np.array([len(values) - 1, 0])).tolist() == [values[-1], values[0]]


def test_numbers_that_are_none_are_missing() -> None:
    assert Column.of([float("nan"), float("inf"), 1.0]).tolist() == [None, None, 1.0]


@pytest.mark.parametrize("values", list(TABLE.values()))
def test_factorized_values_stand_for_the_rows(values: list[Any]) -> None:
    codes, distinct = Column.of(values).factorized()
    assert [distinct[code] for code in codes] == values
