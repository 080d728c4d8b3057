# SPDX-License-Identifier: Apache-2.0
"""The time and the turn between two sensors of one body, by how they turn.

Rates of a rigid body differ between its frames by a constant rotation alone, those of a gyro by a bias, too.
For each shift the best rotation of the centred rates is a closed formula (Wahba 1965; Kabsch 1976), so the
shift that fits best is found without knowing either. It is refined together with them by Gauss-Newton, with
weights that leave out what doesn't fit (Cauchy). Errors are those of blocks of time (Huber 1967), as what is
wrong at one instant is wrong at the next.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from slamhive.data.doctor.turning import cross_of, exp_of, log_of

if TYPE_CHECKING:
    from slamhive.data.doctor.turning import Array, Mask, Turning, Turns

SEARCH = 5.0
"""Seconds within which a shift is looked for; what is farther apart, `clock.epoch` finds."""
LEAST_CORRELATION = 0.6
"""Below this nothing says that the two turn together."""
_SURE_CORRELATION = 0.9
"""Above this the fit of the whole begins near enough for it to find a drift, if there is one."""
_STEP = 0.025
"""Seconds between shifts that are tried: rates are means over 0.1 s."""
_SLOPE = 0.04
"""Seconds to either side over which rates grow: noise of a gyro would grow more over fewer."""
_LEAST_TOLD = 0.4
"""Share of the growth of rates that must be more than noise for a shift to be told."""
_DAMPED = 0.7
"""Share of a step that is taken, as what shakes faster grows more than is seen over these."""
_FEWEST = 15
_MOST = 250
"""Spans that shifts are tried on."""
_SHARE = 0.3
"""Share of the spans that both must know at a shift for it to count."""
_MIRRORED = 0.3
"""Share of what the stated sign leaves that the other one must leave at most, to be the right one."""
_PEAKS = 4
_AS_GOOD = 1.3
"""Shifts that leave at most so many times as much as the best one are as good, as in even steps of a walk."""
_ROUNDS = 14
_SETTLED = 1e-5
"""Seconds, and rad, below which another round changes nothing."""
_BENDS = 1
"""Degree of the polynomial of time that the difference of two biases may follow."""
_CAUCHY = 2.4
_LEAN = 0.001
"""Share of all turning below which turning about an axis tells less than the manifest."""
_TRUST = 0.1
"""Radians that the manifest's mounting may well be off by."""
_SIGMAS = 3.0
_BLOCK_SECONDS = 1.0
_FEWEST_BLOCKS = 6
_WINDOW_SECONDS, _MOST_WINDOWS = 8.0, 12
_LEAST_DRIFT = 1e-4
"""100 parts in a million: five times what a quartz is off by."""
_LEAST_GROWTH = 0.01
"""Seconds by which an offset must grow over the recording for a drift to be one."""
_SAME_SECONDS = 0.01
"""Seconds that two halves may differ by whatever their errors say, which come from few seconds of turning."""
_NEAR_SECONDS = 0.03
"""Seconds that they may differ by where the whole fits well; as much is its error then."""


@dataclass(frozen=True, eq=False)
class Match:
    """Fit of one sensor's turns to the turning of another: t_reference = t + offset + drift · (t − origin).

    Attributes:
        offset: To add to the sensor's time to get the reference's, s.
        error: Three standard deviations of it, s.
        drift: Growth of the offset, s/s; 0 where none is significant.
        drift_error: Three standard deviations of it.
        origin: Time that the offset is for, s: the middle.
        rotation: From rates in the reference's frame to those in the sensor's, shape (3, 3).
        covariance: Of a small turn of the sensor's frame, rad², shape (3, 3).
        correlation: Of the rates after the correction.
        halves: The offsets that each half of the turning has by itself, s.
    """

    offset: float
    error: float
    drift: float
    drift_error: float
    origin: float
    rotation: Array
    covariance: Array
    correlation: float
    halves: tuple[float, float]

    def at(self, time: float) -> float:
        """Return the offset at a time, s."""
        return self.offset + self.drift * (time - self.origin)

    def least_drift(self, length: float) -> float:
        """Return the drift below which there is none, s/s, of so many seconds."""
        return max(_LEAST_DRIFT, _LEAST_GROWTH / length, self.drift_error)


