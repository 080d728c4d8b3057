# SPDX-License-Identifier: Apache-2.0
"""Wheels, GNSS, magnetometer, barometer and planar scanner beside the motion and room that they measure."""

from __future__ import annotations

import numpy as np
import pytest

from slamhive.data.synthetic import aiding, rig
from slamhive.data.synthetic.trajectory import SyntheticMotion
from slamhive.data.synthetic.world import build_world
from slamhive.model.synthetic import SyntheticRecording

FLAT = SyntheticRecording(sensors=("Odometry",), duration_seconds=20.0, loops=0.5, motion=0.0, noise=0.0)
T = np.arange(0.0, 20.0, 0.02)


def wheel_poses(spec: SyntheticRecording) -> np.ndarray:
    """The true poses (n, 4, 4) of the wheels, from the first on."""
    motion = SyntheticMotion(spec).at(T)
    body = np.tile(np.eye(4), (len(T), 1, 1))
    body[:, :3, :3], body[:, :3, 3] = motion.rotation, motion.position
    wheels = body @ rig.MOUNTINGS["odometry"]
    return np.linalg.inv(wheels[0]) @ wheels


def test_wheels_add_up_to_the_path_in_their_plane() -> None:
    found, true = aiding.wheels(FLAT, SyntheticMotion(FLAT), T), wheel_poses(FLAT)
    assert true[:, 2, 3] == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(found[:, 3:5] - true[:, :2, 3], axis=1).max() < 1e-3
    heading = np.arctan2(true[:, 1, 0], true[:, 0, 0])
    assert np.cos(found[:, 5] - heading).min() > 1 - 1e-8


def test_wheels_slip_with_noise() -> None:
    spec = FLAT.model_copy(update={"noise": 1.0})
    found = (
        aiding.wheels(spec, SyntheticMotion(spec), T)[:, :3]
        - aiding.wheels(FLAT, SyntheticMotion(FLAT), T)[:, :3]
    )
    expected = [aiding.SPEED_NOISE, aiding.SPEED_NOISE, aiding.TURN_NOISE]
    assert found.std(axis=0) == pytest.approx(expected, rel=0.1)


def test_fixes_are_as_far_apart_as_the_antenna_moved() -> None:
    trajectory = SyntheticMotion(FLAT)
    motion = trajectory.at(T)
    antenna = motion.position + motion.rotation @ rig.MOUNTINGS["gnss"][:3, 3]
    found = aiding.fixes(FLAT, trajectory, T)
    # Degrees of a sphere of the mean radius: within 0.5 % of the ellipsoid's.
    metres = np.radians(found[:, :2]) * 6_371_000.0
    north, east = metres[:, 0], metres[:, 1] * np.cos(np.radians(49.0))
    steps = np.hypot(np.diff(north), np.diff(east)).sum()
    assert steps == pytest.approx(np.linalg.norm(np.diff(antenna[:, :2], axis=0), axis=1).sum(), rel=0.005)
    assert found[:, 2] == pytest.approx(antenna[:, 2] + 110.0)


def test_a_magnetometer_turns_in_the_field() -> None:
    trajectory = SyntheticMotion(FLAT)
    found = aiding.fields(FLAT, trajectory, T)
    axes = trajectory.at(T).rotation @ rig.MOUNTINGS["magnetometer"][:3, :3]
    assert np.einsum("nij,nj->ni", axes, found) == pytest.approx(np.tile(aiding.FIELD, (len(T), 1)))


def test_pressure_falls_with_height() -> None:
    spec = FLAT.model_copy(update={"motion": 3.0})
    trajectory = SyntheticMotion(spec)
    motion = trajectory.at(T)
    height = (motion.position + motion.rotation @ rig.MOUNTINGS["barometer"][:3, 3])[:, 2]
    slope = np.polyfit(height, aiding.pressures(spec, trajectory, T), 1)[0]
    assert slope == pytest.approx(-11.9, abs=0.2)  # Pa/m near the sea


def test_rays_end_on_the_room_s_surfaces() -> None:
    world, trajectory = build_world(FLAT.seed), SyntheticMotion(FLAT)
    start = 10.0
    ranges = aiding.scan(FLAT, world, trajectory, start, 0)
    assert np.isfinite(ranges).mean() > 0.9
    bearing = aiding.scan_bearings()
    motion = trajectory.at(start + np.arange(aiding.SCAN_RAYS) / (aiding.SCAN_RAYS * aiding.SCAN_RATE))
    mounting = rig.MOUNTINGS["scan"]
    local = ranges[:, None] * np.stack([np.cos(bearing), np.sin(bearing), np.zeros(len(bearing))], axis=1)
    placed = local @ mounting[:3, :3].T + mounting[:3, 3]
    points = np.einsum("nij,nj->ni", motion.rotation, placed) + motion.position
    hit = np.isfinite(ranges)
    assert np.abs(world.distance(points[hit])).max() < 1e-3
