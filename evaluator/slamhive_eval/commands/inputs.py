# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that compare whole estimates with their ground truth by the nearest stamps.

``kitti``, ``repeated``, ``report`` and ``segments`` use them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive_eval import alignment, evaluation
from slamhive_eval.commands import measuring, output

if TYPE_CHECKING:
    import argparse


def add_inputs(parser: argparse.ArgumentParser, estimates: str = "estimated trajectories") -> None:
    """Add ground truth, estimates, how they are read and matched, and ``--json``."""
    parser.add_argument("reference", metavar="GT", help="ground truth; formats as for ape")
    parser.add_argument("estimates", metavar="EST", nargs="+", help=estimates)
    measuring.add_reading(parser)
    group = parser.add_argument_group("matching")
    measuring.add_max_diff(group)
    group.add_argument("--offset", type=float, default=0.0, metavar="S", help="added to EST's stamps [s]")
    output.add_json(parser)


def add_alignment(parser: argparse.ArgumentParser) -> None:
    """Add ``--align``, SE(3) by default."""
    parser.add_argument("--align", choices=alignment.METHODS, default="se3", help="default: se3")


def options(asked: argparse.Namespace) -> evaluation.Options:
    """Return the options to measure with; an alignment that scales leaves no scale to judge."""
    return evaluation.Options(
        alignment=asked.align,
        max_difference_seconds=asked.max_diff,
        offset_seconds=asked.offset,
        has_scale=asked.align not in ("sim3", "scale"),
    )
