# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval score``: the score of a public challenge, by its published rule."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive_eval.commands import output, tables
from slamhive_eval.errors import OptionError
from slamhive_eval.formats import files
from slamhive_eval.formats.column_tables import read_columns
from slamhive_eval.formats.columns import parse_columns
from slamhive_eval.measures import challenges
from slamhive_eval.measures.points import ControlPoints

if TYPE_CHECKING:
    import argparse

    from slamhive_eval.measures.challenges import PointRule

_ENDINGS = (".txt", ".csv")


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Score of estimates by the rule that a challenge has published. kitti: mean translation error in "
        "percent and rotation error in deg/100 m over segments of 100 to 800 m. hilti2022, hilti2023, "
        "lamaria: scores by the error at control points (t x y z), 0 to 100."
    )
    parser.epilog = "Example: slamhive-eval score kitti dataset/poses results/data"
    parser.add_argument("challenge", metavar="CHALLENGE", help=", ".join(challenges.CHALLENGES))
    parser.add_argument(
        "reference", metavar="GT", help="ground truth of one sequence, or a folder with a file for each"
    )
    parser.add_argument("estimate", metavar="EST", help="estimate, or a folder with files of the same names")
    parser.add_argument(
        "--extrinsic", metavar="FILE", help="pose of EST's frame in the one whose control points these are"
    )
    parser.set_defaults(reference_format=None)
    tables.add(parser)
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Score and print."""
    rule = challenges.find_rule(asked.challenge)
    pairs = _pairs(Path(asked.reference), Path(asked.estimate))
    if rule is None:
        output.emit(asked, _kitti(asked, pairs), _show_kitti)
    else:
        output.emit(asked, _points(asked, pairs, rule), _show_points)
    return 0


def _pairs(reference: Path, estimate: Path) -> dict[str, tuple[Path, Path]]:
    """Ground truth and estimate of each sequence by name.

    Raises:
        OptionError: A file and a folder, or an estimate is missing.
    """
    if reference.is_dir() != estimate.is_dir():
        raise OptionError("GT and EST are either two files or two folders with files of the same names")
    if not reference.is_dir():
        return {estimate.stem: (reference, estimate)}
    theirs = {path.stem: path for path in sorted(estimate.iterdir()) if path.suffix in _ENDINGS}
    found = {
        path.stem: (path, theirs[path.stem])
        for path in sorted(reference.iterdir())
        if path.suffix in _ENDINGS and path.stem in theirs
    }
    beyond = sorted(theirs.keys() - found.keys())
    if beyond or not found:
        what = f"no ground truth for {', '.join(beyond)}" if beyond else "no estimate"
        raise OptionError(f"{estimate}: {what} in {reference}; files of a sequence have one name")
    return found


def _kitti(asked: argparse.Namespace, pairs: dict[str, tuple[Path, Path]]) -> dict[str, Any]:
    form = tables.form(asked)
    errors = {}
    for name, (truth, estimate) in pairs.items():
        reference = files.read_trajectory(truth) if form is None else read_columns(truth, form)
        errors[name] = challenges.score_kitti(reference, files.read_estimate(estimate, reference, truth))
    return {"challenge": asked.challenge, **challenges.total_kitti(errors)}


def _points(
    asked: argparse.Namespace, pairs: dict[str, tuple[Path, Path]], rule: PointRule
) -> dict[str, Any]:
    form = tables.form(asked) or parse_columns("t,x,y,z")
    given = None if asked.extrinsic is None else files.read_transform(asked.extrinsic)
    found = {
        name: challenges.score_points(
            rule,
            ControlPoints.of(read_columns(truth, form)),
            files.read_trajectory(estimate),
            rule.extrinsic(truth.stem) if given is None else given,
        )
        | {"weight": rule.weight(name)}
        for name, (truth, estimate) in pairs.items()
    }
    counted = [(one["score"], one["weight"]) for one in found.values() if one["weight"]]
    return {
        "challenge": asked.challenge,
        "score": sum(score * weight for score, weight in counted),
        "meanScore": sum(score for score, _ in counted) / len(counted) if counted else None,
        "sequences": found,
        "notes": [rule.note],
    }


def _show_kitti(result: dict[str, Any]) -> str:
    lines = [f"{'sequence':>16}  {'segments':>8}  {'t [%]':>8}  {'r [deg/100 m]':>13}"]
    for name, one in [*result["sequences"].items(), ("all", result)]:
        numbers = [one["translationPercent"], one["rotationDegPer100m"]]
        shown = ["–" if number is None else f"{number:.4f}" for number in numbers]
        lines.append(f"{name:>16}  {one['segments']:>8}  {shown[0]:>8}  {shown[1]:>13}")
    return "\n".join(lines)


def _show_points(result: dict[str, Any]) -> str:
    recalls = list(next(iter(result["sequences"].values()))["recall"])
    lines = [
        f"{'sequence':>24}  {'score':>6}  {'points met':>10}"
        + "".join(f"  {f'≤ {one}':>7}" for one in recalls)
    ]
    for name, one in result["sequences"].items():
        shares = "".join(f"  {one['recall'][key]:>7.1%}" for key in recalls)
        counts = {0: "  not counted", 2: "  counts twice"}.get(one["weight"], "")
        lines.append(
            f"{name:>24}  {one['score']:>6.2f}  {one['met']:>4} of {one['points']:<3}{shares}{counts}"
        )
        if one["message"]:
            lines.append(f"note: {name}: {one['message']}")
    lines.append(f"{'sum':>24}  {result['score']:>6.2f}")
    return "\n".join(lines + [f"note: {note}" for note in result["notes"]])
