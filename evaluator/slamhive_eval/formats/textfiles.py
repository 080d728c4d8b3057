# SPDX-License-Identifier: Apache-2.0
"""Text files of numbers: what is in them, plain or compressed, and on which line it is wrong.

Regular text is read by `slamhive_eval.formats.decimals`, other text by numpy's C reader; only when that
refuses, or a value turns out wrong, is the text gone through line by line to name the line.
"""

from __future__ import annotations

import bz2
import gzip
import io
import itertools
import re
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive_eval.errors import FileError, NoPosesError
from slamhive_eval.formats.decimals import parse_rows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive_eval.rotation import FloatArray, IndexArray

_BLOCK = 1 << 19
"""Bytes that are turned into numbers at once: what comes of them stays in the processor's cache."""
_KEPT_BYTES = 16 << 20
_HEAD = 1 << 14
_LONGEST_WORD = 30
_COMMA_NUMBER = re.compile(r"(?:^|[;\s])[-+]?\d+,\d+(?:[eE][-+]?\d+)?(?=[;\s]|$)")
_QUOTED = re.compile(r'"[^"]*"')
DECIMAL_COMMA = "its numbers have a decimal comma; write them with a point, as 1.5"
"""Sentence on a line of `has_decimal_comma`."""
_GZIP, _BZIP2, _ZIP = b"\x1f\x8b", b"BZh", b"PK\x03\x04"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_SEPARATORS = str.maketrans(",;", "  ")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def read_bytes(path: str | Path) -> bytes:
    """The UTF-8 text of a file, uncompressed, with lines ending in a newline only.

    Raises:
        FileError: The file can't be read, its compressed data is broken, or it holds no text.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise FileError(path, f"can't be read: {error.strerror or error}") from error
    try:
        if data.startswith(_GZIP):
            data = gzip.decompress(data)
        elif data.startswith(_BZIP2):
            data = bz2.decompress(data)
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise FileError(path, f"the compressed data is broken or cut off ({error})") from error
    if data.startswith(_UTF16):
        data = data.decode("utf-16", errors="replace").encode()
    if data.startswith(_ZIP):
        raise FileError(path, "is a ZIP archive; unpack it, and name the files in it")
    if b"\0" in data:
        raise FileError(path, "is no text file (it holds zero bytes)")
    data = data.removeprefix(_BYTE_ORDER_MARK)
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def decode(data: bytes) -> str:
    """The text; what is no UTF-8 becomes question marks, for a comment may hold anything."""
    return data.decode("utf-8", errors="replace")


def head(data: bytes) -> str:
    """The beginning of a text, up to a line with data at least."""
    end = data.rfind(b"\n", 0, _HEAD) + 1
    text = decode(data[:end])
    return text if next(data_lines(text), None) else decode(data)


def lines_of(text: str) -> Iterator[str]:
    """Lines of a text one by one; StringIO would copy all of it first, in four bytes a character."""
    start = 0
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        yield text[start:end]
        start = end + 1


def data_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines that hold something, without comments, numbered from 1."""
    for number, line in enumerate(lines_of(text), start=1):
        content = line.split("#", 1)[0].strip()
        if content:
            yield number, content


def parse_table(
    path: str | Path, data: bytes, columns: int, meaning: str, *, extra: bool = False
) -> FloatArray:
    """Numbers of a text, one row a line; commas and semicolons count as white space, ``#`` begins a comment.

    Args:
        path: Named in errors.
        data: The whole text, see read_bytes.
        columns: Numbers a line must hold.
        meaning: What they are, for errors.
        extra: Whether further columns may follow.

    Returns:
        The numbers, shape (n, columns), n ≥ 1; NaN and infinity pass.

    Raises:
        NoPosesError: No line with numbers.
        FileError: A line of another length, or something that is no number.
    """
    first = next(data_lines(head(data)), None)
    if first is None:
        raise NoPosesError(path)
    if columns > 2 and has_decimal_comma(first[1]):
        # Halves of numbers could be as many as there should be numbers; 1,2 are two where two should be.
        raise FileError(path, f"{DECIMAL_COMMA}; expected {meaning}", first[0])
    try:
        table = _numbers(data, separated=is_separated(first[1]))
    except ValueError:
        table = np.empty((0, 0))
    if not len(table) or table.shape[1] < columns or (table.shape[1] > columns and not extra):
        _raise_bad_line(path, decode(data), columns, meaning, extra=extra)
        raise FileError(path, f"can't be read as lines of {columns} numbers: {meaning}")
    return table[:, :columns]


