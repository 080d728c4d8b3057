# SPDX-License-Identifier: Apache-2.0
"""Check of an algorithm's trajectory before it is evaluated: TUM text, read with little memory.

Whole blocks of lines are looked at by the interpreter's own loops in C; only a block with something odd in it
is gone through line by line, to name the line. The sentences are those of slamhive_eval, which is not here.
"""

from __future__ import annotations

import math
import operator
import os
from array import array
from dataclasses import dataclass
from itertools import chain
from typing import IO, TYPE_CHECKING, Any

from slamhive.contract.files import NotRegularError, compression_problem, open_regular

if TYPE_CHECKING:
    from collections.abc import Iterator

LIMIT_BYTES = 512 << 20
TRAJECTORY = "output/trajectory.txt"
"""In the run folder."""
_MEANING = "expected timestamp tx ty tz qx qy qz qw"
_COLUMNS = ("time stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_BLOCK = 128 << 10
_LONGEST_LINE = 64 << 10
# As in slamhive_eval: beyond are nanoseconds by mistake, broken programs, and no rotations.
_LARGEST_STAMP_SECONDS = 1e12
_LARGEST_METRES = 1e30
_SMALLEST_QUATERNION_COMPONENT = 1e-3


@dataclass(frozen=True, slots=True)
class TrajectoryInfo:
    """A sound trajectory.

    Attributes:
        poses: How many; 0 where every line is empty or a comment, which is what a lost run writes.
        duration_seconds: From the first to the last.
        sha256: Of the file.
        path: In the run folder.
    """

    poses: int
    duration_seconds: float
    sha256: str
    path: str = TRAJECTORY


@dataclass(frozen=True, slots=True)
class TrajectoryCheck:
    """What was found.

    Attributes:
        info: The trajectory, None if it can't be used.
        problem: Why not, in a sentence.
        missing: There is no such file.
    """

    info: TrajectoryInfo | None = None
    problem: str | None = None
    missing: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return the fields of summary.json."""
        info = self.info
        if info is None:
            return {"trajectoryProblem": self.problem, "trajectoryMissing": self.missing}
        # To a microsecond, as a monitor's last words have it: all know of it the same.
        described = {"poses": info.poses, "durationSeconds": round(info.duration_seconds, 6)}
        return {"trajectory": {**described, "sha256": info.sha256, "path": info.path}}


class _Fault(Exception):  # noqa: N818 - never seen outside
    """What is wrong with the file, and in which line."""

    def __init__(self, message: str, line: int | None = None) -> None:
        place = TRAJECTORY if line is None else f"{TRAJECTORY}, line {line}"
        super().__init__(f"{place}: {message}")


def check_trajectory(output_directory: str, limit: int = LIMIT_BYTES) -> TrajectoryCheck:
    """Check the trajectory an algorithm wrote; whatever is there, this neither fails nor waits.

    Args:
        output_directory: Where the algorithm wrote.
        limit: Bytes it may have.
    """
    try:
        with open_regular(f"{output_directory}/trajectory.txt") as descriptor:
            size = os.fstat(descriptor).st_size
            if size > limit:
                return TrajectoryCheck(problem=f"{TRAJECTORY} is larger than {limit >> 20} MiB")
            if problem := compression_problem(descriptor, TRAJECTORY):
                return TrajectoryCheck(problem=problem)
            with open(descriptor, "rb", closefd=False) as file:
                return TrajectoryCheck(_read(file, limit))
    except (FileNotFoundError, NotRegularError):
        return TrajectoryCheck(problem=f"{TRAJECTORY} is missing or not a regular file", missing=True)
    except _Fault as fault:
        return TrajectoryCheck(problem=str(fault))
    except OSError as error:
        return TrajectoryCheck(problem=f"{TRAJECTORY}: can't be read: {error.strerror or error}")


def _read(file: IO[bytes], limit: int) -> TrajectoryInfo:
    from hashlib import sha256  # noqa: PLC0415 - 5 MiB of memory that nobody needs while the algorithm runs

    digest = sha256()
    while block := file.read(_BLOCK):
        digest.update(block)
    file.seek(0)
    poses = _Poses()
    for lines in _blocks(file, limit):
        poses.add(lines)
    return TrajectoryInfo(poses.count, poses.last - poses.first, digest.hexdigest())


def _blocks(text: IO[bytes], limit: int) -> Iterator[list[bytes]]:
    """Give the text's lines in blocks; lines end as they do on any system."""
    rest = text.read(3).removeprefix(b"\xef\xbb\xbf")
    total = line = 0
    while block := text.read(_BLOCK):
        total += len(block)
        if total > limit:
            raise _Fault(f"is larger than {limit >> 20} MiB")
        data = rest + block
        if b"\0" in data:
            raise _Fault("is no text file (it holds zero bytes)")
        if b"\r" in data:
            # A carriage return at the end may be half of a line's end.
            data, half = (data[:-1], b"\r") if data.endswith(b"\r") else (data, b"")
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") + half
        *lines, rest = data.split(b"\n")
        line += len(lines)
        if len(rest) > _LONGEST_LINE:
            raise _Fault(f"is longer than {_LONGEST_LINE >> 10} KiB; {_MEANING}", line + 1)
        yield lines
    if b"\0" in rest:
        raise _Fault("is no text file (it holds zero bytes)")
    yield rest.replace(b"\r", b"\n").split(b"\n")


class _Poses:
    """What was seen so far."""

    def __init__(self) -> None:
        self.count = 0
        self.first = self.last = 0.0
        self._line = 0

    def add(self, lines: list[bytes]) -> None:
        """Take the next lines.

        Raises:
            _Fault: One of them is wrong.
        """
        values = _plain_block(lines, self.last if self.count else -math.inf)
        if values is None:
            values = self._one_by_one(lines)
        if values:
            if not self.count:
                self.first = values[0]
            self.last = values[-8]
            self.count += len(values) // 8
        self._line += len(lines)

    def _one_by_one(self, lines: list[bytes]) -> array[float]:
        values: array[float] = array("d")
        before = self.last if self.count else -math.inf
        for number, line in enumerate(lines, start=self._line + 1):
            words = line.partition(b"#")[0].replace(b",", b" ").split()
            if words:
                pose = _pose(words, number)
                problem = _problem(pose, before)
                if problem is not None:
                    raise _Fault(problem, number)
                before = pose[0]
                values.extend(pose)
        return values


def _plain_block(lines: list[bytes], before: float) -> array[float] | None:
    """Return the numbers of lines that are all sound, None where one must be looked at by itself."""
    rows = [row for row in map(bytes.split, lines) if row]
    if not rows:
        return array("d")
    try:
        if any(map(operator.ne, map(len, rows), [8] * len(rows))):
            return None
        words = list(chain.from_iterable(rows))
        values = array("d", map(float, words))
    except ValueError:
        return None
    if b"_" in b" ".join(words):
        return None
    columns = [values[k::8] for k in range(8)]
    stamps = columns[0]
    largest_turn = map(max, *(map(abs, column) for column in columns[4:]))
    sound = (
        all(map(math.isfinite, values))
        and before <= stamps[0]
        and all(map(operator.le, stamps, stamps[1:]))
        and stamps[0] >= -_LARGEST_STAMP_SECONDS
        and stamps[-1] <= _LARGEST_STAMP_SECONDS
        and all(max(column) <= _LARGEST_METRES and min(column) >= -_LARGEST_METRES for column in columns[1:4])
        and min(largest_turn) >= _SMALLEST_QUATERNION_COMPONENT
    )
    return values if sound else None


def _pose(words: list[bytes], line: int) -> list[float]:
    if len(words) != 8:
        raise _Fault(f"found {len(words)} of 8 values; {_MEANING}", line)
    pose = []
    for word in words:
        number = None if b"_" in word else _number(word)
        if number is None:
            text = word[:200].decode("utf-8", "replace")
            shown = text if len(text) <= 30 else text[:30] + "…"
            raise _Fault(f"{shown!r} is no number; {_MEANING}", line)
        pose.append(number)
    return pose


def _number(word: bytes) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _problem(pose: list[float], before: float) -> str | None:
    stamp, furthest = pose[0], max(map(abs, pose[1:4]))
    for name, value in zip(_COLUMNS, pose, strict=True):
        if not math.isfinite(value):
            return f"{name} is {value}; every value must be a finite number (leave out times without a pose)"
    if abs(stamp) > _LARGEST_STAMP_SECONDS:
        return f"time stamp {stamp:.10g} is no number of seconds (nanoseconds perhaps?)"
    if furthest > _LARGEST_METRES:
        return f"the position {furthest:.3g} m is beyond {_LARGEST_METRES:g} m"
    if stamp < before:
        what = f"time stamp {stamp:.9f} s comes before the one above it, {before:.9f} s"
        return f"{what}; stamps must not decrease"
    if max(map(abs, pose[4:])) < _SMALLEST_QUATERNION_COMPONENT:
        return "the quaternion is zero; it must have norm 1 (order qx qy qz qw)"
    return None
