# SPDX-License-Identifier: Apache-2.0
"""Lidar scans, each column fired from where the platform is at its own time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic.rig import LIDAR_POSE
from slamhive.data.synthetic.streams import stream

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.data.synthetic.trajectory import SyntheticMotion
    from slamhive.data.synthetic.world import World
    from slamhive.model.synthetic import SyntheticRecording

RANGE_NOISE = 0.01
"""Standard deviation of a range at noise 1, m."""
ELEVATION = (-22.0, 18.0)
"""Lowest and highest beam, degrees."""

POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 12, 16, 20],
        "itemsize": 24,
    }
)
"""One point: x, y, z in m in the lidar's frame, ring from below, time in s since the start of the scan."""


class LidarModel:
    """Makes the scans of one recording."""

    def __init__(self, spec: SyntheticRecording, world: World, trajectory: SyntheticMotion) -> None:
        self._spec, self._world, self._trajectory = spec, world, trajectory
        rings, columns = spec.lidar.rings, spec.lidar.columns
        azimuth = np.pi - 2.0 * np.pi * np.arange(columns)[:, None] / columns
        elevation = np.radians(np.linspace(*ELEVATION, rings))
        # (columns, rings, 3): points come in the order they were taken.
        self._beams = np.stack(
            [
                np.cos(azimuth) * np.cos(elevation),
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation) + 0.0 * azimuth,
            ],
            axis=2,
        )
        self._ring = np.tile(np.arange(rings, dtype=np.uint16), columns)
        self.column_times = np.arange(columns) / (columns * spec.lidar.rate)
        """`(columns,)`, s since the start of the scan."""
        faces = 6 * len(world.lower)
        self._reflectivity = stream(spec.seed, "reflectivity").uniform(20.0, 200.0, faces)

    def scan(self, start: float, index: int) -> npt.NDArray[np.void]:
        """Take one scan.

        Args:
            start: When the first column fires, s since the start of the recording.
            index: Number of the scan, for its noise.

        Returns:
            `(n,)` of dtype POINT, in order of time, without points out of range.
        """
        limits = self._spec.lidar
        motion = self._trajectory.at(start + self.column_times)
        rotation = motion.rotation @ LIDAR_POSE[:3, :3]
        origin = motion.position + motion.rotation @ LIDAR_POSE[:3, 3]
        beams = np.einsum("cij,crj->icr", rotation, self._beams).reshape(3, -1)
        origins = np.repeat(origin.T, limits.rings, axis=1)
        directions = beams.astype(np.float32)
        times = np.repeat(start + self.column_times, limits.rings)
        distance, face = self._world.cast(origins.astype(np.float32), directions, times)
        rng = stream(self._spec.seed, "lidar", index)
        noise = rng.standard_normal(len(distance)) * (RANGE_NOISE * self._spec.noise)
        measured = distance + noise
        cosine = np.abs(directions[(face % 6) // 2, np.arange(len(face))])
        keep = (measured >= limits.min_range) & (measured <= limits.max_range)
        local = self._beams.reshape(-1, 3) * measured[:, None]
        points = np.zeros(int(keep.sum()), dtype=POINT)
        points["x"], points["y"], points["z"] = local[keep].T
        points["intensity"] = (self._reflectivity[face] * cosine)[keep]
        points["ring"] = self._ring[keep]
        points["time"] = np.repeat(self.column_times, limits.rings)[keep]
        return points
