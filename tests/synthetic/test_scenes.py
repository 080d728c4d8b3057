# SPDX-License-Identifier: Apache-2.0
"""Corridor, field and people: what sensors see of them is where it is at that instant."""

from __future__ import annotations

import numpy as np
import pytest

from slamhive.data.synthetic import aiding, rig
from slamhive.data.synthetic.camera import CameraModel
from slamhive.data.synthetic.lidar import LidarModel
from slamhive.data.synthetic.scenes import CORRIDOR, build_scene
from slamhive.data.synthetic.texture import build_atlas
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.data.synthetic.world import World, build_world
from slamhive.model.synthetic import SyntheticRecording

SCENES = [{"scene": "Corridor"}, {"scene": "Field"}, {"people": 6}, {"scene": "Corridor", "people": 4}]


def spec_of(given: dict[str, object], **more: object) -> SyntheticRecording:
    base = {"seed": 4, "durationSeconds": 30, "noise": 0, "lidar": {"rings": 16, "columns": 120}}
    return SyntheticRecording.model_validate(base | given | more)


def scan_of(spec: SyntheticRecording, world: World, start: float) -> np.ndarray:
    return LidarModel(spec, world, SyntheticMotion(spec)).scan(start, 0)


def in_world(points: np.ndarray, spec: SyntheticRecording, times: np.ndarray) -> np.ndarray:
    local = np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float64)
    motion = SyntheticMotion(spec).at(times)
    body = local @ rig.LIDAR_POSE[:3, :3].T + rig.LIDAR_POSE[:3, 3]
    return np.einsum("nij,nj->ni", motion.rotation, body) + motion.position


@pytest.mark.parametrize("given", SCENES, ids=str)
def test_points_lie_on_what_is_there_at_their_own_time(given: dict[str, object]) -> None:
    spec = spec_of(given)
    world = build_scene(spec)
    points = scan_of(spec, world, 14.0)
    assert len(points) > 400
    times = 14.0 + points["time"].astype(np.float64)
    places = in_world(points, spec, times)
    for time in np.unique(times):
        assert world.at(time).distance(places[times == time]).max() < 3e-4


def test_without_people_the_room_is_what_it_was() -> None:
    world, room = build_scene(spec_of({})), build_world(4)
    assert (world.lower.tolist(), world.upper.tolist(), world.walkers) == (
        room.lower.tolist(),
        room.upper.tolist(),
        None,
    )


def test_people_are_seen_in_front_of_the_same_room_and_walk() -> None:
    spec = spec_of({"people": 6})
    world, room = build_scene(spec), build_world(4)
    assert world.lower[: len(room.lower)].tolist() == room.lower.tolist()
    alone, among = scan_of(spec, room, 14.0), scan_of(spec, world, 14.0)
    assert len(alone) == len(among)
    ranges = [np.sqrt(sum(one[axis].astype(float) ** 2 for axis in "xyz")) for one in (alone, among)]
    nearer = ranges[0] - ranges[1] > 1e-3
    assert nearer.sum() > 20
    assert among[~nearer].tolist() == alone[~nearer].tolist()
    # Each goes at the pace of a walker, and what is behind is what it always was.
    assert world.walkers is not None
    times = np.linspace(0.0, 30.0, 3001)
    speed = np.linalg.norm(np.diff(world.walkers.places(times), axis=2), axis=1) / 0.01
    assert 0.3 < speed.mean() < 1.5
    assert speed.max() < 1.6


@pytest.mark.parametrize("given", SCENES, ids=str)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_comes_near_the_platform(given: dict[str, object], seed: int) -> None:
    spec = spec_of(given, seed=seed)
    world, motion = build_scene(spec), SyntheticMotion(spec)
    times = np.arange(0.0, 30.0, 0.1)
    places = motion.at(times).position
    nearest = min(world.at(t).distance(place[None])[0] for t, place in zip(times, places, strict=True))
    # Sensors are at most 0.35 m from the body's origin.
    assert nearest > 0.4


@pytest.mark.parametrize("given", [{"scene": "Corridor", "people": 4}, {"people": 6}], ids=str)
def test_depth_images_show_people_where_they_are(given: dict[str, object]) -> None:
    camera = {"width": 96, "height": 72}
    spec = spec_of(given, sensors=["Rgbd"], camera=camera)
    world = build_scene(spec)
    atlas = build_atlas(world, spec.seed)
    color = rig.cameras(spec)["color"]
    model = CameraModel(spec, color, world, atlas, SyntheticMotion(spec))
    faces = 6 * (len(world.lower) - len(world.walkers.phase if world.walkers else ()))
    seen = 0
    for at in (8.0, 12.0, 16.0, 20.0):
        view = model._view(at)
        rows, columns = np.mgrid[0:72, 0:96].reshape(2, -1).astype(np.float64)
        rays = view.rotation @ color.lens.rays(np.stack([columns, rows], axis=1)).T.astype(np.float32)
        depth, face = world.cast(view.origin[:, None], rays, np.full(rays.shape[1], at))
        same = face == view.face.ravel()
        assert same.mean() > 0.995
        assert view.depth.ravel()[same] == pytest.approx(depth[same], rel=1e-4)
        seen += int((face >= faces).sum())
        assert model.image(at, 0).shape == (72, 96, 3)
        # Another instant in between leaves what this one shows.
        model._view(at + 3.0)
        assert (model._renderer.colors(view) == model._renderer.colors(view)).all()
    assert seen > 50


def test_a_corridor_tells_little_of_the_way_along_it_and_a_field_little_of_all() -> None:
    corridor = spec_of({"scene": "Corridor"})
    motion = SyntheticMotion(corridor).at(np.linspace(0.0, 30.0, 300)).position
    assert np.ptp(motion, axis=0)[0] > 4 * np.ptp(motion, axis=0)[1]
    _, face = _faces(corridor)
    along = (face % 6) // 2 == 0
    # The ends, 15 m away, and the sides of door frames.
    assert along.mean() < 0.12
    field = spec_of({"scene": "Field"})
    points = scan_of(field, build_scene(field), 14.0)
    below = in_world(points, field, 14.0 + points["time"].astype(np.float64))[:, 2] < 0.01
    assert 0.75 < below.mean() < 1.0
    assert len(points) < 0.7 * 16 * 120


def _faces(spec: SyntheticRecording) -> tuple[np.ndarray, np.ndarray]:
    world = build_scene(spec)
    assert world.upper[0].tolist() == list(CORRIDOR)
    bearing = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    rays = np.stack([np.cos(bearing), np.sin(bearing), 0.0 * bearing]).astype(np.float32)
    return world.cast(np.array([[0.0], [0.0], [1.3]], np.float32), rays)


def test_planar_scans_see_people_too() -> None:
    spec = spec_of({"people": 8}, sensors=["LaserScan"])
    motion = SyntheticMotion(spec)
    alone, among = (
        aiding.scan(spec, world, motion, 14.0, 0) for world in (build_world(4), build_scene(spec))
    )
    assert (among <= alone).all()
    assert (among < alone - 0.01).sum() > 5
