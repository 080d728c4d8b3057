# SPDX-License-Identifier: Apache-2.0
"""Lenses: by iteration, from pixels to rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

ITERATIONS = 25
"""Steps of the fixed-point iteration; each gains about a digit with the lenses in use."""


@dataclass(frozen=True)
class Lens:
    """Pinhole with radial-tangential distortion (Brown 1966), as OpenCV has it: pixel centres are integers.

    Attributes:
        width: Columns, pixels.
        height: Rows, pixels.
        matrix: `(3, 3)`, K.
        coefficients: `(5,)`, k1, k2, p1, p2, k3.
    """

    width: int
    height: int
    matrix: Array
    coefficients: Array

    def scaled(self, scale: float) -> Lens:
        """Give the same lens on an image of another size; the size is rounded, the intrinsics follow it."""
        width, height = max(1, round(self.width * scale)), max(1, round(self.height * scale))
        return Lens(
            width,
            height,
            scale_matrix(self.matrix, width / self.width, height / self.height),
            self.coefficients,
        )

    def rays(self, pixels: Array) -> Array:
        """Give the direction that a pixel looks in.

        Args:
            pixels: `(n, 2)`.

        Returns:
            `(n, 3)`, in the optical frame, with z = 1, so that a length along it is a depth.
        """
        bent = ((pixels - self.matrix[:2, 2]) / np.diag(self.matrix)[:2]).T
        straight = bent.copy()
        for _ in range(ITERATIONS):
            radial, tangential = self._terms(straight)
            straight = (bent - tangential) / radial
        return np.stack([*straight, np.ones(len(pixels))], axis=1)

    def _terms(self, xy: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3 = self.coefficients
        x, y = xy
        r2 = x * x + y * y
        tangential = np.stack(
            [2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]
        )
        return 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), tangential


def scale_matrix(matrix: Array, sx: float, sy: float) -> Array:
    """Scale K `(3, 3)` or P `(3, 4)`: f' = f·s, Tx' = Tx·s, c' = (c + 0.5)·s - 0.5."""
    result = matrix.copy()
    for row, s in ((0, sx), (1, sy)):
        result[row] *= s
        result[row, 2] += 0.5 * s - 0.5
    return result
