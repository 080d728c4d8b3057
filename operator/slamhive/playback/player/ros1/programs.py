# SPDX-License-Identifier: Apache-2.0
"""The programs of ROS that the player runs: the master (roscore) and the bag (rosbag play)."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
import xmlrpc.client
from typing import TYPE_CHECKING, Any

from slamhive.playback.protocol import LOOPBACK, PlayError, ros1_variables

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from pathlib import Path

PLAYER_NODE, BAG_NODE = "/slamhive_player", "/slamhive_bag"
_MASTER_SECONDS = 30.0
_LOOK_SECONDS = 0.05


class RosProgram:
    """A program of ROS that runs beside us, its output in a file.

    Args:
        argv: Its command line.
        log: Where its output goes.
    """

    def __init__(self, argv: Sequence[str], log: Path) -> None:
        self._log = log
        try:
            with log.open("wb") as file:
                self._process = subprocess.Popen(
                    argv, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT
                )
        except OSError as error:
            raise PlayError(f"{argv[0]} can't be started: {error.strerror}") from None

    @property
    def status(self) -> int | None:
        """Its exit status, None while it runs."""
        return self._process.poll()

    def last_line(self) -> str:
        """Return the last line that it printed."""
        text = self._log.read_text(encoding="utf-8", errors="replace")
        lines = [line.strip() for line in text.replace("\r", "\n").splitlines() if line.strip()]
        return lines[-1] if lines else "it printed nothing"

    def end(self) -> None:
        """End it."""
        for number in (signal.SIGINT, signal.SIGKILL):
            if self.status is None:
                self._process.send_signal(number)
                try:
                    self._process.wait(10.0)
                except subprocess.TimeoutExpired:
                    continue


class Master:
    """A ROS master of our own, reachable from this machine (or pod) alone.

    Args:
        folder: Where ROS may write.
        port: Its port; 0 for any that is free.
        stopped: Asked whether to give up waiting.

    Raises:
        PlayError: It doesn't start.
    """

    def __init__(self, folder: Path, port: int, stopped: Callable[[], bool]) -> None:
        port = port or _free_port()
        self.uri = f"http://{LOOPBACK}:{port}"
        (folder / "ros").mkdir(exist_ok=True)
        os.environ.update(ros1_variables(self.uri, str(folder / "ros")))
        self._program = RosProgram(["roscore", "-p", str(port)], folder / "roscore.log")
        self.api = xmlrpc.client.ServerProxy(self.uri)
        deadline = time.monotonic() + _MASTER_SECONDS
        while not self._answers():
            if self._program.status is not None or time.monotonic() > deadline or stopped():
                self.end()
                raise PlayError(f"roscore doesn't answer: {self._program.last_line()}")
            time.sleep(_LOOK_SECONDS)

    def _answers(self) -> bool:
        # rosout is the last that roscore starts: a node that finds it finds everything.
        try:
            found: Any = self.api.lookupNode(PLAYER_NODE, "/rosout")
        except (OSError, xmlrpc.client.Error):
            return False
        return bool(found[0] == 1)

    def check(self) -> None:
        """Make sure that it is there.

        Raises:
            PlayError: It has ended.
        """
        if self._program.status is not None:
            raise PlayError(f"roscore has ended: {self._program.last_line()}")

    def set_simulated_time(self) -> None:
        """Let all nodes from now on take their time from the bag."""
        self.api.setParam(PLAYER_NODE, "/use_sim_time", True)

    def taken(self, topics: Sequence[str], node: str) -> list[str]:
        """Return those of the topics whose messages reach a node that isn't ours, if the bag were played now.

        The node that plays is asked for its connections: the master only knows who wants to have some.
        """
        try:
            found: Any = self.api.lookupNode(PLAYER_NODE, node)
            if found[0] != 1:
                return []
            answer: Any = xmlrpc.client.ServerProxy(str(found[2])).getBusInfo(PLAYER_NODE)
        except (OSError, xmlrpc.client.Error):
            return []
        others = {
            str(link[4]) for link in answer[2] if link[2] == "o" and link[1] not in {PLAYER_NODE, "/rosout"}
        }
        return [topic for topic in topics if topic in others]

    def has_publisher(self, topic: str) -> bool:
        """Tell whether a node that isn't ours has announced a topic; it may still be out of our reach."""
        try:
            found: Any = self.api.getSystemState(PLAYER_NODE)
        except (OSError, xmlrpc.client.Error):
            return False
        publishers = {str(name): nodes for name, nodes in found[2][0]} if found[0] == 1 else {}
        return bool(set(publishers.get(topic, ())) - {BAG_NODE, PLAYER_NODE})

    def published(self, types: Collection[str]) -> list[str]:
        """Return the topics of some types that nodes that aren't ours have announced, each with its type."""
        try:
            state: Any = self.api.getSystemState(PLAYER_NODE)
            known: Any = self.api.getTopicTypes(PLAYER_NODE)
        except (OSError, xmlrpc.client.Error):
            return []
        kinds = {str(topic): str(kind) for topic, kind in known[2]}
        return sorted(
            f"{topic} ({kinds[topic]})"
            for topic, nodes in state[2][0]
            if kinds.get(topic, "").partition("/")[2] in types and set(nodes) - {BAG_NODE, PLAYER_NODE}
        )

    def end(self) -> None:
        """End it."""
        self._program.end()


def play_bag(folder: Path, recording: str, rate: float, remap: Mapping[str, str]) -> RosProgram:
    """Start rosbag play, paused before the first message: it tells of its topics and of the clock already."""
    options = ["--pause", "--clock", "--rate", repr(rate)]
    renamed = [f"{old}:={new}" for old, new in remap.items() if old != new]
    argv = ["rosbag", "play", *options, recording, f"__name:={BAG_NODE[1:]}", *renamed]
    return RosProgram(argv, folder / "rosbag.log")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
