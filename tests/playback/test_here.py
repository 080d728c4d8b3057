# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes and their player as processes of this machine: environments, variables, arguments."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import slamhive.playback
from slamhive.archive import Archive
from slamhive.local.home.catalog import Workshop
from slamhive.local.home.folder import Home
from slamhive.local.programs.environments import Environments
from slamhive.local.programs.players import PlayerBase, player_base
from slamhive.local.programs.unavailable import Unavailable
from slamhive.local.running.attempt import end_left_behind
from slamhive.local.running.runner import Job, Runner, Watcher
from slamhive.local.running.workbench import Workbench
from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid
from slamhive.playback import ros2
from slamhive.playback.player.ros2 import shm
from slamhive.playback.ros2 import find_ros2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive.model.results import RunRecord

    Echo = Callable[..., tuple[RunRecord, Path]]

HERE = Path(__file__).parent
WHEELS = Path(slamhive.playback.__file__).parent / "ros2-player.txt"
USERS = {
    "ROS_DOMAIN_ID": "7",
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "ROS_LOCALHOST_ONLY": "0",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    "ROS_STATIC_PEERS": "192.0.2.1",
    "ROS_LOG_DIR": "/nonexistent",
    "FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA",
    "FASTDDS_DEFAULT_PROFILES_FILE": "/nonexistent/profile.xml",
    "FASTRTPS_DEFAULT_PROFILES_FILE": "/nonexistent/profile.xml",
    "SKIP_DEFAULT_XML": "1",
    "CYCLONEDDS_URI": "file:///nonexistent/cyclonedds.xml",
    "ROS_DISCOVERY_SERVER": "192.0.2.1:11811",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
}
"""Of a shell in which somebody works with a robot."""
SPEC = {
    "local": {"adapter": "node.py"},
    "modes": [{"name": "lidar"}],
    "parameters": {"voxel": {"type": "Number", "default": 0.5}},
    "files": [
        {"path": "echo.yaml", "template": "echo:\n  ros__parameters:\n    voxel: {{ parameters.voxel }}\n"}
    ],
    "output": {"frame": "lidar"},
    "paces": ["Realtime"],
    "realtime": {"queue": 1},
    "recording": ["Mcap"],
    "ros2": {
        "poses": {"topic": "/poses", "type": "Odometry"},
        "topics": {"lidar": "cloud"},
        "arguments": "Ros",
        "parameters": "echo.yaml",
    },
}


JAZZY = """--no-binary empy
ros-rclpy[fastrtps]==7.1.6
ros-sensor-msgs==5.3.6
ros-nav-msgs==5.3.6
ros-rosgraph-msgs==2.0.3
"""


class Notes(Watcher):
    """A watcher that remembers the records."""

    def __init__(self) -> None:
        self.records: list[RunRecord] = []

    def finished(self, job: Job, record: RunRecord) -> None:
        self.records.append(record)


@pytest.fixture(scope="session")
def base() -> PlayerBase:
    """The base of a player: wheels."""
    try:
        return player_base()
    except Unavailable as error:
        pytest.skip(str(error))


@pytest.fixture
def echo(base: PlayerBase, tmp_path: Path, environments: Path, tiny: Path) -> Echo:
    """Runs the node that echoes with its requirements, on a second of the small recording."""
    assert base.requirements == WHEELS
    folder = tmp_path / "algorithms" / "echo"
    folder.mkdir(parents=True)
    (tmp_path / "environments").symlink_to(environments)
    (tmp_path / "datasets").symlink_to(tiny)
    shutil.copyfile(HERE / "echo2.py", folder / "node.py")
    home = Home.at(tmp_path)

    def run(requirements: bytes, program: str = "") -> tuple[RunRecord, Path]:
        (folder / "requirements.txt").write_bytes(requirements)
        (folder / "run.sh").write_text(program)
        (folder / "run.sh").chmod(0o755)
        spec = SPEC | ({"local": {"command": ["run.sh", "one"]}} if program else {})
        workshop = Workshop()
        workshop.add([Algorithm.model_validate({"metadata": {"name": "echo"}, "spec": spec})], folder)
        workshop.add(load_file(tiny / "tiny" / "dataset.yaml"), tiny / "tiny")
        template: dict[str, Any] = {
            "algorithmRef": {"name": "echo"},
            "datasetRef": {"name": "tiny"},
            "input": {"duration": "1s"},
            "evaluate": False,
            "retries": 0,
        }
        body = {"metadata": {"name": "here"}, "spec": {"template": {"spec": template}}}
        sweep = Sweep.model_validate(body)
        with Archive.open(home.archive_url) as archive:
            job, notes = Job(sweep, local_uid(sweep), Plan(sweep, workshop)), Notes()
            Runner(Workbench(home, workshop, archive), notes, parallelism=1).run([job])
        (record,) = notes.records

        assert record.folder, record.message
        return record, Path(record.folder)

    return run