def is_mirrored(reference: Turning, turns: Turns) -> bool:
    """Tell whether a sensor turns as a reference does whose rates are all of the other sign.

    A rotation between the two can't make up for that where the body turns about three axes.
    """
    if len(turns) < 2 * _FEWEST:
        return False
    stated, mirrored = _Pair(reference, turns, np.eye(3)).least()
    return mirrored < _MIRRORED * min(stated, 1.0)


def match(reference: Turning, turns: Turns, expected: Array) -> Match | None:
    """Find time and turn between a sensor and a reference.

    Args:
        reference: Of the gyro, or another sensor that tells all the time.
        turns: The sensor's.
        expected: Rotation from rates in the reference's frame to those in the sensor's that the manifest
            states, shape (3, 3): taken where the motion doesn't tell.

    Returns:
        None where the two have too little in common to tell.
    """
    if len(turns) < 2 * _FEWEST:
        return None
    pair = _Pair(reference, turns, expected)
    start = pair.coarse()
    whole = None if start is None else pair.refined(start, 0.0, drifting=False)
    drifting = pair.drifting(whole)
    if drifting is not None:
        return drifting
    if whole is None or whole.correlation < LEAST_CORRELATION:
        return None
    found = [None if begin is None else part.refined(begin, 0.0, drifting=False)
             for part in pair.parts(2) for begin in (part.coarse(),)]  # fmt: skip
    if len(found) < 2 or None in found:
        return None
    first, second = (half for half in found if half is not None)
    # Where one half turns little, what they differ by is more honest than what is left within them.
    apart = abs(first.offset - second.offset)
    error = max(whole.error, apart / 2.0)
    if apart > max(first.error + second.error, _SAME_SECONDS):
        # One that turns once, from rest, is off by more than is left in it, although the whole fits well.
        if apart > _NEAR_SECONDS or whole.correlation < _SURE_CORRELATION:
            return None
        error = max(error, apart)
    return replace(whole, error=error, halves=(first.offset, second.offset))


