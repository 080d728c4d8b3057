# SPDX-License-Identifier: Apache-2.0
"""Files of numbers that programs wrote, read block by block into arrays, and thinned while they are read."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.runfiles.errors import FileMissingError, FileTooLargeError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats
    from slamhive.runfiles.artifacts import ArtifactFolder

    Table = npt.NDArray[np.float64]

MAX_FILE = 64 * 2**20
"""Bytes of a file that is read for a picture."""

MAX_ROWS = 100_000
"""Rows of it that are kept: beyond, every 2nd, 4th, 8th of them."""

_BLOCK = 2**18
_LONGEST_LINE = 2**16


@dataclass(frozen=True, eq=False)
class FileNumbers:
    """Rows of numbers that were read from a run's file, thinned where it has too many.

    Attributes:
        name: the file's.
        header: its first line, where that was asked for.
        rows: (n, columns).
        count: rows that the file has.
        every: how many of those each row stands for.
    """

    name: str
    header: bytes
    rows: Table
    count: int
    every: int


def read_numbers(
    place: ArtifactFolder,
    names: tuple[str, ...],
    parse: Callable[[bytes], Table],
    fold: Callable[[npt.NDArray[np.float64]], Table] = lambda rows: rows[:, 0],
    *,
    headed: bool = False,
) -> FileNumbers:
    """Read the first of some files that is there.

    Args:
        place: the run's folder.
        names: of the files.
        parse: turns whole lines into rows, (k, columns).
        fold: turns (n, k, columns) into (n, columns): what stands for k rows; the first of them unless given.
        headed: whether the first line is none of numbers.

    Raises:
        FileMissingError: none of them is there.
        FileTooLargeError: it has more than MAX_FILE bytes.
    """
    name, blocks = _first(place, names)
    header = b""
    kept: list[Table] = []
    length, count, every = 0, 0, 1
    carried: Table | None = None
    for block in blocks:
        lines = block
        if headed and not header:
            header, _, lines = block.partition(b"\n")
        rows = parse(lines)
        count += len(rows)
        if carried is not None and len(carried):
            rows = np.concatenate([carried, rows])
        whole = len(rows) // every * every
        carried = rows[whole:]
        if whole:
            kept.append(fold(rows[:whole].reshape(-1, every, rows.shape[1])))
            length += len(kept[-1])
        while length > MAX_ROWS:
            together = np.concatenate(kept)
            even = length // 2 * 2
            kept = [fold(together[:even].reshape(-1, 2, together.shape[1])), together[even:]]
            length = sum(map(len, kept))
            every *= 2
    if carried is not None and len(carried):
        kept.append(fold(carried[None]))
    return FileNumbers(name, header, np.concatenate(kept) if kept else np.empty((0, 0)), count, every)


def numbers_of(line: bytes, separator: bytes | None = None) -> list[float]:
    """Return the numbers of a line; none where one of them is no number."""
    try:
        return [float(part) for part in line.split(separator)]
    except ValueError:
        return []


def stacked(rows: list[list[float]], width: int) -> Floats:
    """Return rows as an array, (n, width), also where there are none."""
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _first(place: ArtifactFolder, names: tuple[str, ...]) -> tuple[str, Iterator[bytes]]:
    for name in names:
        try:
            with place.open(name) as descriptor:
                opened = os.dup(descriptor)
        except FileMissingError:
            continue
        size = os.fstat(opened).st_size
        if size > MAX_FILE:
            os.close(opened)
            raise FileTooLargeError(
                f"{name}: {size / 2**20:.0f} MiB, and files of at most {MAX_FILE // 2**20} MiB are drawn: "
                "download it",
                "path",
            )
        return name, _blocks(opened)
    raise FileMissingError(f"the run has no {names[0].rpartition('/')[2]} here")


def _blocks(descriptor: int) -> Iterator[bytes]:
    """Go through a file in whole lines, some at a time; one without an end is cut."""
    rest = b""
    left = MAX_FILE
    with os.fdopen(descriptor, "rb", buffering=0) as stream:
        while left > 0 and (read := stream.read(min(_BLOCK, left))):
            left -= len(read)
            lines, end, rest = (rest + read).rpartition(b"\n")
            if end:
                yield lines + end
            elif len(rest) > _LONGEST_LINE:
                rest = rest[:_LONGEST_LINE]
    if rest:
        yield rest + b"\n"
