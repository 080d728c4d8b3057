# SPDX-License-Identifier: Apache-2.0
"""Conversion of the poses that a program wrote in its own way into the contract's file, line by line.

It is done where the output is read: once, by whoever watched the run, when nothing of the run is left that
could change it. The program's own file stays. What it holds is no more to be trusted than any other output.
"""

from __future__ import annotations

import errno
import math
import os
from array import array
from contextlib import contextmanager, suppress
from dataclasses import replace
from decimal import Decimal
from typing import TYPE_CHECKING, NamedTuple

from slamhive.contract.files import NotRegularError, open_folder, open_regular
from slamhive.contract.lines import (
    LIMIT_BYTES,
    TextFault,
    absent,
    blocks,
    missing,
    named,
    number,
    opened_text,
    shown,
)
from slamhive.contract.posefiles import (
    BY_FRAMES,
    COLUMNS,
    CSV,
    EUROC,
    FRAME_INDEX,
    KITTI,
    NANOSECONDS,
    SINCE_FIRST,
    TUM,
)
from slamhive.contract.rotation import TOLERANCE, from_matrix, inverse, is_rotation, normalized
from slamhive.contract.trajectory import TrajectoryCheck, check_pose, other_count, parse_pose, words_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from slamhive.contract.posefiles import DeclaredPoseFile, PoseFiles

_MATRIX = 12
_NORM_TOLERANCE = 5 * TOLERANCE
_SECOND = 10**9
_LARGEST_NANOSECONDS = 1e21
_LARGEST_INDEX = 2**53
_LARGEST_SECONDS = 1e9
"""Of a recording, some thirty years: more is no time since its first frame."""
_LEAST_SHARE = 1e-3
"""Of a nanosecond: what a stamp that was computed in floating point may be off by."""
_FRAMES_BYTES = 64 << 20
_NAN = b"nan"
_SEPARATORS = (",", ";", "\t")
_SHOWN_NAMES = 200
# What an algorithm can do to its own folder; all else is the disk's fault.
_OF_THE_ALGORITHM = {
    *(errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.ENOENT, errno.ELOOP, errno.ENOTEMPTY),
    errno.EEXIST,
}
_MEANINGS = {
    TUM: "expected timestamp tx ty tz qx qy qz qw",
    EUROC: "expected timestamp, tx, ty, tz, qw, qx, qy, qz",
    KITTI: "expected the 3×4 pose matrix row by row, perhaps after the frame index",
    CSV: "expected the columns that its header names",
}


class Converted(NamedTuple):
    """Result of converting a program's pose files: faults of the files, and of the machine.

    Attributes:
        trajectory: What is wrong with the file of the trajectory; nothing where there is none or all is well.
        keyframes: What is wrong with that of the keyframes, None if nothing is.
        fault: What the machine refused, None if nothing.
    """

    trajectory: TrajectoryCheck
    keyframes: str | None = None
    fault: str | None = None


class MachineFault(Exception):  # noqa: N818 - it becomes a run's reason, SystemFault
    """Fault of the machine in reading or writing poses, in a sentence: the algorithm is not to blame."""


def convert_all(output_directory: str, files: PoseFiles, trajectory: str, keyframes: str) -> Converted:
    """Convert what a program wrote; whatever is there, this neither fails nor waits.

    Args:
        output_directory: Where it wrote, and where the contract's files are made.
        files: What it wrote.
        trajectory: Name of the file that is made of its trajectory.
        keyframes: Name of the file that is made of its keyframes.
    """
    try:
        beside = _convert(output_directory, files.keyframes, files.frames, keyframes)
        found = _convert(output_directory, files.trajectory, files.frames, trajectory)
        if found.missing and files.trajectory is not None:
            found = replace(found, problem=absent(output_directory, files.trajectory.path))
    except MachineFault as refusal:
        return Converted(TrajectoryCheck(problem=str(refusal)), fault=str(refusal))
    return Converted(found, beside.problem)


def _convert(
    output_directory: str, source: DeclaredPoseFile | None, frames: str | None, target: str
) -> TrajectoryCheck:
    """Convert a file of poses, and return what is wrong with it.

    Raises:
        MachineFault: The machine refuses.
    """
    if source is None:
        return TrajectoryCheck()
    name = named(source.path)
    try:
        convert(output_directory, source, frames, target)
    except (FileNotFoundError, NotRegularError):
        return TrajectoryCheck(problem=missing(source.path), missing=True)
    except TextFault as problem:
        return TrajectoryCheck(problem=str(problem))
    except OSError as error:
        return TrajectoryCheck(problem=f"{name}: can't be read: {error.strerror or error}")
    return TrajectoryCheck()


