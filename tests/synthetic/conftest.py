# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from slamhive.data.synthetic import generate, rig
from slamhive.data.synthetic.camera import CameraModel
from slamhive.data.synthetic.texture import Atlas, build_atlas
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.data.synthetic.world import World, build_world
from slamhive.model.synthetic import SyntheticCamera, SyntheticLidar, SyntheticRecording

if TYPE_CHECKING:
    from slamhive.data.synthetic import SyntheticOutput

EVERYTHING = SyntheticRecording(
    seed=5,
    sensors=("Lidar", "Imu", "Stereo", "Rgbd"),
    loops=0.15,
    duration_seconds=7.0,
    lidar=SyntheticLidar(rings=8, columns=90),
    camera=SyntheticCamera(width=96, height=72, rate=5.0),
    header_offset_seconds=0.004,
    depth_offset_seconds=0.013,
)


@pytest.fixture(scope="session")
def everything() -> SyntheticRecording:
    return EVERYTHING


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> SyntheticOutput:
    return generate(EVERYTHING, tmp_path_factory.mktemp("synthetic") / "everything")


@dataclass(frozen=True)
class Studio:
    """A room to take noise-free pictures in."""

    spec: SyntheticRecording
    world: World
    atlas: Atlas
    trajectory: SyntheticMotion

    def camera(self, role: str, **changes: object) -> CameraModel:
        spec = self.spec.model_copy(update={"camera": self.spec.camera.model_copy(update=changes)})
        atlas = self.atlas if role == "color" else self.atlas.grey()
        return CameraModel(spec, rig.cameras(spec)[role], self.world, atlas, self.trajectory)


@pytest.fixture(scope="session")
def studio() -> Studio:
    spec = SyntheticRecording(
        seed=3,
        sensors=("Stereo", "Rgbd"),
        duration_seconds=30.0,
        noise=0.0,
        camera=SyntheticCamera(width=240, height=180),
    )
    world = build_world(spec.seed)
    return Studio(spec, world, build_atlas(world, spec.seed), SyntheticMotion(spec))
