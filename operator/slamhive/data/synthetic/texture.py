# SPDX-License-Identifier: Apache-2.0
"""The surfaces' textures: block noise at many scales, so that corners are found near and far.

All faces share one image, with its smaller copies (mip levels, Williams 1983) beside it, so that a whole view
is textured by one look-up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from slamhive.data.synthetic.streams import stream

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.data.synthetic.world import World

    Floats = npt.NDArray[np.float32]
    Bytes = npt.NDArray[np.uint8]

TEXEL = 0.008
"""Size of a texel, m."""
LEVELS = 6
GUTTER = 16
"""Texels of margin around each face, so that smaller copies don't mix neighbours."""
WIDTH = 4096

_SCALES = ((60, 0.30), (25, 0.38), (11, 0.12), (5, 0.06), (2, 0.03))
"""Block sizes in texels and their contrast. Strong blocks are 20 cm and more, so that an image holds about as
many strong corners as a feature extractor takes: with fine ones, each frame would choose others."""
_SHADE = (0.78, 0.90, 0.84, 1.0, 0.66, 1.08)
"""Brightness of faces looking to -x, +x, -y, +y, -z, +z."""


@dataclass(frozen=True)
class Atlas:
    """Textures of all faces of a world.

    Attributes:
        image: `(h, w, 3)`, RGB, level 0 at the left, the smaller ones in a column at its right.
        offset: `(2, n)`, texel of each face's least corner at level 0.
        level_offset: `(2, LEVELS)`, texel where each level starts.
    """

    image: Bytes
    offset: Floats
    level_offset: Floats

    def grey(self) -> Atlas:
        """Give the same textures in grey, `(h, w)`."""
        return Atlas(
            cv2.cvtColor(self.image, cv2.COLOR_RGB2GRAY).astype(np.uint8), self.offset, self.level_offset
        )

    def sample(self, face: npt.NDArray[np.int32], u: Floats, v: Floats, level: Floats) -> Floats:
        """Look colours up, bilinear in a level and linear between two.

        Args:
            face: `(n,)`.
            u: `(n,)`, along the face's first axis, m from its least corner.
            v: `(n,)`, along its second axis.
            level: `(n,)`, log2 of the texels that a pixel covers.

        Returns:
            `(n,)` or `(n, 3)`, 0 to 255.
        """
        x = u * np.float32(1.0 / TEXEL) + self.offset[0].take(face)
        y = v * np.float32(1.0 / TEXEL) + self.offset[1].take(face)
        level = np.clip(level, np.float32(0.0), np.float32(LEVELS - 1.001))
        lower = level.astype(np.int32)
        fine, coarse = (self._look_up(x, y, number) for number in (lower, lower + 1))
        share = level - lower.astype(np.float32)
        if self.image.ndim == 3:
            share = share[:, None]
        return np.asarray(fine + (coarse - fine) * share)

    def _look_up(self, x: Floats, y: Floats, level: npt.NDArray[np.int32]) -> Floats:
        scale = np.float32(0.5) ** np.arange(LEVELS, dtype=np.float32)
        size = scale.take(level)
        count, columns = len(x), 1024
        rows = -(-count // columns)
        maps = np.zeros((2, rows * columns), dtype=np.float32)
        maps[0, :count] = x * size + self.level_offset[0].take(level)
        maps[1, :count] = y * size + self.level_offset[1].take(level)
        maps -= np.float32(0.5)
        across, down = maps.reshape(2, rows, columns)
        found = cv2.remap(self.image, across, down, cv2.INTER_LINEAR)
        return np.asarray(found.reshape(rows * columns, *self.image.shape[2:])[:count], dtype=np.float32)


def build_atlas(world: World, seed: int) -> Atlas:
    """Paint all faces of a world and pack them into one image."""
    sizes = [_texels(world, face) for face in range(6 * len(world.lower))]
    places, height = _pack(sizes)
    image = np.zeros((height, WIDTH, 3), dtype=np.uint8)
    for face, ((width, rows), (left, top)) in enumerate(zip(sizes, places, strict=True)):
        painted = _paint(width, rows, stream(seed, "texture", face), _SHADE[face % 6])
        image[top : top + rows + 2 * GUTTER, left : left + width + 2 * GUTTER] = cv2.copyMakeBorder(
            painted, GUTTER, GUTTER, GUTTER, GUTTER, cv2.BORDER_REPLICATE
        )
    offset = np.array(places, dtype=np.float32).T + GUTTER
    return _with_levels(image, offset)


def face_axes(face: int) -> tuple[int, int, int]:
    """Give a face's normal axis and the axes of its texture's u and v."""
    axis = face % 6 // 2
    return axis, int(axis == 0), 1 if axis == 2 else 2


def _texels(world: World, face: int) -> tuple[int, int]:
    _, u, v = face_axes(face)
    extent = (world.upper - world.lower)[face // 6]
    return int(np.ceil(extent[u] / TEXEL)), int(np.ceil(extent[v] / TEXEL))


def _pack(sizes: list[tuple[int, int]]) -> tuple[list[tuple[int, int]], int]:
    """Place rectangles on shelves, the highest first, aligned so that levels halve evenly."""
    step = 2 ** (LEVELS - 1)
    places = [(0, 0)] * len(sizes)
    left = top = shelf = 0
    for index in sorted(range(len(sizes)), key=lambda i: (-sizes[i][1], i)):
        width, height = (-(-(size + 2 * GUTTER) // step) * step for size in sizes[index])
        if left + width > WIDTH:
            left, top, shelf = 0, top + shelf, 0
        places[index] = (left, top)
        left, shelf = left + width, max(shelf, height)
    return places, top + shelf


def _with_levels(image: Bytes, offset: Floats) -> Atlas:
    height, width = image.shape[:2]
    whole = np.zeros((height, width + width // 2, 3), dtype=np.uint8)
    whole[:, :width] = image
    starts = [(0, 0)]
    level, top = image, 0
    for _ in range(1, LEVELS):
        half = (level.shape[1] // 2, level.shape[0] // 2)
        level = cv2.resize(level, half, interpolation=cv2.INTER_AREA).astype(np.uint8)
        whole[top : top + level.shape[0], width : width + level.shape[1]] = level
        starts.append((width, top))
        top += level.shape[0]
    return Atlas(whole, offset, np.array(starts, dtype=np.float32).T)


def _paint(width: int, height: int, rng: np.random.Generator, shade: float) -> Bytes:
    """Paint one face: a tint, blocks of five sizes, and rectangles like posters and labels."""
    tint = 95.0 + 60.0 * rng.random(3)
    tone = np.zeros((height, width), dtype=np.float32)
    for size, contrast in _SCALES:
        rows, columns = height // size + 2, width // size + 2
        blocks = rng.uniform(-1.0, 1.0, (rows, columns)).astype(np.float32) * np.float32(contrast)
        wide = cv2.resize(blocks, (columns * size, rows * size), interpolation=cv2.INTER_NEAREST)
        dy, dx = rng.integers(0, size, 2)
        tone += wide[dy : dy + height, dx : dx + width]
    pattern = (1.0 + tone)[..., None] * (tint * shade).astype(np.float32)
    image: Bytes = np.clip(pattern, 4.0, 251.0).astype(np.uint8)
    for _ in range(round(width * height * TEXEL**2 * 2.5) + 1):
        extent = (rng.uniform(0.04, 0.4, 2) / TEXEL).astype(int)
        corner = (rng.uniform(0.0, 1.0, 2) * (width, height)).astype(int)
        color = (rng.uniform(20.0, 235.0, 3) * shade).tolist()
        low, high = corner.tolist(), (corner + extent).tolist()
        cv2.rectangle(image, low, high, color, thickness=cv2.FILLED if rng.random() < 0.6 else 3)
    return image
