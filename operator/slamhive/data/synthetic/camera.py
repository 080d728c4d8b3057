# SPDX-License-Identifier: Apache-2.0
"""Images: what the renderer sees, gathered over the exposure, with the sensor's noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.synthetic.render import WorldRenderer
from slamhive.data.synthetic.rig import DEPTH_SCALE
from slamhive.data.synthetic.streams import stream

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.data.synthetic.render import View
    from slamhive.data.synthetic.rig import RigCamera
    from slamhive.data.synthetic.texture import Atlas
    from slamhive.data.synthetic.trajectory import SyntheticMotion
    from slamhive.data.synthetic.world import World
    from slamhive.model.synthetic import SyntheticRecording

    Array = npt.NDArray[np.float64]

READ_NOISE = 1.2
"""Standard deviation of a black pixel at noise 1, grey levels."""
SHOT_NOISE = 0.012
"""Variance that a pixel gains per grey level at noise 1."""
DEPTH_NOISE = 0.001
"""Standard deviation of a depth at noise 1, m at 1 m; it grows with the square (Khoshelham 2012)."""
DEPTH_RANGE = (0.3, 10.0)
"""Depths outside are recorded as 0, m."""
BLUR_SAMPLES = 9
"""Instants averaged over an exposure."""


class CameraModel:
    """Makes the images of one camera."""

    def __init__(
        self,
        spec: SyntheticRecording,
        camera: RigCamera,
        world: World,
        atlas: Atlas,
        trajectory: SyntheticMotion,
    ) -> None:
        self._spec, self._camera, self._trajectory = spec, camera, trajectory
        self._renderer = WorldRenderer(camera.lens, world, atlas)
        self._last: tuple[float, View] | None = None

    def pose(self, at: float) -> Array:
        """Give T_world_camera `(4, 4)` at an instant, s since the start of the recording."""
        motion = self._trajectory.at(at)
        body = np.eye(4)
        body[:3, :3], body[:3, 3] = motion.rotation[0], motion.position[0]
        return np.asarray(body @ self._camera.pose)

    def image(self, at: float, index: int) -> npt.NDArray[np.uint8]:
        """Take an image whose exposure is centred on an instant.

        Args:
            at: s since the start of the recording.
            index: Number of the frame, for its noise.

        Returns:
            `(height, width)` or, in colour, `(height, width, 3)`.
        """
        exposure = self._spec.camera.exposure_seconds
        instants = at + exposure * (np.arange(BLUR_SAMPLES) + 0.5 - BLUR_SAMPLES / 2.0) / BLUR_SAMPLES
        views = [self._view(float(t)) for t in (instants if exposure > 0.0 else [at])]
        bright = sum(self._renderer.colors(view) for view in views) * np.float32(
            self._spec.light / len(views)
        )
        bright = np.asarray(bright, dtype=np.float32)
        if self._spec.noise > 0.0:
            rng = stream(self._spec.seed, self._camera.role, index)
            noise = rng.standard_normal(bright.shape, dtype=np.float32)
            deviation = np.sqrt(np.float32(SHOT_NOISE) * bright + np.float32(READ_NOISE**2))
            bright = bright + noise * deviation * np.float32(self._spec.noise)
        return np.asarray(np.clip(bright + np.float32(0.5), 0.0, 255.0), dtype=np.uint8)

    def depth(self, at: float, index: int) -> npt.NDArray[np.uint16]:
        """Take a depth image registered to the camera: `(height, width)`, mm, 0 where there is none."""
        z = self._view(at).depth
        if self._spec.noise > 0.0:
            noise = stream(self._spec.seed, "depth", index).standard_normal(z.shape, dtype=np.float32)
            z = z + noise * z * z * np.float32(DEPTH_NOISE * self._spec.noise)
        valid = (z >= DEPTH_RANGE[0]) & (z <= DEPTH_RANGE[1])
        return np.where(valid, z * np.float32(DEPTH_SCALE) + np.float32(0.5), np.float32(0.0)).astype(
            np.uint16
        )

    def _view(self, at: float) -> View:
        """Look from where the platform is; colour and depth of one instant share the work."""
        if self._last is None or self._last[0] != at:
            self._last = at, self._renderer.view(self.pose(at), at)
        return self._last[1]
