# SPDX-License-Identifier: Apache-2.0
"""Folders that `slamhive algorithm new` makes pass `slamhive algorithm check` untouched."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from slamhive.local.starting import Kind
from slamhive.playback.ros import find_ros, what_it_takes


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [Kind.LIDAR_PYTHON, Kind.PROGRAM, pytest.param(Kind.ROS1_NODE, marks=pytest.mark.ros)]
)
def test_a_folder_passes_untouched(kind: Kind, tmp_path: Path, environments: Path) -> None:
    if kind is Kind.ROS1_NODE and find_ros() is None:
        pytest.skip(what_it_takes())
    if kind is Kind.PROGRAM and (shutil.which("cc") is None or shutil.which("make") is None):
        pytest.skip("there is no compiler: apt-get install gcc libc6-dev make")
    home = tmp_path / "home"
    home.mkdir()
    (home / "environments").symlink_to(environments)
    slamhive = Path(sys.executable).with_name("slamhive")
    env = {
        name: value for name, value in os.environ.items() if name not in {"SLAMHIVE_ARCHIVE", "KUBECONFIG"}
    }
    env |= {"SLAMHIVE_HOME": str(home)}

    def call(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [slamhive, "algorithm", *words],
            cwd=tmp_path,
            env=env,
            capture_output=True,
            text=True,
            check=False,
        )

    made = call("new", "mine", "--from", kind.value)
    assert made.returncode == 0, made.stderr
    checked = call("check", "mine", "--on", "process", "--format", "json")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    rows = {row["check"]: row["answer"] for row in json.loads(checked.stdout)}
    wanted = {
        "parameters",
        "runs",
        "data",
        "accuracy",
        "frame",
        "direction",
        "stamp",
        "determinism",
        "SIGTERM",
    }
    assert {name for name, answer in rows.items() if answer == "pass"} >= wanted - {"stamp", "SIGTERM"}
    assert wanted <= set(rows)
