# SPDX-License-Identifier: Apache-2.0
"""Judgement of ground truth: what its tracker filled in, leaps, its rate, and whose pose it is."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from slamhive.data.doctor.findings import Finding, Severity
from slamhive.data.recordings.posetopics import POSE_TYPES, TRUTH_NAME, truth_topic
from slamhive.model.variant import TRUTH
from slamhive_eval import rotation
from slamhive_eval.coverage import REFERENCE_GAP_SECONDS

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from slamhive.data.doctor.examined import Examined
    from slamhive_eval import Trajectory

    Array = npt.NDArray[np.float64]
    Indices = npt.NDArray[np.intp]

_FILLED_SECONDS = 0.2
"""Shorter fillings move nothing by more than a few centimetres."""
_CATCH_UP, _CAUGHT_METRES, _CAUGHT_RADIANS = 2.0, 0.01, np.radians(1.0)
"""A platform that starts from rest is faster in its second step than in its first. One whose pose was held is
where it has gone meanwhile at once: many steps in one."""
_BENT = 5.0
_MOVED_METRES = 0.005
_STRAIGHT_SHARE = 1 / 3
"""Share of the moving time above which straight lines are the motion itself, as in a simulator's corridor."""
_INNER = _PARTS = 8
"""Poses of a window that are compared with its chord, and parts of it between which bends are looked for."""
_FASTER, _LEAP_METRES, _LEAP_ACCELERATION = 5.0, 0.03, 20.0
"""Of a leap: times the speed around it, m (noise of tracking is a few mm), and m/s² (twice gravity, which
drones and hands don't keep up for a whole step of 3 cm)."""
_LEAP_DEGREES, _LEAP_SPIN = 5.0, 30_000.0
"""The same for turns: degrees, and degrees/s², more than hands and drones reach."""
_AWAY_SECONDS = 3.0
_AROUND = 5
_HOLES = 100
"""Stretches above which a manifest isn't given a hole for each."""


class Stretch(NamedTuple):
    """Poses of a stretch that is wrong: the first and the last."""

    first: int
    last: int


class _Leaps(NamedTuple):
    """Poses from which a truth leaps; all its steps, m or degrees, and each one's speed to that around it."""

    at: npt.NDArray[np.intp]
    moves: Array
    times: Array
    unit: str


def judge_truth(examined: Examined) -> Iterator[Finding]:
    """Yield the findings of a ground truth by itself."""
    yield from _two(examined)
    truth = examined.truth
    if truth is None or len(truth) < 2:
        return
    yield from _rate(truth)
    # Poses of one stamp can't tell of speeds.
    kept = np.flatnonzero(np.diff(truth.stamps, prepend=-np.inf) > 0)
    truth = truth.select(kept)
    if len(truth) < 3 * _AROUND:
        return
    held, straight = _held(truth), _straight(truth)
    leaps, turns = _leaps(truth, [*held, *straight])
    away = excursions(leaps.at, truth.stamps, truth.positions)
    # There is one field for them all, so both findings propose the same.
    holes = _holes(examined, truth, sorted([*held, *straight, *away]))
    yield from _filled(truth, held, straight, holes)
    yield from _jumps(truth, leaps, holes if away else {})
    yield from _jumps(truth, turns, {})


def _rate(truth: Trajectory) -> Iterator[Finding]:
    """Yield a time between poses so long that few of an estimate's poses would meet one."""
    usual = float(np.median(np.diff(truth.stamps)))
    if usual <= REFERENCE_GAP_SECONDS:
        return
    yield Finding(
        "truth.rate",
        Severity.WARNING,
        f"groundTruth: its {len(truth)} poses are {usual:.3g} s apart typically: an estimate "
        "meets few of them within association.maxDifference (10 ms), and spans of more than "
        f"{REFERENCE_GAP_SECONDS:g} s between poses count as holes, so that runs come out Lost; if these are "
        "surveyed points, declare format: ControlPoints, and the estimate is interpolated to them",
        TRUTH,
        len(truth),
        float(truth.stamps[0]),
        usual,
        "s",
    )


