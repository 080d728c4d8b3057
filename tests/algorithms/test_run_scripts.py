# SPDX-License-Identifier: Apache-2.0
"""Scripts that start the nodes of an image of one's own, with a rosrun that starts nodes which only wait."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.templating.rendering import Renderer

if TYPE_CHECKING:
    from collections.abc import Iterator

ALGORITHMS = Path(__file__).parents[2] / "images" / "algorithms"
NODES: dict[str, list[str]] = {
    "vins-mono": ["pose_graph", "vins_estimator", "feature_tracker"],
    "vins-fusion": ["loop_fusion_node", "vins_node"],
    "lio-sam": [
        *("lio_sam_imuPreintegration", "lio_sam_imageProjection"),
        *("lio_sam_featureExtraction", "lio_sam_mapOptmization"),
    ],
}
# It notes that it is up, and that it was told to end. The one that is to fail waits until the others are up.
ROSRUN = """#!{python}
import os, pathlib, signal, sys, time
log, count = pathlib.Path({log!r}), {count}
def note(word):
    with log.open("a") as file:
        file.write(f"{{word}} {{sys.argv[2]}}\\n")
def end(*_):
    note("ended")
    os._exit(134)
signal.signal(signal.SIGINT, end)
note("up")
if sys.argv[2] == {failing!r}:
    while log.read_text().count("up ") < count:
        time.sleep(0.01)
    sys.stderr.write("no vocabulary\\n")
    sys.exit(7)
signal.pause()
"""
STARTED: list[subprocess.Popen[str]] = []
systems = pytest.mark.parametrize("name", sorted(NODES))


def script(name: str, folder: Path) -> Path:
    """Return the run.sh of a system, rendered with all of its nodes."""
    (algorithm,) = load_file(ALGORITHMS / name / "algorithm.yaml")
    assert isinstance(algorithm, Algorithm)
    spec = algorithm.spec
    parameters = spec.fill({"loop_closure": True} if "loop_closure" in spec.parameters else {})
    told: dict[str, Any] = dict.fromkeys(("algorithm", "run", "mode", "seed", "cores", "input"))
    told |= {"sensors": {}, "parameters": parameters}
    told["dataset"] = {"recording": {"path": "dataset/recording.bag"}}
    path = folder / "run.sh"
    path.write_text(Renderer(told, str(folder), str(folder)).text(dict(spec.templates)["run.sh"]))
    return path


def start(name: str, folder: Path, failing: str = "", **variables: str) -> subprocess.Popen[str]:
    log, tools = folder / "log", folder / "bin"
    log.touch()
    tools.mkdir()
    rosrun = ROSRUN.format(python=sys.executable, log=str(log), count=len(NODES[name]), failing=failing)
    for tool, text in {"rosrun": rosrun, "rosparam": "#!/bin/sh\n"}.items():
        (tools / tool).write_text(text)
        (tools / tool).chmod(0o755)
    process = subprocess.Popen(
        ["bash", str(script(name, folder))],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A ROS of this machine's own would go before ours.
        env={"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}", "BASH_ENV": os.devnull} | variables,
    )
    STARTED.append(process)
    return process


@pytest.fixture(autouse=True)
def _nothing_stays() -> Iterator[None]:
    """Kill the nodes of a script that a failed test left."""
    yield
    while STARTED:
        with suppress(ProcessLookupError):
            os.killpg(STARTED.pop().pid, signal.SIGKILL)


def notes(folder: Path, word: str) -> list[str]:
    """Return the nodes that noted a word, each once: one may be told to end again while it notes that."""
    lines = (folder / "log").read_text().splitlines()
    return sorted({line.split()[1] for line in lines if line.startswith(f"{word} ")})


@systems
def test_the_first_node_to_end_ends_the_others_and_the_run(name: str, tmp_path: Path) -> None:
    first, *others = NODES[name]
    process = start(name, tmp_path, failing=first)
    _, error = process.communicate(timeout=50)
    assert (process.returncode, error.splitlines()[-1]) == (7, "no vocabulary")
    assert notes(tmp_path, "ended") == sorted(others)


@systems
def test_all_nodes_are_told_to_end(name: str, tmp_path: Path) -> None:
    process = start(name, tmp_path)
    deadline = time.monotonic() + 50
    while len(notes(tmp_path, "up")) < len(NODES[name]):
        assert time.monotonic() < deadline, notes(tmp_path, "up")
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=50)
    assert notes(tmp_path, "ended") == sorted(NODES[name])


@systems
def test_an_image_without_ros_is_told_what_it_lacks(name: str, tmp_path: Path) -> None:
    process = subprocess.run(
        ["bash", str(script(name, tmp_path))],
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": str(tmp_path), "BASH_ENV": os.devnull},
        executable="/bin/bash",
    )
    assert process.returncode == 2
    assert process.stderr == ("no rosrun: the image's BASH_ENV has to name the setup.bash of its workspace\n")


def test_what_the_image_names_is_sourced(tmp_path: Path) -> None:
    (tmp_path / "setup.bash").write_text("rosrun() { echo found >&2; exit 5; }\n")
    process = start("vins-fusion", tmp_path, BASH_ENV=str(tmp_path / "setup.bash"))
    _, error = process.communicate(timeout=50)
    assert (process.returncode, set(error.split())) == (5, {"found"})
