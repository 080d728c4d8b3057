# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval batch``: many estimates, one JSON object a line as they finish."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive_eval import batch, pairs
from slamhive_eval.commands import measuring, tables
from slamhive_eval.errors import OptionError
from slamhive_eval.evaluation import Options, RpeOptions

if TYPE_CHECKING:
    from slamhive_eval.formats import files


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Evaluate many estimates on all processors: coverage, outcome, absolute and relative errors, one "
        "JSON object a line in the order they finish. What is wrong with a pair is its line's error; the "
        "exit code is 1 then."
    )
    parser.epilog = "Example: slamhive-eval batch runs/ --reference gt.txt --align sim3 se3 > results.jsonl"
    parser.add_argument(
        "path",
        metavar="DIR|FILE",
        help="a folder with estimates, or a list of pairs, one a line: GT EST, or JSON with reference and "
        "estimate",
    )
    parser.add_argument(
        "--reference",
        metavar="GT",
        help="ground truth of all estimates in DIR (default: groundtruth.* or gt.* beside or above each)",
    )
    parser.add_argument(
        "--pattern", default="*.txt", metavar="GLOB", help="names of the estimates in DIR (default: *.txt)"
    )
    parser.add_argument(
        "--reference-format",
        choices=tables.FORMATS,
        help="table: the ground truth has the columns that --columns names; control-points: it is positions "
        "at instants, t x y z or as --columns says",
    )
    tables.add(parser)
    measuring.add_preparation(parser, several=True)
    parser.add_argument("--delta", type=float, default=1.0, metavar="D", help="distance of an RPE's pair")
    parser.add_argument(
        "--unit", choices=pairs.UNITS, default="frames", help="unit of delta (default: frames)"
    )
    parser.add_argument("--all-pairs", action="store_true", help="all pairs instead of consecutive ones")
    parser.add_argument("--rel-tolerance", type=float, default=0.1, metavar="T", help="default: 0.1")
    parser.add_argument(
        "--min-coverage", type=float, default=0.9, metavar="SHARE", help="from which a run is tracked"
    )
    parser.add_argument("--sort", action="store_true", help="sort poses of estimates by time")
    measuring.add_by_index(parser)
    parser.add_argument(
        "--no-segments",
        action="store_true",
        help="pass over segments.csv beside an estimate, by which it is measured map by map",
    )
    parser.add_argument("--jobs", type=int, metavar="N", help="processes (default: one a processor)")
    parser.add_argument("--json", action="store_true", help="no effect: every line is JSON anyway")


def run(asked: argparse.Namespace) -> int:
    """Evaluate all pairs and print a line for each."""
    if Path(asked.path).is_dir():
        found = batch.find_pairs(asked.path, asked.reference, asked.pattern)
    elif asked.reference is not None:
        raise OptionError(f"--reference goes with a folder, and {asked.path} is none")
    else:
        found = batch.read_pairs(asked.path)
    unsorted: files.Unsorted = "sort" if asked.sort else "error"
    failed = 0
    for result in batch.evaluate_pairs(
        found,
        _options(asked),
        unsorted=unsorted,
        by_index=asked.by_index,
        processes=asked.jobs,
        with_segments=not asked.no_segments,
        truths=batch.Truths(tables.form(asked), asked.reference_format == tables.CONTROL_POINTS),
    ):
        failed += "error" in result
        sys.stdout.write(json.dumps(result, allow_nan=False) + "\n")
        sys.stdout.flush()
    if failed:
        sys.stderr.write(f"slamhive-eval: {failed} of {len(found)} pairs could not be evaluated\n")
    return 1 if failed else 0


def _options(asked: argparse.Namespace) -> list[Options]:
    rpe = RpeOptions(
        asked.delta, asked.unit, "all" if asked.all_pairs else "consecutive", asked.rel_tolerance
    )
    hows = [
        measuring.preparation(argparse.Namespace(**{**vars(asked), "align": name}))
        for name in dict.fromkeys(asked.align)
    ]
    return [
        Options(
            alignment=how.alignment,
            extrinsic=how.extrinsic,
            max_difference_seconds=how.max_difference_seconds,
            offset_seconds=how.offset_seconds,
            rpe=(rpe,),
            min_coverage=asked.min_coverage,
            has_scale=not asked.unscaled,
            matching=how.matching,
            max_gap_seconds=how.max_gap_seconds,
            clock=how.clock,
            hand_eye=how.hand_eye,
            first_poses=how.first_poses,
            robust=how.robust,
            keep=how.keep,
        )
        for how in hows
    ]
