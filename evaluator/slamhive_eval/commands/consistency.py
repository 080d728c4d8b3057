# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval consistency``: whether an estimator knows how wrong it is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive_eval.commands import measuring, output
from slamhive_eval.errors import FileError
from slamhive_eval.measures.consistency import Part, measure_consistency
from slamhive_eval.preparing import prepare

if TYPE_CHECKING:
    import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Errors against the covariances that the estimate came with: NEES, ANEES and the shares within 1, 2 "
        "and 3 sigma, of position, rotation and both. Covariances come with Odometry and "
        "PoseWithCovarianceStamped, OpenVINS' text files, and columns named as cov_xx or cov_x_yaw."
    )
    parser.epilog = "Example: slamhive-eval consistency groundtruth.txt run.bag:/odom --align yaw"
    parser.add_argument("reference", metavar="GT", help="ground truth, taken for exact")
    parser.add_argument("estimate", metavar="EST", help="estimated trajectory with covariances")
    measuring.add_reading(parser)
    measuring.add_preparation(parser)
    parser.set_defaults(align="se3")
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    reference = measuring.read_reference(asked)
    estimate = measuring.read_estimate(asked, asked.estimate, reference)
    if estimate.covariances is None:
        raise FileError(
            asked.estimate,
            "has no covariances; Odometry, PoseWithCovarianceStamped, OpenVINS' text files and tables with "
            "columns cov_xx, cov_yy, cov_zz have",
        )
    prepared = prepare(reference, estimate, measuring.preparation(asked))
    truth, aligned = prepared.reference, prepared.estimate
    covariances = aligned.covariances
    assert covariances is not None  # noqa: S101 - aligning keeps them
    parts: dict[str, Part | None] = {"position": "position"}
    if covariances.shape[1] == 6 and truth.oriented and aligned.oriented:
        parts |= {"rotation": "rotation", "pose": None}
    measured = {
        name: measure_consistency(truth, aligned, covariances, part=part).as_dict()
        for name, part in parts.items()
    }
    output.emit(asked, {**prepared.as_dict(), **measured, "estimate": asked.estimate}, _show)
    return 0


def _show(result: dict[str, Any]) -> str:
    sigmas = "".join(f"  {f'{k} sigma':>8}" for k in (1, 2, 3))
    promised = "".join(f"  {share:>8.1%}" for share in (0.95, 0.6827, 0.9545, 0.9973))
    lines = [
        f"{result['poses']} poses, alignment {result['alignment']['method']}",
        f"{'':>9}  {'count':>6}  {'ANEES':>9}  {'NEES mean':>9}  {'in 95 %':>8}{sigmas}",
        f"{'expected':>9}  {'':>6}  {1:>9}  {'':>9}{promised}",
    ]
    for name in ("position", "rotation", "pose"):
        found = result.get(name)
        if found is None:
            continue
        if not found["count"]:
            lines.append(f"{name:>9}  {0:>6}  no covariance has an inverse")
            continue
        shares = "".join(f"  {sum(one['shares']) / len(one['shares']):>8.1%}" for one in found["withinSigma"])
        lines.append(
            f"{name:>9}  {found['count']:>6}  {found['anees']:>9.4g}  {found['nees']['mean']:>9.4g}  "
            f"{found['neesWithin95']:>8.1%}{shares}"
        )
        if found["withoutCovariance"]:
            lines.append(f"{'':>9}  {found['withoutCovariance']} poses without a covariance that can be used")
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])