def variables_in(folder: Path) -> dict[str, str]:
    lines = (folder / "run/output/environment.txt").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line)


def started_with(folder: Path) -> list[str]:
    """Return interpreter, rclpy, and the words that the node was started with."""
    return (folder / "run/output/started.txt").read_text().splitlines()


def check_played(record: RunRecord, folder: Path) -> None:
    assert record.reason is None, record.message
    assert len((folder / "run/output/trajectory.txt").read_text().splitlines()) == 10
    assert (folder / "run/output/voxel.txt").read_text() == "0.5"


def test_a_node_on_wheels_has_nothing_of_the_user_s_shell(
    echo: Echo, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in USERS.items():
        monkeypatch.setenv(name, value)
    record, folder = echo(WHEELS.read_bytes())
    check_played(record, folder)
    found = variables_in(folder)
    changed = {name for name, value in USERS.items() if found.get(name) not in {None, value}}
    assert changed == {
        *("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"),
        *("ROS_LOG_DIR", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"),
    }
    same = {name for name, value in USERS.items() if found.get(name) == value}
    assert same == {"_ROS_WHEELS_BOOTSTRAP_COMPLETE"}  # set by its own wheels, after they found its libraries
    own = os.path.realpath(found["AMENT_PREFIX_PATH"])
    assert all(os.path.realpath(path).startswith(own) for path in found["LD_LIBRARY_PATH"].split(":"))
    python, rclpy, _, *words = started_with(folder)
    assert Path(python).parents[1].samefile(own)
    assert Path(rclpy).is_relative_to(Path(python).parents[1])
    assert words == [
        *("--ros-args", "-p", "use_sim_time:=true", "-r", "cloud:=/points"),
        *("--params-file", f"{folder}/run/files/echo.yaml"),
    ]
    told = json.loads((folder / "player/supervisor.json").read_text())["env"]
    assert {name for name in told if name.startswith(("ROS_", "RMW", "FAST", "CYCLONE", "_"))} == {
        "ROS_LOG_DIR"
    }
    # What is measured and ended is what was started: the wheels have it start anew in the same process.
    record_of = json.loads((folder / "player/process.json").read_text())
    assert list((folder / "player").glob(f"*_{record_of['algorithm']['pid']}_*.log"))
    assert json.loads((folder / "player/summary.json").read_text())["leftProcesses"] == 0


@pytest.fixture
def install(
    base: PlayerBase, tmp_path: Path, environments: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[str, Path], Path]]:
    """A function that sources a ROS 2: packages of wheels, as one that is installed has them."""

    def lay_out(distribution: str, wheels: Path) -> Path:
        made = Environments(environments)._made("the wheels", base.python, wheels)
        packages = next(made.resolve().glob("lib/python3.*/site-packages"))
        prefix = tmp_path / "opt"
        own = prefix / packages.relative_to(made.resolve())
        own.mkdir(parents=True)
        left_out = re.compile(
            r"(rosbags|apsw|lz4|ruamel|backports|typing_extensions|ros_wheels_bootstrapper)"
        )
        for path in packages.iterdir():
            if not left_out.match(path.name):
                (own / path.name).symlink_to(path)
        (prefix / "share").symlink_to(made.resolve() / "share")
        for path in made.resolve().glob("lib/*.so*"):
            (prefix / "lib" / path.name).symlink_to(path)
        programs = environments.parent / "programs"  # an environment is for the path of its Python
        programs.mkdir(exist_ok=True)
        with suppress(FileExistsError):
            (programs / "python3").symlink_to(base.python.path)
        libraries = [str(prefix / "lib"), *map(str, packages.glob("ros_*.libs"))]
        for name, value in {
            "ROS_VERSION": "2",
            "ROS_DISTRO": distribution,
            "AMENT_PREFIX_PATH": str(prefix),
            "PYTHONPATH": f"{own}:/nonexistent",
            "LD_LIBRARY_PATH": ":".join(libraries),
            "PATH": f"{prefix}/bin:{programs}:{os.environ['PATH']}",
        }.items():
            monkeypatch.setenv(name, value)
        ros2._look.cache_clear()
        return prefix

    yield lay_out
    monkeypatch.undo()
    ros2._look.cache_clear()


@pytest.fixture
def installed(install: Callable[[str, Path], Path]) -> Path:
    """A ROS 2 that was sourced: Kilted."""
    return install("kilted", WHEELS)


@pytest.mark.slow
def test_a_node_of_an_installed_ros_has_what_was_sourced(
    installed: Path, echo: Echo, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in USERS.items():
        monkeypatch.setenv(name, value)
    record, folder = echo(b"")
    check_played(record, folder)
    found = variables_in(folder)
    assert found["ROS_DISTRO"] == "kilted"
    assert found["AMENT_PREFIX_PATH"] == str(installed)
    assert f":{installed}/bin:" in found["PATH"]
    *_, last = found["PYTHONPATH"].split(":")
    assert Path(last).is_relative_to(installed)
    assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in found
    _, rclpy, *_ = started_with(folder)
    assert Path(rclpy).is_relative_to(installed)
    told = json.loads((folder / "player/supervisor.json").read_text())
    assert told["env"]["AMENT_PREFIX_PATH"] == str(installed)
    packages = subprocess.run(
        [told["argv"][0], "-c", "import rosbags, rclpy; print(rosbags.__path__[0], rclpy.__path__[0])"],
        env=told["env"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert [Path(path).is_relative_to(installed) for path in packages] == [False, True]


@pytest.mark.slow
def test_a_program_of_its_own_has_what_was_sourced_and_the_arguments(installed: Path, echo: Echo) -> None:
    ros = find_ros2()
    assert ros is not None
    record, folder = echo(b"", f'#!/bin/sh\nexec {ros.python} "${{0%/*}}/node.py" "$@"\n')
    check_played(record, folder)
    _, rclpy, _, *words = started_with(folder)
    assert Path(rclpy).is_relative_to(installed)
    assert words[:4] == ["one", "--ros-args", "-p", "use_sim_time:=true"]
    assert variables_in(folder)["AMENT_PREFIX_PATH"] == str(installed)


@pytest.mark.slow
def test_a_node_of_jazzy_is_played_to_by_kilted(echo: Echo) -> None:
    check_played(*echo(JAZZY.encode()))


@pytest.mark.slow
def test_an_installed_jazzy_plays_too(
    install: Callable[[str, Path], Path], echo: Echo, tmp_path: Path
) -> None:
    (tmp_path / "jazzy.txt").write_text(JAZZY)
    prefix = install("jazzy", tmp_path / "jazzy.txt")
    record, folder = echo(b"")
    check_played(record, folder)
    assert Path(started_with(folder)[1]).is_relative_to(prefix)
    # It has no tf2_msgs, and none of ROS 1 is taken for it: /tf_static of the recording is no sensor's.
    said = (folder / "player/log.txt").read_text()
    assert "/tf_static can't be played: install the package tf2_msgs of ROS 2" in said


@pytest.mark.slow
def test_a_node_on_wheels_has_none_of_a_ros_that_was_sourced(installed: Path, echo: Echo) -> None:
    record, folder = echo(WHEELS.read_bytes())
    check_played(record, folder)
    found = variables_in(folder)
    assert str(installed) not in "".join(found.values())
    assert "ROS_DISTRO" not in found


def test_what_a_killed_slamhive_left_in_shared_memory_goes_with_its_runs(tmp_path: Path) -> None:
    name = Path(shm.FOLDER) / f"fastdds_{os.getpid():016x}"
    name.write_bytes(b"x")
    name.with_name(f"{name.name}_el").touch()
    try:
        end_left_behind(tmp_path)
        assert name.exists()
        record = tmp_path / "sweep" / "run" / "player" / "process.json"
        record.parent.mkdir(parents=True)
        record.write_text("{}")
        end_left_behind(tmp_path)
        assert not name.exists()
        assert not record.exists()
    finally:
        name.unlink(missing_ok=True)
        name.with_name(f"{name.name}_el").unlink(missing_ok=True)