class _Pair:
    """A reference and a sensor's turns, laid onto one another."""

    def __init__(self, reference: Turning, turns: Turns, expected: Array) -> None:
        self.turns = turns
        self._reference = reference
        self._expected = expected
        self._origin = float(turns.begin[0] + turns.end[-1]) / 2.0
        stride = max(1, len(turns) // _MOST)
        self._few = turns.select(slice(None, None, stride))

    def parts(self, count: int) -> list[_Pair]:
        """Return parts that follow one another and turn alike much."""
        power = np.cumsum(np.sum((self.turns.rates - self.turns.rates.mean(axis=0)) ** 2, axis=1))
        number = np.minimum((power / power[-1] * count).astype(np.intp), count - 1)
        chosen = [self.turns.select(number == k) for k in range(count)]
        return [_Pair(self._reference, part, self._expected) for part in chosen if len(part) >= _FEWEST]

    def coarse(self) -> float | None:
        """Return the shift at which the rates fit best, s."""
        shifts, (left, _) = self._tried()
        inner = (left[1:-1] <= left[:-2]) & (left[1:-1] <= left[2:]) & np.isfinite(left[1:-1])
        lows = np.flatnonzero(inner) + 1
        best = [self._lowest(shifts[k]) for k in lows[np.argsort(left[lows])][:_PEAKS]]
        limit = _AS_GOOD * min((value for value, _ in best), default=0.0)
        return min((shift for value, shift in best if value <= limit), key=abs, default=None)

    def least(self) -> tuple[float, float]:
        """Return the least share that is left at any shift by a rotation, and by a mirrored one."""
        stated, mirrored = self._tried()[1].min(axis=1)
        return float(stated), float(mirrored)

    def _tried(self) -> tuple[Array, Array]:
        """Return shifts (s) and what is left at each, as `_left`, by the reference at times a step apart."""
        few, turning = self._few, self._reference
        count = round(SEARCH / _STEP)
        first = few.begin.min() - SEARCH - _STEP
        grid = first + _STEP * np.arange(int((few.end.max() + SEARCH - first) / _STEP) + 3, dtype=np.float64)
        # Windows of the reference, of all shifts of a time in one piece, and one more to interpolate.
        table = np.vstack((turning.angle(grid).T, turning.piece(grid)))
        windows = sliding_window_view(table, 2 * count + 2, axis=1)

        def moved(times: Array) -> tuple[Array, Array]:
            place = (times - first) / _STEP
            low = place.astype(np.intp)
            share = (place - low)[:, np.newaxis]
            near = windows[:, low - count]
            return near[3, :, :-1], near[:3, :, :-1] * (1.0 - share) + near[:3, :, 1:] * share

        (one, before), (other, after) = moved(few.begin), moved(few.end)
        after -= before
        after /= (few.end - few.begin)[:, np.newaxis]
        return _STEP * np.arange(-count, count + 1, dtype=np.float64), _left(few, one == other, after)

    def _lowest(self, shift: float) -> tuple[float, float]:
        """Return the share that is left at the best shift near one, and that shift."""
        few, near = self._few, np.linspace(-_STEP, _STEP, 11) + shift
        known, rates = zip(*(self._reference.over(few.begin + k, few.end + k) for k in near), strict=True)
        left, _ = _left(few, np.array(known).T, np.array(rates).T)
        best = int(np.argmin(left))
        return float(left[best]), float(near[best])

    def drifting(self, steady: Match | None) -> Match | None:
        """Return the fit with a drift, where there is one."""
        length = float(np.ptp(self.turns.middle))
        count = min(int(length / _WINDOW_SECONDS), _MOST_WINDOWS)
        if count < 4:
            return None
        at_once = None if steady is None else self.refined(steady.offset, 0.0, drifting=True)
        is_sure = steady is not None and steady.correlation > _SURE_CORRELATION
        if is_sure and at_once is not None and abs(at_once.drift) <= at_once.least_drift(length):
            return None
        fits = [
            found
            for part in self.parts(count)
            for start in (part.coarse(),)
            for found in (None if start is None else part.refined(start, 0.0, drifting=False),)
            if found is not None and found.correlation >= LEAST_CORRELATION
        ]
        if len(fits) < 4:
            return None
        x, y = np.array([one.origin for one in fits]), np.array([one.offset for one in fits])
        i, j = np.triu_indices(len(x), 1)
        slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])))
        middle = float(np.median(y - slope * (x - self._origin)))
        tried = [self.refined(middle, slope, drifting=True), at_once]
        found = max((one for one in tried if one), key=lambda one: one.correlation, default=None)
        if found is None or found.correlation < LEAST_CORRELATION:
            return None
        # The parts by themselves must say so, too: one that is off isn't a drift.
        left = np.abs(y - found.offset - found.drift * (x - found.origin))
        agree = np.median(left) < max(0.25 * abs(found.drift) * length, _SAME_SECONDS)
        rises = np.mean(np.sign(y[j] - y[i]) * np.sign(x[j] - x[i]) == np.sign(found.drift)) > 0.8
        return found if abs(found.drift) > found.least_drift(length) and agree and rises else None

    def refined(self, offset: float, drift: float, *, drifting: bool) -> Match | None:
        """Return the fit by Gauss-Newton from an offset, and a drift, near the right ones."""
        turns, origin = self.turns, self._origin
        late = turns.middle - origin
        # Biases of gyros wander, which a slow turn would take for a shift.
        bends = np.vander(late / max(float(np.abs(late).max()), 1e-9), _BENDS + 1, increasing=True)
        matrix, bias, weights = self._expected, np.zeros((_BENDS + 1, 3)), np.ones(len(turns))
        columns, settled = 1 + drifting, False
        turned = slice(columns, columns + 3)
        for number in range(_ROUNDS + 1):
            moved = offset + drift * late
            known, rates = self._reference.over(turns.begin + moved, turns.end + moved)
            on, after = self._reference.over(turns.begin + moved + _SLOPE, turns.end + moved + _SLOPE)
            off, before = self._reference.over(turns.begin + moved - _SLOPE, turns.end + moved - _SLOPE)
            use = known & on & off
            if np.count_nonzero(use) < _FEWEST:
                return None
            seen, true, weight = turns.rates[use], rates[use], weights[use]
            if number == 0:
                matrix, bias[0] = _turned(seen, true, weight, self._expected)
            missed = seen - true @ matrix.T - bends[use] @ bias
            size = np.linalg.norm(missed, axis=1)
            scale = max(float(np.median(size)), 1e-9)
            weight = 1.0 / (1.0 + (size / (_CAUCHY * scale)) ** 2)
            weights[use] = weight
            slope = (after - before)[use] @ matrix.T / (2.0 * _SLOPE)
            table = np.zeros((len(seen), 3, columns + 3 * (_BENDS + 2)))
            table[:, :, :columns] = slope[:, :, np.newaxis]
            table[:, :, columns - 1] *= late[use][:, np.newaxis] if drifting else 1.0
            table[:, :, turned] = -cross_of(true @ matrix.T)
            for power in range(_BENDS + 1):
                place = columns + 3 * (power + 1)
                table[:, :, place : place + 3] = bends[use][:, power, np.newaxis, np.newaxis] * np.eye(3)
            pulled = (table * weight[:, np.newaxis, np.newaxis]).reshape(-1, table.shape[2]).T
            normal, whole = pulled @ table.reshape(-1, table.shape[2]), pulled @ missed.ravel()
            # About an axis that the body hardly turns about, noise would say.
            lean = _LEAN * float(np.sum(_centred(true, weight) ** 2))
            normal[turned, turned] += lean * np.eye(3)
            inverse = _inverse(normal)
            if number == _ROUNDS or settled:
                break
            whole[turned] -= lean * log_of(matrix @ self._expected.T)
            change = inverse @ whole
            offset += _DAMPED * float(np.clip(change[0], -_STEP, _STEP))
            drift += _DAMPED * float(change[1]) if drifting else 0.0
            turn = change[turned]
            matrix = exp_of(turn / max(1.0, float(np.linalg.norm(turn)) / 0.2)) @ matrix
            bias = bias + change[columns + 3 :].reshape(-1, 3)
            settled = max(abs(change[0]), float(np.abs(turn).max())) < _SETTLED
        told = self._told(slope, weight, float(np.average(size**2, weights=weight)))
        if told < _LEAST_TOLD:
            return None
        spread = _spread(turns.middle[use], weight, table, missed, inverse)
        # The manifest's mounting was leant on, and may be wrong.
        trust = inverse[:, turned] * (lean * _TRUST)
        spread += trust @ trust.T
        apart = _centred(seen, weight), _centred(true @ matrix.T, weight)
        power = np.sqrt(np.sum(apart[0] ** 2) * np.sum(apart[1] ** 2))
        return Match(
            offset=offset,
            error=_SIGMAS * float(np.sqrt(spread[0, 0])) / told,
            drift=drift,
            drift_error=_SIGMAS * float(np.sqrt(spread[1, 1])) / told if drifting else 0.0,
            origin=origin,
            rotation=matrix,
            covariance=spread[turned, turned],
            correlation=float(np.sum(apart[0] * apart[1]) / power) if power > 0 else 0.0,
            halves=(offset, offset),
        )

    def _told(self, slope: Array, weight: Array, missed: float) -> float:
        """Return the share of the growth of the reference's rates that isn't its noise.

        By noise alone a shift would seem to be told; `missed` is what is left of all noise, rad²/s².
        """
        length = float(np.median(self.turns.end - self.turns.begin))
        noise = min(self._reference.noise(length), missed)
        shaken = noise * 2.0 * min(1.0, 2.0 * _SLOPE / length) / (2.0 * _SLOPE) ** 2
        grown = float(np.average(np.sum(slope**2, axis=1), weights=weight))
        return 1.0 - shaken / grown if grown > 0 else 0.0


