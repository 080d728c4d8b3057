# SPDX-License-Identifier: Apache-2.0
"""One HTML page that shows several estimates beside their ground truth, complete in itself.

The page holds its data, style and script; it loads nothing, and a content security policy sees to that.
Its script draws SVG: trajectories from four sides, errors over time and path, their histogram and boxes.
"""

from __future__ import annotations

import html
import importlib.resources
import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.coverage import FRAME_STEP_SECONDS, KEYFRAME_STEP_SECONDS, REFERENCE_GAP_SECONDS
from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive_eval.evaluation import Evaluation, Poses
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

MAX_POINTS = 1500
"""Points of a curve; of more, each stretch shows its largest error."""
BINS = 40
KINDS = {"position": ("Position error", "m"), "rotation": ("Rotation error", "°")}


def report_html(
    reference: Trajectory,
    evaluations: Mapping[str, Evaluation],
    *,
    title: str = "Trajectory evaluation",
    reference_name: str = "ground truth",
) -> str:
    """Make the page.

    Args:
        reference: The whole ground truth.
        evaluations: What evaluate found for each estimate, by the name to show.
        title: Of the page.
        reference_name: What to call the ground truth.

    Returns:
        An HTML document.

    Raises:
        OptionError: No evaluations.
    """
    data = report_data(reference, evaluations, title=title, reference_name=reference_name)
    assets = importlib.resources.files("slamhive_eval") / "assets"
    style, script, page = (
        (assets / f"report.{kind}").read_text(encoding="utf-8") for kind in ("css", "js", "html")
    )
    parts = {"TITLE": html.escape(title), "STYLE": style, "SCRIPT": script, "DATA": as_script_data(data)}
    return re.sub("@([A-Z]+)@", lambda mark: parts[mark[1]], page)


def report_data(
    reference: Trajectory, evaluations: Mapping[str, Evaluation], *, title: str, reference_name: str
) -> dict[str, Any]:
    """Return the curves, statistics and histograms that the page of a report draws, as plain JSON data.

    Args:
        reference: The whole ground truth.
        evaluations: By the name to show.
        title: Of the page.
        reference_name: What to call the ground truth.

    Returns:
        Curves of at most MAX_POINTS points, statistics, histograms over common bins and boxes.

    Raises:
        OptionError: No evaluations.
    """
    if not evaluations:
        raise OptionError("a report needs at least one estimate")
    start = float(reference.stamps[0])
    compared = [found.poses for found in evaluations.values() if found.poses is not None]
    oriented = all(poses.reference.oriented and poses.estimate.oriented for poses in compared)
    kinds = {kind: about for kind, about in KINDS.items() if oriented or kind == "position"}
    edges = {kind: bin_edges([_errors(poses, kind) for poses in compared]) for kind in kinds}
    return {
        "title": title,
        "kinds": {kind: {"name": name, "unit": unit} for kind, (name, unit) in kinds.items()},
        "edges": {kind: _rounded(values) for kind, values in edges.items()},
        "reference": truth_data(reference, reference_name),
        "estimates": [_estimate(name, found, edges, start) for name, found in evaluations.items()],
    }


def _estimate(name: str, found: Evaluation, edges: dict[str, FloatArray], start: float) -> dict[str, Any]:
    told = found.as_dict()
    entry: dict[str, Any] = {
        "name": name,
        **{key: told[key] for key in ("outcome", "message", "coverage", "scale", "alignment", "notes")},
        "poses": found.matched,
        "statistics": {"position": told["ate"], "rotation": told["ateRotationDeg"]},
        "rpe": told["rpe"][:1],
    }
    poses = found.poses
    if poses is None:
        return {**entry, "time": []}
    return entry | curves(
        poses.estimate,
        poses.reference.stamps - start,
        poses.reference.distances,
        {kind: _errors(poses, kind) for kind in edges},
        edges,
        keyframes=found.coverage.keyframes,
    )


