# SPDX-License-Identifier: Apache-2.0
"""Numbers in regular text are float()'s to the last bit; whatever else is in a text is left to others."""

from __future__ import annotations

import math
import struct
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from slamhive_eval.formats import decimals
from slamhive_eval.formats.textfiles import parse_table

FORMATS = ("%r", "%.17g", "%.16g", "%.15f", "%.9f", "%.6f", "%.18e", "%.9e", "%.0f", "%.3E", "%+.4f", "%.25f")


@pytest.fixture(name="no_help", autouse=True)
def no_help_fixture(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many numbers are in unusual form, none is left to C."""
    monkeypatch.setattr(decimals, "_MOST_ODD", 1.0)


def bits(numbers: np.ndarray) -> list[int]:
    return np.ascontiguousarray(numbers).view(np.int64).ravel().tolist()


def read(words: list[str]) -> list[int]:
    found = decimals.parse_rows("\n".join(words).encode())
    assert found is not None
    assert found.shape == (len(words), 1)
    return bits(found)


def exact(words: list[str]) -> list[int]:
    return [struct.unpack("<q", struct.pack("<d", float(word)))[0] for word in words]


def midpoint(value: float) -> str:
    """The decimal number half-way to the next float, where it is one of few digits."""
    between = (Fraction(value) + Fraction(math.nextafter(value, math.inf))) / 2
    scaled = between * 10**22
    return (
        f"{scaled.numerator // 10**22}.{scaled.numerator % 10**22:022d}" if scaled.denominator == 1 else "1"
    )


usual = st.one_of(st.floats(-1e10, 1e10), st.floats(-1, 1), st.integers(-(10**19), 10**19).map(float))
digits = st.text("0123456789", min_size=1, max_size=24)
written = st.one_of(
    st.builds(lambda form, value: form % value, st.sampled_from(FORMATS), usual),
    st.floats(allow_nan=False).map(repr),
    st.builds(lambda a, b: f"{a}.{b}", digits, digits),
    st.builds(lambda a, b, e: f"-{a}.{b}e{e:+03d}", digits, digits, st.integers(-40, 40)),
    digits,
    st.floats(2**20, 2**60).map(midpoint),
    st.sampled_from(("-0", "0.0", "-.5", "7.", "1e5", "1E-300", "inf", "-Infinity", "1e400", "+3", "1e-5")),
)


@given(st.lists(written, min_size=1, max_size=40))
@example(["9007199254740993", "9007199254740995", "90071992547409.93", "0.500000000000000055511"])
@example(["18000000000000000000", "18446744073709551615", "18446744073709551616", "99999999999999999999"])
@example(["1.7999999999999999999", "1799.9999999999999999", "1800.0000000000000000", "0.1800000000000000000"])
def test_every_bit_is_that_of_float(words: list[str]) -> None:
    assert read(words) == exact(words)


def test_many_numbers_of_all_lengths(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decimals, "_MOST_ODD", 0.001)
    rng = np.random.default_rng(1)
    values = np.column_stack(
        (rng.uniform(1.4e9, 1.7e9, 20_000), rng.normal(0, 100, 20_000), rng.uniform(-1, 1, 20_000))
    )
    for form in ("%.17g", "%.18e", "%.16g", "%.9f"):
        words = [form % value for value in values.ravel()]
        text = "\n".join(" ".join(words[k : k + 3]) for k in range(0, len(words), 3))
        found = decimals.parse_rows(text.encode())
        assert found is not None, form
        assert found.shape == values.shape
        assert bits(found) == exact(words)


WRONG = "1_0 1.2.3 .. . - --1 -+1 e-05 .e-05 1e 1e- 0x10 1,5 é 1/2 1:2 # 1# 5e-0. 1e-055e-05 nan0 ١ 11111111x"


@pytest.mark.parametrize("word", WRONG.split())
def test_what_is_no_number(word: str) -> None:
    assert decimals.parse_rows(f"1.5 2.5\n3.5 {word}\n".encode()) is None
    assert decimals.parse_rows(f"{word} 2.5\n".encode()) is None


IRREGULAR = (
    "1 2|3",
    "1  2|3  4",
    " 1 2",
    "1 2 ",
    "1 2||3 4",
    "1 2|3|4 5 6",
    "1\f2",
    "1|2 3",
    "",
    "|",
    " ",
    "1 2|# a|3 4",
)


@pytest.mark.parametrize("text", IRREGULAR)
def test_irregular_text(text: str) -> None:
    assert decimals.parse_rows(text.replace("|", "\n").encode()) is None


def test_unusual_numbers_are_left_to_c(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    assert decimals.parse_rows(b"1e-100 2\n3 4\n") is None
    assert decimals.parse_rows(b"1e-100 2\n" + b"3 4\n" * 20) is not None


def test_text_in_several_blocks_regular_and_not() -> None:
    rng = np.random.default_rng(2)
    rows = rng.normal(0, 10, (40_000, 3))
    lines = [f"{a:.17g} {b:.9f} {c!r}" for a, b, c in rows.tolist()]
    expected = exact(" ".join(lines).split())
    lines[0] = "# head\n# of two lines\n" + lines[0]
    lines[30_000] = "  " + lines[30_000].replace(" ", " \t ") + "  # remark"
    found = parse_table("file", "\n".join(lines).encode(), 3, "three numbers")
    assert bits(found) == expected