def _left(turns: Turns, known: Mask, rates: Array) -> Array:
    """Return the shares of the rates that the best rotation from a reference's doesn't explain, 0 to 1.

    Below them are those of the best rotation with a reflection: shape (2, m).

    Args:
        turns: n spans.
        known: Which of them the reference knows at each of m shifts, shape (n, m).
        rates: Its rates, shape (3, n, m).
    """
    count, length = known.sum(axis=0), len(turns)
    weight = known.astype(np.float64)
    many = np.maximum(count, 1)
    # About their means of all, so that sums of products keep their digits.
    seen = turns.rates - turns.rates.mean(axis=0)
    true = rates * weight
    true -= true.sum(axis=1, keepdims=True) / many * weight
    mean = seen.T @ weight / many
    power = np.sum(seen**2, axis=1) @ weight - np.sum(mean**2, axis=0) * many
    power *= np.einsum("jnm,jnm->m", true, true)
    # That `seen` has another mean there doesn't matter: the others sum up to nothing.
    table = (seen.T @ true).transpose(2, 1, 0)
    values = np.linalg.svd(table, compute_uv=False)
    third = values[:, 2] * np.sign(np.linalg.det(table))
    sums = values[:, 0] + values[:, 1] + np.stack((third, -third))
    explained = np.maximum(sums, 0.0) ** 2 / np.maximum(power, 1e-300)
    enough = count >= max(_FEWEST, _SHARE * length)
    # Below 0 by rounding, none would be as good as the best.
    return np.where(enough & (power > 0), np.maximum(1.0 - explained, 0.0), np.inf)


