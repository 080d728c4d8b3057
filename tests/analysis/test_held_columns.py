# SPDX-License-Identifier: Apache-2.0
"""Columns mean the same however they are held: numbers by codes, texts as one array."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.compact import growing
from slamhive.analysis.compact.texts import PackedTexts

MANY = 600
HELD: list[tuple[list[Any], bool]] = [
    ([(500, 1000, None)[k % 3] for k in range(MANY)], True),
    ([(0.5, -1.5, 2.0)[k % 3] for k in range(MANY)], True),
    ([k % 2 == 0 for k in range(MANY)], True),
    ([k / 7 for k in range(MANY)], False),
    ([(-0.0, 1.0)[k % 2] for k in range(MANY)], False),  # as a code it would lose its sign
    ([f"run-{k:03d}" for k in range(MANY)], True),
    ([f"läuft-{k}" for k in range(MANY)], True),
    ([f"run-{k % 500}" if k % 7 else None for k in range(MANY)], True),
]


@pytest.mark.parametrize(("values", "coded"), HELD)
def test_values_come_back(values: list[Any], coded: bool) -> None:
    column = Column.of(values)
    assert column.is_coded == coded
    halves = [Column.of(values[:250]), Column.of(values[250:])]
    for found in (column, Column.concatenate(halves), column.take(np.arange(MANY))):
        assert [repr(one) for one in found.tolist()] == [repr(one) for one in values]
        codes, different = found.factorized()
        assert [different[code] for code in codes.tolist()] == values
        assert found.present.tolist() == [value is not None for value in values]
        order = np.lexsort([np.arange(MANY), found.ranks()]).tolist()
        assert order == sorted(range(MANY), key=lambda k: (values[k] is None, values[k] or 0))
        assert np.array_equal(found.marks(), column.marks())


def test_texts_of_one_array_are_found_and_others_are_not() -> None:
    names = [f"run-{k}" for k in range(MANY)]
    column = Column.of(names)
    assert isinstance(column.values, PackedTexts)
    assert (column.values.index("run-7"), "run-7" in column.values, "run-x" in column.values) == (
        7,
        True,
        False,
    )
    assert np.flatnonzero(column.among(["run-3", "run-3\0", "ü", 5, None])).tolist() == [3]
    with pytest.raises(ValueError, match="none of the texts"):
        column.values.index("run")


@pytest.mark.parametrize("texts", [["a", "b\0"], ["ü", "b"], ["a" * 10_000, "b"]])
def test_texts_that_do_not_fit_in_an_array_stay_as_they_are(texts: list[str]) -> None:
    assert PackedTexts.of(texts) is None


def test_a_few_long_texts_do_not_make_all_others_take_their_room() -> None:
    long = [f"{k:03d}" + "x" * 3000 for k in range(MANY)]
    short = [f"run-{k}" for k in range(20 * MANY)]
    columns = [Column.of(long), Column.of(short)]
    assert all(isinstance(column.values, PackedTexts) for column in columns)
    found = Column.concatenate(columns)
    assert not isinstance(found.values, PackedTexts)
    assert found.tolist() == long + short


def test_long_texts_look_the_same_however_they_are_held() -> None:
    texts = [f"{k:03d}" + "x" * 300 for k in range(MANY)]
    many, few = Column.of(texts), Column.of(texts[:5])
    assert (isinstance(many.values, PackedTexts), isinstance(few.values, PackedTexts)) == (True, False)
    assert many.marks()[:5].tolist() == few.marks().tolist()


@pytest.mark.parametrize(("values", "coded"), HELD)
def test_a_column_grows_in_its_memory_and_stays_what_it_was(
    values: list[Any], coded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(growing, "LARGE", 100)
    begun = Column.concatenate([Column.of(values[:300]), Column.of(values[300:560])])
    grown = Column.concatenate([begun, Column.of(values[560:])])
    other = Column.concatenate([begun, Column.of(values[:40])])
    for found, wanted in ((begun, values[:560]), (grown, values), (other, values[:560] + values[:40])):
        assert [repr(one) for one in found.tolist()] == [repr(one) for one in wanted]
    if not coded:
        assert np.shares_memory(begun.numbers, grown.numbers)
        assert not np.shares_memory(begun.numbers, other.numbers)
