# SPDX-License-Identifier: Apache-2.0
"""The room: a closed box full of axis-aligned boxes, and the rays that meet them.

Surfaces are faces of boxes, so a ray's distance is exact to float32 (slab test, Kay and Kajiya 1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic.streams import stream
from slamhive.data.synthetic.trajectory import SEMI_AXES

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]
    Floats = npt.NDArray[np.float32]

CLEARANCE = 0.75
"""No obstacle comes nearer to the path than this, m."""
TINY = np.float32(1e-9)


@dataclass(frozen=True)
class Walkers:
    """People on ellipses around the world's origin, or to and fro on a line.

    Attributes:
        axes: `(k, 2)`, semi-axes along x and y, m.
        lane: `(k,)`, what is added to y, m.
        phase: `(k,)`, where they start, rad.
        rate: `(k,)`, rad/s.
    """

    axes: Array
    lane: Array
    phase: Array
    rate: Array

    def places(self, t: Array) -> Array:
        """Return their places, `(k, 2, n)`, at `(n,)` instants, s since the start of the recording."""
        angle = self.phase[:, None] + self.rate[:, None] * t
        x = self.axes[:, :1] * np.cos(angle)
        return np.stack([x, self.axes[:, 1:] * np.sin(angle) + self.lane[:, None]], axis=1)

    def moved(self, t: Array) -> Array:
        """Return their displacements from where they started, `(k, 3, n)`, m."""
        way = self.places(t) - self.places(np.zeros(1))
        return np.concatenate([way, np.zeros((len(way), 1, way.shape[2]))], axis=1)


@dataclass(frozen=True)
class World:
    """Box 0 is the room, seen from inside; the others stand, hang or are mounted in it.

    Attributes:
        lower: `(n, 3)`, least corner of each box, m.
        upper: `(n, 3)`, greatest corner of each box, m.
        walkers: The last boxes are people, at the start; None: nothing moves.
    """

    lower: Array
    upper: Array
    walkers: Walkers | None = None

    def at(self, t: float) -> World:
        """Give the world as it stands at an instant, s since the start of the recording."""
        if self.walkers is None:
            return self
        way = self.walkers.moved(np.array([t]))[:, :, 0]
        shift = np.concatenate([np.zeros((len(self.lower) - len(way), 3)), way])
        return World(self.lower + shift, self.upper + shift)

    def cast(
        self, origins: Floats, directions: Floats, times: Array | None = None
    ) -> tuple[Floats, npt.NDArray[np.int32]]:
        """Find what each ray meets first.

        Args:
            origins: `(3, n)` or `(3, 1)`, inside the room and outside the boxes, m.
            directions: `(3, n)`, of any length but zero.
            times: `(n,)`, when each is cast, s since the start of the recording; None: at the start.

        Returns:
            `(n,)` distance in units of the direction's length, and `(n,)` face, which is
            6·box + 2·axis + (1 if upper).
        """
        inverse = np.float32(1.0) / away_from_zero(directions)
        low, high = self.lower.astype(np.float32), self.upper.astype(np.float32)
        start = -origins * inverse
        best, face = _leave(start, inverse, low[0], high[0])
        moving = self.walkers.moved(times) if self.walkers is not None and times is not None else ()
        still = len(low) - len(moving)
        for box in range(1, len(low)):
            shift = moving[box - still].astype(np.float32) if box >= still else np.float32(0.0)
            least, most = low[box, :, None] + shift, high[box, :, None] + shift
            one, two = least * inverse + start, most * inverse + start
            near, far = np.minimum(one, two).max(axis=0), np.maximum(one, two).min(axis=0)
            hit = np.flatnonzero((near <= far) & (near > 0.0) & (near < best))
            if hit.size:
                best[hit] = near[hit]
                sides = (side if side.shape[1] == 1 else side[:, hit] for side in (least, most))
                face[hit] = 6 * box + _entered(start[:, hit], inverse[:, hit], *sides)
        return best, face

    def distance(self, points: Array) -> Array:
        """Measure how far points are from the nearest surface.

        Args:
            points: `(n, 3)`, m.

        Returns:
            `(n,)`, m, not negative.
        """
        result = np.full(len(points), np.inf)
        for low, high in zip(self.lower, self.upper, strict=True):
            beyond = np.maximum(np.maximum(low - points, points - high), 0.0)
            inside = np.minimum(points - low, high - points).min(axis=1)
            result = np.minimum(result, np.where(inside > 0.0, inside, np.linalg.norm(beyond, axis=1)))
        return result


def away_from_zero(directions: Floats) -> Floats:
    """Replace components that are nearly zero: a ray parallel to an axis has no finite inverse."""
    return np.where(np.abs(directions) < TINY, TINY, directions)


def _leave(start: Floats, inverse: Floats, low: Floats, high: Floats) -> tuple[Floats, npt.NDArray[np.int32]]:
    """Find where rays that start inside a box leave it."""
    one, two = low[:, None] * inverse + start, high[:, None] * inverse + start
    leave = np.maximum(one, two)
    axis = np.argmin(leave, axis=0)
    rays = np.arange(leave.shape[1])
    return leave[axis, rays], (2 * axis + (inverse[axis, rays] > 0.0)).astype(np.int32)


def _entered(start: Floats, inverse: Floats, low: Floats, high: Floats) -> npt.NDArray[np.int32]:
    """Find by which of a box's six faces rays enter it."""
    enter = np.minimum(low * inverse + start, high * inverse + start)
    axis = np.argmax(enter, axis=0)
    upper = inverse[axis, np.arange(enter.shape[1])] < 0.0
    return np.asarray(2 * axis + upper, dtype=np.int32)


