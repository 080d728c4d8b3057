# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive_eval import Trajectory, rotation

if TYPE_CHECKING:
    from collections.abc import Callable

SHARED = Path(__file__).parents[3] / "shared" / "data"


def shared(part: str) -> Path:
    folder = SHARED / part
    if not folder.exists():
        pytest.skip(f"../shared/data/{part} is not here")
    return folder


@pytest.fixture(scope="session")
def icra2023() -> Path:
    return shared("icra2023")


@pytest.fixture(scope="session")
def trajectories() -> Path:
    return shared("trajectories")


@pytest.fixture(scope="session")
def lidar2d() -> Path:
    return shared("lidar2d")


@pytest.fixture(scope="session")
def bags() -> Path:
    return shared("bags")


def wander(n: int = 200, seed: int = 0, rate: float = 10.0, start: float = 1.6e9) -> Trajectory:
    """A smooth random path in full 3-D."""
    rng = np.random.default_rng(seed)
    velocity = np.cumsum(rng.normal(0, 0.05, (n, 3)), axis=0) + rng.normal(0, 0.5, 3)
    turns = np.cumsum(rng.normal(0, 0.02, (n, 3)), axis=0)
    return Trajectory(
        start + np.arange(n) / rate,
        np.cumsum(velocity, axis=0) / rate,
        rotation.from_roll_pitch_yaw(turns),
    )


@pytest.fixture(scope="session", name="wander")
def wander_fixture() -> Callable[..., Trajectory]:
    return wander
