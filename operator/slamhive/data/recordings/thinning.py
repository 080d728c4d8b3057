# SPDX-License-Identifier: Apache-2.0
"""Thinning of a stream to a lower rate: the frames to keep, chosen by their time stamps alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.model.sensors import SAME_RATE

if TYPE_CHECKING:
    import numpy.typing as npt

    Stamps = npt.NDArray[np.int64]
    Mask = npt.NDArray[np.bool_]

_GAP = 3.0
"""Steps longer than this many typical ones are gaps and say nothing about the rate."""
_EARLY = 0.3
"""Wanted periods by which a frame may come before its time."""
_RARE = 0.1
"""More gaps than this share of all steps are no gaps: the stream is irregular."""


def rate_of(stamps: Stamps) -> float | None:
    """Return the mean rate of a stream in Hz, gaps left out; None for fewer than two stamps.

    Gaps are rare steps of more than three typical ones; where they aren't rare, the stream is an irregular
    one and its mean rate that over all of it.

    Args:
        stamps: ns, increasing, shape (n,).
    """
    steps = np.diff(stamps)
    apart = steps[steps > 0]
    if not apart.size:
        return None
    # Messages of one stamp count, as they do where bursts of samples are stamped on arrival.
    steps = steps[steps >= 0]
    regular = steps[steps <= _GAP * np.median(apart)]
    if steps.size - regular.size <= _RARE * steps.size:
        steps = regular
    return float(1e9 * steps.size / steps.sum())


def thin(stamps: Stamps, rate: float) -> Mask:
    """Choose the frames to keep for a lower rate.

    When the recorded rate is a multiple of the wanted one, each kept frame is the one nearest to one
    wanted period after the frame kept before: spacing stays regular under jitter, drift and drops.
    Otherwise frames nearest to the ticks of a clock are kept: spacing varies by one recorded period,
    the mean rate is exact.

    Args:
        stamps: ns, increasing, shape (n,).
        rate: Wanted rate, Hz.

    Returns:
        Mask of the frames to keep, shape (n,); all of them when the stream isn't faster.
    """
    recorded = rate_of(stamps)
    if recorded is None or recorded <= rate * SAME_RATE:
        return np.ones(len(stamps), dtype=np.bool_)
    ratio = recorded / rate
    whole = round(ratio)
    regular = abs(ratio - whole) <= 0.02 * whole
    mask = np.zeros(len(stamps), dtype=np.bool_)
    mask[_chain(stamps, whole * 1e9 / recorded) if regular else _grid(stamps, 1e9 / rate)] = True
    return mask


def partners(stamps: Stamps, others: Stamps, limit: float) -> npt.NDArray[np.intp]:
    """Find for each stamp the nearest of another stream.

    Args:
        stamps: ns, increasing, shape (n,).
        others: ns, increasing, shape (m,).
        limit: Largest difference, ns.

    Returns:
        Index into others, -1 where none is near enough, shape (n,). Each is used once at most.
    """
    result = np.full(len(stamps), -1, dtype=np.intp)
    if not len(others):
        return result
    right = np.clip(np.searchsorted(others, stamps), 0, len(others) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(others[left] - stamps) <= np.abs(others[right] - stamps), left, right)
    distance = np.abs(others[nearest] - stamps)
    result[distance <= limit] = nearest[distance <= limit]
    if len(np.unique(result[result >= 0])) < np.count_nonzero(result >= 0):
        _settle_claims(result, distance)
    return result


def _settle_claims(result: npt.NDArray[np.intp], distance: Stamps) -> None:
    """Leave each partner to the nearest of those who claim it."""
    owner: dict[int, int] = {}
    for k in np.flatnonzero(result >= 0).tolist():
        rival = owner.get(int(result[k]))
        if rival is None or distance[k] < distance[rival]:
            if rival is not None:
                result[rival] = -1
            owner[int(result[k])] = k
        else:
            result[k] = -1


def _chain(stamps: Stamps, period: float) -> list[int]:
    kept = [0]
    while True:
        last = kept[-1]
        if last + 1 >= len(stamps):
            return kept
        target = stamps[last] + period
        right = max(int(np.searchsorted(stamps, target)), last + 1)
        left = right - 1
        # Before a gap or the end, or for a dropped frame, a frame much too early isn't taken instead.
        early = target - stamps[left] if left > last else np.inf
        late = stamps[right] - target if right < len(stamps) else np.inf
        if early <= min(late, _EARLY * period):
            kept.append(left)
        elif right < len(stamps):
            kept.append(right)
        else:
            return kept


def _grid(stamps: Stamps, period: float) -> npt.NDArray[np.intp]:
    ticks = np.rint((stamps - stamps[0]) / period)
    distance = np.abs(stamps - stamps[0] - ticks * period)
    order = np.lexsort((distance, ticks))
    _, first = np.unique(ticks[order], return_index=True)
    kept: npt.NDArray[np.intp] = np.sort(order[first])
    return kept
