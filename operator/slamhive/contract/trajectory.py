# SPDX-License-Identifier: Apache-2.0
"""Check of an algorithm's trajectory before it is evaluated: TUM text, read with little memory.

Whole blocks of lines are looked at by the interpreter's own loops in C; only a block with something odd in it
is gone through line by line, to name the line. The sentences are those of slamhive_eval, which is not here.
"""

from __future__ import annotations

import math
import operator
from array import array
from dataclasses import dataclass
from itertools import chain
from typing import IO, Any

from slamhive.contract.files import NotRegularError
from slamhive.contract.lines import (
    BLOCK_BYTES,
    LIMIT_BYTES,
    TextFault,
    absent,
    blocks,
    number,
    opened_text,
    shown,
)

FILE = "trajectory.txt"
"""In the output folder."""
TRAJECTORY = "output/trajectory.txt"
"""In the run folder."""
MOST_POSES = 5_000_000
"""Poses of a trajectory: of hours at a thousand a second, which a workstation can still measure."""
_MEANING = "expected timestamp tx ty tz qx qy qz qw"
_COLUMNS = ("time stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
# As in slamhive_eval: beyond are nanoseconds by mistake, broken programs, and no rotations.
_LARGEST_STAMP_SECONDS = 1e12
_LARGEST_METRES = 1e30
_SMALLEST_QUATERNION_COMPONENT = 1e-3


@dataclass(frozen=True, slots=True)
class SoundTrajectory:
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
    """Result of checking an algorithm's trajectory: its key figures, or why it can't be used.

    Attributes:
        info: The trajectory, None if it can't be used.
        problem: Why not, in a sentence.
        missing: There is no such file.
    """

    info: SoundTrajectory | None = None
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


def check_trajectory(output_directory: str, limit: int = LIMIT_BYTES) -> TrajectoryCheck:
    """Check the trajectory an algorithm wrote; whatever is there, this neither fails nor waits.

    Args:
        output_directory: Where the algorithm wrote.
        limit: Bytes it may have.
    """
    try:
        with opened_text(output_directory, FILE, limit) as file:
            return TrajectoryCheck(_read(file, limit))
    except (FileNotFoundError, NotRegularError):
        return TrajectoryCheck(problem=absent(output_directory, FILE), missing=True)
    except TextFault as fault:
        return TrajectoryCheck(problem=str(fault))
    except OSError as error:
        return TrajectoryCheck(problem=f"{TRAJECTORY}: can't be read: {error.strerror or error}")


def _read(file: IO[bytes], limit: int) -> SoundTrajectory:
    from hashlib import sha256  # noqa: PLC0415 - 5 MiB of memory that nobody needs while the algorithm runs

    digest = sha256()
    while block := file.read(BLOCK_BYTES):
        digest.update(block)
    file.seek(0)
    poses = _PoseCount()
    for lines in blocks(file, TRAJECTORY, _MEANING, limit):
        poses.add(lines)
    if poses.unknown and not poses.count:
        rows = "its only row holds" if poses.unknown == 1 else f"all {poses.unknown} rows hold"
        raise TextFault.at(TRAJECTORY, f"{rows} NaN: no pose")
    return SoundTrajectory(poses.count, poses.last - poses.first, digest.hexdigest())


class _PoseCount:
    """Count, first and last stamp of the poses in a trajectory's lines that were checked so far.

    Rows that hold NaN are no poses: an evaluation leaves them out and counts them.
    """

    def __init__(self) -> None:
        self.count = self.unknown = 0
        self.first = self.last = 0.0
        self._line = 0

    def add(self, lines: list[bytes]) -> None:
        """Take the next lines.

        Raises:
            TextFault: One of them is wrong.
        """
        values = _plain_block(lines, self.last if self.count else -math.inf)
        if values is None:
            values = self._one_by_one(lines)
        if values:
            if not self.count:
                self.first = values[0]
            self.last = values[-8]
            self.count += len(values) // 8
            if self.count > MOST_POSES:
                raise TextFault.at(TRAJECTORY, f"has more than {MOST_POSES:,} poses")
        self._line += len(lines)

    def _one_by_one(self, lines: list[bytes]) -> array[float]:
        values: array[float] = array("d")
        before = self.last if self.count else -math.inf
        for line_number, line in enumerate(lines, start=self._line + 1):
            words = words_of(line)
            if words:
                try:
                    pose = parse_pose(words, _MEANING)
                    if any(map(math.isnan, pose)):
                        self.unknown += 1
                        continue
                    check_pose(pose, before)
                except ValueError as error:
                    raise TextFault.at(TRAJECTORY, str(error), line_number) from None
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


def words_of(line: bytes) -> list[bytes]:
    """Return the words of a line, none where it is empty or a comment."""
    return line.partition(b"#")[0].replace(b",", b" ").split()


def other_count(words: list[bytes], columns: int, meaning: str) -> ValueError:
    """Return the error that a line has another number of values: of a decimal comma about twice as many."""
    commas = 1.5 * columns < len(words) <= 2 * columns and not any(b"." in word for word in words)
    hint = "; numbers with a decimal comma? write a point" if commas else ""
    return ValueError(f"found {len(words)} of {columns} values{hint}; {meaning}")


def parse_pose(words: list[bytes], meaning: str) -> list[float]:
    """Return the numbers of a line.

    Args:
        words: Its words: time stamp, tx, ty, tz, qx, qy, qz, qw.
        meaning: What is expected, in a sentence's words.

    Raises:
        ValueError: They are no 8 numbers; says so without naming the line.
    """
    if len(words) != len(_COLUMNS):
        raise other_count(words, len(_COLUMNS), meaning)
    pose = []
    for word in words:
        found = number(word)
        if found is None:
            raise ValueError(f"{shown(word)} is no number; {meaning}")
        pose.append(found)
    return pose


def check_pose(pose: list[float], before: float) -> None:
    """Check a pose.

    Args:
        pose: Time stamp in s, tx, ty, tz in m, qx, qy, qz, qw.
        before: Stamp of the pose before it.

    Raises:
        ValueError: What is wrong with it, without naming the line.
    """
    stamp, furthest = pose[0], max(map(abs, pose[1:4]))
    for name, value in zip(_COLUMNS, pose, strict=True):
        if not math.isfinite(value):
            raise ValueError(
                f"{name} is {value}; every value must be a finite number (leave out times without a pose)"
            )
    if abs(stamp) > _LARGEST_STAMP_SECONDS:
        raise ValueError(f"time stamp {stamp:.10g} is no number of seconds (nanoseconds perhaps?)")
    if furthest > _LARGEST_METRES:
        raise ValueError(f"the position {furthest:.3g} m is beyond {_LARGEST_METRES:g} m")
    if stamp < before:
        what = f"time stamp {stamp:.9f} s comes before the one above it, {before:.9f} s"
        raise ValueError(f"{what}; stamps must not decrease")
    if max(map(abs, pose[4:])) < _SMALLEST_QUATERNION_COMPONENT:
        raise ValueError("the quaternion is zero; it must have norm 1 (order qx qy qz qw)")
