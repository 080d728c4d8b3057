# SPDX-License-Identifier: Apache-2.0
"""Readings of poses: whether they fit the ground truth as they are declared, or better as something else.

Compared are the frames of all sensors of the mode, the inverse, moved stamps, and stamps that are no sensor
time at all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.analysis.measuring import Subject, measure
from slamhive.conformance.findings import CheckAnswer, Finding, failed, warned
from slamhive.model.algorithm import Poses
from slamhive.model.evaluation import Association, EvaluationSettings
from slamhive.model.results import Outcome
from slamhive_eval import EvaluationError, Trajectory
from slamhive_eval.rotation import conjugate, rotate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import numpy.typing as npt

    from slamhive.model.algorithm import Output
    from slamhive.model.results import Result
    from slamhive.model.sensors import SensorMode
    from slamhive_eval import ControlPoints, Relations

    Array = npt.NDArray[np.float64]

_MAX_SHARE = 0.02
"""An ATE above this share of the path says that something is wrong with the frame, the stamp or the scale."""
MANY_DROPPED = 0.1
"""Share of frames dropped above which a program doesn't keep up, which may be why the ATE is large."""
TOO_SLOW = "is the machine busy, or the program too slow? try again when it is quiet"
_CLEARLY = 0.85
"""A reading of the poses is clearly better than another when its error is below this share of that one's."""
_SHIFTS_SECONDS = (-0.1, -0.05, 0.05, 0.1)


class Fit(NamedTuple):
    """Errors of poses against the ground truth under one reading of them: frame, direction and stamp.

    Attributes:
        metres: RMSE of the ATE.
        degrees: RMSE of its rotations; infinite where there are none.
    """

    metres: float
    degrees: float

    def __str__(self) -> str:
        """Return the figures as people read them."""
        return f"{self.metres:.4f} m, {self.degrees:.2f}°"

    def compared(self, other: Fit) -> str:
        """Say how much less the error is than another's."""
        if np.isfinite(other.metres) and other.metres > self.metres > 0:
            return f"{other.metres / self.metres:.1f} times less"
        turn = other.degrees - self.degrees
        return f"{turn:.2f}° less" if np.isfinite(turn) else "which has an error at all"

    def clearly_better(self, other: Fit) -> bool:
        """Tell whether one figure is clearly better than another's, and the other not clearly worse."""
        pairs = list(zip(self, other, strict=True))
        better = any(own < _CLEARLY * its for own, its in pairs)
        return better and not any(its < _CLEARLY * own for own, its in pairs)


@dataclass(frozen=True, eq=False)
class Declared:
    """Declaration of an Algorithm's poses, with the other frames and time shifts to compare them with.

    Attributes:
        mode: its sensor mode.
        output: what it declares.
        frames: T_body_frame of the frames whose poses they could be, (4, 4) each.
        seconds: length of the recording.
        stamps: sensor time of the recording's frames, s, (n,).
        dropped: how many of them a player dropped.
    """

    mode: SensorMode
    output: Output
    frames: Mapping[str, Array]
    seconds: float
    stamps: Array = field(default_factory=lambda: np.empty(0))
    dropped: int = 0

    @property
    def shifts(self) -> dict[float, str]:
        """Return by how many s stamps are moved for a comparison, and what each is called."""
        found = {shift: f"{shift:+.2f} s" for shift in _SHIFTS_SECONDS}
        if len(self.stamps) > 1:
            period = float(np.median(np.diff(self.stamps)))
            for frames, words in ((0.5, "half a frame"), (1.0, "one frame")):
                for sign, way in ((1, "later"), (-1, "earlier")):
                    shift = sign * frames * period
                    found = {one: name for one, name in found.items() if abs(one - shift) > 0.1 * period}
                    found[shift] = f"{shift:+.3f} s ({words} {way})"
        return found


def _inaccurate(declared: Declared, told: str) -> Finding:
    count = len(declared.stamps)
    if declared.dropped > MANY_DROPPED * count:
        return warned("accuracy", f"{told}, with {declared.dropped} of {count} frames dropped", TOO_SLOW)
    how = "see whether frame, direction, stamp, scale and units are right: another reading may fit below"
    return failed("accuracy", told, how)