def _centred(rates: Array, weight: Array) -> Array:
    mean = np.average(rates, axis=0, weights=weight)
    return np.asarray((rates - mean) * np.sqrt(weight)[:, np.newaxis])


def _turned(seen: Array, true: Array, weight: Array, expected: Array) -> tuple[Array, Array]:
    """Return the rotation and the bias that fit best; the expected one where rates say nothing."""
    means = [np.average(rates, axis=0, weights=weight) for rates in (seen, true)]
    table = (seen - means[0]).T @ ((true - means[1]) * weight[:, np.newaxis])
    table = table + _LEAN * np.linalg.norm(table) * expected
    u, _, v = np.linalg.svd(table)
    matrix = u @ np.diag((1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(v)))) @ v
    return matrix, means[0] - matrix @ means[1]


def _inverse(normal: Array) -> Array:
    """Return the inverse of a matrix of normal equations whose unknowns have units of their own."""
    unit = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    return np.asarray(np.linalg.pinv(normal / np.outer(unit, unit), rcond=1e-10) / np.outer(unit, unit))


def _spread(times: Array, weight: Array, table: Array, missed: Array, inverse: Array) -> Array:
    """Return the covariance of the unknowns by what is left in blocks of time.

    The sum of two: of what each block pulls at them, which sees noise where it is; and of the noise of all
    blocks where the unknowns are told, as these may be a few short ramps that any shift fits.
    """
    count = max(_FEWEST_BLOCKS, int(np.ptp(times) / _BLOCK_SECONDS))
    block = np.minimum(
        ((times - times[0]) / max(float(np.ptp(times)), 1e-9) * count).astype(np.intp), count - 1
    )
    pull = np.zeros((count, table.shape[2]))
    np.add.at(pull, block, np.einsum("n,nij,ni->nj", weight, table, missed))
    noise = np.zeros((count, 3))
    np.add.at(noise, block, weight[:, np.newaxis] * missed)
    filled = len(np.unique(block))
    level = noise.T @ noise / weight.sum() * filled / max(filled - table.shape[2] / 3.0, 1.0)
    inner = pull.T @ pull + np.einsum("n,nki,kl,nlj->ij", weight, table, level, table, optimize=True)
    return np.asarray(inverse @ inner @ inverse)
