# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval ape --reference-format control-points``: errors at surveyed positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval.commands import measuring, output, tables
from slamhive_eval.commands.output import Measured
from slamhive_eval.errors import EvaluationError, OptionError
from slamhive_eval.evaluation import Options
from slamhive_eval.formats.column_tables import read_columns
from slamhive_eval.measures.points import ControlPoints, evaluate_points, require_point_options

if TYPE_CHECKING:
    import argparse

    from slamhive_eval.trajectory import Trajectory


def measure(asked: argparse.Namespace) -> int:
    """Measure every estimate at the control points and print.

    Returns:
        The exit code.

    Raises:
        OptionError: What control points can't serve was asked for.
        EvaluationError: Too few of them are met.
    """
    how = measuring.preparation(asked)
    if asked.relation not in ("trans_part", "point_distance"):
        raise OptionError(f"control points have no orientations, which the relation {asked.relation} needs")
    require_point_options(how)
    if asked.support == "common":
        raise OptionError("--support common needs more than control points")
    form = tables.form(asked)
    assert form is not None  # noqa: S101 - control points always have one
    points = ControlPoints.of(read_columns(asked.reference, form, asked.times))
    options = Options(
        alignment=how.alignment,
        extrinsic=how.extrinsic,
        max_difference_seconds=how.max_difference_seconds,
        max_gap_seconds=how.max_gap_seconds,
        offset_seconds=how.offset_seconds,
        first_poses=how.first_poses,
        robust=how.robust,
        keep=how.keep,
    )
    measured = [
        _measured(asked, points, name, measuring.read_estimate(asked, name, None), options)
        for name in asked.estimates
    ]
    output.write(asked, measured)
    results = [one.result for one in measured]
    if len(results) == 1:
        output.emit(asked, results[0], lambda result: _show(result, details=asked.details))
    else:
        output.emit(asked, {"results": results}, lambda _: measuring.show_several(results))
    return 0


def _measured(
    asked: argparse.Namespace, points: ControlPoints, name: str, estimate: Trajectory, options: Options
) -> Measured:
    found = evaluate_points(points, estimate, options)
    if found.laid is None or found.ate is None or found.errors is None:
        raise EvaluationError(f"{name}: {found.message}")
    values = found.as_dict()
    result = {
        "relation": asked.relation,
        **found.ate.as_dict(),
        **found.laid.as_dict(),
        **{key: values[key] for key in ("points", "pointErrors", "notes")},
        "estimate": name,
    }
    laid = found.laid
    return Measured("ape", name, laid.reference, laid.estimate, found.errors, None, found.ate, result)


def _show(result: dict[str, Any], *, details: bool) -> str:
    points = result["points"]
    lines = [f"{points['met']} of {points['count']} control points met", measuring.show(result)]
    if details:
        lines += [f"{one['time']:.6f}  {one['error']:.6f}" for one in result["pointErrors"]]
    return "\n".join(lines)