def curves(
    estimate: Trajectory,
    times: FloatArray,
    distances: FloatArray,
    errors: Mapping[str, FloatArray],
    edges: Mapping[str, FloatArray],
    *,
    keyframes: bool = False,
) -> dict[str, Any]:
    """Return the curves, histogram and box of an estimate's poses, as the page draws them.

    Args:
        estimate: Its n poses.
        times: Seconds since the ground truth began, (n,).
        distances: Path of the ground truth until then in m, (n,).
        errors: By kind, (n,) each; the first says which poses stand for a stretch. None for a path alone.
        edges: Of the bins of each kind's histogram.
        keyframes: Whether the estimate holds keyframes only.
    """
    first = next(iter(errors.values()), np.zeros(len(estimate)))
    shown = _shown(first)
    limit = KEYFRAME_STEP_SECONDS if keyframes else FRAME_STEP_SECONDS
    return {
        "path": _path(estimate, shown),
        "breaks": _breaks(estimate.stamps, shown, limit),
        "thinned": len(shown) < len(first),
        "time": _rounded(times[shown]),
        "distance": _rounded(distances[shown]),
        "errors": {kind: _rounded(found[shown]) for kind, found in errors.items()},
        "histogram": {
            kind: np.histogram(np.minimum(found, edges[kind][-1]), edges[kind])[0].tolist()
            for kind, found in errors.items()
        },
        "box": {kind: _box(found) for kind, found in errors.items()},
    }


def truth_data(reference: Trajectory, name: str) -> dict[str, Any]:
    """Return the path of the ground truth, as the page draws it."""
    shown = np.unique(np.linspace(0, len(reference) - 1, min(len(reference), MAX_POINTS)).astype(np.intp))
    return {
        "name": name,
        "path": _path(reference, shown),
        "breaks": _breaks(reference.stamps, shown, REFERENCE_GAP_SECONDS),
    }


def as_script_data(data: Mapping[str, Any]) -> str:
    """Return data as JSON for a script element, which no name in it can end."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _errors(poses: Poses, kind: str) -> FloatArray:
    return poses.errors if kind == "position" else poses.rotation_errors_deg


def bin_edges(errors: list[FloatArray]) -> FloatArray:
    """Common bins from zero to the largest error; the last one holds what one outlier would stretch."""
    if not errors:
        return np.linspace(0.0, 1.0, BINS + 1)
    largest = max(float(one.max()) for one in errors)
    usual = 1.5 * max(float(np.quantile(one, 0.99)) for one in errors)
    return np.linspace(0.0, max(min(largest, usual), 1e-12), BINS + 1)


def _shown(errors: FloatArray) -> IndexArray:
    """Indices of the poses to draw: of each stretch the one with the largest error, and both ends."""
    n = len(errors)
    if n <= MAX_POINTS:
        return np.arange(n)
    begin = np.unique(np.linspace(0, n, MAX_POINTS - 1).astype(np.intp))[:-1]
    largest = np.maximum.reduceat(errors, begin)
    stretch = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, n)))
    at = np.flatnonzero(errors == largest[stretch])
    _, first = np.unique(stretch[at], return_index=True)
    return np.unique(np.concatenate(([0], at[first], [n - 1])))


def _path(trajectory: Trajectory, shown: IndexArray) -> list[list[float]]:
    return [_rounded(trajectory.positions[shown, axis]) for axis in range(3)]


def _breaks(stamps: FloatArray, shown: IndexArray, limit: float) -> list[int]:
    """Points before which the estimate had no pose for longer than the limit."""
    gaps = np.concatenate(([0], np.cumsum(np.diff(stamps) > limit)))[shown]
    return (np.flatnonzero(np.diff(gaps) > 0) + 1).tolist()


def _box(errors: FloatArray) -> dict[str, float]:
    """Quartiles, and whiskers to the last error within 1.5 times their distance (Tukey 1977)."""
    low, middle, high = np.quantile(errors, (0.25, 0.5, 0.75))
    reach = 1.5 * (high - low)
    inside = errors[(errors >= low - reach) & (errors <= high + reach)]
    names = ("low", "q1", "median", "q3", "high", "max")
    values = np.array((inside.min(), low, middle, high, inside.max(), errors.max()))
    return dict(zip(names, _rounded(values), strict=True))


def _rounded(values: FloatArray) -> list[float]:
    """Six significant digits of the largest: finer than a screen, and a third of the text."""
    largest = float(np.abs(values).max()) if len(values) else 0.0
    digits = min(6 - int(np.ceil(np.log10(largest))), 15) if largest > 0 else 0
    rounded: list[float] = np.round(values, digits).tolist()
    return rounded
