# SPDX-License-Identifier: Apache-2.0
"""Decimal numbers in regular text, thousands at a time, each exactly as ``float()`` reads it.

C's reader needs arithmetic of arbitrary length for numbers of 16 digits and more, one number after the other.
Here a number's digits are one integer w below 2⁶⁴, and w / 10ᵐ is divided in double-double arithmetic, whose
error is below 2⁻¹⁰⁰ of it: where the rounding to 53 bits could depend on that, or a number is written in any
other way, ``float()`` itself is asked.

Sources: eight digits in a word, Lemire 2018 (fast_double_parser); exact products, Dekker 1971; why w / 10ᵐ is
right with w below 2⁵³ and m up to 22, Clinger 1990.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray, IndexArray

    Words = npt.NDArray[np.uint64]
    Flags = npt.NDArray[np.bool_]

_WORD = 8
_LONGEST = 3 * _WORD
"""Digits before, or after, the point."""
_LARGEST = 18 * 10**18
"""Digits whose integer is at most this fit 64 bits, rounded to float64 too."""
_LARGEST_POWER = 45
"""10⁴⁵ is the sum of two float64; 10⁴⁶ isn't for certain."""
_EXACT_POWER = 22
"""10²² is a float64."""
_EXACT = np.uint64(1 << 53)
_MARGIN = 2.0**-98
_MOST_ODD = 0.05
"""Share of numbers written otherwise above which C's reader is as fast."""

