# SPDX-License-Identifier: Apache-2.0
"""Whole commands with real algorithms, each in a home of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from slamhive.local.home.catalog import load_workshop

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.dataset import Dataset

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def home(tmp_path: Path, environments: Path) -> Path:
    """A home of real algorithms."""
    folder = tmp_path / "home"
    folder.mkdir()
    (folder / "environments").symlink_to(environments)
    return folder


@pytest.fixture
def lend(home: Path, lend_recording: Callable[[Dataset, Path], None]) -> Callable[[str], None]:
    """Links a generated dataset of the catalog into the home."""
    return lambda name: lend_recording(load_workshop().dataset(name).dataset, home)


@pytest.fixture
def slamhive(home: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs the command in the home."""

    def run(*arguments: str, timeout: float = 1500) -> subprocess.CompletedProcess[str]:
        variables = {name: value for name, value in os.environ.items() if not name.startswith("SLAMHIVE_")}
        return subprocess.run(
            [str(Path(sys.executable).with_name("slamhive")), *arguments],
            env=variables | {"SLAMHIVE_HOME": str(home), "COLUMNS": "200"},
            capture_output=True,
            text=True,
            check=False,
            timeout=timeout,
            cwd=ROOT,
        )

    return run
