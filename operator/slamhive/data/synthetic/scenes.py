# SPDX-License-Identifier: Apache-2.0
"""Surroundings of a recording: the room, a corridor or an open field, and people who walk in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic.streams import stream
from slamhive.data.synthetic.trajectory import SEMI_AXES
from slamhive.data.synthetic.world import Walkers, World, build_world
from slamhive.model.synthetic import SyntheticScene

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.model.synthetic import SyntheticRecording

    Array = npt.NDArray[np.float64]
    Box = tuple[Array, Array]

CORRIDOR = (15.0, 1.8, 2.6)
"""Half of a corridor's length and width, and its height, m."""
FIELD = 250.0
"""Half of what there is of a field, m: its end is farther than any sensor reaches."""
_LANE = 1.4
"""Distance from a corridor's middle at which people walk, m."""
_PERSON = (0.45, 0.3)
"""Size of a person across, m."""


def build_scene(spec: SyntheticRecording) -> World:
    """Build what is around a recording's platform."""
    match spec.scene:
        case SyntheticScene.CORRIDOR:
            world = _corridor(stream(spec.seed, "corridor"))
        case SyntheticScene.FIELD:
            world = _field(stream(spec.seed, "field"))
        case _:
            world = build_world(spec.seed)
    return _peopled(world, spec) if spec.people else world


def _corridor(rng: np.random.Generator) -> World:
    """Build a corridor whose two walls have door frames, of which no two are as far apart."""
    length, width, height = CORRIDOR
    boxes = [(np.array([-length, -width, 0.0]), np.array([length, width, height]))]
    for side in (-1.0, 1.0):
        places = np.linspace(-length + 2.0, length - 3.0, 7) + rng.uniform(-1.2, 1.2, 7)
        for x in places:
            inner, outer = side * (width - rng.uniform(0.06, 0.14)), side * (width + 0.1)
            low, high = min(inner, outer), max(inner, outer)
            end = x + rng.uniform(0.9, 1.2)
            boxes.append((np.array([x, low, 0.0]), np.array([end, high, 2.1])))
    return _world(boxes)


def _field(rng: np.random.Generator) -> World:
    """Build even ground with trees, bushes and a hut, none of them near the path."""
    boxes = [(np.array([-FIELD, -FIELD, 0.0]), np.array([FIELD, FIELD, FIELD]))]
    reach = max(SEMI_AXES) + 3.0
    for count, size, height, farthest in (
        (40, (0.25, 0.5), (4.0, 8.0), 60.0),
        (15, (0.8, 2.0), (0.6, 1.5), 40.0),
    ):
        for _ in range(count):
            away, bearing = rng.uniform(reach, farthest), rng.uniform(0.0, 2.0 * np.pi)
            boxes.append(_standing(away, bearing, rng.uniform(*size, 2), rng.uniform(*height)))
    boxes.append(_standing(25.0, rng.uniform(0.0, 2.0 * np.pi), np.array([5.0, 3.5]), 2.6))
    return _world(boxes)


def _standing(away: float, bearing: float, size: Array, height: float) -> Box:
    centre = away * np.array([np.cos(bearing), np.sin(bearing)])
    return np.append(centre - size / 2, 0.0), np.append(centre + size / 2, height)


def _world(boxes: list[Box]) -> World:
    low, high = (np.array(side) for side in zip(*boxes, strict=True))
    return World(low, high)


def _peopled(world: World, spec: SyntheticRecording) -> World:
    """Add people: they keep off the path, go either way, and through what else is in theirs."""
    rng, count = stream(spec.seed, "people"), spec.people or 0
    sides = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    ways = rng.choice([-1.0, 1.0], count)
    speed, phase = rng.uniform(0.8, 1.5, count), rng.uniform(0.0, 2.0 * np.pi, count)
    tall, off = rng.uniform(1.55, 1.9, count), rng.uniform(1.3, 2.3, count)
    if spec.scene is SyntheticScene.CORRIDOR:
        axes = np.tile([CORRIDOR[0] - 3.0, 0.0], (count, 1))
        lane = sides * _LANE
    else:
        axes = np.array(SEMI_AXES) + (sides * off)[:, None]
        lane = np.zeros(count)
    walkers = Walkers(axes, lane, phase, ways * speed / axes[:, 0])
    places = walkers.places(np.zeros(1))[:, :, 0]
    half = np.array(_PERSON) / 2
    low = np.column_stack([places - half, np.zeros(count)])
    high = np.column_stack([places + half, tall])
    return World(np.vstack([world.lower, low]), np.vstack([world.upper, high]), walkers)