def convert(
    output_directory: str, source: DeclaredPoseFile, frames: str | None, target: str, limit: int = LIMIT_BYTES
) -> None:
    """Write the poses of a file as the contract has them: ``timestamp tx ty tz qx qy qz qw``, s and m.

    Args:
        output_directory: Where the algorithm wrote, and where it is written.
        source: The file and what its numbers mean.
        frames: File with the stamps of the recording's frames, for stamps that count from them.
        target: Name of the file that is made; what is there is replaced.
        limit: Bytes that either may have.

    Raises:
        FileNotFoundError: There is no such file.
        NotRegularError: It is something else than a file, or a link leads there.
        TextFault: It doesn't hold what is declared; names the line.
        OSError: It can't be read.
        MachineFault: The machine refuses.
    """
    stamps = None if source.stamps not in BY_FRAMES else read_frames(frames or "")
    name = named(source.path)
    with opened_text(output_directory, source.path, limit) as text:
        meaning = _MEANINGS[source.format]
        rows = _FileRows(source, stamps)
        with _written(output_directory, target) as write:
            total = 0
            for lines in blocks(text, name, meaning, limit):
                made = rows.converted(lines)
                total += len(made)
                if total > limit:
                    raise TextFault.at(name, f"its poses take more than {limit >> 20} MiB as {named(target)}")
                write(made)


def read_frames(path: str) -> array[int]:
    """Return the stamps of a recording's frames, ns of sensor time, which its preparation wrote line by line.

    Raises:
        MachineFault: They can't be read.
    """
    stamps = array("q")
    problem: str | None = "it is no list of stamps"
    try:
        with open_regular(path) as descriptor, open(descriptor, "rb", closefd=False) as file:
            if os.fstat(descriptor).st_size <= _FRAMES_BYTES:
                stamps.extend(map(int, file))
                problem = None
    except OSError as error:
        problem = error.strerror
    except (ValueError, OverflowError):
        pass
    if problem is not None:
        raise MachineFault(f"the stamps of the recording's frames can't be read: {path}: {problem}")
    return stamps


