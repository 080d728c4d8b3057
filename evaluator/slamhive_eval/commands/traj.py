# SPDX-License-Identifier: Apache-2.0
"""``slamhive-eval traj``: what trajectories are like; cut, move, match, align and convert them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.commands import measuring, output
from slamhive_eval.errors import FileError, OptionError
from slamhive_eval.formats import files, writing
from slamhive_eval.measures.description import GAP_PERIODS, describe
from slamhive_eval.preparing import prepare
from slamhive_eval.trajectory import check_rigid

if TYPE_CHECKING:
    import argparse

    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

_ENDINGS: dict[str, writing.OutputFormat] = {".csv": "csv", ".kitti": "kitti", ".tum": "tum", ".txt": "tum"}


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Describe trajectories, and write them anew: cut, thinned, moved, matched with and aligned to ground "
        "truth, in that order, in any format."
    )
    parser.epilog = (
        "Example: slamhive-eval traj run.bag:/odom --reference gt.txt --align se3 --output odom.tum"
    )
    parser.add_argument("estimates", metavar="FILE", nargs="+", help="trajectories")
    parser.add_argument("--reference", metavar="GT", help="ground truth to match with and align to")
    parser.add_argument("--sync", action="store_true", help="keep only poses with one of the ground truth")
    measuring.add_reading(parser)
    cut = parser.add_argument_group("cut")
    cut.add_argument("--start", type=float, metavar="S", help="leave out poses before this stamp [s]")
    cut.add_argument("--end", type=float, metavar="S", help="leave out poses after this stamp [s]")
    cut.add_argument("--every", type=int, default=1, metavar="N", help="keep every N-th pose")
    move = parser.add_argument_group("move")
    move.add_argument("--scale", type=float, default=1.0, metavar="X", help="factor of the positions")
    move.add_argument("--transform", metavar="FILE", help="T of T·pose: the world moved")
    move.add_argument("--transform-right", metavar="FILE", help="T of pose·T: another frame of the body")
    move.add_argument("--invert", action="store_true", help="use the inverses of both")
    measuring.add_preparation(parser)
    out = parser.add_argument_group("output")
    out.add_argument("--output", metavar="PATH", help="file to write; a folder for several trajectories")
    out.add_argument(
        "--output-format",
        choices=writing.OUTPUT_FORMATS,
        help="default: by the ending of PATH, .txt and .tum, .csv, .kitti",
    )
    out.add_argument("--plot", metavar="FILE", help="a figure of them: .png, .svg or .pdf (needs matplotlib)")
    output.add_json(parser)


def run(asked: argparse.Namespace) -> int:
    """Describe, and write where asked."""
    how = measuring.preparation(asked)
    reference = measuring.read_reference(asked) if asked.reference is not None else None
    if reference is None and (asked.sync or asked.align != "none" or asked.hand_eye or how.clock != "given"):
        raise OptionError("matching and aligning need ground truth: --reference")
    targets = _targets(asked)
    move = _motion(asked)
    made = []
    for name in asked.estimates:
        trajectory = move(_cut(asked, measuring.read_estimate(asked, name, reference)))
        made.append(_laid(asked, reference, trajectory, how) if reference is not None else trajectory)
    for (path, kind), trajectory in zip(targets, made, strict=bool(targets)):
        try:
            writing.write_trajectory(path, trajectory, kind)
        except OSError as error:
            raise FileError(path, f"can't be written: {error.strerror or error}") from error
    if asked.plot is not None:
        from slamhive_eval.reports import figures  # noqa: PLC0415 - only where asked for

        figures.save_trajectories(asked.plot, dict(zip(_names(asked), made, strict=True)), reference)
    described = [
        {"file": name, **describe(one), "notes": list(one.notes)}
        for name, one in zip(asked.estimates, made, strict=True)
    ]
    result = described[0] if len(described) == 1 else {"results": described}
    output.emit(asked, result, lambda _: "\n\n".join(map(_show, described)))
    return 0


def _names(asked: argparse.Namespace) -> list[str]:
    """Return names of the trajectories for a figure: file stems where those differ, else numbered paths."""
    stems = [Path(name.split(":", 1)[0]).stem for name in asked.estimates]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{k}: {name}" for k, name in enumerate(asked.estimates, start=1)]


def _cut(asked: argparse.Namespace, trajectory: Trajectory) -> Trajectory:
    if asked.every < 1:
        raise OptionError(f"--every must be at least 1, not {asked.every}")
    first = -np.inf if asked.start is None else asked.start
    last = np.inf if asked.end is None else asked.end
    kept = np.flatnonzero((trajectory.stamps >= first) & (trajectory.stamps <= last))[:: asked.every]
    if not len(kept):
        span = f"{trajectory.stamps[0]:.3f} s to {trajectory.stamps[-1]:.3f} s"
        raise OptionError(f"no pose lies within --start and --end; the poses are from {span}")
    return trajectory.select(kept)


def _motion(asked: argparse.Namespace) -> Any:
    if not (np.isfinite(asked.scale) and asked.scale > 0):
        raise OptionError(f"the scale must be a positive number, not {asked.scale}")
    left, right = (
        np.eye(4) if path is None else check_rigid(files.read_transform(path))
        for path in (asked.transform, asked.transform_right)
    )
    if asked.invert:
        left, right = _inverse(left), _inverse(right)

    def move(trajectory: Trajectory) -> Trajectory:
        if asked.transform is not None or asked.scale != 1.0:
            trajectory = trajectory.transformed(left[:3, :3], left[:3, 3], asked.scale)
        return trajectory if asked.transform_right is None else trajectory.moved(right)

    return move


def _inverse(motion: FloatArray) -> FloatArray:
    inverse = np.eye(4)
    inverse[:3, :3] = motion[:3, :3].T
    inverse[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return inverse


def _laid(asked: argparse.Namespace, reference: Trajectory, trajectory: Trajectory, how: Any) -> Trajectory:
    """Matched with and aligned to the ground truth; all of it unless only matched poses were asked for."""
    found = prepare(reference, trajectory, how)
    if asked.sync:
        return found.estimate
    if found.clock is not None:
        trajectory = found.clock.apply(trajectory)
    elif how.offset_seconds:
        trajectory = trajectory.shifted(how.offset_seconds)
    return found.alignment.apply(trajectory)


def _targets(asked: argparse.Namespace) -> list[tuple[Path, writing.OutputFormat]]:
    if asked.output is None:
        if asked.output_format is not None:
            raise OptionError("--output-format needs --output")
        return []
    path = Path(asked.output)
    if len(asked.estimates) == 1 and not path.is_dir():
        kind = asked.output_format or _ENDINGS.get(path.suffix.lower())
        if kind is None:
            known = ", ".join(_ENDINGS)
            raise OptionError(f"{path}: name a format by --output-format, or by the ending: {known}")
        return [(path, kind)]
    if not path.is_dir():
        raise OptionError(f"{path}: several trajectories need a folder that exists")
    several: writing.OutputFormat = asked.output_format or "tum"
    ending = {"tum": "tum", "kitti": "kitti", "euroc": "csv", "csv": "csv"}[several]
    names = [Path(name.split(":", 1)[0]).stem for name in asked.estimates]
    if len(set(names)) < len(names):
        raise OptionError(f"the files would have the same names in {path}: {', '.join(sorted(names))}")
    return [(path / f"{name}.{ending}", several) for name in names]


def _show(found: dict[str, Any]) -> str:
    def number(name: str, unit: str, digits: int = 3) -> str:
        return "–" if found[name] is None else f"{found[name]:.{digits}f} {unit}"

    size = " × ".join(f"{length:.3f}" for length in found["extent"])
    kind = "keyframes" if found["keyframes"] else "poses"
    rows = {
        kind: f"{found['poses']}{'' if found['oriented'] else ', positions only'}",
        "time": f"{found['start']:.6f} s to {found['end']:.6f} s, {found['duration']:.3f} s",
        "step": f"median {number('medianStep', 's', 4)}, longest {number('longestStep', 's', 4)}",
        "gaps": f"{found['gaps']} longer than {GAP_PERIODS:g} steps, {found['equalStamps']} equal stamps",
        "path": f"{found['pathLength']:.3f} m within {size} m",
        "speed": f"mean {number('meanSpeed', 'm/s')}, largest {number('maxSpeed', 'm/s')}",
        "turned": number("turned", "degrees", 1),
    }
    lines = [f"  {name:<12}{text}" for name, text in rows.items()]
    return "\n".join([found["file"], *lines, *(f"note: {note}" for note in found["notes"])])
