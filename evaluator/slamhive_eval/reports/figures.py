# SPDX-License-Identifier: Apache-2.0
"""A figure of several estimates as PNG, SVG or PDF, for papers; needs matplotlib, an extra."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.coverage import FRAME_STEP_SECONDS, KEYFRAME_STEP_SECONDS, is_keyframes
from slamhive_eval.errors import EvaluationError, FileError, OptionError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive_eval.evaluation import Evaluation
    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

FORMATS = (".png", ".svg", ".pdf")
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9")
"""Okabe and Ito 2008: distinct for colour-blind eyes."""
LINES = ("-", "--", ":", "-.")


def save_figure(
    path: str | Path,
    reference: Trajectory,
    evaluations: Mapping[str, Evaluation],
    *,
    title: str = "",
    dots_per_inch: float = 150.0,
) -> None:
    """Draw trajectories (xy, xz, yz), position errors over time, their histogram and boxes.

    Args:
        path: Where to; the suffix decides between PNG, SVG and PDF.
        reference: The whole ground truth.
        evaluations: What evaluate found for each estimate, by the name to show; those without common
            poses are left out.
        title: Above the figure.
        dots_per_inch: Of a PNG.

    Raises:
        OptionError: Another suffix, or no estimate with common poses.
        EvaluationError: matplotlib isn't installed.
        FileError: The file can't be written.
    """
    _check_name(path)
    found = {name: one for name, one in evaluations.items() if one.poses is not None}
    if not found:
        raise OptionError("a figure needs at least one estimate with poses in common with the ground truth")
    figure = _figure((13.0, 8.0))
    axes = figure.subplots(2, 3)
    for axis, (a, b) in zip(axes[0], ((0, 1), (0, 2), (1, 2)), strict=True):
        _draw_paths(axis, reference, found, a, b)
    _draw_errors(axes[1], reference, found)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    _save(figure, path, title, dots_per_inch)


def save_trajectories(
    path: str | Path,
    trajectories: Mapping[str, Trajectory],
    reference: Trajectory | None = None,
    *,
    title: str = "",
    dots_per_inch: float = 150.0,
) -> None:
    """Draw trajectories as they are: from three sides, and height, speed and heading over time.

    Args:
        path: Where to; the suffix decides between PNG, SVG and PDF.
        trajectories: In one world, by the name to show; at least one.
        reference: Ground truth, drawn beneath them.
        title: Above the figure.
        dots_per_inch: Of a PNG.

    Raises:
        OptionError: Another suffix.
        EvaluationError: matplotlib isn't installed.
        FileError: The file can't be written.
    """
    _check_name(path)
    figure = _figure((13.0, 8.0))
    axes = figure.subplots(2, 3)
    shown: list[tuple[str, Trajectory, dict[str, Any]]] = []
    if reference is not None:
        shown.append(("ground truth", reference, {"color": "0.75", "linewidth": 4}))
    shown += [
        (name, one, {"linewidth": 1.2, **_style(k)}) for k, (name, one) in enumerate(trajectories.items())
    ]
    begin = min(one.stamps[0] for _, one, _ in shown)
    for name, one, style in shown:
        rows = _broken(
            one, np.column_stack((one.stamps - begin, one.positions, _speeds(one), _headings(one)))
        )
        for axis, (a, b) in zip(axes[0], ((1, 2), (1, 3), (2, 3)), strict=True):
            axis.plot(rows[:, a], rows[:, b], label=name, **style)
            axis.set_xlabel(f"{'xyz'[a - 1]} [m]")
            axis.set_ylabel(f"{'xyz'[b - 1]} [m]")
            axis.set_aspect("equal", adjustable="datalim")
        for axis, column, what in zip(
            axes[1], (3, 4, 5), ("z [m]", "speed [m/s]", "heading [deg]"), strict=True
        ):
            axis.plot(rows[:, 0], rows[:, column], **style)
            axis.set_xlabel("time since the first pose [s]")
            axis.set_ylabel(what)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    _save(figure, path, title, dots_per_inch)


def _check_name(path: str | Path) -> None:
    suffix = Path(path).suffix
    if suffix.lower() not in FORMATS:
        raise OptionError(f"a figure's name must end in {', '.join(FORMATS)}, not {suffix!r}")


def _figure(inches: tuple[float, float]) -> Any:
    try:
        figures = importlib.import_module("matplotlib.figure")
    except ImportError as error:
        raise EvaluationError("figures need matplotlib: pip install matplotlib") from error
    return figures.Figure(figsize=inches, layout="constrained")


def _save(figure: Any, path: str | Path, title: str, dots_per_inch: float) -> None:
    if title:
        figure.suptitle(title)
    try:
        figure.savefig(path, dpi=dots_per_inch)
    except OSError as error:
        raise FileError(path, f"can't be written: {error.strerror or error}") from error


def _speeds(trajectory: Trajectory) -> FloatArray:
    """Speed in m/s since the pose before, shape (n,); NaN where no time has passed."""
    steps = np.diff(trajectory.stamps)
    lengths = np.diff(trajectory.distances)
    speeds = np.divide(lengths, steps, out=np.full(len(steps), np.nan), where=steps > 0)
    return np.concatenate((speeds[:1] if len(speeds) else [np.nan], speeds))


def _headings(trajectory: Trajectory) -> FloatArray:
    """Angle of the body's x axis about z in degrees, unwrapped, shape (n,); NaN without orientations."""
    if not trajectory.oriented:
        return np.full(len(trajectory), np.nan)
    forward = trajectory.matrices[:, :, 0]
    return np.rad2deg(np.unwrap(np.arctan2(forward[:, 1], forward[:, 0])))