def readings(
    declared: Declared, truth: Trajectory | Relations | ControlPoints, estimate: Trajectory, result: Result
) -> Iterator[Finding]:
    """Compare poses as they are declared with other readings of them: frames, the inverse, moved stamps.

    Args:
        declared: what is declared.
        truth: the ground truth of the body.
        estimate: what the algorithm wrote, converted as declared.
        result: its evaluation, with an ATE.
    """
    output, frames, shifts = declared.output, declared.frames, declared.shifts
    backwards = inverse(estimate)

    def fit(frame: str, shift: float = 0.0, poses: Trajectory = estimate) -> Fit:
        return _fit(declared, truth, poses, frame, shift)

    length, own = float(result.values["pathLength"]), fit(output.frame)
    share = own.metres / length
    tracked = result.outcome is Outcome.TRACKED and share <= _MAX_SHARE
    told = f"{own}, {share:.2%} of {length:.1f} m; coverage {result.coverage or 0.0:.2f}"
    if tracked:
        yield Finding(CheckAnswer.PASS, "accuracy", told)
    else:
        why = result.values.get("message") or f"more than {_MAX_SHARE:.0%} of the path"
        yield _inaccurate(declared, f"{told}; {why}")
    others = {
        frame: fit(frame)
        for frame, pose in frames.items()
        if not np.allclose(pose, frames[output.frame], atol=1e-6)
    }
    # Where poses are bad in every reading, which of them is least so says nothing.
    bad = min(found.metres for found in (own, *others.values())) > _MAX_SHARE * length
    by_frame = {f"output.frame: {name}": found for name, found in others.items()}
    yield _compared("frame", f"frame {output.frame}", own, by_frame, "declare {}", hidden=bad)
    turned_around = fit(output.frame, poses=backwards)
    bad = min(own.metres, turned_around.metres) > _MAX_SHARE * length
    inverted = bool(output.trajectory and output.trajectory.inverted)
    was = "inverted as declared" if inverted else "not inverted"
    how = f"declare inverted: {str(not inverted).lower()} in output.trajectory" if output.trajectory else ""
    how = how or "write the pose of the sensor in the world, not the world's in the sensor's frame"
    yield _compared("direction", f"poses {was}", own, {"the inverse": turned_around}, how, hidden=bad)
    moved = {shift: fit(output.frame, shift) for shift in shifts}
    nearest = min(moved, key=moved.__getitem__)
    # Drift as large as what a shift does hides it.
    hidden = own.metres > abs(nearest) * length / declared.seconds
    named = {f"{shifts[shift]}": other for shift, other in moved.items()}
    how = "stamp poses with the sensor time of the moment that they belong to; they fit moved by {}"
    yield _compared("stamp", f"stamp {output.stamp}", own, named, how, hidden=hidden)
    if not tracked:
        alone = [own, *others.values(), turned_around, *moved.values()]
        yield from _together(declared, min(alone), _MAX_SHARE * length, estimate, truth)


def _fit(
    declared: Declared,
    truth: Trajectory | Relations | ControlPoints,
    poses: Trajectory,
    frame: str,
    shift: float = 0.0,
) -> Fit:
    """Return the errors of poses taken as those of a frame, with their stamps moved."""
    settings = EvaluationSettings(association=Association(offset=shift))
    subject = Subject(
        declared.mode, declared.frames[frame], keyframes=declared.output.poses is Poses.KEYFRAMES
    )
    values = measure(truth, poses, settings, subject).values
    metres, turn = values.get("ate") or {}, values.get("ateRotationDeg") or {}
    return Fit(metres.get("rmse", np.inf), turn.get("rmse", np.inf))


