# SPDX-License-Identifier: Apache-2.0
"""Listings of the catalog at several widths, and options of ``dataset prepare``."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import pytest
from rich.console import Console

from slamhive.cli.parts.listing import show_catalog

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HEADINGS = ("algorithm", "sensors", "what it is")
LINES = [("orb-slam3-smallvoc", "stereo, rgbd", "a sentence that goes on " * 4), ("loam", "lidar", "short")]


def listed(width: int, *, terminal: bool = True) -> tuple[list[str], bool]:
    stream = io.StringIO()
    console = Console(file=stream, width=width, force_terminal=terminal, no_color=True)
    complete = show_catalog(HEADINGS, LINES, (2,), console)
    return stream.getvalue().splitlines(), complete


@pytest.mark.parametrize("width", [20, 40, 80, 120, 300])
def test_names_stay_whole_and_entries_take_one_line(width: int) -> None:
    lines, complete = listed(width)
    assert len(lines) == 4 + len(LINES)
    assert all(any(name in line for line in lines) for name, *_ in LINES)
    assert all(any(sensors in line for line in lines) for _, sensors, _ in LINES)
    assert complete == (width >= 80)
    assert ("…" in "".join(lines)) == (80 <= width < 300)
    assert len(lines[-1]) <= max(width, 38)


def test_a_pipe_gets_no_wider_lines_than_a_terminal() -> None:
    lines, complete = listed(80, terminal=False)
    assert complete
    assert max(map(len, lines)) <= 80
    assert not listed(40, terminal=False)[1], "what has no room is left out, and said to be"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--start", "abc"), "--start: expected a duration such as"),
        (("--sensors", "lidar"), "no sensor for the role 'lidar'"),
    ],
)
def test_wrong_options_of_prepare(
    words: tuple[str, ...],
    message: str,
    desk: Path,
    slamhive: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert slamhive("dataset", "prepare", "synthetic-camera", "--sensors", "stereo", *words) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_prepare_leaves_absent_options_to_their_defaults(desk: Path, slamhive: Callable[..., int]) -> None:
    assert slamhive("dataset", "prepare", "synthetic-camera", "--sensors", "mono") == 0
