# SPDX-License-Identifier: Apache-2.0
"""Trajectories in files: TUM, EuRoC ground truth, KITTI and tables, plain or compressed, and recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import FileError, NoPosesError, OptionError, TrajectoryError
from slamhive_eval.formats import bags, kitti_files, tables
from slamhive_eval.formats.textfiles import (
    DECIMAL_COMMA,
    data_lines,
    decode,
    fault_in_row,
    has_decimal_comma,
    head,
    is_number,
    is_separated,
    known_rows,
    parse_table,
    read_bytes,
    shorten,
    words_of,
)
from slamhive_eval.trajectory import SMALLEST_QUATERNION_COMPONENT, Trajectory, find_fault

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray

Format = Literal["tum", "euroc", "kitti", "csv", "bag"]
Unsorted = Literal["error", "sort"]

FORMATS: tuple[Format, ...] = get_args(Format)
_COLUMNS: dict[str, tuple[int, str]] = {
    "tum": (8, "timestamp tx ty tz qx qy qz qw"),
    "euroc": (8, "timestamp [ns], px, py, pz, qw, qx, qy, qz, …"),
}
"""Columns a line of each format without names needs, and what they are; see kitti_files for KITTI's."""

_TUM_ORDER = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
_EUROC_ORDER = ("time", "x", "y", "z", "qw", "qx", "qy", "qz")
_USUAL = {"tum": (_TUM_ORDER, 1.0), "euroc": (_EUROC_ORDER, 1e9)}
"""Fields of the first columns, and units of time a second."""
_FIRST_NANOSECOND_STAMP = 1e14
_FIRST_UNIX_STAMP = 1e8
_STAMPED_MATRIX = (
    "found a time stamp and a 3×4 pose matrix a line, which is no known format: write the 12 numbers of the "
    "matrix alone, as KITTI does, and the stamps in s to a file of times"
)


