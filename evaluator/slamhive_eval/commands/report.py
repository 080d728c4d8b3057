# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval report``: a page or a figure that shows estimates beside their ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from slamhive_eval import evaluation
from slamhive_eval.commands import inputs, measuring, output
from slamhive_eval.errors import FileError, OptionError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "One HTML page, complete in itself, with the trajectories from four sides, errors over time and "
        "path, histogram, boxes and statistics; or a figure as PNG, SVG or PDF (needs matplotlib)."
    )
    parser.epilog = "Example: slamhive-eval report groundtruth.txt a.txt b.txt --align se3 -o report.html"
    inputs.add_inputs(parser)
    inputs.add_alignment(parser)
    measuring.add_support(parser)
    parser.add_argument("-o", "--output", metavar="FILE", help="the page (default: report.html)")
    parser.add_argument("--figure", metavar="FILE", help="a figure: .png, .svg or .pdf")
    parser.add_argument("--title", default="Trajectory evaluation", metavar="TEXT", help="of page and figure")


def run(asked: argparse.Namespace) -> int:
    """Measure, write and say where to."""
    options = inputs.options(asked)
    reference = measuring.read_reference(asked)
    estimates = [estimate for _, estimate in measuring.read_estimates(asked, reference)]
    names = _names(asked.estimates)
    found = {
        name: evaluation.evaluate(reference, estimate, options)
        for name, estimate in zip(names, estimates, strict=True)
    }
    written = []
    if asked.output or not asked.figure:
        from slamhive_eval.reports import report  # noqa: PLC0415 - only where asked for

        written.append(asked.output or "report.html")
        page = report.report_html(
            reference, found, title=asked.title, reference_name=Path(asked.reference).name
        )
        try:
            Path(written[-1]).write_text(page, encoding="utf-8")
        except OSError as error:
            raise FileError(written[-1], f"can't be written: {error.strerror or error}") from error
    if asked.figure:
        from slamhive_eval.reports import figures  # noqa: PLC0415

        figures.save_figure(asked.figure, reference, found, title=asked.title)
        written.append(asked.figure)
    each = {name: one.as_dict() for name, one in found.items()}
    notes = [f"note: {note}" for estimate in estimates for note in estimate.notes]
    output.emit(asked, {"written": written, "estimates": each}, lambda _: "\n".join(written + notes))
    return 0


def _names(estimates: Sequence[str]) -> list[str]:
    """Return names for the estimates: file stems where they tell them apart, otherwise the words given."""
    stems = [Path(name).stem for name in estimates]
    names = stems if len(set(stems)) == len(stems) else list(estimates)
    if len(set(names)) != len(names):
        raise OptionError("the same estimate is given twice")
    return names
