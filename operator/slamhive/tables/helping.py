# SPDX-License-Identifier: Apache-2.0
"""Helper of the first reading of a large archive: a process that makes columns of every other part of it.

Reading takes the processor, not the disk, and Python's lock lets one thread of a process compute. So the
helper is a process, of a fresh interpreter: what reads may have threads, and a database must not be used
after a fork. It is told the database and which runs by its standard input, and answers by its output.
Where it fails, whoever asked reads the part instead.
"""

from __future__ import annotations

import fcntl
import os
import pickle
import select
import struct
import subprocess
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self

from slamhive.archive.connection import connect, reading
from slamhive.contract.heap import return_memory
from slamhive.tables.batches import BatchReader, joined
from slamhive.tables.uncollected import uncollected

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import TracebackType

    from sqlalchemy import Connection

    from slamhive.tables.batches import RunBatch

LEAST_HELPED = 10
"""Batches from which on another process helps: it takes half a second to begin."""

TOGETHER = 50
"""Batches that become one as they are there."""

_HEAD = struct.Struct("!Q")
_PIPE_BYTES = 2**20
_BOTH = 2


class ReadingHelper:
    """A process that reads parts of an archive.

    Attributes:
        asked: numbers of the parts that it was asked for and has not answered.

    Args:
        url: the archive's database URL, which no list of processes shows.
    """

    AHEAD = 2
    """Parts that it is asked for at a time, so that it need not wait for the next."""

    def __init__(self, url: str) -> None:
        # -P: a struct.py in the working folder is none of ours.
        command = [sys.executable, "-P", "-m", "slamhive.tables.helping"]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, bufsize=0
        )
        self._answers = self._process.stdout.fileno() if self._process.stdout else -1
        with suppress(OSError):  # an answer then fits in it, and the next one is begun
            fcntl.fcntl(self._answers, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self.asked: list[int] = []
        self._tell(url)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()

    def ask(self, number: int, first: int, last: int) -> None:
        """Ask for a part, the runs from one id to another."""
        self.asked.append(number)
        self._tell((first, last))

    def is_ready(self) -> bool:
        """Tell whether it answers, or is gone."""
        return bool(select.select([self._answers], [], [], 0)[0])

    def answers(
        self, instead: Callable[[int, int], RunBatch], pieces: Sequence[tuple[int, int]], count: int
    ) -> Iterator[tuple[int, RunBatch]]:
        """Go through parts that it was asked for, with their numbers.

        Args:
            instead: reads a part where the helper can't.
            pieces: first and last id of each part.
            count: how many answers are waited for.
        """
        for _ in range(count):
            number = self.asked.pop(0)
            yield number, self._answer() or instead(*pieces[number])

    def _answer(self) -> RunBatch | None:
        try:
            found: RunBatch = pickle.loads(self._exactly(*_HEAD.unpack(self._exactly(_HEAD.size))))  # noqa: S301 - written by a process of ours
        except (OSError, EOFError):
            return None
        return found

    def _exactly(self, count: int) -> bytearray:
        found = bytearray()
        while len(found) < count:
            part = os.read(self._answers, min(count - len(found), _PIPE_BYTES))
            if not part:
                raise EOFError
            found += part
        return found

    def _tell(self, what: Any) -> None:
        if self._process.stdin is not None:
            with suppress(OSError):  # it is gone: its answers are missing then
                self._process.stdin.write(pickle.dumps(what))


def read_all(connection: Connection, reader: BatchReader) -> list[RunBatch]:
    """Return all runs of an archive; of a large one with the help of another process."""
    pieces = reader.pieces()
    if len(pieces) < LEAST_HELPED or len(os.sched_getaffinity(0)) < _BOTH:
        return [reader.between(*piece) for piece in pieces]
    with ReadingHelper(connection.engine.url.render_as_string(hide_password=False)) as helper:
        return [
            _read_together(reader, helper, pieces[start : start + TOGETHER])
            for start in range(0, len(pieces), TOGETHER)
        ]


def _read_together(reader: BatchReader, helper: ReadingHelper, pieces: Sequence[tuple[int, int]]) -> RunBatch:
    """Return some batches as one: a thousand small arrays leave holes in memory, large ones do not."""
    found: dict[int, RunBatch] = {}
    while (place := len(found) + len(helper.asked)) < len(pieces):
        if len(helper.asked) < helper.AHEAD:
            helper.ask(place, *pieces[place])
        elif helper.is_ready():
            found.update(helper.answers(reader.between, pieces, 1))
        else:
            found[place] = reader.between(*pieces[place])
    found.update(helper.answers(reader.between, pieces, len(helper.asked)))
    whole = joined([found.pop(place) for place in range(len(pieces))])
    return_memory()
    return whole


def main() -> None:
    """Read what is asked for until nobody asks."""
    asked, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    engine = connect(pickle.load(asked), read_only=True)  # noqa: S301 - written by whoever started this
    with suppress(EOFError, BrokenPipeError), uncollected(), reading(engine) as connection:
        reader = BatchReader(connection)
        while True:
            first, last = pickle.load(asked)  # noqa: S301
            content = pickle.dumps(reader.between(first, last), pickle.HIGHEST_PROTOCOL)
            answers.write(_HEAD.pack(len(content)))
            answers.write(content)
            answers.flush()


if __name__ == "__main__":
    main()