class _FileRows:
    """The lines of a file, one after another."""

    def __init__(self, source: DeclaredPoseFile, frames: array[int] | None) -> None:
        self._source = source
        self._frames = frames
        self._meaning = _MEANINGS[source.format]
        self._stamp = self._stamps()
        self._before = float("-inf")
        self._line = 0
        self._rows = 0
        self._width: int | None = None
        self._table: _CsvTable | None = None

    def converted(self, lines: list[bytes]) -> bytes:
        """Return the poses of the next lines.

        Raises:
            TextFault: One of them is wrong.
        """
        made = []
        for line in lines:
            self._line += 1
            try:
                pose = self._pose(line)
            except ValueError as error:
                raise TextFault.at(named(self._source.path), str(error), self._line) from None
            if pose is not None:
                made.append(pose)
        return b"".join(made)

    def _pose(self, line: bytes) -> bytes | None:
        """Return the pose of a line, None where it has none."""
        words = self._words(line)
        if not words:
            return None
        if self._source.format == KITTI:
            stamp, words = self._kitti(words)
        else:
            stamp = self._stamp(words[0])
            words = [stamp, *words[1:]]
        self._rows += 1
        pose = parse_pose(words, self._meaning)
        if any(map(math.isnan, pose)):  # an evaluation leaves the row out, and counts it
            return b" ".join((stamp, *[_NAN] * 7)) + b"\n"
        check_pose(pose, self._before)
        self._before = pose[0]
        x, y, z, w = quaternion = (pose[4], pose[5], pose[6], pose[7])
        squared = x * x + y * y + z * z + w * w
        if not (1 - _NORM_TOLERANCE) ** 2 <= squared <= (1 + _NORM_TOLERANCE) ** 2:
            raise ValueError(
                f"the quaternion qx qy qz qw = {x:g} {y:g} {z:g} {w:g} has norm {squared**0.5:.3g}, not 1; "
                f"{self._meaning}"
            )
        if self._source.inverted:
            translation, turn = inverse((pose[1], pose[2], pose[3]), normalized(quaternion))
            words = [stamp, *(repr(value).encode() for value in (*translation, *turn))]
        return b" ".join(words) + b"\n"

    def _words(self, line: bytes) -> list[bytes] | None:
        """Return the words of a pose in the order of COLUMNS, or of a matrix."""
        form = self._source.format
        if form == CSV:
            return self._cells(line)
        words = words_of(line)
        if not words or form == KITTI:
            return words
        if form == EUROC:
            if len(words) < len(COLUMNS):
                raise other_count(words, len(COLUMNS), self._meaning)
            return [*words[:4], *words[5:8], words[4]]
        if len(words) != len(COLUMNS):
            raise other_count(words, len(COLUMNS), self._meaning)
        return words

    def _cells(self, line: bytes) -> list[bytes] | None:
        if not line.strip():
            return None
        remark = line.lstrip().startswith(b"#")
        if self._table is None:
            if remark and self._source.header is not None:
                return None
            columns = self._source.columns or {name: name for name in COLUMNS}
            self._table = _CsvTable.of(line, columns, self._source.header)
            if self._source.header is None:
                return None
        return None if remark else self._table.cells(line)

    def _kitti(self, words: list[bytes]) -> tuple[bytes, list[bytes]]:
        """Return the stamp of a line with a matrix, and the words of its pose."""
        if len(words) not in (_MATRIX, _MATRIX + 1):
            raise other_count(words, _MATRIX, self._meaning)
        if self._width is not None and len(words) != self._width:
            raise ValueError(f"found {len(words)} values, and {self._width} in the lines above it")
        self._width = len(words)
        if len(words) > _MATRIX:
            stamp = self._stamp(words[0])
        elif self._source.stamps == FRAME_INDEX:
            stamp = self._stamp(b"%d" % self._rows)
        else:
            raise ValueError(
                f"found {_MATRIX} values, which hold no time stamp; declare stamps: {FRAME_INDEX}, or write "
                f"the stamp before them"
            )
        cells = words[-_MATRIX:]
        if any(value is not None and math.isnan(value) for value in map(number, cells)):
            return stamp, [stamp, *[_NAN] * 7]
        values = [_finite(word, self._meaning) for word in cells]
        rotation = [*values[0:3], *values[4:7], *values[8:11]]
        if not is_rotation(rotation):
            raise ValueError(
                "its first three columns are no rotation: their rows must be orthonormal to "
                f"{TOLERANCE:g}, and right-handed"
            )
        turn = (repr(value).encode() for value in from_matrix(rotation))
        return stamp, [stamp, cells[3], cells[7], cells[11], *turn]

    def _stamps(self) -> Callable[[bytes], bytes]:
        """Return a function that makes seconds of a stamp's word."""
        if self._source.stamps == FRAME_INDEX:
            return lambda word: _seconds_text(_frame_stamp(word, self._frames or array("q")))
        if self._source.stamps == SINCE_FIRST:
            return lambda word: _seconds_text(_since_first(word, self._frames or array("q")))
        if self._source.stamps == NANOSECONDS:
            return lambda word: _seconds_text(_nanoseconds(word))
        return lambda word: word


class _CsvTable:
    """A CSV file by its first line.

    Args:
        names: What its first line names.
        wanted: The names of COLUMNS there.
        separator: Between two cells; None: white space.
    """

    def __init__(self, names: Sequence[str], wanted: Sequence[str], separator: bytes | None) -> None:
        for name in wanted:
            if names.count(name) != 1:
                found = "no column" if name not in names else f"{names.count(name)} columns"
                listed = ", ".join(names)
                listed = listed if len(listed) <= _SHOWN_NAMES else listed[:_SHOWN_NAMES] + "…"
                raise ValueError(f"the first line has {found} {name!r}; it names {listed}")
        self._places = [names.index(name) for name in wanted]
        self._least = max(self._places) + 1
        self._separator = separator

    @classmethod
    def of(cls, line: bytes, columns: Mapping[str, str], header: Sequence[str] | None) -> _CsvTable:
        """Read the first line.

        Args:
            line: it.
            columns: as `DeclaredPoseFile` has them.
            header: the names where that line has none.
        """
        text = line.decode("utf-8", "replace").strip().removeprefix("#").strip()
        separator = next((one for one in _SEPARATORS if one in text), None)
        names = header or [_bare(cell) for cell in text.split(separator)]
        return cls(names, [columns[name] for name in COLUMNS], separator.encode() if separator else None)

    def cells(self, line: bytes) -> list[bytes]:
        """Return the cells of a line in the order of COLUMNS."""
        found = line.split(self._separator)
        if len(found) < self._least:
            raise ValueError(f"found {len(found)} of at least {self._least} values; {_MEANINGS[CSV]}")
        return [found[place].strip().strip(b'"') for place in self._places]


