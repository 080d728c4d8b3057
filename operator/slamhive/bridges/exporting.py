# SPDX-License-Identifier: Apache-2.0
"""Export of chosen runs to another program's folder."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from slamhive.bridges.gathering import handed

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.analysis.frame import Frame
    from slamhive.bridges.places import Here
    from slamhive.bridges.targets import BridgeTarget


def export(
    frame: Frame, target: BridgeTarget, folder: Path, source: Here, tell: Callable[[int], Any]
) -> tuple[int, int, dict[str, str], dict[str, int]]:
    """Write the runs of a table into another program's folder.

    Args:
        frame: the rows.
        target: whose folder.
        folder: the folder; it may have runs already.
        source: where the runs' files are.
        tell: told of each run that is done.

    Returns:
        How many runs were written, how many were there as they are, what is in the place of names that the
        program refuses, and sentences on what is missing, each with the number of runs.

    Raises:
        InputError: the program's library isn't installed.
    """
    writer = importlib.import_module(f"slamhive.bridges.{target}").Writer(folder, source)
    new = same = 0
    try:
        for run in handed(frame, source):
            if writer.write(run):
                new += 1
            else:
                same += 1
            tell(new + same)
    finally:
        writer.close()
    return new, same, writer.names.changed, getattr(writer, "missing", {})


def next_step(target: BridgeTarget, folder: Path) -> str:
    """Return the command that opens what was written."""
    text: str = importlib.import_module(f"slamhive.bridges.{target}").NEXT
    return text.format(folder=folder)
