# SPDX-License-Identifier: Apache-2.0
"""An installed ROS 2 and the wheels: which is found, what is taken of it, and why one can't be."""

from __future__ import annotations

import platform
import shutil
import sys
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.home.catalog import AlgorithmEntry, Workshop
from slamhive.local.programs import interpreters, players, rosreadiness
from slamhive.local.programs.environments import Environments, availability
from slamhive.local.programs.interpreters import Interpreter, interpreter
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.algorithm import Algorithm
from slamhive.model.readiness import State
from slamhive.playback import ros2
from slamhive.playback.player.ros2.transport import has_rmw
from slamhive.playback.ros import Ros
from slamhive.playback.ros2 import (
    find_ros2,
    is_of_wheels,
    libraries_without_ros,
    ros2_fault,
    wheels_fault,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

MODULES = (
    "rclpy",
    "sensor_msgs/msg",
    "nav_msgs/msg",
    "geometry_msgs/msg",
    "rosgraph_msgs/msg",
    "rcl_interfaces/srv",
)
SOURCED = Ros(2, "/usr/bin/python3", (3, 12), "jazzy 7.1.6", (), ())


@pytest.fixture(autouse=True)
def _looked_anew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name in ("ROS_VERSION", "ROS_DISTRO", "AMENT_PREFIX_PATH", "PYTHONPATH"):
        monkeypatch.delenv(name, raising=False)
    ros2._look.cache_clear()
    yield
    ros2._look.cache_clear()


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Lays out a ROS 2 with some modules, for this interpreter, and sources it."""

    def lay_out(*modules: str) -> Path:
        prefix, programs = tmp_path / "opt", tmp_path / "programs"
        packages = prefix / "lib/python3/site-packages"
        for module in modules:
            (packages / module).mkdir(parents=True)
            (packages / module / "__init__.py").touch()
        (packages / "rclpy-7.1.6.dist-info").mkdir(parents=True)
        (packages / "rclpy-7.1.6.dist-info" / "METADATA").write_text("Name: rclpy\nVersion: 7.1.6\n")
        programs.mkdir()
        (programs / "python3").symlink_to(getattr(sys, "_base_executable", sys.executable))
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        for name, value in {
            "ROS_VERSION": "2",
            "ROS_DISTRO": "jazzy",
            "AMENT_PREFIX_PATH": str(prefix),
            "PYTHONPATH": f"{elsewhere}:{packages}",
            "PATH": f"{prefix}/bin:{programs}",
        }.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(ros2, "PYTHONS", ("python3",))
        return prefix

    return lay_out


def test_a_shell_that_sourced_nothing_has_no_ros_2() -> None:
    assert find_ros2() is None
    assert ros2_fault() is None


def test_of_one_that_was_sourced_its_own_paths_alone_are_taken(source: Callable[..., Path]) -> None:
    prefix = source(*MODULES)
    found = find_ros2()
    assert found is not None, ros2_fault()
    assert (found.release, found.version) == ("jazzy 7.1.6", sys.version_info[:2])
    assert found.paths == (str(prefix / "lib/python3/site-packages"),)
    variables = dict(found.variables)
    assert variables["PATH"] == str(prefix / "bin")
    assert variables["AMENT_PREFIX_PATH"] == str(prefix)


def test_one_that_python_cannot_take_is_none_and_the_reason_is_told(source: Callable[..., Path]) -> None:
    source(*MODULES[:2])
    assert find_ros2() is None
    fault = ros2_fault()
    assert fault is not None
    assert fault.startswith("jazzy is sourced, and no Python here can take it (")
    assert "No module named 'nav_msgs'" in fault


def test_an_rmw_is_there_if_its_library_is(tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "librmw_cyclonedds_cpp.so").touch()
    assert has_rmw(f"/nonexistent::{tmp_path}", "rmw_cyclonedds_cpp")
    assert not has_rmw(f"/nonexistent:{tmp_path}", "rmw_zenoh_cpp")
    assert not has_rmw("", "rmw_cyclonedds_cpp")


def test_libraries_of_any_ros_2_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheels = tmp_path / "lib"
    packages = wheels / "python3.11" / "site-packages"
    packages.mkdir(parents=True)
    (packages / "ros_wheels_bootstrapper.pth").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/jazzy")
    theirs = ["/opt/ros/jazzy/lib", "", str(wheels), str(packages / "ros_rcl.libs")]
    assert libraries_without_ros(":".join(["/opt/cuda/lib", *theirs, "/opt/rose/lib"])) == (
        "/opt/cuda/lib:/opt/rose/lib"
    )


@pytest.mark.parametrize(
    ("text", "brings"),
    [
        ("ros-rclpy[fastrtps]==9.1.2\n", True),
        ("numpy\nROS_rclpy\n", True),
        ("ros-kilted-rclpy==9.1.2 \\\n    --hash=sha256:00\n", True),
        ("# ros-rclpy\nros-sensor-msgs==5.5.1\n", False),
        ("ros-rclpyx\n", False),
        ("", False),
    ],
)
def test_requirements_that_bring_rclpy(text: str, brings: bool) -> None:
    assert is_of_wheels(text.encode()) is brings


@pytest.mark.parametrize(
    ("machine", "libc", "said"),
    [
        ("x86_64", ("glibc", "2.28"), None),
        ("x86_64", ("glibc", "2.36"), None),
        ("x86_64", ("glibc", "2.27"), "wheels of ROS 2 need glibc 2.28 or newer, and here is glibc 2.27"),
        ("x86_64", ("", ""), "wheels of ROS 2 need glibc 2.28 or newer, and here is none"),
        ("aarch64", ("glibc", "2.36"), "there are wheels of ROS 2 for x86_64 alone, and this is aarch64"),
    ],
)
def test_machines_that_can_have_wheels(
    monkeypatch: pytest.MonkeyPatch, machine: str, libc: tuple[str, str], said: str | None
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(platform, "libc_ver", lambda: libc)
    assert wheels_fault() == said


def node(folder: Path, requirements: str = "", program: str = "import rclpy\n", **ros: Any) -> AlgorithmEntry:
    """Return a ROS 2 node with a program in Python."""
    spec = {
        "local": {},
        "modes": [{"name": "lidar"}],
        "output": {"frame": "lidar"},
        "paces": ["Realtime"],
        "realtime": {"queue": 1},
        "recording": ["Mcap"],
        "ros2": {"poses": {"topic": "/poses", "type": "Odometry"}} | ros,
    }
    (folder / "adapter.py").write_text(program)
    (folder / "requirements.txt").write_text(requirements)
    return AlgorithmEntry(Algorithm.model_validate({"metadata": {"name": "echo"}, "spec": spec}), folder)


@pytest.mark.parametrize(
    ("requirements", "program", "sourced"),
    [
        ("", "import rclpy", SOURCED),
        ("", "import cyclonedds", SOURCED),
        ("", "import cyclonedds", None),
        ("ros-rclpy[fastrtps]==9.1.2", "import rclpy", SOURCED),
        ("ros-rclpy[fastrtps]==9.1.2", "import rclpy", None),
    ],
)
def test_the_python_of_a_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, requirements: str, program: str, sourced: Ros | None
) -> None:
    monkeypatch.setattr(interpreters, "find_ros2", lambda: sourced)
    beside = "ros2 jazzy 7.1.6" if sourced and not requirements else None
    assert interpreter(node(tmp_path, requirements, program)).beside == beside


def test_a_node_on_wheels_gets_a_python_that_has_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = node(tmp_path, "ros-rclpy[fastrtps]==9.1.2")
    monkeypatch.setattr(sys, "version_info", (3, 14, 0))
    monkeypatch.setattr(interpreters, "_probe", lambda name: Interpreter(name, (3, int(name[8:]))))
    assert interpreter(entry).path == "python3.11"
    monkeypatch.setattr(interpreters, "_probe", lambda _: None)
    said = availability(entry)
    assert said is not None
    assert said.startswith("needs Python >=3.11,>=3.10,<3.14, here is 3.14; install another python3.x ")
    monkeypatch.setattr(interpreters, "wheels_fault", lambda: "there are none for toasters")
    assert availability(entry) == "brings rclpy in its requirements: there are none for toasters"


@pytest.mark.parametrize("program", ["import rclpy\n", "if True:\n    from rclpy.node import Node\n"])
def test_a_node_that_takes_rclpy_from_nowhere_says_what_it_needs(tmp_path: Path, program: str) -> None:
    said = availability(node(tmp_path, program=program))
    assert said == (
        "needs ROS 2: source the setup of an installed one before slamhive is started, or name "
        "ros-rclpy[fastrtps] in its requirements"
    )


def test_a_node_whose_machine_has_no_player_says_what_that_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = node(tmp_path, program="import cyclonedds")
    monkeypatch.setattr(players, "wheels_fault", lambda: "there are none for toasters")
    assert availability(entry) == (
        "the ROS 2 player can't be had: there are none for toasters; source the setup of an installed ROS 2"
    )
    monkeypatch.setattr(players, "wheels_fault", lambda: None)
    monkeypatch.setattr(players, "WHEELS_PYTHON", ">=3.98,<3.99")
    said = availability(entry)
    assert said is not None
    assert said.startswith("the ROS 2 player needs Python >=3.98,<3.99, here is 3.")
    assert said.endswith("; source the setup of an installed ROS 2")


def test_another_rmw_needs_an_installed_ros_2_that_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = node(tmp_path, program="", rmw="rmw_cyclonedds_cpp")
    needs = "needs an installed ROS 2 with rmw_cyclonedds_cpp, which was sourced: "
    monkeypatch.setattr(players, "wheels_fault", lambda: None)
    monkeypatch.setattr(players, "python_for", lambda *_: Interpreter(sys.executable, (3, 11)))
    assert availability(entry) == f"{needs}wheels have rmw_fastrtps_cpp alone"
    monkeypatch.setattr(players, "find_ros2", lambda: SOURCED)
    assert availability(entry) == f"{needs}jazzy 7.1.6 has none"
    monkeypatch.setattr(players, "has_rmw", lambda *_: True)
    assert availability(entry) is None


def test_of_humble_the_player_takes_nothing_as_its_python_is_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    humble = Ros(2, "/usr/bin/python3", (3, 10), "humble 3.3.11", (), ())
    monkeypatch.setattr(players, "find_ros2", lambda: humble)
    monkeypatch.setattr(players, "wheels_fault", lambda: None)
    monkeypatch.setattr(players, "python_for", lambda *_: Interpreter(sys.executable, (3, 11)))
    assert players.player_base().requirements == ros2.WHEELS
    monkeypatch.setattr(players, "wheels_fault", lambda: "there are none for toasters")
    with pytest.raises(
        Unavailable, match=r"toasters; humble 3\.3\.11, which was sourced, is for Python 3\.10"
    ):
        players.player_base()


def test_the_player_s_environment_is_one_of_those_that_a_node_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interpreters, "find_ros2", lambda: SOURCED)
    monkeypatch.setattr(players, "find_ros2", lambda: SOURCED)
    made = Environments(tmp_path)
    first, second = made.folders_of(node(tmp_path))
    (tmp_path / "other").mkdir()
    assert made.folders_of(node(tmp_path / "other", "numpy"))[0] == first != second


def test_doctor_says_what_a_player_is_made_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(players, "wheels_fault", lambda: None)
    monkeypatch.setattr(players, "python_for", lambda *_: Interpreter(sys.executable, (3, 12)))
    monkeypatch.setattr(rosreadiness, "_INSTALLED", tmp_path / "none")
    row = rosreadiness.ros2(Workshop())
    assert row.state is State.THERE
    assert row.found.endswith("; nodes are played to by wheels of ROS 2 for Python 3.12")
    monkeypatch.setattr(players, "wheels_fault", lambda: "there are none for toasters")
    assert rosreadiness.ros2(Workshop()).state is State.UNNEEDED
    row = rosreadiness.ros2(Workshop({"echo": node(tmp_path)}))
    assert row.state is State.MISSING
    assert row.costs.startswith("the ROS 2 nodes echo run in containers and on clusters alone: ")
    assert "none for toasters" in row.costs


def test_doctor_says_why_a_sourced_ros_2_is_not_taken(
    source: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source()
    monkeypatch.setattr(rosreadiness, "_INSTALLED", tmp_path / "none")
    monkeypatch.setattr(players, "wheels_fault", lambda: None)
    monkeypatch.setattr(players, "python_for", lambda *_: Interpreter(sys.executable, (3, 12)))
    row = rosreadiness.ros2(Workshop())
    assert row.state is State.LIMITED
    assert "No module named 'rclpy'" in row.found


def test_doctor_says_that_an_installed_ros_2_was_not_sourced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "jazzy").mkdir()
    (tmp_path / "jazzy" / "local_setup.sh").touch()
    monkeypatch.setattr(rosreadiness, "_INSTALLED", tmp_path)
    monkeypatch.setattr(players, "wheels_fault", lambda: None)
    monkeypatch.setattr(players, "python_for", lambda *_: Interpreter(sys.executable, (3, 12)))
    row = rosreadiness.ros2(Workshop())
    assert row.state is State.LIMITED
    assert row.found.startswith("not sourced, though there is jazzy; ")
    assert row.helps == f"source {tmp_path}/jazzy/setup.bash"


@pytest.mark.parametrize(
    ("free", "state"), [(16 << 20, State.LIMITED), (95 << 20, State.LIMITED), (200 << 20, State.THERE)]
)
def test_doctor_says_whether_shared_memory_is_enough(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int, state: State
) -> None:
    workshop = Workshop({"echo": node(tmp_path)})
    usage = shutil.disk_usage(tmp_path)._replace(free=free)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    (row,) = rosreadiness.shared_memory(workshop, tmp_path)
    assert row.state is state
    assert not list(rosreadiness.shared_memory(Workshop(), tmp_path))


def test_doctor_says_that_there_is_no_shared_memory(tmp_path: Path) -> None:
    (row,) = rosreadiness.shared_memory(Workshop({"echo": node(tmp_path)}), tmp_path / "shm")
    assert row.state is State.MISSING
    assert row.found == f"{tmp_path}/shm is not there"
