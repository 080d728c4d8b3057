# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from slamhive.data.synthetic import rig
from slamhive.data.synthetic.lidar import RANGE_NOISE, LidarModel
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.data.synthetic.world import World, build_world
from slamhive.model.synthetic import SyntheticLidar, SyntheticRecording

SPEC = SyntheticRecording(seed=2, duration_seconds=30.0, lidar=SyntheticLidar(rings=16, columns=180))
WORLD, TRAJECTORY = build_world(2), SyntheticMotion(SPEC)


def take(spec: SyntheticRecording, start: float = 14.0) -> np.ndarray:
    return LidarModel(spec, WORLD, TRAJECTORY).scan(start, 0)


def in_world(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    local = np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float64)
    motion = TRAJECTORY.at(times)
    body = local @ rig.LIDAR_POSE[:3, :3].T + rig.LIDAR_POSE[:3, 3]
    return np.einsum("nij,nj->ni", motion.rotation, body) + motion.position


def test_points_lie_on_surfaces_when_moved_by_their_own_pose() -> None:
    points = take(SPEC.model_copy(update={"noise": 0.0}))
    assert len(points) == 16 * 180
    assert WORLD.distance(in_world(points, 14.0 + points["time"].astype(np.float64))).max() < 1e-4
    assert WORLD.distance(in_world(points, np.full(len(points), 14.0))).max() > 0.05


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_noise_is_along_the_beam_and_of_the_stated_size(scale: float) -> None:
    def ranges(noise: float) -> np.ndarray:
        points = take(SPEC.model_copy(update={"noise": noise}))
        return np.sqrt(sum(points[axis].astype(np.float64) ** 2 for axis in "xyz"))

    assert (ranges(scale) - ranges(0.0)).std() == pytest.approx(RANGE_NOISE * scale, rel=0.05)


def test_points_come_in_order_of_time_with_their_rings() -> None:
    points = take(SPEC)
    assert (np.diff(points["time"]) >= 0.0).all()
    assert 0.0 <= points["time"].min() <= points["time"].max() < 0.1
    assert set(points["ring"]) == set(range(16))
    elevation = np.arctan2(points["z"], np.hypot(points["x"], points["y"]))
    means = [elevation[points["ring"] == ring].mean() for ring in range(16)]
    np.testing.assert_allclose(np.degrees(means), np.linspace(-22.0, 18.0, 16), atol=1e-3)


def test_returns_out_of_range_are_dropped() -> None:
    limits = SPEC.lidar.model_copy(update={"min_range": 2.5, "max_range": 5.0})
    points = take(SPEC.model_copy(update={"lidar": limits}))
    ranges = np.sqrt(sum(points[axis] ** 2 for axis in "xyz"))
    assert 0 < len(points) < 16 * 180
    assert 2.499 < ranges.min() < ranges.max() < 5.001


@pytest.mark.parametrize(
    ("direction", "distance", "face"),
    [
        ((1.0, 0.0, 0.0), 3.0, 6),
        ((2.0, 0.0, 0.0), 1.5, 6),
        ((-1.0, 0.0, 0.0), 5.0, 0),
        ((0.0, 1.0, 0.0), 6.0, 3),
        ((0.0, 0.0, 1.0), 3.0, 5),
        ((0.0, 0.0, -1.0), 1.0, 4),
        ((4.0, 0.0, 1.2), 5.0 / 4.0, 1),
        ((1.0, 0.0, -0.2), 3.0, 6),
    ],
)
def test_rays_meet_what_they_should(
    direction: tuple[float, float, float], distance: float, face: int
) -> None:
    low, high = [[-5.0, -6.0, 0.0], [3.0, -1.0, 0.0]], [[5.0, 6.0, 4.0], [4.0, 1.0, 1.5]]
    origin, ray = np.array([[0.0, 0.0, 1.0]], np.float32).T, np.array([direction], np.float32).T
    reached, met = World(np.array(low), np.array(high)).cast(origin, ray)
    assert reached[0] == pytest.approx(distance, rel=1e-6)
    assert met[0] == face
