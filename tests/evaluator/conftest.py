# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive.local.home.folder import lock
from slamhive_eval import Trajectory, rotation

if TYPE_CHECKING:
    from collections.abc import Callable

EVO = "evo==1.38.1"
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


@pytest.fixture(scope="session")
def evo(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """Runs a program of evo: of EVO_BIN, the path, or an environment of its own that outlives the session."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slamhive-tests"
    own = cache / EVO.replace("==", "-") / "bin"
    with lock(cache / "evo.lock"):
        found = shutil.which("evo_res", path=os.environ.get("EVO_BIN")) or shutil.which("evo_res", path=own)
        if found is None:
            try:
                venv.create(own.parent, clear=True)
                words = ["pip", "install", "--quiet", "--python", own / "python", EVO]
                uv = Path(sys.prefix) / "bin" / "uv"
                subprocess.run([uv, *words], check=True, capture_output=True, timeout=600)
            except (OSError, subprocess.SubprocessError):
                shutil.rmtree(own.parent, ignore_errors=True)
                pytest.skip(f"{EVO} can't be installed here; EVO_BIN names a folder with its programs")
            found = str(own / "evo_res")
    home = tmp_path_factory.mktemp("evo")

    def run(program: str, *words: str) -> str:
        return subprocess.run(
            [Path(found).with_name(program), *words],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "HOME": str(home), "MPLBACKEND": "Agg"},
        ).stdout

    return run


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