def read_trajectory(
    path: str | Path,
    file_format: Format | None = None,
    *,
    times: str | Path | None = None,
    topic: str | None = None,
    unsorted: Unsorted = "error",
    by_index: bool = False,
) -> Trajectory:
    """Read a trajectory, finding out the format unless told.

    Args:
        path: A file, plain or compressed by gzip or bzip2; or a recording (ROS 1 bag, folder of a ROS 2 bag,
            MCAP), perhaps with the topic as in ``run.bag:/odom`` or ``run.bag:/tf:map.base_link``.
        file_format: ``tum``, ``euroc``, ``kitti``, ``csv`` (named columns) or ``bag``; None to tell by the
            first line or, for recordings, by the file's name.
        times: For KITTI: the file with one stamp in s a line, that of frame k in line k. Without it the
            stamps are frames. Line k, counted from 0, is frame k unless it begins with its frame index.
        topic: For recordings: the topic, see `slamhive_eval.formats.bags.read_bag`.
        unsorted: What to do with decreasing stamps: ``error`` names the line, ``sort`` sorts the poses
            by time, keeping the order of equal stamps.
        by_index: For KITTI: take poses and stamps as far as both go where their numbers differ, with a note.

    Returns:
        The trajectory, stamps in s. Rows that hold NaN are left out, counted and noted.

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
    data = read_bytes(path)
    header, detected = None, file_format is None
    if file_format is None:
        file_format, header = ("kitti", None) if times is not None else _detect(path, head(data))
    if file_format == "csv":
        return _from_table(path, data, header or _find_header(path, head(data)), unsorted)
    if file_format == "kitti":
        return kitti_files.parse_poses(path, data, times, sort=unsorted == "sort", by_index=by_index)
    table = parse_table(path, data, *_COLUMNS[file_format], extra=file_format == "euroc")
    if file_format == "euroc":
        # float64 nanoseconds divided by 1e9, as evo does: a stamp then equals evo's to the last bit.
        stamps, quaternions = table[:, 0] / 1e9, table[:, [5, 6, 7, 4]]
    else:
        stamps, quaternions = table[:, 0], table[:, 4:8]
    nanoseconds = detected and file_format == "tum" and not (stamps <= _FIRST_NANOSECOND_STAMP).any()
    stamps = stamps / 1e9 if nanoseconds else stamps
    rows = tables.Rows(stamps, table[:, 1:4], quaternions, oriented=True, covariances=None)
    found = _checked(path, data, rows, unsorted)
    # TUM's columns with EuRoC's stamps, as ORB-SLAM3 writes them.
    return found.noted("its time stamps were taken for nanoseconds") if nanoseconds else found


def read_estimate(
    path: str | Path,
    reference: Trajectory,
    reference_path: str | Path,
    file_format: Format | None = None,
    *,
    times: str | Path | None = None,
    topic: str | None = None,
    unsorted: Unsorted = "error",
    by_index: bool = False,
) -> Trajectory:
    """Read an estimate that is to be paired with a ground truth.

    Args:
        path: As for read_trajectory, as is what isn't told here.
        reference: The ground truth.
        reference_path: Its file, for errors.
        file_format: Of the estimate.
        times: For KITTI: stamps of the frames.
        topic: For recordings.
        unsorted: What to do with decreasing stamps.
        by_index: Pair KITTI poses as far as both go where files have unequal numbers of them, with a note.

    Returns:
        The estimate, whose stamps are those of the ground truth's clock or frames.

    Raises:
        FileError: What read_trajectory and `kitti_files.check_pair` say.
        OptionError: Unknown format, or ``by_index`` for poses with time stamps.
    """
    found = read_trajectory(path, file_format, times=times, topic=topic, unsorted=unsorted, by_index=by_index)
    if by_index and times is None:
        for name, one in ((reference_path, reference), (path, found)):
            if one.stamped_by == "time":
                raise OptionError(f"--by-index is for KITTI poses without times, and {name} has time stamps")
    return kitti_files.check_pair(reference, found, reference_path, path, by_index=by_index)


def detect_format(path: str | Path) -> Format:
    """Return the format of a file by its first line or, for recordings, by its name.

    Raises:
        FileError: It can't be read, or its first line is of no known format.
    """
    path, _ = _split_topic(path, None)
    return "bag" if bags.is_bag(path) else _detect(path, head(read_bytes(path)))[0]


def read_transform(path: str | Path) -> FloatArray:
    """Read a rigid motion: 16 or 12 numbers of a matrix row by row, or ``x y z qx qy qz qw``.

    Returns:
        The matrix, shape (4, 4). It isn't checked to be rigid.

    Raises:
        FileError: The file can't be read or holds other than so many numbers.
    """
    words = read_text(path).translate(str.maketrans("[](),;", "      ")).split()
    if len(words) not in (7, 12, 16) or not all(map(is_number, words)):
        raise FileError(
            path, "a transform has 16 or 12 numbers of a matrix row by row, or 7: x y z qx qy qz qw"
        )
    numbers = np.array(words, dtype=np.float64)
    matrix = np.eye(4)
    if len(words) == 7:
        largest = np.abs(numbers[3:]).max()
        if not np.isfinite(numbers).all() or largest < SMALLEST_QUATERNION_COMPONENT:
            raise FileError(path, "the quaternion is zero, or a number isn't finite")
        matrix[:3, :3] = rotation.to_matrix(rotation.normalize(numbers[3:] / largest))
        matrix[:3, 3] = numbers[:3]
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
    from slamhive_eval.formats.writing import write_trajectory  # noqa: PLC0415 - readers needn't it

    write_trajectory(path, trajectory, "tum")


def read_text(path: str | Path) -> str:
    """The text of a file, uncompressed, with lines ending in a newline only.

    Raises:
        FileError: The file can't be read, its compressed data is broken, or it holds no text.
    """
    return decode(read_bytes(path))


def _find_header(path: str | Path, text: str) -> tables.Header | None:
    first = next(data_lines(text), None)
    content = first[1] if first is not None else ""
    return tables.find_header(path, text, content if any(map(is_number, words_of(content))) else None)


def _detect(path: str | Path, text: str) -> tuple[Format, tables.Header | None]:
    first = next(data_lines(text), None)
    if first is None:
        raise NoPosesError(path)
    number, content = first
    words = words_of(content)
    numeric = any(map(is_number, words))
    header = tables.find_header(path, text, content if numeric else None)
    if numeric:
        found = _detect_numbers(path, number, words, header, separated=is_separated(content))
        # Names above the usual columns in the usual order tell nothing new; above others they decide.
        if found is not None and (header is None or (found in _USUAL and header.is_usual(*_USUAL[found]))):
            return found, None
    if header is not None:
        return "csv", header
    if has_decimal_comma(content):
        raise FileError(path, DECIMAL_COMMA, number)
    known = "; ".join(f"{name} has {count}" for name, (count, _) in _COLUMNS.items())
    values = f"{len(words)} value{'s' * (len(words) != 1)} a line" if numeric else shorten(content)
    raise FileError(
        path,
        f"found {values}, which is no known format ({known} numbers a line; kitti has 12, or 13 with the "
        "frame index first; csv names its columns, as in timestamp,x,y,z,qx,qy,qz,qw)",
        number,
    )


def _detect_numbers(
    path: str | Path, number: int, words: list[str], header: tables.Header | None, *, separated: bool
) -> Format | None:
    """Return the format of lines of numbers by the first of them; None where it is none."""
    stamp = abs(float(words[0])) if is_number(words[0]) else 0.0
    if header is None and len(words) > kitti_files.COLUMNS and not stamp < _FIRST_UNIX_STAMP:
        matrix = words[1 : 1 + kitti_files.COLUMNS]
        if all(map(is_number, matrix)) and kitti_files.check_matrices(np.array([matrix], float)) is None:
            raise FileError(path, _STAMPED_MATRIX, number)
    nanoseconds = stamp > _FIRST_NANOSECOND_STAMP and separated
    counts = {kitti_files.COLUMNS} if header is not None else {kitti_files.COLUMNS, kitti_files.COLUMNS + 1}
    if len(words) in counts and not nanoseconds:
        return "kitti"
    covariances = header is not None and header.covariance
    if len(words) == 8 or (len(words) > 8 and separated and not covariances):
        return "euroc" if nanoseconds else "tum"
    return None


def _from_table(
    path: str | Path, data: bytes, header: tables.Header | None, unsorted: Unsorted
) -> Trajectory:
    if header is None:
        raise FileError(
            path, "the first line names no time and position, as timestamp,x,y,z,qx,qy,qz,qw does", 1
        )
    return _checked(path, data, tables.read_table(path, decode(data), header), unsorted, header.line)


def _checked(
    path: str | Path, data: bytes, rows: tables.Rows, unsorted: Unsorted, skipped: int = 0
) -> Trajectory:
    stamps, positions, quaternions, oriented, covariances = rows
    known = known_rows(path, stamps, positions, quaternions)
    order = known.rows
    if unsorted == "sort" and (np.diff(stamps[order]) < 0).any():
        order = order[np.argsort(stamps[order], kind="stable")]
    stamps, positions, quaternions = stamps[order], positions[order], quaternions[order]
    covariances = None if covariances is None else covariances[order]
    try:
        return Trajectory(
            stamps,
            positions,
            quaternions,
            oriented=oriented,
            covariances=covariances,
            notes=known.notes,
            nan_rows=known.left_out,
        )
    except TrajectoryError as error:
        fault = find_fault(stamps, positions, quaternions)
        if fault is None:
            raise FileError(path, str(error)) from None
        raise fault_in_row(path, data, int(order[fault.row]), fault.message, skipped) from None
