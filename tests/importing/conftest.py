# SPDX-License-Identifier: Apache-2.0
"""The real runs of the original system, and small ones made up for what can go wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from slamhive.cli import importing, results

if TYPE_CHECKING:
    from collections.abc import Callable

    from typer import Typer

ICRA = Path(__file__).parents[3] / "shared" / "data" / "icra2023"


@pytest.fixture(scope="session")
def icra() -> Path:
    if not ICRA.is_dir():
        pytest.skip("the runs of the original paper are not there (../shared/data/icra2023)")
    return ICRA


def command(app: Typer, home: Path) -> Callable[..., Any]:
    """Return a function that calls a command as the shell would, and gives its outcome."""

    def call(*words: str, **options: Any) -> Any:
        environment = {"SLAMHIVE_HOME": str(home), "SLAMHIVE_ARCHIVE": ""}
        return CliRunner().invoke(app, [str(word) for word in words], env=environment, **options)

    return call


@pytest.fixture
def take(tmp_path: Path) -> Callable[..., Any]:
    """``slamhive import`` into a fresh home."""
    return command(importing.app, tmp_path / "home")


@pytest.fixture
def show(tmp_path: Path) -> Callable[..., Any]:
    """``slamhive results`` on that home."""
    return command(results.app, tmp_path / "home")


@pytest.fixture(scope="session")
def published(paper_home: Callable[..., Path]) -> Callable[..., str]:
    """``slamhive results`` on all 81 runs with both alignments."""
    home = paper_home("sim3", "se3")

    def call(*words: str) -> str:
        outcome = command(results.app, home)(*words)
        assert outcome.exit_code == 0, outcome.output
        return str(outcome.stdout)

    return call


@pytest.fixture(scope="session")
def reference(icra: Path) -> dict[str, Any]:
    return dict(json.loads((icra / "reference.json").read_text()))


@pytest.fixture(scope="session")
def tables(icra: Path) -> dict[str, Any]:
    return dict(json.loads((icra / "paper_tables.json").read_text()))


CONFIG = """\
slam-hive-algorithm: {algorithm}
slam-hive-dataset: {dataset}
algorithm-parameters:
  nFeatures: 1000
dataset-parameters:
  fps: 20.0
  T: [1.0, 0.0,
      0.0, 1.0]
algorithm-remap:
  mono_topic: /camera/image_raw
dataset-remap:
"""


@pytest.fixture
def make_run(tmp_path: Path) -> Callable[..., Path]:
    """Write a run folder, and ground truth of its dataset: a curve at 10 Hz for 20 s."""

    def poses() -> str:
        lines = (f"{100 + k / 10} {k / 10} {(k / 50) ** 2} {(k % 7) / 100} 0 0 0 1" for k in range(200))
        return "\n".join(lines) + "\n"

    def make(
        number: str = "001",
        *,
        algorithm: str = "orb-slam2-ros-mono",
        dataset: str = "Hall_01",
        config: str | None = None,
        trajectory: str | None = "same",
        profile: str | None = "time,cpu_usage,memory_usage\n0,0,100\n2,1.5,300\n3,0.5,200\n",
    ) -> Path:
        folder = tmp_path / "runs" / number
        folder.mkdir(parents=True)
        (folder / "config.yaml").write_text(config or CONFIG.format(algorithm=algorithm, dataset=dataset))
        if trajectory is not None:
            (folder / "traj.txt").write_text(poses() if trajectory == "same" else trajectory)
        if profile is not None:
            (folder / "profiling.csv").write_text(profile)
        truth = tmp_path / "truth"
        truth.mkdir(exist_ok=True)
        (truth / "Hall_01.txt").write_text(poses())
        return folder

    return make
