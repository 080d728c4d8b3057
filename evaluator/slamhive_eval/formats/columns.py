# SPDX-License-Identifier: Apache-2.0
"""Format of a table whose columns are named beside it, as ground truth of most data sets is published.

``slamhive-eval --columns`` and a Dataset's ``groundTruth.table`` describe it;
`slamhive_eval.formats.column_tables` reads it. Standard library alone: manifests are checked by it before
anything is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from slamhive_eval.errors import OptionError, did_you_mean

TimeUnit = Literal["s", "ms", "us", "ns"]
AngleUnit = Literal["rad", "deg"]
Direction = Literal["Pose", "Inverse"]

COLUMNS = (
    *("t", "sec", "nsec", "frame"),
    *("tx", "ty", "tz", "qx", "qy", "qz", "qw", "roll", "pitch", "yaw", "matrix", "_"),
)
"""``matrix`` stands for twelve columns, the 3×4 pose matrix by rows; ``_`` for one that is passed over."""
_ALIASES = {"timestamp": "t", "time": "t", "x": "tx", "y": "ty", "z": "tz"}
MATRIX_COLUMNS = 12
POSITION, QUATERNION = ("tx", "ty", "tz"), ("qx", "qy", "qz", "qw")
ANGLES = ("roll", "pitch", "yaw")
_DELIMITERS = (",", ";", "\t", " ")


@dataclass(frozen=True)
class TableFormat:
    """Format of a table: the meaning of its columns, their units, and how the file is to be read.

    Attributes:
        columns: Words of COLUMNS from the first column on; further ones are passed over. Time: one of ``t``,
            ``sec`` (with ``nsec``) and ``frame``; without any, line k from 0 is frame k.
        delimiter: What separates columns; a space means any white space. None to tell by the first line: a
            comma, semicolon or tab, else white space.
        skip: Lines passed over at the top. Empty ones and comments (#) always are.
        time_unit: Of ``t``.
        angle_unit: Of ``roll``, ``pitch`` and ``yaw``; R = Rz(yaw)·Ry(pitch)·Rx(roll).
        rotation: ``Pose``: turns vectors of the frame into the world; ``Inverse``: vectors of the world into
            the frame, as roll, pitch and yaw of Boreas do.
        rate: Frames a second, for frames.
        start_time: Time of frame 0 in s.
        min_interval: Poses less than so many seconds after the last one kept are dropped.

    Raises:
        OptionError: Columns that contradict one another or make no position over time.
    """

    columns: tuple[str, ...]
    delimiter: str | None = None
    skip: int = 0
    time_unit: TimeUnit = "s"
    angle_unit: AngleUnit = "rad"
    rotation: Direction = "Pose"
    rate: float | None = None
    start_time: float = 0.0
    min_interval: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(_ALIASES.get(name, name) for name in self.columns))
        problem = _columns_problem(self) or _settings_problem(self)
        if problem:
            raise OptionError(problem)

    @property
    def by_frames(self) -> bool:
        """True if lines have frames instead of times."""
        return not {"t", "sec"}.intersection(self.columns)

    @property
    def oriented(self) -> bool:
        """True if the columns contain orientations."""
        return bool({"qw", "roll", "matrix"}.intersection(self.columns))

    @property
    def width(self) -> int:
        """Columns that a line needs."""
        places = self.places.items()
        return max(place + (MATRIX_COLUMNS if name == "matrix" else 1) for name, place in places)

    @property
    def places(self) -> dict[str, int]:
        """Index of each column by its name, from 0; of ``matrix`` the first of its twelve."""
        found, place = {}, 0
        for name in self.columns:
            if name != "_":
                found[name] = place
            place += MATRIX_COLUMNS if name == "matrix" else 1
        return found


def parse_columns(words: str, **settings: object) -> TableFormat:
    """The format that names separated by commas or blanks describe, as in ``sec,nsec,x,y,z``.

    Raises:
        OptionError: What TableFormat says.
    """
    return TableFormat(tuple(words.replace(",", " ").split()), **settings)  # type: ignore[arg-type]


def _columns_problem(form: TableFormat) -> str:
    """Return the fault of the columns, in a sentence; empty where there is none."""
    names = [name for name in form.columns if name != "_"]
    for name in names:
        if name not in COLUMNS:
            return (
                f"columns: unknown column {name!r}{did_you_mean(name, COLUMNS)}; known: {', '.join(COLUMNS)}"
            )
        if names.count(name) > 1:
            return f"columns: {name} is there {names.count(name)} times"
    has = set(names)
    if len(has & {"t", "sec", "frame"}) > 1 or ("nsec" in has and "sec" not in has):
        return "columns: the time is either t, sec with or without nsec, or frame"
    return _pose_problem(has)


def _pose_problem(has: set[str]) -> str:
    rotations = has.intersection((*QUATERNION, *ANGLES))
    if "matrix" in has:
        both = rotations or has.intersection(POSITION)
        return "columns: matrix is position and rotation; name no other column of them" if both else ""
    if not has.issuperset(POSITION):
        return "columns: a position is needed: tx, ty and tz, or matrix"
    if rotations and rotations not in (set(QUATERNION), set(ANGLES)):
        found = ", ".join(name for name in COLUMNS if name in rotations)
        return f"columns: a rotation is either qx, qy, qz, qw or roll, pitch, yaw, all of them, not {found}"
    return ""


def _settings_problem(form: TableFormat) -> str:
    if form.delimiter is not None and form.delimiter not in _DELIMITERS:
        return f"delimiter: expected a comma, semicolon, tab or space, not {form.delimiter!r}"
    if form.skip < 0:
        return f"skip: expected a number of lines from 0 on, not {form.skip}"
    if form.rate is not None and not form.by_frames:
        return "rate: only for frames; the columns have the time"
    if form.rate is not None and not 0 < form.rate < float("inf"):
        return f"rate: expected a positive number of frames a second, not {form.rate}"
    if not 0 <= form.min_interval < float("inf"):
        return f"minInterval: expected seconds from 0 on, not {form.min_interval}"
    return ""