def build_world(seed: int) -> World:
    """Furnish a room around the path: pillars, crates, lamps and shelves at 1 to 8 m."""
    rng = stream(seed, "world")
    half = np.array([9.2, 6.8]) + rng.uniform(-0.4, 0.4, 2)
    height = rng.uniform(4.0, 4.5)
    boxes = [(np.array([-half[0], -half[1], 0.0]), np.array([half[0], half[1], height]))]
    boxes += _scatter(rng, half, 10, lambda: (rng.uniform(0.3, 0.7, 2), 0.0, height))
    boxes += _scatter(rng, half, 12, lambda: (rng.uniform(0.4, 1.3, 2), 0.0, rng.uniform(0.4, 1.2)))
    boxes += _scatter(rng, half, 8, lambda: (rng.uniform(0.3, 1.5, 2), 0.0, rng.uniform(1.2, 2.4)))
    boxes += _scatter(
        rng, half, 5, lambda: (rng.uniform(0.4, 1.4, 2), height - rng.uniform(0.6, 1.9), height)
    )
    # Inside the lap, where the cameras look: without these a monocular algorithm sees far walls alone, and
    # any nearer they would fill its view.
    inner, far = half * 0.55, CLEARANCE + 0.7
    boxes += _scatter(rng, inner, 4, lambda: (rng.uniform(0.25, 0.5, 2), 0.0, height), far)
    boxes += _scatter(rng, inner, 6, lambda: (rng.uniform(0.3, 0.9, 2), 0.0, rng.uniform(0.7, 2.0)), far)
    boxes += [_mounted(rng, half, height) for _ in range(14)]
    low, high = (np.array(side) for side in zip(*boxes, strict=True))
    return World(low, high)


def _scatter(
    rng: np.random.Generator,
    half: Array,
    count: int,
    draw: Callable[[], tuple[Array, float, float]],
    clearance: float = CLEARANCE,
) -> list[tuple[Array, Array]]:
    """Place boxes of drawn size and height range where they leave the path free."""
    phi = np.linspace(0.0, 2.0 * np.pi, 400)
    path = np.stack([SEMI_AXES[0] * np.cos(phi), SEMI_AXES[1] * np.sin(phi)], axis=1)
    placed: list[tuple[Array, Array]] = []
    while len(placed) < count:
        size, bottom, top = draw()
        centre = rng.uniform(-half + size / 2 + 0.1, half - size / 2 - 0.1)
        gap = np.maximum(np.abs(path - centre) - size / 2, 0.0)
        if np.linalg.norm(gap, axis=1).min() >= clearance:
            placed.append((np.append(centre - size / 2, bottom), np.append(centre + size / 2, top)))
    return placed


def _mounted(rng: np.random.Generator, half: Array, height: float) -> tuple[Array, Array]:
    """Mount a box on a wall; its back lies inside the wall, where nothing sees it."""
    along, side = int(rng.integers(2)), rng.choice([-1.0, 1.0])
    across = 1 - along
    width, depth = rng.uniform(0.6, 2.2), rng.uniform(0.15, 0.6)
    bottom = rng.uniform(0.0, height - 1.2)
    low, high = np.empty(3), np.empty(3)
    low[along] = rng.uniform(-half[along], half[along] - width)
    high[along] = low[along] + width
    low[across], high[across] = sorted([side * (half[across] - depth), side * (half[across] + 0.1)])
    low[2], high[2] = bottom, bottom + rng.uniform(0.4, 1.2)
    return low, high