_SPACE, _TAB, _NEWLINE, _POINT, _MINUS, _PLUS, _LETTER_E, _ZERO = b" \t\n.-+e0"
_FIRST_LETTER, _COMMA = b":,"
_POWERS = np.array([float(10**k) for k in range(_LARGEST_POWER + 1)])
_REMAINDERS = np.array([float(10**k - int(float(10**k))) for k in range(_LARGEST_POWER + 1)])
_INTEGER_POWERS = np.array([10 ** min(k, 19) for k in range(_LONGEST + 1)], dtype=np.uint64)
_LARGEST_WHOLE = np.array([max(_LARGEST // 10**k - 1, 0) for k in range(_LONGEST + 1)], dtype=np.uint64)
_SPLITTER = 2.0**27 + 1.0


class _NumberParts(NamedTuple):
    """Positions of the parts of n numbers in a text, row by row, each of shape (n,).

    Attributes:
        characters: The text, with room before it.
        width: Numbers in a row.
        negative: Whether there is a minus.
        first: Of the digits before the point.
        point: Or where it would be.
        end: Of the digits after the point.
        exponent: What is written behind an e; None where there is no e in the whole text.
    """

    characters: npt.NDArray[np.uint8]
    width: int
    negative: Flags
    first: IndexArray
    point: IndexArray
    end: IndexArray
    exponent: IndexArray | None


def parse_rows(text: bytes) -> FloatArray | None:
    """Numbers of a text with one space or tab between them and one newline after each row.

    Args:
        text: Whole lines, best some 100 kB of them.

    Returns:
        The numbers, shape (rows, columns), each the float64 that ``float()`` makes of it; None for a text
        that isn't regular, has many numbers in unusual form, or something else in it.
    """
    numbers = _find(text)
    if numbers is None:
        return None
    values, odd = _values(numbers)
    where = np.flatnonzero(odd)
    if len(where) > _MOST_ODD * len(values):
        return None
    for k in where:
        begin = int(numbers.first[k]) - int(numbers.negative[k])
        word = text[begin - _LONGEST : int(numbers.end[k]) - _LONGEST + len("e+00")].split()[0]
        if b"_" in word:
            return None
        try:
            values[k] = float(word)
        except ValueError:
            return None
    return values.reshape(-1, numbers.width)


def _find(text: bytes) -> _NumberParts | None:
    """The numbers of a text; None where it is irregular."""
    end_of_text = b"" if text.endswith(b"\n") else b"\n"
    characters = np.frombuffer(b"".join((b"0" * _LONGEST, text, end_of_text)), np.uint8)
    marks = np.flatnonzero((characters <= _SPACE) | (characters == _POINT))
    kinds = characters[marks]
    separators = np.flatnonzero(kinds != _POINT)
    between = kinds[separators]
    ends_row = between == _NEWLINE
    width = int(ends_row.argmax()) + 1
    rows, rest = divmod(len(separators), width)
    blanks = np.count_nonzero(between == _SPACE) + np.count_nonzero(between == _TAB)
    if rest or blanks != len(separators) - rows or np.count_nonzero(ends_row[width - 1 :: width]) != rows:
        return None
    end = marks[separators]
    start = np.concatenate(([_LONGEST], end[:-1] + 1))
    before = marks[separators - 1]
    before[0] = marks[0]
    pointed = (before >= start) & (before < end)
    # More points than numbers with one: two of them in a number.
    if (start == end).any() or np.count_nonzero(pointed) != len(marks) - len(end):
        return None
    point = np.where(pointed, before, end)
    negative = characters[start] == _MINUS
    first = start + negative
    exponent = None
    if characters.max() >= _FIRST_LETTER:
        end, exponent = _exponents(characters, first, end)
        point = np.minimum(point, end)
    return _NumberParts(characters, width, negative, first, point, end, exponent)


def _exponents(
    characters: npt.NDArray[np.uint8], first: IndexArray, end: IndexArray
) -> tuple[IndexArray, IndexArray | None]:
    """Return the ends of the digits, and exponents of a sign and two digits behind them; None without any."""
    letter, sign, tens, units = (characters[end - k].astype(np.intp) for k in (4, 3, 2, 1))
    has = (letter | 32 == _LETTER_E) & ((sign == _MINUS) | (sign == _PLUS)) & (end - 4 > first)
    tens, units = tens - _ZERO, units - _ZERO
    has &= (tens >= 0) & (tens <= 9) & (units >= 0) & (units <= 9)
    if not has.any():
        return end, None
    return np.where(has, end - 4, end), np.where(has, (_COMMA - sign) * (10 * tens + units), 0)


def _values(numbers: _NumberParts) -> tuple[FloatArray, Flags]:
    """Value of each number, and whether it has to be read otherwise."""
    whole_length = numbers.point - numbers.first
    length = np.maximum(numbers.end - numbers.point - 1, 0)
    whole, odd = _integers(numbers.characters, numbers.point, whole_length)
    digits, also = _integers(numbers.characters, numbers.end, length)
    odd |= also | (whole_length + length == 0)
    power = length if numbers.exponent is None else length - numbers.exponent
    if power.min() < 0 or power.max() > _LARGEST_POWER:
        odd |= (power < 0) | (power > _LARGEST_POWER)
        power = np.clip(power, 0, _LARGEST_POWER)
    if whole.any():
        length = np.minimum(length, _LONGEST)
        odd |= whole > _LARGEST_WHOLE[length]
        digits += whole * _INTEGER_POWERS[length]
    digits[odd] = 0
    value, unsure = _divided(digits, power)
    return np.where(numbers.negative, -value, value), odd | unsure


def _integers(characters: npt.NDArray[np.uint8], end: IndexArray, length: IndexArray) -> tuple[Words, Flags]:
    """Integers of so many digits before end, and whether they are something else or above the largest."""
    words = np.ndarray((len(characters) - _WORD + 1,), dtype="<u8", buffer=characters, strides=(1,))
    value, wrong = _words(words, end, length)
    for k in range(1, -(-min(int(length.max()), _LONGEST) // _WORD)):
        which = _some(length > _WORD * k)
        assert which is not None  # noqa: S101 - the longest is
        word, bad = _words(words, end[which] - _WORD * k, length[which] - _WORD * k)
        if k == 2:
            bad |= word >= np.uint64(_LARGEST // 10**16)
        value[which] += word * np.uint64(10 ** (_WORD * k))
        wrong[which] |= bad
    return value, wrong | (length > _LONGEST)


def _words(words: Words, end: IndexArray, length: IndexArray) -> tuple[Words, Flags]:
    """Integers of the last eight of so many digits, and whether there is something else."""
    word = words[end - _WORD] ^ np.uint64(0x3030303030303030)
    shift = np.maximum(8 * _WORD - 8 * length, 0).astype(np.uint64)
    word = (word >> shift) << shift
    wrong = ((word + np.uint64(0x7676767676767676)) | word) & np.uint64(0x8080808080808080)
    word = (word * np.uint64((10 << 8) + 1)) >> np.uint64(8)
    word = ((word & np.uint64(0x00FF00FF00FF00FF)) * np.uint64((100 << 16) + 1)) >> np.uint64(16)
    word = ((word & np.uint64(0x0000FFFF0000FFFF)) * np.uint64((10000 << 32) + 1)) >> np.uint64(32)
    return word, wrong != 0


def _divided(digits: Words, power: IndexArray) -> tuple[FloatArray, Flags]:
    """Digits / 10^power rounded to nearest, and where that isn't certain."""
    near = digits.astype(np.float64)
    divisor = _POWERS[power]
    quotient = near / divisor
    unsure = np.zeros(len(digits), dtype=bool)
    inexact = (digits > _EXACT) | (power > _EXACT_POWER)
    which = _some(inexact)
    if which is not None:
        parts = digits[which], near[which], quotient[which], divisor[which], _REMAINDERS[power[which]]
        quotient[which], unsure[which] = _corrected(*parts)
    return quotient, unsure


def _corrected(
    digits: Words, near: FloatArray, quotient: FloatArray, divisor: FloatArray, remainder: FloatArray
) -> tuple[FloatArray, Flags]:
    """Digits / (divisor + remainder) from near / divisor, and where its last bit isn't certain."""
    rest = (digits - near.astype(np.uint64)).view(np.int64).astype(np.float64)
    product = quotient * divisor
    above, below = _halves(quotient)
    high, low = _halves(divisor)
    error = above * high - product + above * low + below * high + below * low
    change = (near - product - error + rest - quotient * remainder) / divisor
    margin = quotient * _MARGIN
    value = quotient + (change + margin)
    return value, value != quotient + (change - margin)


def _some(flags: Flags) -> IndexArray | slice | None:
    """Indices of the true ones, or of all where most are true: that is faster."""
    count = np.count_nonzero(flags)
    if not count:
        return None
    return slice(None) if 4 * count > 3 * len(flags) else np.flatnonzero(flags)


def _halves(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two numbers of half the digits with the sum of each (Veltkamp)."""
    scaled = _SPLITTER * values
    high = scaled - (scaled - values)
    return high, values - high
