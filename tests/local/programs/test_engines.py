# SPDX-License-Identifier: Apache-2.0
"""Container engines as they answer: which is used, and what is said of one that can't be."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

import pytest

from slamhive import __version__
from slamhive.local.programs.containerwords import ImageProgram, confined
from slamhive.local.programs.engines import ContainerChoice, Engine, find_engine
from slamhive.local.programs.images import Image, player_image
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.rosnodes import Ros1, Ros2
from slamhive.monitor.programs.engine import EngineError
from slamhive.playback.pod import PLAYER_IMAGES

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.rosnodes import RosNode

CONTROLLERS = ["cpuset", "cpu", "cpuacct", "memory", "pids"]
DOCKER = {"ID": "a", "MemoryLimit": True, "CPUSet": True, "PidsLimit": True, "CgroupVersion": "2"}


def of_podman(**changes: Any) -> str:
    """Return podman's description of itself."""
    host = {
        "cgroupControllers": CONTROLLERS,
        "cgroupVersion": "v2",
        "ociRuntime": {"name": "crun"},
        "security": {"rootless": False},
        "serviceIsRemote": False,
    }
    return json.dumps({"host": host | changes})


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Install programs that print something and end, and nothing else."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))

    def install(name: str, out: str = "", err: str = "", code: int = 0) -> None:
        (folder / f"{name}.out").write_text(out)
        (folder / f"{name}.err").write_text(err)
        program = folder / name
        program.write_text(f"#!/bin/sh\n/bin/cat {program}.out\n/bin/cat {program}.err >&2\nexit {code}\n")
        program.chmod(0o755)

    return install


def why(choice: ContainerChoice | None = None) -> str:
    with pytest.raises(Unavailable) as found:
        find_engine(choice)
    return str(found.value)


def test_without_any_engine_it_says_what_to_install(installed: Callable[..., None]) -> None:
    assert "podman or docker isn't installed: apt-get install podman" in why()


def test_podman_goes_before_docker(installed: Callable[..., None]) -> None:
    installed("podman", of_podman())
    installed("docker", json.dumps(DOCKER))
    assert find_engine() == Engine("podman", ("podman",))
    assert find_engine(ContainerChoice.DOCKER) == Engine("docker", ("docker",))


def test_an_engine_that_is_there_and_does_not_answer_is_passed_over(installed: Callable[..., None]) -> None:
    installed("podman", err="Error: cannot clone: Operation not permitted\n", code=125)
    installed("docker", json.dumps(DOCKER))
    assert find_engine().name == "docker"
    told = why(ContainerChoice.PODMAN)
    assert "podman is installed but can't be used: cannot clone: Operation not permitted" in told
    assert "run slamhive as root" in told


NO_DAEMON = (
    "Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is the docker daemon running?"
)


@pytest.mark.parametrize(
    ("name", "printed", "sentences"),
    [
        ("docker", {"out": json.dumps({"ServerErrors": [NO_DAEMON]})}, ["Cannot connect", "systemctl start"]),
        ("docker", {"err": f"ERROR: {NO_DAEMON}\n", "code": 1}, ["Cannot connect", "systemctl start docker"]),
        ("docker", {"err": "permission denied while trying to connect", "code": 1}, ["usermod -aG docker"]),
        ("docker", {"out": json.dumps(DOCKER | {"CPUSet": False})}, ["no control of cpuset"]),
        ("docker", {"out": "[]"}, ["doesn't say what it can do"]),
        ("podman", {"out": "hello"}, ["doesn't say what it can do"]),
        ("podman", {"out": of_podman(serviceIsRemote=True)}, ["on another machine"]),
        ("podman", {"out": of_podman(cgroupVersion="v1")}, ["apt-get install runc"]),
        (
            "podman",
            {"out": of_podman(cgroupVersion="v1", cgroupControllers=[], security={"rootless": True})},
            ["no control of cpuset, memory, pids", "control groups of version 2, or run slamhive as root"],
        ),
        (
            "podman",
            {"out": of_podman(cgroupControllers=["memory", "pids"], security={"rootless": True})},
            ["no control of cpuset here", "Delegate=cpu cpuset memory pids"],
        ),
        (
            "podman",
            {"err": 'Error: exec: "newuidmap": executable file not found in $PATH', "code": 125},
            ["uidmap", "--add-subuids"],
        ),
    ],
)
def test_what_an_engine_lacks_is_said_with_what_helps(
    installed: Callable[..., None], name: str, printed: dict[str, Any], sentences: list[str]
) -> None:
    installed(name, **printed)
    told = why()
    assert all(sentence in told for sentence in sentences), told
    assert "\n" not in told


