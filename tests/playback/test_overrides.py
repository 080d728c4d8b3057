# SPDX-License-Identifier: Apache-2.0
"""Parameters that nodes were started with are told by their processes' arguments."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from typing import TYPE_CHECKING

import pytest

from slamhive.playback.player.ros2.overrides import Overrides, overrides, undeclared

if TYPE_CHECKING:
    from pathlib import Path

FILE = """
/**:
  ros__parameters: # all
    voxel: {{size: 1.0}}
lab:
  back:
    ros__parameters: {{a: 1, b.c: 2}}
"""


def started(folder: Path, *words: str) -> list[Overrides]:
    """Return the overrides of a process with these arguments of ROS."""
    mark = str(uuid.uuid4())
    command = [sys.executable, "-c", "print(flush=True); input()", "--ros-args", *words]
    with subprocess.Popen(
        command,
        env=os.environ | {"MARK": mark},
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        found = overrides(f"MARK={mark}")
        process.communicate("\n")
    return found


def test_those_of_files_and_of_arguments(tmp_path: Path) -> None:
    file = tmp_path / "node.yaml"
    file.write_text(FILE.format())
    of_file = ("/**", {"voxel.size"}), ("lab/back", {"a", "b.c"})
    for path in (str(file), file.name):
        given = started(tmp_path, "--params-file", path, "-p", "rate:=2", "--param", "back:a:=x:=y")
        assert given[:2] == [(path, section, names) for section, names in of_file]
        assert given[2:] == [("", "/**", {"rate"}), ("", "/**/back", {"a"})]


@pytest.mark.parametrize("text", ["a: [", "- a", "/**: {ros__parameters: 1}", "a: &a {b: *a}", None])
def test_a_file_that_is_none_is_left_to_ros(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "node.yaml").write_text(text)
    given = started(tmp_path, "--params-file", "node.yaml", "-p", "rate:=2")
    assert given[-1] == ("", "/**", {"rate"})
    assert all(not names for _, _, names in given[:-1])


@pytest.mark.parametrize(
    ("section", "node", "meant"),
    [
        ("/**", "/lab/back", True),
        ("back", "/back", True),
        ("back", "/lab/back", False),
        ("/*/back", "/lab/back", True),
        ("/*/back", "/lab/b/back", False),
        ("/**/back", "/back", True),
        ("/lab/**", "/lab/b/back", True),
        ("b.ck", "/back", False),
    ],
)
def test_the_nodes_of_a_section(section: str, node: str, meant: bool) -> None:
    assert Overrides("", section, frozenset()).is_for(node) is meant


def test_only_what_surely_no_node_declares_is_said() -> None:
    file = Overrides("/run/files/node.yaml", "/**", frozenset({"voxel", "max_rang"}))
    argument = Overrides("", "/**/back", frozenset({"q1", "q2"}))
    ours, back = frozenset({"voxel"}), frozenset({"max_range", "q1"})
    assert undeclared([file, argument], {"/front": ours, "/back": back}) == (
        "no node declares max_rang (did you mean max_range?), which node.yaml sets: ROS 2 ignored it; "
        "no node declares q2, which the command sets: ROS 2 ignored it"
    )
    assert undeclared([file, argument], {"/front": ours, "/back": None}) == ""
    assert undeclared([argument], {"/front": ours}) == ""
