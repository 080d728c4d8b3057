# SPDX-License-Identifier: Apache-2.0
"""Trajectories in files: TUM, EuRoC ground truth, KITTI and tables, plain or compressed, and recordings.

numpy's C reader takes the whole file at once; only when it refuses, or a value turns out wrong, is the
text gone through line by line to name the line.
"""

from __future__ import annotations

import bz2
import gzip
import io
import itertools
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval import bags, rotation, tables
from slamhive_eval.errors import FileError, OptionError, TrajectoryError
from slamhive_eval.trajectory import LARGEST_METRES, Trajectory, find_fault

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive_eval.rotation import FloatArray

Format = Literal["tum", "euroc", "kitti", "csv", "bag"]
Unsorted = Literal["error", "sort"]

FORMATS: tuple[Format, ...] = get_args(Format)
_COLUMNS: dict[str, tuple[int, str]] = {
    "tum": (8, "timestamp tx ty tz qx qy qz qw"),
    "euroc": (8, "timestamp [ns], px, py, pz, qw, qx, qy, qz, …"),
    "kitti": (12, "the 3×4 pose matrix row by row"),
}
"""Columns a line of each format without names needs, and what they are."""

_TUM_ORDER = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
_EUROC_ORDER = ("time", "x", "y", "z", "qw", "qx", "qy", "qz")
_FIRST_NANOSECOND_STAMP = 1e14
_BLOCK = 1 << 24
"""Characters that are turned into numbers at once."""
_GZIP, _BZIP2 = b"\x1f\x8b", b"BZh"


def read_trajectory(
    path: str | Path,
    file_format: Format | None = None,
    *,
    times: str | Path | None = None,
    topic: str | None = None,
    unsorted: Unsorted = "error",
) -> Trajectory:
    """Read a trajectory, finding out the format unless told.

    Args:
        path: A file, plain or compressed by gzip or bzip2; or a recording (ROS 1 bag, folder of a ROS 2 bag,
            MCAP), perhaps with the topic as in ``run.bag:/odom`` or ``run.bag:/tf:map.base_link``.
        file_format: ``tum``, ``euroc``, ``kitti``, ``csv`` (named columns) or ``bag``; None to tell by the
            first line or, for recordings, by the file's name.
        times: For KITTI: the file with one stamp in s a line. Without it pose k has the stamp k.
        topic: For recordings: the topic, see `slamhive_eval.bags.read_bag`.
        unsorted: What to do with decreasing stamps: ``error`` names the line, ``sort`` sorts the poses
            by time, keeping the order of equal stamps.

    Returns:
        The trajectory, stamps in s.

    Raises:
        FileError: The file is missing, empty, no text, or wrong in the line named; for recordings as well
            what read_bag says.
        OptionError: Unknown format.
    """
    if file_format is not None and file_format not in FORMATS:
        raise OptionError(f"unknown trajectory format {file_format!r}; known are {', '.join(FORMATS)}")
    path, topic = _split_topic(path, topic)
    if file_format == "bag" or (file_format is None and bags.is_bag(path)):
        return bags.read_bag(path, topic, sort=unsorted == "sort")
    if topic is not None:
        raise FileError(path, f"is no recording; only those have topics such as {topic!r}")
    text = read_text(path)
    header = None
    if file_format is None:
        file_format, header = ("kitti", None) if times is not None else _detect(path, text)
    if file_format == "csv":
        return _from_table(path, text, header or tables.find_header(path, text), unsorted)
    table = parse_table(path, text, *_COLUMNS[file_format], extra=file_format == "euroc")
    if file_format == "kitti":
        return _from_kitti(path, text, table, times)
    if file_format == "euroc":
        # float64 nanoseconds divided by 1e9, as evo does: a stamp then equals evo's to the last bit.
        stamps, quaternions = table[:, 0] / 1e9, table[:, [5, 6, 7, 4]]
    else:
        stamps, quaternions = table[:, 0], table[:, 4:8]
    return _checked(path, text, (stamps, table[:, 1:4], quaternions), unsorted)


def detect_format(path: str | Path) -> Format:
    """What a file is by its first line or, for recordings, by its name.

    Raises:
        FileError: It can't be read, or its first line is of no known format.
    """
    path, _ = _split_topic(path, None)
    return "bag" if bags.is_bag(path) else _detect(path, read_text(path))[0]