def _broken(trajectory: Trajectory, rows: FloatArray) -> FloatArray:
    """Rows with one of NaN wherever there was no pose for long, so that no line crosses the gap."""
    limit = KEYFRAME_STEP_SECONDS if is_keyframes(trajectory) else FRAME_STEP_SECONDS
    gaps = np.flatnonzero(np.diff(trajectory.stamps) > limit) + 1
    broken: FloatArray = np.insert(rows, gaps, np.nan, axis=0)
    return broken


def _style(k: int) -> dict[str, Any]:
    return {"color": COLOURS[k % len(COLOURS)], "linestyle": LINES[k // len(COLOURS) % len(LINES)]}


def _draw_paths(
    axis: Any, reference: Trajectory, evaluations: Mapping[str, Evaluation], a: int, b: int
) -> None:
    truth = _broken(reference, reference.positions)
    axis.plot(truth[:, a], truth[:, b], color="0.75", linewidth=4, label="ground truth")
    for k, (name, one) in enumerate(evaluations.items()):
        assert one.poses is not None  # noqa: S101 - the caller left others out
        positions = _broken(one.poses.estimate, one.poses.estimate.positions)
        axis.plot(positions[:, a], positions[:, b], linewidth=1.2, label=name, **_style(k))
    axis.set_xlabel(f"{'xyz'[a]} [m]")
    axis.set_ylabel(f"{'xyz'[b]} [m]")
    axis.set_aspect("equal", adjustable="datalim")


def _draw_errors(axes: Any, reference: Trajectory, evaluations: Mapping[str, Evaluation]) -> None:
    over_time, histogram, boxes = axes
    series = {name: one.poses for name, one in evaluations.items() if one.poses is not None}
    for k, (name, poses) in enumerate(series.items()):
        since_start = poses.reference.stamps - reference.stamps[0]
        curve = _broken(poses.estimate, np.column_stack((since_start, poses.errors)))
        over_time.plot(curve[:, 0], curve[:, 1], linewidth=0.9, label=name, **_style(k))
        share = [100.0 / len(poses.errors)] * len(poses.errors)
        histogram.hist(poses.errors, bins=40, weights=share, histtype="step", label=name, **_style(k))
    over_time.set_ylim(bottom=0.0)
    over_time.set_xlabel("time since the ground truth began [s]")
    over_time.set_ylabel("position error [m]")
    histogram.set_xlabel("position error [m]")
    histogram.set_ylabel("poses [%]")
    boxes.boxplot([poses.errors for poses in series.values()], showfliers=False)
    boxes.set_xticks(range(1, len(series) + 1), list(series), rotation=20, horizontalalignment="right")
    boxes.set_ylabel("position error [m]")
