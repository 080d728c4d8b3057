# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval health``: whether a system knew that it was lost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive_eval.commands import measuring, output
from slamhive_eval.errors import OptionError
from slamhive_eval.formats.healthfiles import COVARIANCES, HEALTH, read_covariances, read_health
from slamhive_eval.measures.health import HealthRule, describe, evaluate_health
from slamhive_eval.measures.losses import LossRule

if TYPE_CHECKING:
    import argparse

_RULE = LossRule()


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "A system's own confidence over time against its losses: how long before a loss it warned, which "
        "share of its warnings was false, how well its values tell large errors; NEES of its covariances."
    )
    parser.epilog = "Example: slamhive-eval health groundtruth.txt trajectory.txt --health health.csv"
    parser.add_argument("reference", metavar="GT", help="ground truth; formats as for ape")
    parser.add_argument("estimate", metavar="EST", help="estimated trajectory")
    parser.add_argument(
        "--health", metavar="FILE", help=f"stamp, value and flag of each row (default: {HEALTH} beside EST)"
    )
    parser.add_argument(
        "--covariances",
        metavar="FILE",
        help=f"stamp and covariance of each pose (default: {COVARIANCES} beside EST, or those in EST)",
    )
    loss = parser.add_argument_group("losses")
    for name, unit, told in (
        ("window", "S", "a pose is looked back from over so many seconds"),
        ("share", "SHARE", "an error is too large above this share of the true path in them"),
        ("metres", "M", "and above so many metres"),
        ("lasting", "S", "for so many seconds at least"),
    ):
        usual = getattr(_RULE, name)
        loss.add_argument(
            f"--{name}", type=float, default=usual, metavar=unit, help=f"{told} (default: {usual:g})"
        )
    loss.add_argument(
        "--horizon",
        type=float,
        default=HealthRule().horizon,
        metavar="S",
        help="warnings so long before a loss are true (default: %(default)g)",
    )
    measuring.add_reading(parser)
    measuring.add_preparation(parser)
    parser.set_defaults(align="se3")
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Measure and print."""
    loss = LossRule(asked.window, asked.share, asked.metres, asked.lasting)
    rule = HealthRule(loss, asked.horizon)
    reference = measuring.read_reference(asked)
    estimate = measuring.read_estimate(asked, asked.estimate, reference)
    health, covariances = (
        asked.health or _beside(asked, HEALTH),
        asked.covariances or _beside(asked, COVARIANCES),
    )
    if health is None and covariances is None and estimate.covariances is None:
        raise OptionError(
            f"{asked.estimate}: there is neither {HEALTH} nor {COVARIANCES} beside it; name --health or "
            "--covariances"
        )
    found = evaluate_health(
        reference,
        estimate,
        measuring.preparation(asked),
        said=None if health is None else read_health(health),
        covariances=None if covariances is None else read_covariances(covariances),
        rule=rule,
    )
    output.emit(asked, {**found, "estimate": asked.estimate}, _show)
    return 0


def _beside(asked: argparse.Namespace, name: str) -> Path | None:
    path = Path(asked.estimate).with_name(name)
    return path if path.is_file() else None


def _show(result: dict[str, Any]) -> str:
    found, losses = result["health"], result.get("healthLosses", [])
    lines = [f"{result['estimate']}: {describe(found)}"] if describe(found) else []
    for loss in losses:
        lead = "missed" if loss["lead"] is None else f"warned {_when(loss['lead'])}"
        if "warning" in found:
            lines.append(f"  lost {loss['begin']:.3f} to {loss['end']:.3f} s, {lead}")
        else:
            lines.append(f"  lost {loss['begin']:.3f} to {loss['end']:.3f} s")
    if "warning" in found:
        lines.append(
            f"false: {_percent(found['false']['share'])} of {found['warning']['seconds']:.3f} s warned"
        )
        lines.append(f"missed: {_percent(found['missed']['share'])} of {found['lostSeconds']:.3f} s lost")
    if found.get("values"):
        auc = "–" if found["auc"] is None else f"{found['auc']:.4f}"
        lines.append(f"AUC: {auc} of {found['values']} values")
    for part, nees in found.get("nees", {}).items():
        if not nees["count"]:
            lines.append(f"NEES of {part}: no covariance has an inverse")
            continue
        lines.append(
            f"NEES of {part}: mean {measuring.number(nees['mean'])} of {nees['count']} poses, in 95 % of "
            f"cases {nees['low']:.4g} to {nees['high']:.4g}; {nees['within95']:.1%} of poses within 95 %"
        )
    return "\n".join(lines)


def _when(lead: float) -> str:
    return f"{lead:.3f} s before" if lead >= 0 else f"{-lead:.3f} s after its begin"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{share:.1%}"
