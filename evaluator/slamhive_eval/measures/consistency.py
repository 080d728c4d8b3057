# SPDX-License-Identifier: Apache-2.0
"""Consistency of an estimator: the covariances that it states, compared with its errors.

NEES, the normalised estimation error squared eᵀ·P⁻¹·e, has the mean d for errors of d dimensions that
follow their covariance (Bar-Shalom et al. 2001, section 5.4; OpenVINS reports the same).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError
from slamhive_eval.statistics import Statistics, chi_square_quantile

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

Part = Literal["position", "rotation"]

SMALLEST_VARIANCE = 1e-24
"""(10⁻¹² m)², (10⁻¹² rad)²: less is rounding, or a program that knows nothing and says so oddly."""

SIGMAS = (1.0, 2.0, 3.0)
CHI_SQUARE_95 = {3: 7.814727903251179, 6: 12.591587243743977}
"""Limits that chi-square of 3 and of 6 degrees of freedom stays below in 95 %."""


@dataclass(frozen=True, eq=False)
class Consistency:
    """Errors beside what the covariances promise.

    Attributes:
        dimensions: 3 for positions or rotations alone, 6 for poses.
        errors: Position error in m, rotation vector in rad, or both, reference world, shape (n, d).
        sigmas: Standard deviations promised for each, shape (n, d).
        nees: eᵀ·P⁻¹·e, shape (k,), of the k poses whose covariance has an inverse.
        used: Which poses these are, shape (n,).
    """

    dimensions: int
    errors: FloatArray
    sigmas: FloatArray
    nees: FloatArray
    used: npt.NDArray[np.bool_]

    @property
    def within(self) -> dict[float, FloatArray]:
        """Share of the errors of each dimension within 1, 2 and 3 sigma, shape (d,) each."""
        errors, sigmas = np.abs(self.errors[self.used]), self.sigmas[self.used]
        return {k: np.mean(errors <= k * sigmas, axis=0) for k in SIGMAS if len(errors)}

    @property
    def bounds(self) -> tuple[float, float] | None:
        """Bounds that the mean NEES of consistent, independent errors stays within in 95 %; None of none.

        n times the mean is chi-square of n·d degrees (Bar-Shalom et al. 2001, section 5.4.2). Errors of
        one run follow one another: a mean a little outside proves nothing.
        """
        n = len(self.nees)
        if not n:
            return None
        low, high = (chi_square_quantile(share, n * self.dimensions) / n for share in (0.025, 0.975))
        return low, high

    def summary(self) -> dict[str, Any]:
        """The NEES alone, as plain JSON data; nothing but the count where no covariance has an inverse."""
        told: dict[str, Any] = {
            "count": len(self.nees),
            "withoutCovariance": int(np.count_nonzero(~self.used)),
        }
        if self.bounds is not None:
            mean = float(np.mean(self.nees))
            told["mean"] = mean if math.isfinite(mean) else None
            told["low"], told["high"] = self.bounds
            told["within95"] = float(np.mean(self.nees <= CHI_SQUARE_95[self.dimensions]))
        return told

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data; expectations of consistent Gaussian errors stand beside what was found."""
        statistics = Statistics.of(self.nees)
        inside = self.nees <= CHI_SQUARE_95[self.dimensions]
        return {
            "dimensions": self.dimensions,
            "count": len(self.nees),
            "withoutCovariance": int(np.count_nonzero(~self.used)),
            "anees": statistics.mean / self.dimensions if statistics else None,
            "nees": statistics.as_dict() if statistics else None,
            "neesExpected": float(self.dimensions),
            "neesMeanBounds": list(self.bounds) if self.bounds else None,
            "neesWithin95": float(np.mean(inside)) if len(inside) else None,
            "withinSigma": [
                {"sigma": k, "expected": math.erf(k / math.sqrt(2.0)), "shares": shares.tolist()}
                for k, shares in self.within.items()
            ],
        }


