# SPDX-License-Identifier: Apache-2.0
"""Faults of a pair of trajectories, found by trying the usual ones.

Each fault (a clock, a convention, a turn or lever arm between the frames, a scale) is undone by itself, and
the pair is laid onto one another anew. The one that helps most is kept, and the others are tried on what is
left. What has a number to fit is found from each half of the estimate by itself and must help in the other
one too: drift of an estimate doesn't, and is no fault of the pair.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import association, rotation
from slamhive_eval.alignment import align, umeyama_scale
from slamhive_eval.conventions import CONVENTIONS, Convention, read_as
from slamhive_eval.errors import AssociationError, EvaluationError
from slamhive_eval.timing import find_offset
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive_eval.alignment import Method
    from slamhive_eval.rotation import FloatArray, IndexArray

LEAST_GAIN = 1.3
"""So many times must positions or rotations fit better for a fault to be named."""
_LEAST_ELSEWHERE = 1.1
"""And so many times in the half of the poses that its number doesn't come from."""
_NO_WORSE = 0.9
_MOST_POSES = 400
_MOST_FAULTS = 4
_MOST_TIMES = 1000.0
_FEWEST = 10
_EXACT = 1e-7
"""Errors below this share of the path, or in rad, are rounding."""
_SEARCH_SECONDS = 2.0
_SETTLED_SECONDS = 2e-5
_AS_GOOD = math.log(1.1)
"""Log of the factor by which an offset by turning rates may fit worse than the best, which drift moves."""
_STEP_SECONDS = 1.0
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_ROUNDS = 60
_LEAST_TURNING = 0.02
"""Of the turns about the main axes: about one that the body hardly turns about, no arm is found."""
_NAMED_SECONDS = 0.6
_NAMED_DEGREES = 3.0
_CLOCKS = (
    (37.0, "TAI instead of UTC"),
    (18.0, "GPS time instead of UTC"),
    (19.0, "TAI instead of GPS time"),
    (315_964_800.0, "counted from 1980, as GPS does"),
    (315_964_782.0, "GPS time instead of UTC since 1970"),
    (946_684_800.0, "counted from 2000"),
)
_AXES = {
    "180° about x": (1, 0, 0, 0),
    "180° about y": (0, 1, 0, 0),
    "180° about z": (0, 0, 1, 0),
    "90° about x": (1, 0, 0, 1),
    "−90° about x": (-1, 0, 0, 1),
    "90° about y": (0, 1, 0, 1),
    "−90° about y": (0, -1, 0, 1),
    "90° about z": (0, 0, 1, 1),
    "−90° about z": (0, 0, -1, 1),
    "camera axes (x right, y down, z forward) in a body with x forward and z up": (-1, 1, -1, 1),
    "body axes (x forward, z up) where the ground truth has a camera's": (1, -1, 1, 1),
}


@dataclass(frozen=True)
class Fault:
    """A fault of a pair, and how to undo it.

    Attributes:
        code: ``clock``, ``turn``, ``lever``, ``scale``, or a convention of `slamhive_eval.conventions`.
        better: How many times better positions or rotations fit without it, whichever gains more.
        message: A sentence.
        flag: Words for ``slamhive-eval ape`` and ``rpe`` that undo it.
        value: Its number: s, degrees, m or a factor; None where it has none.
    """

    code: str
    better: float
    message: str
    flag: str
    value: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        return {
            "code": self.code,
            "better": self.better,
            "value": self.value,
            "message": self.message,
            "flag": self.flag,
        }


@dataclass(frozen=True, eq=False)
class Fit:
    """Root mean squares of what is left between a pair that was laid onto one another.

    Attributes:
        position: In m.
        step: Of the way over a second, in m: what drifts slowly is not in it.
        rotation_rad: In rad; None without orientations.
        pairs: Poses that were compared.
        alignment_rad: How far the errors of the positions may turn the alignment, in rad.
    """

    position: float
    step: float
    rotation_rad: float | None
    pairs: int
    alignment_rad: float

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        turned = None if self.rotation_rad is None else math.degrees(self.rotation_rad)
        return {"position": self.position, "step": self.step, "rotationDeg": turned, "pairs": self.pairs}