def test_limits_with_version_1_of_control_groups_take_runc(installed: Callable[..., None]) -> None:
    installed("podman", of_podman(cgroupVersion="v1"))
    installed("runc")
    assert find_engine().command == ("podman", "--runtime", "runc")


def test_podman_by_the_name_of_docker_is_podman(installed: Callable[..., None]) -> None:
    installed("docker", of_podman(security={"rootless": True}))
    assert find_engine() == Engine("podman", ("docker",), rootless=True)


def test_turned_off_is_said_so(installed: Callable[..., None]) -> None:
    installed("podman", of_podman())
    assert "--container none" in why(ContainerChoice.NONE)


def test_a_long_or_wild_message_is_cut_and_printable(installed: Callable[..., None]) -> None:
    installed("podman", of_podman())
    engine = find_engine()
    installed("podman", err="Error: \x1b[31m" + "x" * 5000 + "\n", code=1)
    with pytest.raises(EngineError) as found:
        engine.call("ps")
    assert len(str(found.value)) <= 400
    assert str(found.value).isprintable()


@pytest.mark.parametrize(
    ("engine", "user"),
    [
        (Engine("podman", ("podman",), rootless=True), "65532:65532"),
        (Engine("docker", ("docker",), rootless=True), "0:0"),
        (Engine("docker", ("docker",)), "1000:100"),
    ],
)
def test_without_root_a_program_is_whom_its_folder_belongs_to(
    monkeypatch: pytest.MonkeyPatch, engine: Engine, user: str
) -> None:
    """So no folder has to be opened to others of the machine."""
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(os, "getegid", lambda: 100)
    words = confined(ImageProgram(engine, Image("sha256:1", ()), "home"), "run", (), 1)
    assert words[words.index("--user") + 1] == user
    assert any(word.startswith("/tmp:") and "notmpcopyup" in word for word in words) is engine.is_podman


def node_of(ros: int, **fields: Any) -> RosNode:
    kind = {1: Ros1, 2: Ros2}[ros]
    return kind.model_validate({"poses": {"topic": "/odometry", "type": "Odometry"}, **fields})


@pytest.mark.parametrize("ros", [1, 2])
def test_each_ros_has_a_player_of_its_own_and_a_variable_names_another(
    monkeypatch: pytest.MonkeyPatch, ros: int
) -> None:
    own = PLAYER_IMAGES[ros]
    for other in PLAYER_IMAGES.values():
        monkeypatch.delenv(other.variable, raising=False)
    assert player_image(node_of(ros)) == f"slamhive/ros{ros}-player:{__version__}"
    monkeypatch.setenv(own.variable, "example.org/player:1")
    assert player_image(node_of(ros)) == "example.org/player:1"
    assert player_image(node_of(3 - ros)) == f"slamhive/ros{3 - ros}-player:{__version__}"


def test_an_rmw_that_our_player_has_not_takes_one_of_the_users(monkeypatch: pytest.MonkeyPatch) -> None:
    variable = PLAYER_IMAGES[2].variable
    monkeypatch.delenv(variable, raising=False)
    node = node_of(2, rmw="rmw_cyclonedds_cpp")
    with pytest.raises(Unavailable, match=rf"a player with rmw_cyclonedds_cpp, which \${variable} names"):
        player_image(node)
    monkeypatch.setenv(variable, "example.org/player:1")
    assert player_image(node) == "example.org/player:1"
