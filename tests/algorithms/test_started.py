# SPDX-License-Identifier: Apache-2.0
"""Folders that `slamhive algorithm new` makes pass `slamhive algorithm check` untouched."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from slamhive.local.programs.starting import ExampleKind
from slamhive.playback.ros import find_ros, what_it_takes

if TYPE_CHECKING:
    from collections.abc import Callable


PASSED = {"parameters", "runs", "data", "accuracy", "frame", "direction", "determinism"}


def sound(rows: dict[str, dict[str, str]]) -> set[str]:
    """Return the checks that passed; where frames were dropped, poses may be in doubt."""
    dropped = "0 dropped" not in rows["data"]["found"].split(", ")
    in_doubt = {"data", "accuracy", "frame", "direction"} if dropped else set()
    return {
        name
        for name, row in rows.items()
        if row["answer"] == "pass" or (name in in_doubt and row["answer"] == "warning")
    }


class Commands:
    """`slamhive algorithm …` in a folder, with a home of its own."""

    def __init__(self, folder: Path, environments: Path) -> None:
        home = folder / "home"
        home.mkdir()
        (home / "environments").symlink_to(environments)
        left_out = {"SLAMHIVE_ARCHIVE", "KUBECONFIG"}
        self._env = {name: value for name, value in os.environ.items() if name not in left_out}
        self._env["SLAMHIVE_HOME"] = str(home)
        self._folder = folder

    def call(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run one."""
        return subprocess.run(
            [Path(sys.executable).with_name("slamhive"), "algorithm", *words],
            cwd=self._folder,
            env=self._env,
            capture_output=True,
            text=True,
            check=False,
        )

    def answers(self, name: str, executor: str) -> dict[str, dict[str, str]]:
        """Check an algorithm, which passes, and return the row of each check."""
        checked = self.call("check", name, "--on", executor, "--format", "json")
        assert checked.returncode == 0, checked.stdout + checked.stderr
        return {row["check"]: row for row in json.loads(checked.stdout)}


@pytest.fixture
def commands(tmp_path: Path, environments: Path) -> Commands:
    """The command line, working in the test's folder."""
    return Commands(tmp_path, environments)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        ExampleKind.LIDAR_PYTHON,
        ExampleKind.PROGRAM,
        ExampleKind.ROS2_NODE,
        pytest.param(ExampleKind.ROS1_NODE, marks=pytest.mark.ros),
    ],
)
def test_a_folder_passes_untouched(kind: ExampleKind, commands: Commands) -> None:
    if kind is ExampleKind.ROS1_NODE and find_ros() is None:
        pytest.skip(what_it_takes())
    if kind is ExampleKind.PROGRAM and (shutil.which("cc") is None or shutil.which("make") is None):
        pytest.skip("there is no compiler: apt-get install gcc libc6-dev make")
    made = commands.call("new", "mine", "--from", kind.value)
    assert made.returncode == 0, made.stderr
    rows = commands.answers("mine", "process")
    assert sound(rows) >= PASSED
    assert {"stamp", "SIGTERM"} <= set(rows)
    if kind is ExampleKind.ROS2_NODE:
        # Where each scan waits for the pose of the last, a busy machine drops none.
        equal = "2 runs are equal to the byte; 0 of 180 frames had no pose after 2s"
        assert rows["stepped"]["found"] == equal


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(ExampleKind))
def test_its_image_is_built_as_the_folder_says_and_passes(
    kind: ExampleKind, commands: Commands, image_of: Callable[[Path, str], str], tmp_path: Path
) -> None:
    name = f"started-{kind.value}"
    made = commands.call("new", name, "--from", kind.value)
    assert made.returncode == 0, made.stderr
    image_of(tmp_path / name, name)
    assert sound(commands.answers(name, "container")) >= PASSED
