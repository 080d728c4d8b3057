# SPDX-License-Identifier: Apache-2.0
"""Trajectories and their errors, with numpy alone.

    >>> from slamhive_eval import Options, evaluate, read_trajectory
    >>> result = evaluate(read_trajectory("gt.txt"), read_trajectory("est.txt"), Options(alignment="sim3"))
    >>> result.outcome, result.ate.rmse, result.coverage.share

Names load when first used, so that ``slamhive-eval`` can set the number of BLAS threads before numpy.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slamhive_eval.alignment import Alignment, align, umeyama_scale
    from slamhive_eval.association import (
        Association,
        associate,
        associate_forward,
        associate_uniquely,
        interpolate,
        match,
    )
    from slamhive_eval.coverage import Coverage, measure_coverage
    from slamhive_eval.errors import (
        AssociationError,
        EvaluationError,
        FileError,
        NoPosesError,
        OptionError,
        TrajectoryError,
    )
    from slamhive_eval.evaluation import Evaluation, Options, Outcome, RpeOptions, evaluate
    from slamhive_eval.formats.clouds import Cloud, read_cloud, sample_mesh
    from slamhive_eval.formats.column_tables import read_columns
    from slamhive_eval.formats.columns import TableFormat
    from slamhive_eval.formats.evo_zip import ErrorSeries, write_error_arrays, write_evo_zip
    from slamhive_eval.formats.files import read_euroc, read_kitti, read_trajectory, read_tum, write_tum
    from slamhive_eval.formats.healthfiles import Confidence, read_covariances, read_health
    from slamhive_eval.formats.writing import write_trajectory
    from slamhive_eval.handeye import HandEye, hand_eye
    from slamhive_eval.measures.consistency import Consistency, measure_consistency
    from slamhive_eval.measures.health import Awareness, HealthRule, ToldLoss, evaluate_health, measure_health
    from slamhive_eval.measures.kitti import KittiErrors, kitti_errors
    from slamhive_eval.measures.losses import LocalErrors, LossRule, local_errors
    from slamhive_eval.measures.maps import MapEntropy, MapErrors, compare_maps, mean_map_entropy, thin_out
    from slamhive_eval.measures.motion import Smoothness, smoothness, velocities, velocity_errors
    from slamhive_eval.measures.points import ControlPoints, PointErrors, evaluate_points
    from slamhive_eval.measures.relations import RelationErrors, Relations, evaluate_relations, read_relations
    from slamhive_eval.measures.relative import (
        ScaleDrift,
        SubTrajectoryErrors,
        scale_drift,
        sub_trajectory_errors,
    )
    from slamhive_eval.measures.repeated import Repeated, summarize
    from slamhive_eval.measures.segments import Piece, evaluate_pieces, number_poses, read_segments
    from slamhive_eval.measures.support import (
        Gap,
        SegmentedEvaluation,
        Support,
        common_support,
        evaluate_segments,
        find_support,
        segment_numbers,
        within,
    )
    from slamhive_eval.metrics import ape_errors, rpe_errors
    from slamhive_eval.pairs import find_pairs
    from slamhive_eval.preparing import Preparation, Prepared, prepare
    from slamhive_eval.reports.figures import save_figure, save_trajectories
    from slamhive_eval.reports.report import report_html
    from slamhive_eval.reports.result_tables import csv_table, latex_table
    from slamhive_eval.robust import align_robustly
    from slamhive_eval.statistics import Statistics
    from slamhive_eval.timing import TimeOffset, find_offset
    from slamhive_eval.trajectory import Trajectory

__version__ = "0.1.0"
"""The version of slamhive-eval and of slamhive: the one place where it is written."""

_MODULES = {
    "alignment": ("Alignment", "align", "umeyama_scale"),
    "association": (
        "Association",
        "associate",
        "associate_forward",
        "associate_uniquely",
        "interpolate",
        "match",
    ),
    "formats.column_tables": ("read_columns",),
    "formats.columns": ("TableFormat",),
    "coverage": ("Coverage", "measure_coverage"),
    "errors": (
        "AssociationError",
        "EvaluationError",
        "FileError",
        "NoPosesError",
        "OptionError",
        "TrajectoryError",
    ),
    "evaluation": ("Evaluation", "Options", "Outcome", "RpeOptions", "evaluate"),
    "formats.files": ("read_euroc", "read_kitti", "read_trajectory", "read_tum", "write_tum"),
    "metrics": ("ape_errors", "rpe_errors"),
    "statistics": ("Statistics",),
    "pairs": ("find_pairs",),
    "measures.relations": ("RelationErrors", "Relations", "evaluate_relations", "read_relations"),
    "measures.points": ("ControlPoints", "PointErrors", "evaluate_points"),
    "handeye": ("HandEye", "hand_eye"),
    "preparing": ("Preparation", "Prepared", "prepare"),
    "robust": ("align_robustly",),
    "timing": ("TimeOffset", "find_offset"),
    "formats.clouds": ("Cloud", "read_cloud", "sample_mesh"),
    "measures.consistency": ("Consistency", "measure_consistency"),
    "formats.healthfiles": ("Confidence", "read_covariances", "read_health"),
    "measures.health": ("Awareness", "HealthRule", "ToldLoss", "evaluate_health", "measure_health"),
    "measures.losses": ("LocalErrors", "LossRule", "local_errors"),
    "formats.evo_zip": ("ErrorSeries", "write_error_arrays", "write_evo_zip"),
    "reports.figures": ("save_figure", "save_trajectories"),
    "measures.kitti": ("KittiErrors", "kitti_errors"),
    "measures.maps": ("MapEntropy", "MapErrors", "compare_maps", "mean_map_entropy", "thin_out"),
    "measures.motion": ("Smoothness", "smoothness", "velocities", "velocity_errors"),
    "measures.relative": ("ScaleDrift", "SubTrajectoryErrors", "scale_drift", "sub_trajectory_errors"),
    "measures.repeated": ("Repeated", "summarize"),
    "reports.report": ("report_html",),
    "reports.result_tables": ("csv_table", "latex_table"),
    "measures.segments": ("Piece", "evaluate_pieces", "number_poses", "read_segments"),
    "measures.support": (
        "Gap",
        "SegmentedEvaluation",
        "Support",
        "common_support",
        "evaluate_segments",
        "find_support",
        "segment_numbers",
        "within",
    ),
    "trajectory": ("Trajectory",),
    "formats.writing": ("write_trajectory",),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [  # noqa: RUF022 - by concept, not by letter
    "Trajectory",
    "read_trajectory",
    "read_tum",
    "read_euroc",
    "read_kitti",
    "read_columns",
    "TableFormat",
    "write_trajectory",
    "write_tum",
    "Options",
    "RpeOptions",
    "evaluate",
    "Evaluation",
    "Outcome",
    "Association",
    "associate",
    "associate_uniquely",
    "associate_forward",
    "interpolate",
    "match",
    "TimeOffset",
    "find_offset",
    "Alignment",
    "align",
    "align_robustly",
    "Preparation",
    "Prepared",
    "prepare",
    "HandEye",
    "hand_eye",
    "umeyama_scale",
    "find_pairs",
    "ape_errors",
    "rpe_errors",
    "Statistics",
    "Coverage",
    "measure_coverage",
    "Relations",
    "RelationErrors",
    "read_relations",
    "evaluate_relations",
    "ControlPoints",
    "PointErrors",
    "evaluate_points",
    "kitti_errors",
    "KittiErrors",
    "sub_trajectory_errors",
    "SubTrajectoryErrors",
    "scale_drift",
    "ScaleDrift",
    "velocity_errors",
    "velocities",
    "smoothness",
    "Smoothness",
    "measure_consistency",
    "Consistency",
    "read_health",
    "read_covariances",
    "Confidence",
    "evaluate_health",
    "measure_health",
    "HealthRule",
    "Awareness",
    "ToldLoss",
    "local_errors",
    "LossRule",
    "LocalErrors",
    "find_support",
    "Support",
    "Gap",
    "common_support",
    "within",
    "evaluate_segments",
    "evaluate_pieces",
    "segment_numbers",
    "SegmentedEvaluation",
    "read_segments",
    "number_poses",
    "Piece",
    "summarize",
    "Repeated",
    "read_cloud",
    "Cloud",
    "sample_mesh",
    "compare_maps",
    "MapErrors",
    "mean_map_entropy",
    "MapEntropy",
    "thin_out",
    "report_html",
    "save_figure",
    "save_trajectories",
    "ErrorSeries",
    "write_evo_zip",
    "write_error_arrays",
    "csv_table",
    "latex_table",
    "EvaluationError",
    "TrajectoryError",
    "FileError",
    "NoPosesError",
    "AssociationError",
    "OptionError",
]


def __getattr__(name: str) -> Any:
    module = _HOME.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"slamhive_eval.{module}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