@dataclass(frozen=True, eq=False)
class Explained:
    """Result of `explain`.

    Attributes:
        before: As the pair is, after an SE(3) alignment; None where no poses belong together.
        after: With all faults undone; None likewise.
        faults: Those found, in the order in which they were undone.
        extrinsic: Pose of the estimate's frame in the ground truth's body, with turn and arm, shape (4, 4).
    """

    before: Fit | None
    after: Fit | None
    faults: tuple[Fault, ...]
    extrinsic: FloatArray

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        return {
            "before": self.before and self.before.as_dict(),
            "after": self.after and self.after.as_dict(),
            "faults": [fault.as_dict() for fault in self.faults],
            "extrinsic": self.extrinsic.tolist(),
        }


@dataclass(frozen=True, eq=False)
class _Reading:
    """The pair, as it is taken."""

    offset: float = 0.0
    conventions: tuple[Convention, ...] = ()
    extrinsic: FloatArray = field(default_factory=lambda: np.eye(4))
    scaled: bool = False

    @property
    def alignment(self) -> Method:
        """Alignment that leaves no more than the faults that are left."""
        return "sim3" if self.scaled else "se3"


def explain(reference: Trajectory, estimate: Trajectory) -> Explained:
    """Find what undone makes a pair fit better.

    Args:
        reference: Ground truth.
        estimate: Of any clock, world and frame of the same body.

    Returns:
        The faults, none where the pair is as it should be.
    """
    pair = _Pair(reference, estimate)
    reading = _Reading()
    found: list[Fault] = []
    before = fit = pair.fit(reading)
    while len(found) < _MOST_FAULTS:
        best = max(pair.tries(reading, fit), key=lambda tried: tried.total, default=None)
        if best is None:
            break
        found.append(best.fault)
        reading, fit = best.reading, best.fit
    return Explained(before, fit, tuple(found), reading.extrinsic)


def hints(reference: Trajectory, estimate: Trajectory) -> list[str]:
    """Return a note for each fault of a pair."""
    found = explain(reference, estimate)
    return [f"fits {times(one.better)} better if {one.message} ({one.flag})" for one in found.faults]


def times(better: float) -> str:
    """Return a gain in words."""
    return f"over {_MOST_TIMES:.0f} times" if better > _MOST_TIMES else f"{better:.1f} times"


@dataclass(frozen=True, eq=False)
class _Tried:
    fault: Fault
    reading: _Reading
    fit: Fit
    total: float


