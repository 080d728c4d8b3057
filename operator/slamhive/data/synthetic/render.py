# SPDX-License-Identifier: Apache-2.0
"""Views of the world through a lens: for each pixel the face it sees, its depth and its colour.

Only faces that look at the camera are tested, each only in the part of the image where it can be; pixels at
outlines are sampled four times, so that edges are smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic.texture import TEXEL
from slamhive.data.synthetic.world import away_from_zero

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from slamhive.data.synthetic.optics import Lens
    from slamhive.data.synthetic.texture import Atlas
    from slamhive.data.synthetic.world import World

    Array = npt.NDArray[np.float64]
    Floats = npt.NDArray[np.float32]
    Ints = npt.NDArray[np.int32]

NEAR = 0.05
"""Nothing is nearer to a camera than this, m."""
SEAM = np.float32(1e-4)
"""Faces reach this much over their edges, so that rounding opens no seam between two, m."""

_U = np.array([1, 0, 0], dtype=np.intp)
_V = np.array([2, 2, 1], dtype=np.intp)


@dataclass(frozen=True)
class View:
    """View of a camera from one pose: for each pixel the face that it sees, and its depth.

    Attributes:
        face: `(height, width)`, number of the face.
        depth: `(height, width)`, along the optical axis, m.
        origin: `(3,)`, the camera's centre in the world.
        rotation: `(3, 3)`, camera to world.
        at: When, s since the start of the recording.
    """

    face: Ints
    depth: Floats
    origin: Floats
    rotation: Floats
    at: float = 0.0


class WorldRenderer:
    """Renders one world through one lens."""

    def __init__(self, lens: Lens, world: World, atlas: Atlas) -> None:
        self._lens, self._atlas = lens, atlas
        rows, columns = np.mgrid[0 : lens.height, 0 : lens.width].reshape(2, -1).astype(np.float64)
        centres = np.stack([columns, rows], axis=1)
        self._rays = lens.rays(centres).T.astype(np.float32)
        corners = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)]
        self._subrays = np.stack([lens.rays(centres + shift).T for shift in corners]).astype(np.float32)
        x, y = (self._rays[i].reshape(lens.height, lens.width) for i in (0, 1))
        self._columns = x.min(axis=0) - np.float32(1e-4), x.max(axis=0) + np.float32(1e-4)
        self._rows = y.min(axis=1) - np.float32(1e-4), y.max(axis=1) + np.float32(1e-4)
        self._world = world
        self._place(0.0)

    def _place(self, at: float) -> None:
        """Put the faces where they are at an instant."""
        self._at, world = at, self._world.at(at)
        self._bounds = np.stack([world.lower, world.upper], axis=2)
        faces = np.arange(6 * len(world.lower))
        box, axis, side = faces // 6, faces % 6 // 2, faces % 2
        self._plane = self._bounds[box, axis, side].astype(np.float32)
        self._low = np.stack([self._bounds[box, a[axis], 0] for a in (_U, _V)]).astype(np.float32)
        self._high = np.stack([self._bounds[box, a[axis], 1] for a in (_U, _V)]).astype(np.float32)
        self._axis = axis
        self._corners = np.empty((len(faces), 4, 3))
        for i, (u, v) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            self._corners[faces, i, axis] = self._plane
            self._corners[faces, i, _U[axis]] = (self._low, self._high)[u][0]
            self._corners[faces, i, _V[axis]] = (self._low, self._high)[v][1]

    def view(self, pose: Array, at: float = 0.0) -> View:
        """Find what each pixel's centre sees.

        Args:
            pose: `(4, 4)`, T_world_camera.
            at: When, s since the start of the recording.
        """
        self._follow(at)
        shape = (self._lens.height, self._lens.width)
        rotation, origin = pose[:3, :3].astype(np.float32), pose[:3, 3].astype(np.float32)
        directions = away_from_zero(rotation @ self._rays).reshape(3, *shape)
        inverse = np.float32(1.0) / directions
        depth, face = self._room(origin, inverse)
        for number, window in self._windows(self._facing(pose[:3, 3]), pose):
            axis = self._axis[number]
            reach = (self._plane[number] - origin[axis]) * inverse[axis][window]
            seen = (reach > 0.0) & (reach < depth[window])
            for i, a in enumerate((_U[axis], _V[axis])):
                where = reach * directions[a][window] + origin[a]
                seen &= (where >= self._low[i, number] - SEAM) & (where <= self._high[i, number] + SEAM)
            np.copyto(depth[window], reach, where=seen)
            np.copyto(face[window], np.int32(number), where=seen)
        return View(face, depth, origin, rotation, at)

    def colors(self, view: View) -> Floats:
        """Colour a view: `(height, width)` or `(height, width, 3)`, 0 to 255."""
        self._follow(view.at)
        directions = view.rotation @ self._rays
        face = view.face.reshape(-1)
        flat = self._shade(face, view.depth.reshape(-1), directions, view.origin)
        edge = np.flatnonzero(_outlines(view.face))
        if edge.size:
            flat[edge] = self._supersample(view, edge)
        return flat.reshape(*view.face.shape, *flat.shape[1:])

    def _follow(self, at: float) -> None:
        if self._world.walkers is not None and at != self._at:
            self._place(at)

    def _room(self, origin: Floats, inverse: Floats) -> tuple[Floats, Ints]:
        """Meet the room's own six faces, of which the nearest in front is seen."""
        shape = inverse.shape[1:]
        depth = np.full(shape, np.float32(np.inf))
        face = np.zeros(shape, dtype=np.int32)
        for axis in range(3):
            ahead = inverse[axis] > 0.0
            lower, upper = (self._plane[2 * axis + side] - origin[axis] for side in (0, 1))
            reach = np.where(ahead, upper, lower) * inverse[axis]
            nearer = reach < depth
            np.copyto(depth, reach, where=nearer)
            np.copyto(face, 2 * axis + ahead.astype(np.int32), where=nearer)
        return depth, face

    def _facing(self, origin: Array) -> Ints:
        """List the faces of boxes that look towards a point."""
        below, above = origin < self._bounds[1:, :, 0], origin > self._bounds[1:, :, 1]
        return np.flatnonzero(np.stack([below, above], axis=2).reshape(-1)).astype(np.int32) + 6

    def _windows(self, faces: Ints, pose: Array) -> Iterator[tuple[int, tuple[slice, slice]]]:
        """Bound the rows and columns in which faces can be seen; those that nowhere can are left out."""
        corners = (self._corners[faces] - pose[:3, 3]) @ pose[:3, :3]
        ahead = corners[:, :, 2] >= NEAR
        whole, some = ahead.all(axis=1), ahead.any(axis=1)
        lower, upper = np.full((len(faces), 2), np.inf), np.full((len(faces), 2), -np.inf)
        flat = corners[whole, :, :2] / corners[whole, :, 2:]
        lower[whole], upper[whole] = flat.min(axis=1), flat.max(axis=1)
        for index in np.flatnonzero(some & ~whole):
            front = _in_front(corners[index])
            cut = front[:, :2] / front[:, 2:]
            lower[index], upper[index] = cut.min(axis=0), cut.max(axis=0)
        columns = (self._columns[1] >= lower[:, :1]) & (self._columns[0] <= upper[:, :1])
        rows = (self._rows[1] >= lower[:, 1:]) & (self._rows[0] <= upper[:, 1:])
        spans = [
            np.stack([mask.argmax(axis=1), mask.shape[1] - mask[:, ::-1].argmax(axis=1)], axis=1).tolist()
            for mask in (rows, columns)
        ]
        for index in np.flatnonzero(columns.any(axis=1) & rows.any(axis=1)):
            yield int(faces[index]), (slice(*spans[0][index]), slice(*spans[1][index]))

    def _shade(self, face: Ints, depth: Floats, directions: Floats, origin: Floats) -> Floats:
        """Colour rays `(3, n)` that meet known faces at known depths."""
        axis = self._axis.take(face)
        rays = np.arange(len(face))
        across, up = _U.take(axis), _V.take(axis)
        u = origin.take(across) + depth * directions[across, rays] - self._low[0].take(face)
        v = origin.take(up) + depth * directions[up, rays] - self._low[1].take(face)
        # A pixel covers (depth / f)² / |n·d| of a face with normal n; d is 1 long along the optical axis.
        texels = depth * np.float32(1.0 / (TEXEL * self._lens.matrix[0, 0]))
        tilt = np.maximum(np.abs(directions[axis, rays]), np.float32(1e-3))
        level = np.log2(np.maximum(texels, np.float32(1e-3))) - np.float32(0.5) * np.log2(tilt)
        return self._atlas.sample(face, u, v, level)

    def _supersample(self, view: View, edge: npt.NDArray[np.intp]) -> Floats:
        """Average four rays a pixel where faces meet; each may see what the pixel or a neighbour sees."""
        height, width = view.face.shape
        rows, columns = edge // width, edge % width
        around = [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)]
        candidates = np.stack(
            [
                view.face[np.clip(rows + i, 0, height - 1), np.clip(columns + j, 0, width - 1)]
                for i, j in around
            ]
        )
        found = []
        for rays in self._subrays:
            directions = away_from_zero(view.rotation @ rays[:, edge])
            face, depth = self._nearest(candidates, directions, view.origin)
            found.append(self._shade(face, depth, directions, view.origin))
        return np.asarray(np.mean(found, axis=0), dtype=np.float32)

    def _nearest(self, candidates: Ints, directions: Floats, origin: Floats) -> tuple[Ints, Floats]:
        """Choose for each ray `(3, n)` the nearest of its candidate faces `(k, n)` that it meets."""
        rays = np.arange(candidates.shape[1])
        best_face, best = candidates[0].copy(), np.full(len(rays), np.float32(np.inf))
        for face in candidates:
            axis = self._axis.take(face)
            reach = (self._plane.take(face) - origin.take(axis)) / directions[axis, rays]
            meets = (reach > 0.0) & (reach < best)
            for i, other in enumerate((_U.take(axis), _V.take(axis))):
                where = reach * directions[other, rays] + origin.take(other)
                meets &= (where >= self._low[i].take(face) - SEAM) & (
                    where <= self._high[i].take(face) + SEAM
                )
            np.copyto(best, reach, where=meets)
            np.copyto(best_face, face, where=meets)
        missed = np.isinf(best)
        axis = self._axis.take(best_face)
        plane = (self._plane.take(best_face) - origin.take(axis)) / directions[axis, rays]
        return best_face, np.where(missed, plane, best)


def _outlines(face: Ints) -> npt.NDArray[np.bool_]:
    """Mark pixels beside which another face is seen."""
    result = np.zeros(face.shape, dtype=bool)
    beside, below = face[:, 1:] != face[:, :-1], face[1:] != face[:-1]
    result[:, 1:] |= beside
    result[:, :-1] |= beside
    result[1:] |= below
    result[:-1] |= below
    return result


def _in_front(polygon: Array) -> Array:
    """Cut a polygon `(n, 3)` at the plane z = NEAR (Sutherland and Hodgman 1974)."""
    kept: list[Array] = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[2] >= NEAR:
            kept.append(a)
        if (a[2] >= NEAR) != (b[2] >= NEAR):
            kept.append(a + (b - a) * ((NEAR - a[2]) / (b[2] - a[2])))
    return np.array(kept).reshape(-1, 3)
