# SPDX-License-Identifier: Apache-2.0
"""Records as lines of a log that may lose, cut or mix lines, and back: pure, for Jobs and the operator.

A line is ``@slamhive SEQ/TOTAL CRC32HEX JSON``: SEQ counts records from 0, TOTAL is their number, the CRC is
that of the JSON text in ASCII. A container runtime cuts lines at 16 KiB, so a record that doesn't fit into
one line is spread over several of the same SEQ, whose JSON is ``[k, n, "piece k of n of the record's JSON"]``
instead of an object. Lines of anything else, damaged lines and repeated lines do no harm.
"""

from __future__ import annotations

import json
import re
import zlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

LINE_BYTES = 15_000
"""No line is longer than this, its end included."""

_HEAD_BYTES = 64
_PIECE_CHARACTERS = (LINE_BYTES - 2 * _HEAD_BYTES) // 2
"""A quote or backslash in a piece takes two bytes in its line."""
# A log read with its times has them in front.
_LINE = re.compile(r"(?:\d{4}-\d\d-\d\dT\S+ )?@slamhive (\d{1,7})/(\d{1,7}) ([0-9a-f]{8}) (.+)")


def encode(sequence: int, total: int, record: Mapping[str, Any]) -> str:
    """Return a record as lines, each ended.

    Args:
        sequence: its number, from 0.
        total: how many records there are.
        record: the record: plain JSON values.

    Raises:
        ValueError: it holds what JSON can't say, such as a number that is not finite.
    """
    text = json.dumps(record, allow_nan=False, separators=(",", ":"))
    if _HEAD_BYTES + len(text) <= LINE_BYTES:
        return _line(sequence, total, text)
    pieces = [text[at : at + _PIECE_CHARACTERS] for at in range(0, len(text), _PIECE_CHARACTERS)]
    bodies = (json.dumps([k, len(pieces), piece]) for k, piece in enumerate(pieces))
    return "".join(_line(sequence, total, body) for body in bodies)


def _line(sequence: int, total: int, text: str) -> str:
    return f"@slamhive {sequence}/{total} {zlib.crc32(text.encode('ascii')):08x} {text}\n"


class Decoder:
    """Takes a log as it comes, and knows which records are still missing.

    Attributes:
        total: number of records there are; None before the first sound line.
        records: the whole ones by their number.
        damaged: lines that began as ours and can't be used.
    """

    def __init__(self) -> None:
        self.total: int | None = None
        self.records: dict[int, dict[str, Any]] = {}
        self.damaged = 0
        self._pieces: dict[int, dict[int, str]] = {}

    @property
    def missing(self) -> list[int]:
        """Return the numbers of the records that are not there, in order."""
        return [number for number in range(self.total or 0) if number not in self.records]

    @property
    def is_complete(self) -> bool:
        """Tell whether all records are there."""
        return self.total is not None and len(self.records) == self.total

    def add(self, log: str) -> None:
        """Take lines of a log; each must be whole."""
        for line in log.split("\n"):
            if "@slamhive " in line[:64]:
                self._take(line.rstrip("\r"))

    def _take(self, line: str) -> None:
        found = _LINE.fullmatch(line)
        if found is None or not found[4].isascii() or zlib.crc32(found[4].encode()) != int(found[3], 16):
            self.damaged += 1
            return
        sequence, total = int(found[1]), int(found[2])
        if total != (self.total or total) or sequence >= total:
            self.damaged += 1
            return
        self.total = total
        try:
            content = json.loads(found[4])
            if isinstance(content, list):
                content = self._joined(sequence, content)
            if isinstance(content, dict):
                self.records.setdefault(sequence, content)
        except (ValueError, TypeError, RecursionError):
            self.damaged += 1

    def _joined(self, sequence: int, content: list[Any]) -> Any:
        """Return the record that a piece completes, None while others are missing."""
        number, count, piece = content
        pieces = self._pieces.setdefault(sequence, {})
        pieces[int(number)] = str(piece)
        if len(pieces) < int(count):
            return None
        del self._pieces[sequence]
        return json.loads("".join(pieces[k] for k in sorted(pieces)))


def decode(log: str) -> Decoder:
    """Return a decoder that has read a whole log."""
    decoder = Decoder()
    decoder.add(log)
    return decoder


def encode_all(records: list[dict[str, Any]]) -> Iterator[str]:
    """Return the lines of records whose number is known, one text a record."""
    for number, record in enumerate(records):
        yield encode(number, len(records), record)
