# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval segments``: an estimate that started again or holds several maps, piece by piece."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.commands import inputs, measuring, output
from slamhive_eval.errors import OptionError
from slamhive_eval.measures import segments

if TYPE_CHECKING:
    import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "An estimate that started again or holds several maps: the map over the longest path is aligned and "
        "stands for it, the others are aligned alone and measured in the first one's frame too."
    )
    parser.epilog = "Example: slamhive-eval segments groundtruth.txt trajectory.txt --segments segments.csv"
    inputs.add_inputs(parser)
    inputs.add_alignment(parser)
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument(
        "--segments",
        metavar="FILE",
        help="start, end, map and reason of each piece (default: segments.csv beside EST)",
    )
    parts.add_argument(
        "--restarts", type=float, nargs="+", metavar="S", help="times at which a map began [s]"
    )


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    options = inputs.options(asked)
    reference = measuring.read_reference(asked)
    results = []
    for name in asked.estimates:
        estimate = measuring.read_estimate(asked, name, reference)
        pieces = _restarted(asked) if asked.restarts else _read(asked, name)
        found = segments.evaluate_pieces(reference, estimate, pieces, options)
        results.append({**found, "estimate": name})
    result = results[0] if len(results) == 1 else {"results": results}
    output.emit(asked, result, lambda _: "\n\n".join(map(_show, results)))
    return 0


def _restarted(asked: argparse.Namespace) -> list[segments.Piece]:
    if not (np.isfinite(asked.restarts).all() and (np.diff(asked.restarts) > 0).all()):
        raise OptionError("the times of --restarts must be finite and ascend")
    starts = [-np.inf, *asked.restarts]
    ends = [np.nextafter(time, -np.inf) for time in asked.restarts] + [np.inf]
    return [
        segments.Piece(start, end, str(k)) for k, (start, end) in enumerate(zip(starts, ends, strict=True))
    ]


def _read(asked: argparse.Namespace, name: str) -> list[segments.Piece]:
    path = asked.segments or segments.beside(name)
    if path is None:
        raise OptionError(f"{name}: there is no {segments.NAME} beside it; name --segments or --restarts")
    return segments.read_segments(path)


def _show(result: dict[str, Any]) -> str:
    main = result["mainSegment"]
    count = len(result["segments"])
    lines = [
        f"{result['estimate']}: {result['outcome']}, alignment {result['alignment']}",
        f"the longest of {count} maps (*) covers {result['coverage']:.1%}",
        f"{'map':>10}  {'poses':>6}  {'path [m]':>9}  {'ATE [m]':>9}  {'scale':>8}  {'in * [m]':>9}  reason",
    ]
    for one in result["segments"]:
        ate, shared = (f"{one[key]['rmse']:.5f}" if one[key] else "–" for key in ("ate", "ateInMainFrame"))
        scale = "–" if one["scale"] is None else f"{one['scale']:.5f}"
        name = f"{'*' if one['segment'] == main else ''}{one['map']}"
        lines.append(
            f"{name:>10}  {one['poses']:>6}  {one['metres']:>9.3f}  {ate:>9}  {scale:>8}  {shared:>9}  "
            f"{one['reason']}".rstrip()
        )
    if result["posesOutside"]:
        lines.append(f"{result['posesOutside']} poses are in none of them")
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])