def _numbers(data: bytes, *, separated: bool) -> FloatArray:
    """All numbers of a text, block by block, for a buffer of all of it is as large as the text again.

    Raises:
        ValueError: Something is no number, or lines differ in length.
    """
    parts: list[FloatArray] = []
    start = 0
    if len(data) > _BLOCK:
        # Once it has freed so much, glibc keeps smaller pieces instead of giving them back to the system,
        # which would have to clear the temporary arrays of each block anew: that takes as long as parsing.
        np.empty(_KEPT_BYTES, np.uint8)
    while start < len(data):
        end = data.find(b"\n", start + _BLOCK) + 1 or len(data)
        found = _block(data[start:end], separated=separated)
        start = end
        if len(found):
            parts.append(found)
    if not parts:
        return np.empty((0, 0))
    if len({part.shape[1] for part in parts}) > 1:
        raise ValueError("lines of different lengths")
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _block(block: bytes, *, separated: bool) -> FloatArray:
    if separated:
        block = block.replace(b",", b" ").replace(b";", b" ")
    begin = 0
    while block.startswith(b"#", begin):
        begin = block.find(b"\n", begin) + 1 or len(block)
    found = parse_rows(block[begin:])
    if found is not None:
        return found
    text = io.TextIOWrapper(io.BytesIO(block), encoding="utf-8", errors="replace")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a block without numbers
        return np.loadtxt(text, dtype=np.float64, ndmin=2)


class KnownRows(NamedTuple):
    """Rows of a table that hold poses: those with NaN are left out and counted.

    Attributes:
        rows: Their indices, ascending, shape (m,).
        left_out: How many others there are.
        notes: A sentence on those, if any.
    """

    rows: IndexArray
    left_out: int = 0
    notes: tuple[str, ...] = ()


def known_rows(path: str | Path, *columns: FloatArray) -> KnownRows:
    """Return the rows of a table, given by arrays of shape (n,) or (n, k), that hold no NaN.

    Raises:
        FileError: All hold one.
    """
    count = len(columns[0])
    with np.errstate(all="ignore"):
        # A sum is NaN where one of the numbers is; looking at each takes ten times as long.
        suspect = [one.reshape(count, -1) for one in columns if np.isnan(one.sum())]
    unknown = np.zeros(count, dtype=bool)
    for one in suspect:
        unknown |= np.isnan(one).any(axis=1)
    index = np.flatnonzero(~unknown)
    left_out = count - len(index)
    if not left_out:
        return KnownRows(index)
    if not len(index):
        raise FileError(
            path, f"{'its only row holds' if count == 1 else f'all {count} rows hold'} NaN: no pose"
        )
    hold, were = ("holds", "was") if left_out == 1 else ("hold", "were")
    return KnownRows(index, left_out, (f"{left_out} of {count} rows {hold} NaN and {were} left out",))


def fault_in_row(path: str | Path, data: bytes, row: int, message: str, skipped: int = 0) -> FileError:
    """The error for data row ``row`` (from 0) below some lines, naming the line of the text it stands on."""
    lines = (number for number, _ in data_lines(decode(data)) if number > skipped)
    return FileError(path, message, next(itertools.islice(lines, row, None), None))


def is_number(word: str) -> bool:
    """Tell whether numpy and C take a word for a number."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word


def is_separated(line: str) -> bool:
    """Tell whether commas or semicolons separate the words of a line."""
    return "," in line or ";" in line


def words_of(line: str) -> list[str]:
    """Words of a line without named columns, where commas and semicolons separate as white space does."""
    return line.translate(_SEPARATORS).split()


def shorten(word: str) -> str:
    """A word as an error quotes it."""
    return repr(word if len(word) <= _LONGEST_WORD else word[:_LONGEST_WORD] + "…")


def has_decimal_comma(line: str, columns: int | None = None) -> bool:
    """Tell whether numbers of a line have a comma for the point.

    Args:
        line: The line.
        columns: The values it should hold, where commas may stand between them too: then numbers have none
            for the point, and there are too many of them, at most twice as many.
    """
    if _COMMA_NUMBER.search(line) is not None:
        return True
    plain = _QUOTED.sub("", line)
    return columns is not None and "." not in plain and columns < len(plain.split(",")) <= 2 * columns


def _raise_bad_line(path: str | Path, text: str, columns: int, meaning: str, *, extra: bool) -> None:
    separated: bool | None = None
    for number, content in data_lines(text):
        words = words_of(content)
        # As the numbers were read: what the first line doesn't separate by is part of a word.
        separated = separated or (separated is None and is_separated(content))
        if len(words) != columns and has_decimal_comma(content, columns):
            raise FileError(path, f"{DECIMAL_COMMA}; expected {meaning}", number)
        if len(words) < columns or (len(words) > columns and not extra):
            raise FileError(path, f"found {len(words)} of {columns} values; expected {meaning}", number)
        for word in words if separated else content.split():
            if not is_number(word):
                raise FileError(path, f"{shorten(word)} is no number; expected {meaning}", number)
