# SPDX-License-Identifier: Apache-2.0
"""Options that say what the columns of a ground truth are, for all commands that read one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval.errors import OptionError
from slamhive_eval.formats.columns import COLUMNS, TableFormat, parse_columns

if TYPE_CHECKING:
    import argparse

TABLE, CONTROL_POINTS = "table", "control-points"
FORMATS = (TABLE, CONTROL_POINTS)
_POINTS = "t,x,y,z"
_OPTIONS = ("skip", "delimiter", "time_unit", "angle_unit", "rotation", "rate", "start_time", "min_interval")


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    group = parser.add_argument_group("ground truth in a table")
    group.add_argument(
        "--columns",
        metavar="NAMES",
        help=f"columns of GT from the first on, as in sec,nsec,x,y,z,qx,qy,qz,qw: {', '.join(COLUMNS)} "
        "(matrix: the 3×4 pose by rows; _: passed over). Without a time, line k from 0 is frame k",
    )
    group.add_argument("--skip", type=int, metavar="N", help="lines passed over at the top (default: 0)")
    group.add_argument(
        "--delimiter", metavar="SIGN", help="what separates columns (default: what the first line has)"
    )
    group.add_argument("--time-unit", choices=("s", "ms", "us", "ns"), help="unit of t (default: s)")
    group.add_argument("--angle-unit", choices=("rad", "deg"), help="of roll, pitch, yaw (default: rad)")
    group.add_argument(
        "--rotation",
        choices=("Pose", "Inverse"),
        help="Inverse: rotations turn vectors of the world into the frame, as Boreas' (default: Pose)",
    )
    group.add_argument("--rate", type=float, metavar="HZ", help="frames a second, where lines have frames")
    group.add_argument("--start-time", type=float, metavar="S", help="time of frame 0 (default: 0)")
    group.add_argument(
        "--min-interval",
        type=float,
        metavar="S",
        help="drop poses less than S seconds after the last one kept",
    )


def form(asked: argparse.Namespace) -> TableFormat | None:
    """The format that the options describe; None where they say nothing of columns.

    Raises:
        OptionError: They contradict one another.
    """
    settings: dict[str, Any] = {
        name: value for name in _OPTIONS if (value := getattr(asked, name)) is not None
    }
    words = asked.columns or (_POINTS if asked.reference_format == CONTROL_POINTS else None)
    if words is None:
        if asked.reference_format == TABLE or settings:
            first = (
                "--reference-format table" if not settings else f"--{next(iter(settings)).replace('_', '-')}"
            )
            raise OptionError(f"{first} needs --columns: what the columns of the ground truth are")
        return None
    if asked.reference_format not in (None, *FORMATS):
        raise OptionError(f"--columns is for tables, and --reference-format says {asked.reference_format}")
    return parse_columns(words, **settings)
