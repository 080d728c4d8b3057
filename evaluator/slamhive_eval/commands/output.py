# SPDX-License-Identifier: Apache-2.0
"""Output of a command: a table, one JSON object, or the other forms that it writes to files.

All commands use it.
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.statistics import Statistics
    from slamhive_eval.trajectory import Trajectory

WRITERS: tuple[str, ...] = ("slamhive_eval.commands.saving",)
"""Modules with ``add(parser)`` and ``write(asked, measured)``, for other forms of what was measured."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One estimate, measured by ``ape`` or ``rpe``.

    Attributes:
        metric: Which of the two.
        name: Of the estimate, as it was given.
        reference: Associated ground truth, m poses.
        estimate: Associated estimate, aligned, m poses.
        errors: Shape (m,) for ape, (k,) for rpe, in the relation's unit.
        pairs: Indices (i, j) of rpe, shape (k, 2); None for ape.
        statistics: Of the errors.
        result: What ``--json`` prints.
    """

    metric: Literal["ape", "rpe"]
    name: str
    reference: Trajectory
    estimate: Trajectory
    errors: FloatArray
    pairs: IndexArray | None
    statistics: Statistics
    result: dict[str, Any]


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_writers(parser: argparse.ArgumentParser) -> None:
    """Add the options of all writers."""
    for name in WRITERS:
        importlib.import_module(name).add(parser)


def write(asked: argparse.Namespace, measured: Sequence[Measured]) -> None:
    """Let every writer write what it was asked for."""
    for name in WRITERS:
        importlib.import_module(name).write(asked, measured)


def emit(asked: argparse.Namespace, result: dict[str, Any], show: Callable[[dict[str, Any]], str]) -> None:
    """Print a result: one JSON object where asked, otherwise what ``show`` makes of it."""
    text = json.dumps(result, allow_nan=False) if asked.json else show(result)
    sys.stdout.write(text + "\n")
