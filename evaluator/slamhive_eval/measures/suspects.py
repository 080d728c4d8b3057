# SPDX-License-Identifier: Apache-2.0
"""Suspect stretches of ground truth: where different systems agree with each other and not with the truth.

Systems that share no code err in ways of their own. Where all of them lie beside the truth in the same
direction and by the same distance, the truth is the likelier one to be wrong there; a fault of a sensor that
all of them use, such as a wrong calibration, looks alike.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.alignment import align
from slamhive_eval.association import interpolate
from slamhive_eval.errors import AssociationError, OptionError
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from slamhive_eval.alignment import Method
    from slamhive_eval.rotation import FloatArray

LEAST_SYSTEMS = 3
"""Systems that must agree: two may share a fault by chance."""
LEAST_RATIO = 4.0
"""Distance of their mean from the truth, in standard errors of that mean, from which a stretch is suspect."""
LEAST_SHARE = 3.0
"""The same distance, in typical errors of the systems over all of the path: a stretch stands out."""
LEAST_METRES = 0.01
_MOST_INSTANTS = 2000
_JOINED_SECONDS = 0.5
_MOST_GAP_SECONDS = 0.5
_ROUNDS = 20
_LEAST_INSTANTS = 10
_MOST_DRAWN = 400


@dataclass(frozen=True, eq=False)
class SystemEstimate:
    """An estimate of a system.

    Attributes:
        poses: On the truth's clock, and of its frame.
        is_scaled: Whether it is aligned with a scale, as it has none of its own.
    """

    poses: Trajectory
    is_scaled: bool = False


@dataclass(frozen=True)
class SuspectStretch:
    """A stretch of time in which the systems agree with each other and not with the ground truth.

    Attributes:
        begin: Stamp of its begin in s.
        end: Stamp of its end in s.
        metres: Largest distance of the systems' mean from the truth.
        direction: Unit vector from the truth to that mean there, in the truth's world, shape (3,).
        spread: Standard deviation of a system from that mean there, m.
        ratio: That distance in standard errors of the mean.
    """

    begin: float
    end: float
    metres: float
    direction: tuple[float, float, float]
    spread: float
    ratio: float


@dataclass(frozen=True)
class Suspicion:
    """Stretches of a ground truth that systems contradict together.

    Attributes:
        systems: Names of the systems that were compared.
        instants: Number of stamps of the truth at which three of them or more have poses.
        seconds: Time between the first of these and the last.
        stretches: The stretches, in the order of time.
        rmse: RMSE of each system's mean path over all instants, aligned to those outside, m.
        rmse_without: The same over the instants outside of the stretches, m.
        limit: Distance from the truth below which no instant is suspect, m: a multiple of the typical error
            of the systems, and no less than a centimetre.
        profile: At some 400 of the instants at most, those of the largest distance: stamp in s, distance of
            the systems' mean from the truth and standard error of that mean, m.
    """

    systems: tuple[str, ...]
    instants: int
    seconds: float
    stretches: tuple[SuspectStretch, ...]
    rmse: Mapping[str, float]
    rmse_without: Mapping[str, float]
    limit: float
    profile: tuple[tuple[float, float, float], ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data; None for the RMSE of a system without any pose there."""
        told = asdict(self)
        told["rmseWithout"] = told.pop("rmse_without")
        for name in ("rmse", "rmseWithout"):
            told[name] = {one: None if np.isnan(value) else value for one, value in told[name].items()}
        return told