def _bare(cell: str) -> str:
    return cell.strip().strip('"').strip()


def _finite(word: bytes, meaning: str) -> float:
    value = number(word)
    if value is None:
        raise ValueError(f"{shown(word)} is no number; {meaning}")
    if not abs(value) < float("inf"):
        raise ValueError(f"the pose matrix holds {value}; every value must be a finite number")
    return value


def _nanoseconds(word: bytes) -> int:
    """Return a stamp in ns, exactly; some programs write it with a point or an exponent."""
    if word.isdigit() and len(word) < 20:
        return int(word)
    value = number(word)
    if value is None:
        raise ValueError(f"{shown(word)} is no number of nanoseconds")
    if not abs(value) <= _LARGEST_NANOSECONDS:
        raise ValueError(f"time stamp {value:.10g} is no number of nanoseconds")
    try:
        exact = Decimal(word.decode("ascii", "replace"))
        whole = round(exact)
        sound = abs(exact - whole) <= _LEAST_SHARE
    except ArithmeticError:  # an exponent beyond all numbers
        sound = False
    if not sound:
        raise ValueError(f"time stamp {shown(word)} is no whole number of nanoseconds (seconds perhaps?)")
    return whole


def _frame_stamp(word: bytes, frames: array[int]) -> int:
    """Return the stamp of a frame in ns."""
    value = number(word)
    if value is None or not value.is_integer() or not 0 <= value < _LARGEST_INDEX:
        raise ValueError(f"{shown(word)} is no frame index; frames are counted from 0")
    index = int(value)
    if index >= len(frames):
        raise ValueError(
            f"frame {index} is beyond the recording, which has {len(frames)} frames, the first of them 0"
        )
    return frames[index]


def _since_first(word: bytes, frames: array[int]) -> int:
    """Return the stamp in ns of a number of seconds since the first frame."""
    value = number(word)
    if value is None or not abs(value) <= _LARGEST_SECONDS:
        raise ValueError(f"{shown(word)} is no number of seconds since the first frame")
    if not frames:
        raise ValueError("the recording has no frame that seconds could be counted from")
    return frames[0] + round(value * _SECOND)


def _seconds_text(nanoseconds: int) -> bytes:
    whole, rest = divmod(abs(nanoseconds), _SECOND)
    return b"%s%d.%09d" % (b"-" if nanoseconds < 0 else b"", whole, rest)


@contextmanager
def _written(output_directory: str, name: str) -> Iterator[Callable[[bytes], object]]:
    """Put a file into the folder, whole when the context ends well and not at all otherwise.

    Raises:
        TextFault: What the algorithm put into its folder is in the way.
        MachineFault: The disk refuses.
    """
    aside = f".{name}.{os.urandom(8).hex()}.tmp"
    with _own_faults(name):
        folder = open_folder(output_directory)
    try:
        with _own_faults(name):
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            descriptor = os.open(aside, flags, 0o644, dir_fd=folder)
        try:
            yield lambda data: _write(descriptor, data, name)
            with _own_faults(name):
                os.fsync(descriptor)
                os.replace(aside, name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            with suppress(OSError):
                os.unlink(aside, dir_fd=folder)
            raise
        finally:
            os.close(descriptor)
    finally:
        os.close(folder)


def _write(descriptor: int, data: bytes, name: str) -> None:
    rest = memoryview(data)
    with _own_faults(name):
        while rest:
            rest = rest[os.write(descriptor, rest) :]


@contextmanager
def _own_faults(name: str) -> Iterator[None]:
    """Tell what an algorithm did to its folder from what the disk refuses."""
    try:
        yield
    except OSError as error:
        sentence = f"{named(name)} can't be written: {error.strerror or error}"
        if error.errno in _OF_THE_ALGORITHM:
            raise TextFault(sentence) from None
        raise MachineFault(sentence) from None