def _held(truth: Trajectory) -> list[Stretch]:
    """Return the stretches in which a pose is held and then is where the platform has gone meanwhile."""
    steps, turns = _steps(truth)
    times = np.diff(truth.stamps)
    usual = float(np.median(times))
    rows = np.hstack((truth.positions, truth.quaternions))
    found = []
    for begin, end in _runs((np.diff(rows, axis=0) == 0).all(axis=1)):
        if truth.stamps[end] - truth.stamps[begin] < _FILLED_SECONDS or end + 1 >= len(times):
            continue
        if times[end] > 3.0 * usual:  # It had the time of a gap to get there.
            continue
        after = slice(end + 1, end + 1 + _AROUND)
        for moves, least in ((steps, _CAUGHT_METRES), (turns, _CAUGHT_RADIANS)):
            later = float(np.median(moves[after] / times[after]))
            if moves[end] > least and moves[end] / times[end] > _CATCH_UP * later:
                found.append(Stretch(begin + 1, end))
                break
    return found


def _straight(truth: Trajectory) -> list[Stretch]:
    """Return the stretches of exactly constant velocity in a truth that has none by itself.

    Windows of 0.2 s are compared with their chord. What is nearer to it than the digits tell is straight. A
    straight stretch is filled in if it begins and ends with a kink, or lies between poses with noise.
    """
    stamps, places = truth.stamps, truth.positions
    times = np.diff(stamps)
    usual = float(np.median(times))
    width = max(4, round(_FILLED_SECONDS / usual))
    if len(truth) < 3 * width:
        return []
    lasting = stamps[width:] - stamps[:-width]
    moved = places[width:] - places[:-width]
    far = np.linalg.norm(moved, axis=1)
    away = np.zeros(len(far))
    for at in np.unique(np.linspace(1, width - 1, _INNER).astype(int)):
        share = (stamps[at : at - width] - stamps[:-width]) / lasting
        chord = places[:-width] + moved * share[:, None]
        away = np.maximum(away, np.linalg.norm(places[at : at - width] - chord, axis=1))
    # Stamps are rounded by far less than a step, and those of a steady rate aren't, however few their digits.
    unit, jitter = _quantum(stamps - stamps[0]), float(np.percentile(np.abs(times - usual), 90))
    instant = max(min(jitter, unit) if unit < usual / 20 else 0.0, float(np.spacing(stamps[-1])))
    grain = 1.5 * _quantum(places) + 1e-9 + 1e-12 * float(np.abs(places).max())
    limits = grain + instant * far / lasting
    moving = (far > np.maximum(_MOVED_METRES, 20.0 * limits)) & (lasting < 2.0 * width * usual)
    straight = moving & (away <= limits)
    others = moving & ~straight
    if not straight.any() or straight.sum() > _STRAIGHT_SHARE * moving.sum():
        return []
    if np.median(away[others] / limits[others]) < _BENT:
        return []
    # From pose to pose a kink is sharpest; farther apart it stands out of noise and rounding.
    scales = [(apart, *_bends(truth, apart, usual)) for apart in sorted({1, max(1, width // _PARTS)})]
    inside = np.zeros(len(truth), dtype=np.bool_)
    for begin, end in _runs(straight):
        inside[begin : end + width] = True
    least = 4.0 * float(np.median(limits))
    return [
        Stretch(begin + 1, end - 2)
        for begin, end in _runs(inside)
        if any(_is_made_up(scale, (begin, end - 1), width, least) for scale in scales)
    ]


def _bends(truth: Trajectory, apart: int, usual: float) -> tuple[Array, Array]:
    """Return the distances of poses from the motion before them, and the changes of these, m.

    Args:
        truth: The poses.
        apart: Number of steps between the poses of a difference.
        usual: Usual time between poses, s.
    """
    between = (truth.stamps[apart:] - truth.stamps[:-apart])[:, None]
    speeds = (truth.positions[apart:] - truth.positions[:-apart]) / between * (apart * usual)
    vectors = speeds[apart:] - speeds[:-apart]
    bends = np.pad(np.linalg.norm(vectors, axis=1), apart)
    return bends, np.pad(np.linalg.norm(vectors[apart:] - vectors[:-apart], axis=1), (apart, 2 * apart))


def _is_made_up(scale: tuple[int, Array, Array], stretch: tuple[int, int], width: int, least: float) -> bool:
    """Tell whether a straight stretch of poses has a kink at either end, or noise beside it.

    Args:
        scale: Steps between the poses of a difference, and what `_bends` says of them.
        stretch: Its first pose, and its last one.
        width: Poses of a window.
        least: What digits alone may bend, m.
    """
    apart, bends, changes = scale
    begin, end = stretch
    kinks = []
    for side, at in (
        (slice(max(0, begin - apart - width), max(0, begin - apart)), begin),
        (slice(end + apart + 1, end + apart + width + 1), end),
    ):
        if not bends[side].size:
            return False
        typical, rough = float(np.median(bends[side])), float(np.median(changes[side]))
        # Of noise the second differences are larger than the first; of a smooth motion far smaller.
        is_rough = typical > least and rough > typical
        kink = float(bends[max(0, at - apart) : at + apart + 1].max())
        # A simulator's platform starts at once, from rest or from another straight line.
        kinks.append(is_rough or (typical > 1e-9 and kink > max(least, _BENT * typical)))
    return all(kinks)


def _quantum(values: Array) -> float:
    """Return the unit of the last decimal that numbers are written with; 0 where they have all digits."""
    some = values[:1000]
    for digits in range(1, 8):
        scaled = some * 10.0**digits
        if np.abs(scaled - np.rint(scaled)).max() < 1e-3:
            return float(10.0**-digits)
    return 0.0


def _filled(
    truth: Trajectory, held: list[Stretch], straight: list[Stretch], holes: dict[str, object]
) -> Iterator[Finding]:
    stretches = sorted([*held, *straight])
    if not stretches:
        return
    seconds = sum(float(truth.stamps[one.last + 1] - truth.stamps[one.first - 1]) for one in stretches)
    first = float(truth.stamps[stretches[0].first])
    kinds = [
        f"{len(ones)} {said}"
        for ones, said in (
            (held, "with the same pose again and again, then with a leap to where it has gone meanwhile"),
            (straight, "of exactly constant velocity, as interpolation makes"),
        )
        if ones
    ]
    yield Finding(
        "truth.filled",
        Severity.WARNING,
        f"groundTruth: {len(stretches)} stretch{'es' if len(stretches) > 1 else ''} of {seconds:.1f} s in "
        f"all, the first at {first:.3f} s, were filled in by the tracking system: {'; '.join(kinds)}. Errors "
        "there measure the filling instead of the estimate, relative ones most; leave them out as holes",
        TRUTH,
        len(stretches),
        first,
        seconds,
        "s",
        repair=holes,
    )


def _holes(examined: Examined, truth: Trajectory, stretches: list[Stretch]) -> dict[str, object]:
    """Return holes for stretches as a repair; none where the truth's own times are under one."""
    spec = examined.entry.dataset.spec
    is_moved = spec.repair is not None and spec.repair.ground_truth is not None
    if spec.ground_truth is None or is_moved or len(stretches) > _HOLES:
        return {}
    middles = 0.5 * (truth.stamps[1:] + truth.stamps[:-1])
    holes = [{"start": hole.start, "end": hole.end} for hole in spec.ground_truth.holes]
    holes += [
        {"start": round(float(middles[one.first - 1]), 6), "end": round(float(middles[one.last]), 6)}
        for one in stretches
    ]
    return {TRUTH: {"holes": holes}}


def _leaps(truth: Trajectory, filled: list[Stretch]) -> tuple[_Leaps, _Leaps]:
    """Return the steps and turns that no platform makes, but for those into and out of what was filled in."""
    times = np.diff(truth.stamps)
    free = longest_around(times, _AROUND)
    known = np.zeros(len(times), dtype=np.bool_)
    for one in filled:
        known[max(0, one.first - 2) : one.last + 2] = True

    def found(moves: Array, least: float, hardest: float, unit: str) -> _Leaps:
        speeds = moves / times
        around = local_speed(speeds, _AROUND)
        is_leap = (moves >= least) & (speeds > _FASTER * around) & (speeds - around > hardest * free)
        return _Leaps(np.flatnonzero(is_leap & ~known), moves, speeds / np.maximum(around, 1e-9), unit)

    steps, turns = _steps(truth)
    return (
        found(steps, _LEAP_METRES, _LEAP_ACCELERATION, "m"),
        found(np.degrees(turns), _LEAP_DEGREES, _LEAP_SPIN, "°"),
    )


def _jumps(truth: Trajectory, leaps: _Leaps, holes: dict[str, object]) -> Iterator[Finding]:
    count = leaps.at.size
    if not count:
        return
    k = int(leaps.at[np.argmax(leaps.moves[leaps.at])])
    first, value = float(truth.stamps[leaps.at[0]]), float(leaps.moves[k])
    away = "what is between a leap and the next one back is left out as a hole" if holes else ""
    yield Finding(
        "truth.jump",
        Severity.WARNING,
        f"groundTruth: it leaps {count} time{'s' if count > 1 else ''}, the first at {first:.3f} s, the "
        f"farthest at {truth.stamps[k]:.3f} s by {value:.3g} {leaps.unit} in "
        f"{1e3 * (truth.stamps[k + 1] - truth.stamps[k]):.3g} ms, {leaps.times[k]:.3g} times as fast as "
        "around it: no platform moves so. Relative errors across a leap are the truth's own, absolute ones "
        f"up to its size: look at what was tracked there; {away or 'leave a spoiled side out as a hole'}",
        TRUTH,
        count,
        first,
        value,
        leaps.unit,
        repair=holes,
    )


def excursions(leaps: npt.NDArray[np.intp], stamps: Array, places: Array) -> list[Stretch]:
    """Return the stretches between a leap and the next that soon comes back to where it began.

    Args:
        leaps: Numbers of the poses that they start from.
        stamps: Times of all poses, shape (n,), s.
        places: Their positions, shape (n, m), m.
    """
    found = []
    for k, back in itertools.pairwise(leaps.tolist()):
        far, near = (np.linalg.norm(places[at + 1] - places[k]) for at in (k, back))
        if stamps[back] - stamps[k] <= _AWAY_SECONDS and near < 0.5 * far:
            found.append(Stretch(k + 1, back))
    return found


def local_speed(speeds: Array, around: int) -> Array:
    """Return the median of the speeds of so many steps on either side of each, without its own."""
    found: Array = np.median(np.delete(_windows(speeds, around), around, axis=1), axis=1)
    return found


def longest_around(times: Array, around: int) -> Array:
    """Return the longest of so many steps on either side of each: a platform had all of it to get faster."""
    found: Array = _windows(times, around).max(axis=1)
    return found


def _windows(values: Array, around: int) -> Array:
    return sliding_window_view(np.pad(values, around, mode="reflect"), 2 * around + 1)


def _steps(truth: Trajectory) -> tuple[Array, Array]:
    """Return the distances and turns from pose to pose, m and rad."""
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    if not truth.oriented:
        return steps, np.zeros_like(steps)
    between = rotation.multiply(rotation.conjugate(truth.quaternions[:-1]), truth.quaternions[1:])
    return steps, rotation.angle(between)


def _runs(are: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the begin of each run of true values, and the end after it."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], are, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _two(examined: Examined) -> Iterator[Finding]:
    """Yield the other topics and files that are ground truth by their names."""
    truth = examined.entry.dataset.spec.ground_truth
    if truth is None:
        return
    taken = truth_topic(truth.topic) or truth.file
    others = sorted(
        name
        for name, topic in examined.recording.topics.items()
        if topic.message_type in POSE_TYPES and topic.count and TRUTH_NAME.search(name) and name != taken
    )
    if truth.file is not None:
        own = (examined.entry.root / truth.file).resolve()
        if own.is_file():
            beside = (path for path in own.parent.iterdir() if path != own and path.is_file())
            others += sorted(path.name for path in beside if TRUTH_NAME.fullmatch(path.stem))
    if others:
        yield Finding(
            "truth.two",
            Severity.NOTE,
            f"groundTruth: {taken} is taken; {', '.join(others)} may be ground truth, too: figures against "
            "one can't be compared with those against another, if frame, smoothing or clock differ",
            TRUTH,
            len(others),
        )