def find_suspects(truth: Trajectory, systems: Mapping[str, Sequence[SystemEstimate]]) -> Suspicion:
    """Return the stretches in which systems agree with each other and not with the truth.

    Each estimate is laid onto the truth by what fits: alignment and inliers by turns, so that a stretch that
    is wrong doesn't turn the rest. A system is the mean of its estimates.

    Args:
        truth: Ground truth.
        systems: Estimates by system; systems share no code.

    Raises:
        OptionError: There are fewer than three systems.
        AssociationError: They have no time in common.
    """
    names = sorted(name for name, ones in systems.items() if ones)
    if len(names) < LEAST_SYSTEMS:
        raise OptionError(
            f"systems: {len(names)} with a trajectory, at least {LEAST_SYSTEMS} must be compared: two agree "
            "by chance"
        )
    stamps = truth.stamps[:: max(1, len(truth) // _MOST_INSTANTS)]
    reference = Trajectory(stamps, *interpolate(truth, stamps, np.inf)[1:])
    errors = np.full((len(names), len(stamps), 3), np.nan)
    for row, name in enumerate(names):
        each = np.array([_errors(reference, one) for one in systems[name]])
        known = np.isfinite(each[..., 0])
        # A system is the mean of those of its estimates that have a pose.
        errors[row] = np.where(known[..., np.newaxis], each, 0.0).sum(axis=0)
        errors[row] /= np.where(known.any(axis=0), known.sum(axis=0), np.nan)[:, np.newaxis]
    there = np.isfinite(errors[..., 0]).sum(axis=0) >= LEAST_SYSTEMS
    if there.sum() < _LEAST_INSTANTS:
        raise AssociationError(
            f"{LEAST_SYSTEMS} systems have poses at {there.sum()} stamps of the ground truth in common, at "
            f"least {_LEAST_INSTANTS} are needed"
        )
    return _judged(names, stamps[there], errors[:, there])


def _errors(truth: Trajectory, given: SystemEstimate) -> FloatArray:
    """Return an estimate's position errors, m, shape (n, 3), laid onto the truth by what fits best.

    NaN where it has no pose. Iteratively reweighted least squares with the weights of Geman and McClure
    (1985): what lies far off counts next to nothing.
    """
    errors = np.full((len(truth), 3), np.nan)
    there, positions, quaternions = interpolate(given.poses, truth.stamps, _MOST_GAP_SECONDS)
    used = np.flatnonzero(there)
    if used.size < _LEAST_INSTANTS:
        return errors
    reference = truth.select(used)
    estimate = Trajectory(reference.stamps, positions[used], quaternions[used])
    weights = np.ones(len(used))
    method: Method = "sim3" if given.is_scaled else "se3"
    for _ in range(_ROUNDS):
        laid = align(reference, estimate, method, weights=weights).apply(estimate)
        errors[used] = laid.positions - reference.positions
        squares = np.sum(errors[used] ** 2, axis=1)
        typical = float(np.median(squares)) or 1e-12
        weights = (typical / (typical + squares)) ** 2
    return errors


def _judged(names: list[str], stamps: FloatArray, errors: FloatArray) -> Suspicion:
    """Return the suspects of errors of systems, shape (k, n, 3), NaN where one has no pose."""
    count = np.isfinite(errors[..., 0]).sum(axis=0)
    together = np.nanmean(errors, axis=0)
    away = np.linalg.norm(together, axis=1)
    spread = np.sqrt(np.nansum((errors - together) ** 2, axis=(0, 2)) / (count - 1))
    squares = np.sum(errors**2, axis=2)
    typical = float(np.sqrt(np.nanmedian(squares)))
    unsure = np.maximum(spread / np.sqrt(count), 1e-9)
    ratio, limit = away / unsure, max(LEAST_SHARE * typical, LEAST_METRES)
    odd = (ratio > LEAST_RATIO) & (away > limit)
    # The worst of each few, so that no short stretch is lost in the picture.
    pieces = np.array_split(np.arange(len(stamps)), min(len(stamps), _MOST_DRAWN))
    drawn = [piece[np.argmax(away[piece])] for piece in pieces]
    stretches = []
    for first, last in _spans(stamps, odd):
        worst = first + int(np.argmax(away[first : last + 1]))
        x, y, z = (together[worst] / away[worst]).tolist()
        stretches.append(
            SuspectStretch(
                begin=float(stamps[first]),
                end=float(stamps[last]),
                metres=float(away[worst]),
                direction=(x, y, z),
                spread=float(spread[worst]),
                ratio=float(ratio[worst]),
            )
        )
    return Suspicion(
        systems=tuple(names),
        instants=len(stamps),
        seconds=float(stamps[-1] - stamps[0]),
        stretches=tuple(stretches),
        rmse=_roots(names, squares),
        rmse_without=_roots(names, squares[:, ~odd]),
        limit=limit,
        profile=tuple(zip(stamps[drawn].tolist(), away[drawn].tolist(), unsure[drawn].tolist(), strict=True)),
    )


def _roots(names: list[str], squares: FloatArray) -> dict[str, float]:
    """Return the root of each system's mean square, NaN for one without any."""
    known = np.isfinite(squares)
    sums = np.where(known, squares, 0.0).sum(axis=1)
    counts = np.where(known.any(axis=1), known.sum(axis=1), np.nan)
    return dict(zip(names, np.sqrt(sums / counts).tolist(), strict=True))


def _spans(stamps: FloatArray, odd: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of each stretch; those half a second apart are one, an instant is none."""
    places = np.flatnonzero(odd)
    if not places.size:
        return []
    breaks = np.flatnonzero(np.diff(stamps[places]) > _JOINED_SECONDS)
    firsts, lasts = places[np.r_[0, breaks + 1]], places[np.r_[breaks, places.size - 1]]
    return [(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True) if b > a]