def _together(
    declared: Declared,
    best: Fit,
    limit: float,
    estimate: Trajectory,
    truth: Trajectory | Relations | ControlPoints,
) -> Iterator[Finding]:
    """Look for a reading that differs in several ways at once and is better than any that differs in one."""
    found = {}
    for poses, words in ((estimate, ""), (inverse(estimate), "the inverse, ")):
        for frame, (shift, name) in product(declared.frames, {0.0: "", **declared.shifts}.items()):
            fit = _fit(declared, truth, poses, frame, shift)
            found[f"{words}frame {frame}{', stamps ' + name if name else ''}"] = fit
    name = min(found, key=found.__getitem__)
    if found[name].metres <= limit and found[name].clearly_better(best):
        text = f"no single change fits, several together do: {name}: {found[name]}"
        yield Finding(
            CheckAnswer.FAIL, "frame and stamp", text, f"the poses are {name}: write or declare that"
        )


def misread_stamps(
    declared: Declared, truth: Trajectory | Relations | ControlPoints, estimate: Trajectory
) -> Finding:
    """Say what the stamps of poses are that meet no ground truth: frame indices, or time since the start."""
    stamps, frames = estimate.stamps, declared.stamps
    begin, end = float(frames[0]), float(frames[-1])
    indices = stamps.astype(np.int64)
    readings_of: dict[str, Array] = {}
    if np.array_equal(indices, stamps) and indices.min() >= 0 and indices.max() < len(frames):
        readings_of["frame indices"] = frames[indices]
    # Other units than seconds are refused when the trajectory is read.
    readings_of["seconds since the first frame"] = stamps + begin
    found: dict[str, Fit] = {}
    for name, times in readings_of.items():
        inside = (times >= begin - 1.0) & (times <= end + 1.0)
        if inside.mean() < 0.5 or np.any(np.diff(times) <= 0):
            continue
        poses = Trajectory(times, estimate.positions, estimate.quaternions)
        try:
            found[name] = _fit(declared, truth, poses, declared.output.frame)
        except EvaluationError:
            continue
    told = (
        f"stamps from {stamps[0]:.3f} to {stamps[-1]:.3f}; the recording is from {begin:.3f} to {end:.3f} s"
    )
    fitting = [name for name, fit in found.items() if np.isfinite(fit.metres)]
    if not fitting:
        how = "write the sensor time of each frame: header stamp + timeOffset, in s"
        return Finding(CheckAnswer.FAIL, "stamp", f"{told}: no ground truth is near them", how)
    best = min(fitting, key=found.__getitem__)
    how = "write sensor time in s"
    if best == "frame indices":
        how = f"declare output.trajectory with stamps: frame-index, or {how}"
    elif best == "seconds since the first frame":
        how = f"declare output.trajectory with stamps: s-since-first, or {how}"
    return Finding(CheckAnswer.FAIL, "stamp", f"{told}: as {best} they fit, {found[best]}", how)


def inverse(estimate: Trajectory) -> Trajectory:
    """Return the inverse of each pose: the world's in the body's frame, or the other way round."""
    back = conjugate(estimate.quaternions)
    return Trajectory(estimate.stamps, -rotate(back, estimate.positions), back)


def _compared(
    check: str, what: str, own: Fit, others: Mapping[str, Fit], how: str, *, hidden: bool = False
) -> Finding:
    """Say whether what is declared fits better than all others.

    Args:
        check: what is looked at.
        what: what is declared.
        own: how well it fits.
        others: how well others fit, by name.
        how: what helps, with {} for the name of the other that fits better.
        hidden: whether the drift is too large to tell.
    """
    told = f"{what}: {own}"
    if not others:
        return Finding(CheckAnswer.PASS, check, f"{told}; there is no other to compare with")
    best = min(others, key=others.__getitem__)
    if hidden:
        text = f"{told}; as {best}: {others[best]}; the drift is too large to tell"
        return Finding(CheckAnswer.WARNING, check, text)
    better = [name for name, other in others.items() if other.clearly_better(own)]
    if better:
        best = min(better, key=others.__getitem__)
        text = f"{told}; {best} fits better: {others[best]}, {others[best].compared(own)}"
        return Finding(CheckAnswer.FAIL, check, text, how.format(best))
    close = [name for name, other in others.items() if not own.clearly_better(other)]
    if close:
        best = min(close, key=others.__getitem__)
        return Finding(CheckAnswer.WARNING, check, f"{told}; {best} fits about as well: {others[best]}")
    return Finding(CheckAnswer.PASS, check, f"{told}; the next best, {best}: {others[best]}")