class _Pair:
    """A pair and the faults that can be tried on it."""

    def __init__(self, reference: Trajectory, estimate: Trajectory) -> None:
        self._reference = reference.orthonormal()
        # Of poses with one stamp the first: all would be laid onto one place of the ground truth.
        estimate = estimate.select(np.unique(estimate.stamps, return_index=True)[1])
        step = max(1, len(estimate) // _MOST_POSES)
        self._whole = estimate.orthonormal()
        self._estimate = self._whole.select(slice(None, None, step))
        self._oriented = reference.oriented and estimate.oriented
        self._floor = _EXACT * max(reference.path_length, 1e-6)
        spacing = [float(np.median(np.diff(one.stamps))) for one in (reference, estimate) if len(one) > 1]
        self._gap = max(association.DEFAULT_GAP_SECONDS, 3.0 * max(spacing, default=0.0))

    def fit(self, reading: _Reading, half: int | None = None) -> Fit | None:
        """Lay the pair, or a half of it, onto one another; None where too few poses belong together."""
        matched = self._matched(reading, half)
        if matched is None:
            return None
        truth, found = matched
        try:
            laid = align(truth, found, reading.alignment).apply(found)
        except EvaluationError:
            return None
        left = laid.positions - truth.positions
        first, later = _steps(truth)
        step = left[later] - left[first] if len(first) else left
        spread = _rms(truth.positions - truth.positions.mean(axis=0))
        missed, turned = max(_rms(left), self._floor), None
        if self._oriented:
            between = rotation.multiply(rotation.conjugate(truth.quaternions), laid.quaternions)
            turned = max(float(np.sqrt(np.mean(rotation.angle(between) ** 2))), _EXACT)
        return Fit(
            missed, max(_rms(step), self._floor), turned, len(truth), missed / max(spread, self._floor)
        )

    def tries(self, reading: _Reading, fit: Fit | None) -> Iterator[_Tried]:
        """Yield each fault that undone makes the pair fit better."""
        for convention in CONVENTIONS:
            if convention not in reading.conventions and (self._oriented or convention == "left-handed"):
                taken = replace(reading, conventions=(*reading.conventions, convention))
                yield from self._kept(fit, taken, partial(_of_convention, convention))
        fitted: tuple[tuple[bool, Callable[..., _Reading | None], Callable[..., Fault]], ...] = (
            (True, self._clock, _of_clock),
            (self._oriented, self._turn, _of_turn),
            (self._oriented, self._lever, _of_lever),
            (not reading.scaled, self._scale, self._of_scale),
        )
        for possible, find, describe in fitted:
            changed = find(reading, None) if possible else None
            if changed is not None and (fit is None or self._holds_elsewhere(reading, find)):
                yield from self._kept(fit, changed, partial(describe, reading, changed))

    def _kept(self, fit: Fit | None, taken: _Reading, describe: Callable[[float], Fault]) -> Iterator[_Tried]:
        """Yield a reading that fits better than the one before it."""
        found = self.fit(taken)
        if found is None:
            return
        if fit is None:
            yield _Tried(describe(math.inf), taken, found, math.inf)
            return
        gains = _gains(fit, found)
        if found.pairs >= _NO_WORSE * fit.pairs and max(gains) >= LEAST_GAIN and min(gains) >= _NO_WORSE:
            yield _Tried(describe(max(gains)), taken, found, math.prod(gains))

    def _holds_elsewhere(self, reading: _Reading, find: Callable[..., _Reading | None]) -> bool:
        """Tell whether what is found from either half of the estimate helps in the other one."""
        for half in (0, 1):
            taken = find(reading, half)
            before = self.fit(reading, 1 - half)
            after = None if taken is None else self.fit(taken, 1 - half)
            if after is None or (before is not None and max(_gains(before, after)) < _LEAST_ELSEWHERE):
                return False
        return True

    def _read(self, reading: _Reading, half: int | None = None) -> Trajectory:
        found = self._estimate
        if half is not None:
            middle = len(found) // 2
            found = found.select(slice(middle) if half == 0 else slice(middle, None))
        for convention in reading.conventions:
            found = read_as(found, convention)
        return found.shifted(reading.offset)

    def _matched(self, reading: _Reading, half: int | None = None) -> tuple[Trajectory, Trajectory] | None:
        """Return ground truth, in the estimate's frame, and estimate at the same times."""
        found = self._read(reading, half)
        pairs, truth, kept = association.pair_up(
            self._reference, found, "interpolate", max_gap_seconds=self._gap
        )
        if len(pairs) < _FEWEST:
            return None
        return (truth.moved(reading.extrinsic) if self._oriented else truth), kept

    def _clock(self, reading: _Reading, half: int | None) -> _Reading | None:
        """The offset of the estimate's clock."""
        turning = self._turning_offset(reading, half)
        taken = [] if turning is None else [turning]
        start = self._reference.stamps[0] - self._estimate.stamps[0]
        taken += [reading.offset, start]
        taken += [sign * seconds for seconds, _ in _CLOCKS for sign in (1.0, -1.0)]
        taken.append(3600.0 * round(start / 3600.0))
        best = min(taken, key=lambda offset: self._cost(replace(reading, offset=offset), half))
        if not math.isfinite(self._cost(replace(reading, offset=best), half)):
            return None
        fitted = replace(reading, offset=self._nearby(reading, best, half))
        if turning is not None:
            turned = replace(reading, offset=turning)
            if self._cost(turned, half) <= self._cost(fitted, half) + _AS_GOOD:
                return turned
        return fitted

    def _turning_offset(self, reading: _Reading, half: int | None) -> float | None:
        """The offset by turning rates, in which drift has no part; None where it can't be told."""
        if not self._oriented:
            return None
        try:
            found = find_offset(self._reference, self._read(replace(reading, offset=0.0), half))
        except AssociationError:
            return None
        return found.offset_seconds

    def _nearby(self, reading: _Reading, offset: float, half: int | None) -> float:
        """Return the offset near another one at which the pair fits best, by golden section."""

        def cost(at: float) -> float:
            return self._cost(replace(reading, offset=at), half)

        step = _SEARCH_SECONDS / 10.0
        best = min((offset + step * k for k in range(-10, 11)), key=cost)
        low, high = best - step, best + step
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        at_left, at_right = cost(left), cost(right)
        while high - low > _SETTLED_SECONDS:
            if at_left < at_right:
                high, right, at_right = right, left, at_left
                left = high - _GOLDEN * (high - low)
                at_left = cost(left)
            else:
                low, left, at_left = left, right, at_right
                right = low + _GOLDEN * (high - low)
                at_right = cost(right)
        return (low + high) / 2.0

    def _cost(self, reading: _Reading, half: int | None) -> float:
        fit = self.fit(reading, half)
        if fit is None or fit.pairs < len(self._estimate) / (3 if half is None else 6):
            return math.inf
        return math.log(fit.position) + (math.log(fit.rotation_rad) if fit.rotation_rad else 0.0)

    def _turn(self, reading: _Reading, half: int | None) -> _Reading | None:
        """The turn of the estimate's frame in the body, the mean over all poses of paths laid together."""
        matched = self._matched(reading, half)
        if matched is None:
            return None
        truth, found = matched
        laid = align(truth, found, reading.alignment).apply(found)
        between = rotation.multiply(rotation.conjugate(truth.quaternions), laid.quaternions)
        _, vectors = np.linalg.eigh(between.T @ between)
        change = np.eye(4)
        change[:3, :3] = rotation.to_matrix(vectors[:, -1])
        return replace(reading, extrinsic=reading.extrinsic @ change)

    def _lever(self, reading: _Reading, half: int | None) -> _Reading | None:
        """The place of the estimate's frame in the body, by the ways of a second, which hardly drift."""
        matched = self._matched(reading, half)
        if matched is None:
            return None
        truth, found = matched
        matrices = rotation.to_matrix(truth.quaternions)
        first, later = _steps(truth)
        if len(first) < _FEWEST:
            return None
        inverse = np.linalg.pinv((matrices[later] - matrices[first]).reshape(-1, 3), rcond=_LEAST_TURNING)
        arm = np.zeros(3)
        for _ in range(_ROUNDS):
            moved = truth.positions + matrices @ arm
            beside = Trajectory(truth.stamps, moved, truth.quaternions)
            laid = align(beside, found, reading.alignment).apply(found).positions
            left = laid - truth.positions
            change = inverse @ (left[later] - left[first]).reshape(-1) - arm
            arm = arm + change
            if np.abs(change).max() < self._floor:
                break
        shift = np.eye(4)
        shift[:3, 3] = arm
        return replace(reading, extrinsic=reading.extrinsic @ shift)

    def _scale(self, reading: _Reading, half: int | None) -> _Reading | None:
        """The estimate scaled, unless noise makes it look smaller: then it is so seen from either side."""
        matched = self._matched(reading, half)
        scales = [umeyama_scale(*matched), umeyama_scale(*matched[::-1])] if matched else [None]
        if None in scales or math.prod(filter(None, scales)) < _NO_WORSE:
            return None
        return replace(reading, scaled=True)

    def _of_scale(self, _: _Reading, now: _Reading, gain: float) -> Fault:
        matched = self._matched(now)
        scale = align(*matched, "sim3").scale if matched else 1.0
        message = f"its lengths are multiplied by {scale:.4g}"
        return Fault("scale", gain, message, "--align sim3", scale)


def _steps(truth: Trajectory) -> tuple[IndexArray, IndexArray]:
    """Return the poses that have one a second later, and those: indices, shape (n,) each."""
    later = np.searchsorted(truth.stamps, truth.stamps + _STEP_SECONDS)
    first = np.flatnonzero(later < len(truth))
    return first, later[first]


def _rms(vectors: FloatArray) -> float:
    """Return the root mean square of the lengths of vectors, shape (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors * vectors, axis=1))))


def _gains(before: Fit, after: Fit) -> tuple[float, ...]:
    """Return the factors by which positions and steps fit better, and rotations where there are some."""
    gains: tuple[float, ...] = (before.position / after.position, before.step / after.step)
    if before.rotation_rad and after.rotation_rad:
        unknown = after.alignment_rad
        gains += (max(before.rotation_rad, unknown) / max(after.rotation_rad, unknown),)
    return gains


_SAYINGS: dict[Convention, str] = {
    "inverse": "its poses are taken for the inverse ones: of the world in the body",
    "inverse-rotation": "its rotations are taken for the inverse ones: of the world in the body",
    "wxyz": "its quaternions are read as w x y z",
    "left-handed": "its y axis points the other way: its axes are left-handed",
}


def _of_convention(convention: Convention, gain: float) -> Fault:
    return Fault(convention, gain, _SAYINGS[convention], f"--read-as {convention}")


def _of_clock(before: _Reading, now: _Reading, gain: float) -> Fault:
    offset = now.offset
    change = abs(offset - before.offset)
    causes = [name for seconds, name in _CLOCKS if abs(change - seconds) < _NAMED_SECONDS]
    hours = round(change / 1800.0) / 2.0
    if not causes and 0 < hours <= 14 and abs(change - 3600.0 * hours) < _NAMED_SECONDS:
        causes.append(f"{hours:g} h, as between time zones")
    cause = f" ({causes[0]})" if causes else ""
    return Fault(
        "clock", gain, f"{offset:.4g} s are added to its stamps{cause}", f"--offset {offset:.6f}", offset
    )


def _of_turn(before: _Reading, now: _Reading, gain: float) -> Fault:
    change = np.linalg.inv(before.extrinsic) @ now.extrinsic
    q = rotation.from_matrix(change[np.newaxis, :3, :3])[0]
    degrees = float(np.rad2deg(rotation.angle(q)))
    what = f"by {degrees:.1f}°"
    for name, given in _AXES.items():
        axes = np.array(given, dtype=np.float64)
        away = rotation.multiply(rotation.conjugate(axes / np.linalg.norm(axes)), q)
        if np.rad2deg(rotation.angle(away)) < _NAMED_DEGREES:
            what = f"by {degrees:.1f}°: {name}"
    return Fault("turn", gain, f"its frame is turned in the body {what}", "--extrinsic FILE", degrees)


def _of_lever(before: _Reading, now: _Reading, gain: float) -> Fault:
    change = np.linalg.inv(before.extrinsic) @ now.extrinsic
    x, y, z = change[:3, 3]
    message = f"its frame is at ({x:.3f}, {y:.3f}, {z:.3f}) m in the body, not at its origin"
    return Fault("lever", gain, message, "--extrinsic FILE", float(np.linalg.norm(change[:3, 3])))
