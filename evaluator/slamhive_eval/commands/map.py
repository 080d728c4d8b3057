# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval map``: a map against a reference, or its sharpness alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import alignment, association
from slamhive_eval.commands import measuring, output
from slamhive_eval.formats import clouds, files
from slamhive_eval.measures import maps

if TYPE_CHECKING:
    import argparse

    from slamhive_eval.rotation import FloatArray


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Accuracy, completeness and F-score of a map against a reference cloud or mesh; without one, its "
        "mean map entropy. Reads .ply, .pcd and .npy; needs scipy."
    )
    parser.epilog = "Example: slamhive-eval map map.pcd --reference scan.ply --threshold 0.1 --voxel 0.05"
    parser.add_argument("map", metavar="MAP", help="the estimated map")
    parser.add_argument("--reference", metavar="FILE", help="cloud or mesh to compare it with")
    parser.add_argument(
        "--threshold", type=float, default=0.05, metavar="M", help="of the F-score [m] (default: 0.05)"
    )
    parser.add_argument("--voxel", type=float, metavar="M", help="thin both out to one point a cube [m]")
    parser.add_argument(
        "--samples", type=int, default=200_000, metavar="N", help="points of a mesh (default: 200000)"
    )
    parser.add_argument(
        "--entropy-radius", type=float, metavar="M", help="mean map entropy, neighbourhood [m] (default: 0.3)"
    )
    parser.add_argument(
        "--trajectories",
        nargs=2,
        metavar=("GT", "EST"),
        help="lay the map onto the reference as these trajectories are laid onto one another",
    )
    parser.add_argument("--align", choices=alignment.METHODS, default="se3", help="default: se3")
    measuring.add_max_diff(parser)
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    points = _points(asked, asked.map)
    transform = _transform(asked)
    points = points @ transform[:3, :3].T + transform[:3, 3]
    result: dict[str, Any] = {"points": len(points), "transform": transform.tolist()}
    if asked.reference:
        reference = _points(asked, asked.reference)
        found = maps.compare_maps(reference, points, asked.threshold)
        result |= {"referencePoints": len(reference), **found.as_dict()}
    if asked.entropy_radius is not None or not asked.reference:
        radius = 0.3 if asked.entropy_radius is None else asked.entropy_radius
        result |= maps.mean_map_entropy(points, radius).as_dict()
    output.emit(asked, result, _show)
    return 0


def _points(asked: argparse.Namespace, path: str) -> FloatArray:
    cloud = clouds.read_cloud(path)
    points = clouds.sample_mesh(cloud, asked.samples) if len(cloud.triangles) else cloud.points
    return points if asked.voxel is None else maps.thin_out(points, asked.voxel)


def _transform(asked: argparse.Namespace) -> FloatArray:
    if not asked.trajectories:
        return np.eye(4)
    reference, estimate = (files.read_trajectory(path) for path in asked.trajectories)
    matched = association.associate(reference, estimate, asked.max_diff)
    if not len(matched):
        raise association.no_overlap(reference, estimate, asked.max_diff, 0.0)
    return alignment.align(
        reference.select(matched.reference), estimate.select(matched.estimate), asked.align
    ).transform


def _show(result: dict[str, Any]) -> str:
    lines = [f"{result['points']} points"]
    if "fScore" in result:
        lines[0] += f" against {result['referencePoints']}"
        lines.append(f"{'[m]':>14}  {'mean':>9}  {'median':>9}  {'rmse':>9}  {'max':>9}")
        for name in ("accuracy", "completeness"):
            numbers = "".join(f"  {result[name][key]:>9.5f}" for key in ("mean", "median", "rmse", "max"))
            lines.append(f"{name:>14}{numbers}")
        lines.append(
            f"within {result['threshold']:g} m: precision {result['precision']:.2%}, recall "
            f"{result['recall']:.2%}, F-score {result['fScore']:.4f}"
        )
    if "meanMapEntropy" in result:
        mean = result["meanMapEntropy"]
        lines.append(
            f"mean map entropy {'–' if mean is None else f'{mean:.4f}'} (radius {result['radius']:g} m, "
            f"{result['usedPoints']} points with neighbours)"
        )
    return "\n".join(lines)