def read_transform(path: str | Path) -> FloatArray:
    """Read a rigid motion: 16 or 12 numbers of a matrix row by row, or ``x y z qx qy qz qw``.

    Returns:
        The matrix, shape (4, 4). It isn't checked to be rigid.

    Raises:
        FileError: The file can't be read or holds other than so many numbers.
    """
    words = read_text(path).translate(str.maketrans("[](),;", "      ")).split()
    if len(words) not in (7, 12, 16) or not all(map(_is_number, words)):
        raise FileError(
            path, "a transform has 16 or 12 numbers of a matrix row by row, or 7: x y z qx qy qz qw"
        )
    numbers = np.array(words, dtype=np.float64)
    matrix = np.eye(4)
    if len(words) == 7:
        if not np.isfinite(numbers).all() or not np.abs(numbers[3:]).max() > 0:
            raise FileError(path, "the quaternion is zero, or a number isn't finite")
        matrix[:3, :3], matrix[:3, 3] = rotation.to_matrix(rotation.normalize(numbers[3:])), numbers[:3]
    else:
        matrix[: len(words) // 4] = numbers.reshape(-1, 4)
    return matrix


def _split_topic(path: str | Path, topic: str | None) -> tuple[str | Path, str | None]:
    """The parts of ``FILE:TOPIC``; a file of that name comes first."""
    words = str(path)
    if topic is not None or ":" not in words or Path(words).exists():
        return path, topic
    for k, letter in enumerate(words):
        if letter == ":" and bags.is_bag(words[:k]):
            return words[:k], words[k + 1 :]
    first, _, rest = words.partition(":")
    return (first, rest) if Path(first).exists() else (path, None)


def read_tum(path: str | Path, *, unsorted: Unsorted = "error") -> Trajectory:
    """Read ``timestamp tx ty tz qx qy qz qw`` lines (s, m); see read_trajectory."""
    return read_trajectory(path, "tum", unsorted=unsorted)


def read_euroc(path: str | Path, *, unsorted: Unsorted = "error") -> Trajectory:
    """Read the data.csv of EuRoC's state_groundtruth_estimate0 (ns, m, qw first); see read_trajectory."""
    return read_trajectory(path, "euroc", unsorted=unsorted)


def read_kitti(path: str | Path, times: str | Path | None = None) -> Trajectory:
    """Read KITTI poses with their times file; see read_trajectory."""
    return read_trajectory(path, "kitti", times=times)


def write_tum(path: str | Path, trajectory: Trajectory) -> None:
    """Write ``timestamp tx ty tz qx qy qz qw`` with every digit that float64 needs to be read back."""
    from slamhive_eval.writing import write_trajectory  # noqa: PLC0415 - readers needn't it

    write_trajectory(path, trajectory, "tum")


def read_text(path: str | Path) -> str:
    """The text of a file, uncompressed, with lines ending in a newline only.

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
    if b"\0" in data:
        raise FileError(path, "is no text file (it holds zero bytes)")
    text = data.decode("utf-8-sig", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def parse_table(
    path: str | Path, text: str, columns: int, meaning: str, *, extra: bool = False
) -> FloatArray:
    """Numbers of a text, one row a line; commas count as white space, ``#`` begins a comment.

    Args:
        path: Named in errors.
        text: The whole text.
        columns: Numbers a line must hold.
        meaning: What they are, for errors.
        extra: Whether further columns may follow.

    Returns:
        The numbers, shape (n, columns), n ≥ 1; NaN and infinity pass.

    Raises:
        FileError: No line with numbers, a line of another length, or something that is no number.
    """
    first = next(_data_lines(text), None)
    if first is None:
        raise FileError(path, "holds no poses: every line is empty or a comment")
    try:
        table = _numbers(text, commas="," in first[1])
    except ValueError:
        table = np.empty((0, 0))
    if not len(table) or table.shape[1] < columns or (table.shape[1] > columns and not extra):
        _raise_bad_line(path, text, columns, meaning, extra=extra)
        raise FileError(path, f"can't be read as lines of {columns} numbers: {meaning}")
    return table[:, :columns]


def _numbers(text: str, *, commas: bool) -> FloatArray:
    """All numbers of a text, block by block, for a buffer of all of it is as large as the text again.

    Raises:
        ValueError: Something is no number, or lines differ in length.
    """
    rows = np.empty((0, 0))
    count = start = 0
    while start < len(text):
        end = text.find("\n", start + _BLOCK) + 1 or len(text)
        block = text[start:end]
        start = end
        data = io.BytesIO((block.replace(",", " ") if commas else block).encode())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a block without numbers
            found = np.loadtxt(io.TextIOWrapper(data, encoding="utf-8"), dtype=np.float64, ndmin=2)
        if not len(found):
            continue
        if start >= len(text) and not count:
            return found
        if not count:
            rows = np.empty((text.count("\n") + 1, found.shape[1]))
        if found.shape[1] != rows.shape[1]:
            raise ValueError("lines of different lengths")
        rows[count : count + len(found)] = found
        count += len(found)
    return rows[:count]


def fault_in_row(path: str | Path, text: str, row: int, message: str, skipped: int = 0) -> FileError:
    """The error for data row ``row`` (from 0) below some lines, naming the line of the text it stands on."""
    lines = (number for number, _ in _data_lines(text) if number > skipped)
    return FileError(path, message, next(itertools.islice(lines, row, None), None))


def _data_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines that hold something, without comments, numbered from 1."""
    for number, line in enumerate(tables.lines_of(text), start=1):
        content = line.split("#", 1)[0].strip()
        if content:
            yield number, content


def _raise_bad_line(path: str | Path, text: str, columns: int, meaning: str, *, extra: bool) -> None:
    for number, content in _data_lines(text):
        words = content.replace(",", " ").split()
        if len(words) < columns or (len(words) > columns and not extra):
            raise FileError(path, f"found {len(words)} of {columns} values; expected {meaning}", number)
        for word in words:
            if not _is_number(word):
                shown = word if len(word) <= 30 else word[:30] + "…"
                raise FileError(path, f"{shown!r} is no number; expected {meaning}", number)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return "_" not in word


def _detect(path: str | Path, text: str) -> tuple[Format, tables.Header | None]:
    first = next(_data_lines(text), None)
    if first is None:
        raise FileError(path, "holds no poses: every line is empty or a comment")
    number, content = first
    words = content.replace(",", " ").split()
    numeric = any(map(_is_number, words))
    header = tables.find_header(path, text)
    if header is not None and numeric and header.count != len(words):
        header = None
    # The usual columns in the usual order are read as ever, whatever stands above them.
    if numeric and (header is None or header.order in (_TUM_ORDER, _EUROC_ORDER)):
        if len(words) == 12 and "," not in content:
            return "kitti", None
        if len(words) == 8 or (len(words) > 8 and "," in content):
            nanoseconds = _is_number(words[0]) and abs(float(words[0])) > _FIRST_NANOSECOND_STAMP
            return "euroc" if nanoseconds and "," in content else "tum", None
    if header is not None:
        return "csv", header
    known = "; ".join(f"{name} has {count}" for name, (count, _) in _COLUMNS.items())
    raise FileError(
        path,
        f"found {len(words)} values a line, which is no known format ({known}; csv names its columns, "
        "as in timestamp,x,y,z,qx,qy,qz,qw)",
        number,
    )


def _from_table(path: str | Path, text: str, header: tables.Header | None, unsorted: Unsorted) -> Trajectory:
    if header is None:
        raise FileError(
            path, "the first line names no time and position, as timestamp,x,y,z,qx,qy,qz,qw does", 1
        )
    stamps, positions, quaternions, oriented = tables.read_table(path, text, header)
    return _checked(path, text, (stamps, positions, quaternions), unsorted, header.line, oriented=oriented)


def _checked(
    path: str | Path,
    text: str,
    poses: tuple[FloatArray, FloatArray, FloatArray],
    unsorted: Unsorted,
    skipped: int = 0,
    *,
    oriented: bool = True,
) -> Trajectory:
    stamps, positions, quaternions = poses
    order = np.arange(len(stamps))
    if unsorted == "sort" and (np.diff(stamps) < 0).any():
        order = np.argsort(stamps, kind="stable")
        stamps, positions, quaternions = stamps[order], positions[order], quaternions[order]
    try:
        return Trajectory(stamps, positions, quaternions, oriented=oriented)
    except TrajectoryError as error:
        fault = find_fault(stamps, positions, quaternions)
        if fault is None:
            raise FileError(path, str(error)) from None
        raise fault_in_row(path, text, int(order[fault.row]), fault.message, skipped) from None


def _from_kitti(path: str | Path, text: str, table: FloatArray, times: str | Path | None) -> Trajectory:
    matrices = table.reshape(-1, 3, 4)
    bad = np.flatnonzero(~(np.abs(table) <= LARGEST_METRES).all(axis=1))
    if bad.size:
        raise fault_in_row(path, text, int(bad[0]), "every value must be a finite number")
    rotations = np.clip(matrices[:, :, :3], -2.0, 2.0)  # far from a rotation either way, but no overflow
    gram = np.einsum("nij,nkj->nik", rotations, rotations)
    wrong = (np.abs(gram - np.eye(3)).max(axis=(1, 2)) > 1e-2) | (np.linalg.det(rotations) < 0)
    bad = np.flatnonzero(wrong)
    if bad.size:
        message = "the left 3×3 part is no rotation (orthonormal, determinant 1)"
        raise fault_in_row(path, text, int(bad[0]), message)
    stamps = np.arange(len(table), dtype=np.float64)
    if times is not None:
        times_text = read_text(times)
        stamps = parse_table(times, times_text, 1, "one time stamp in seconds")[:, 0]
        if len(stamps) != len(table):
            raise FileError(times, f"has {len(stamps)} stamps for the {len(table)} poses of {path}")
        fault = find_fault(stamps, matrices[:, :, 3], np.ones((len(stamps), 4)))
        if fault is not None:
            raise fault_in_row(times, times_text, fault.row, fault.message)
    return Trajectory(stamps, matrices[:, :, 3], rotation.from_matrix(rotations), rotations=rotations)