def measure_consistency(
    reference: Trajectory,
    estimate: Trajectory,
    covariances: FloatArray,
    turn: FloatArray | None = None,
    scale: float = 1.0,
    *,
    part: Part | None = None,
) -> Consistency:
    """Compare the errors of associated, aligned trajectories with the estimate's covariances.

    Poses whose covariance is zero, not finite or not positive definite are left out and counted: many
    programs publish zeros where they know nothing.

    Args:
        reference: n poses.
        estimate: n poses in the reference's world frame.
        covariances: Of positions in m², shape (n, 3, 3), or of poses in the order of
            PoseWithCovariance (x, y, z, rotation about fixed x, y, z in rad), shape (n, 6, 6); in the
            estimate's world frame.
        turn: R of the alignment, shape (3, 3), which turns the covariances into the reference's world; None
            where the estimate wasn't turned.
        scale: s of the alignment, which covariances of positions follow by s².
        part: Compare the ``position`` or the ``rotation`` alone, as OpenVINS does; None for all there is.

    Returns:
        The comparison.

    Raises:
        OptionError: Unequal numbers of poses or covariances of another shape, or of positions only for a
            rotation.
    """
    n = len(reference)
    d = covariances.shape[-1]
    if part == "rotation" and d == 3:
        raise OptionError("the covariances are of positions only")
    if len(estimate) != n or d not in (3, 6) or covariances.shape != (n, d, d):
        raise OptionError(
            f"consistency needs {n} estimated poses with covariances ({n}, 3, 3) or ({n}, 6, 6), "
            f"not {len(estimate)} with {covariances.shape}"
        )
    errors = estimate.positions - reference.positions
    if d == 6:
        off = rotation.multiply(estimate.quaternions, rotation.conjugate(reference.quaternions))
        errors = np.hstack((errors, _rotation_vector(off)))
    into_world = np.zeros((d, d))
    into_world[:3, :3] = scale * (np.eye(3) if turn is None else turn)
    if d == 6:
        into_world[3:, 3:] = into_world[:3, :3] / scale
    if part is not None and d == 6:
        chosen = slice(0, 3) if part == "position" else slice(3, 6)
        errors, covariances, d = errors[:, chosen], covariances[:, chosen, chosen], 3
        into_world = into_world[chosen, chosen]
    finite = np.logical_and.reduce(np.isfinite(covariances), axis=(1, 2))
    with np.errstate(all="ignore"):  # what overflows isn't finite, and not used
        turned = into_world @ np.where(finite[:, np.newaxis, np.newaxis], covariances, 0.0) @ into_world.T
        turned = (turned + turned.transpose(0, 2, 1)) / 2.0
    finite &= np.logical_and.reduce(np.isfinite(turned), axis=(1, 2))
    turned = np.where(finite[:, np.newaxis, np.newaxis], turned, 0.0)
    # Definiteness is judged on correlations: metres and radians differ by orders of magnitude.
    variances = np.einsum("nii->ni", turned)
    positive = finite & (variances > SMALLEST_VARIANCE).all(axis=1)
    sigmas = np.sqrt(np.where(variances > 0, variances, 0.0))
    safe = np.where(positive[:, np.newaxis], sigmas, 1.0)
    correlations = turned / (safe[:, :, np.newaxis] * safe[:, np.newaxis, :])
    used = positive & (np.linalg.eigvalsh(correlations)[:, 0] > 1e-12)
    normalised = (errors / safe)[used]
    solved = np.linalg.solve(correlations[used], normalised[:, :, np.newaxis])[:, :, 0]
    return Consistency(d, errors, sigmas, np.sum(normalised * solved, axis=1), used)


def _rotation_vector(q: FloatArray) -> FloatArray:
    """Axis times angle within [0, π], shape (n, 3)."""
    q = np.where(q[:, 3:] < 0, -q, q)
    sine = rotation.vector_norm(q)
    factor = np.where(sine > 1e-12, rotation.angle(q) / np.maximum(sine, 1e-12), 2.0)
    vector: FloatArray = q[:, :3] * factor[:, np.newaxis]
    return vector
