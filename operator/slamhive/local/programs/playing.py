# SPDX-License-Identifier: Apache-2.0
"""The player beside an attempt on a workstation: a program of its own, under a supervisor of its own.

::

    RUN/player/            its files: request, log, supervision, what ROS writes
    RUN/run/output/        where it puts the poses that it heard

What it costs is none of the algorithm's: it is in another process tree and cgroup, and on other processors
where there are any.
"""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import slamhive
from slamhive.local.programs.prepared import PreparedPlayer
from slamhive.local.programs.supervision import Supervised
from slamhive.model.errors import SystemFault
from slamhive.model.results import Reason
from slamhive.monitor import SupervisorSpec
from slamhive.playback.building import play_request
from slamhive.playback.outcome import Played, read_report
from slamhive.playback.protocol import NODE_FILE, READY_FILE, VARIABLE
from slamhive.playback.ros import what_it_takes

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.programs.prepared import AttemptOrder
    from slamhive.playback.ros import Ros

_READY_SECONDS = 60.0
_LOOK_SECONDS = 0.02
MEMORY_LIMIT = 4 * 2**30
"""Of a player, bytes."""


class Player:
    """The player of one attempt.

    Args:
        folder: The attempt's folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "player"
        self._run = folder / "run"
        self._program = Supervised(self._folder)
        self._stopping = False

    @property
    def took_part(self) -> bool:
        """True if sensor data were to be played to this attempt, by whichever slamhive started it."""
        return self._folder.is_dir()

    @property
    def record(self) -> Path:
        """Path of the file in which the player's supervisor records which processes run."""
        return self._program.record

    def start(self, order: AttemptOrder) -> dict[str, str]:
        """Start the player, if the attempt needs one, and wait until a node may be started.

        Args:
            order: what is run.

        Returns:
            Variables by which the algorithm finds it.

        Raises:
            SystemFault: It can't be started.
        """
        prepared = order.program.player(order, self._folder)
        if prepared is None:
            return {}
        # The player must take no CPU time from the cores on which the algorithm is measured.
        with _elsewhere(order.cpus):
            self._program.start(self._supervisor_spec(prepared))
        self._wait_until_ready(prepared.ready)
        return prepared.variables()

    def watch(self, end: Callable[[], None]) -> None:
        """Call a function if the player ends before it was asked to: nobody else would end the algorithm."""
        if not self._program.started:
            return

        def look() -> None:
            self._program.wait()
            played, last = self.played(), self._program.summary()
            # One that ended well found the algorithm gone, whose supervisor is about to find that too: told
            # to end, it would take that for the reason.
            well = last is not None and last.get("exitCode") == 0
            if not self._stopping and not well and not (played and played.completed):
                end()

        threading.Thread(target=look, name="player", daemon=True).start()

    def stop(self) -> None:
        """Ask it to end, as the algorithm has."""
        self._stopping = True
        self._program.end()

    def wait(self) -> None:
        """Wait until it is gone."""
        self._program.wait()

    def played(self) -> Played | None:
        """Return the end of playing, None where nothing was to be played."""
        if not self._folder.is_dir():
            return None
        # Asked before the report is read: the report lies where the algorithm can write.
        if self._program.started and not self._program.running and (number := self._fatal_signal()):
            how = "was killed" if number == signal.SIGKILL else f"was ended by signal {number}"
            return Played(False, "SystemFault", f"the player {how}")
        report = read_report(self._run / "output")
        if report is not None:
            return report
        return Played(False, "SystemFault", self._last_line())

    def _fatal_signal(self) -> int | None:
        """Return the signal that ended it, unless we did: the algorithm can write what it says, not this."""
        summary = self._program.summary()
        if summary is None:
            return signal.SIGKILL
        number = summary.get("signal")
        return None if number is None or summary.get("reason") == Reason.CANCELLED else int(number)

    def _supervisor_spec(self, prepared: PreparedPlayer) -> SupervisorSpec:
        folder = self._folder
        return SupervisorSpec(
            **prepared.supervision,
            log_path=str(folder / "log.txt"),
            usage_path=str(folder / "usage.csv"),
            summary_path=str(folder / "summary.json"),
            process_path=str(self.record),
            memory_limit_bytes=MEMORY_LIMIT,
            parent_pid=os.getpid(),
        )

    def _wait_until_ready(self, ready: Path) -> None:
        deadline = time.monotonic() + _READY_SECONDS
        while not ready.exists():
            if not self._program.running or time.monotonic() > deadline:
                self.stop()
                self.wait()
                raise SystemFault(f"the player doesn't start: {self._last_line()}")
            time.sleep(_LOOK_SECONDS)

    def _last_line(self) -> str:
        with suppress(OSError):
            text = (self._folder / "log.txt").read_text(encoding="utf-8", errors="replace")
            lines = [line.strip() for line in text.splitlines() if line.strip()]
            if lines:
                return lines[-1]
        return self._program.last_words() or "the player was killed"


def own_player(order: AttemptOrder, folder: Path, ros: Ros | None) -> PreparedPlayer | None:
    """Lay out a player that is a process of this machine, with its ROS; None where nothing is played.

    It gets none of the variables by which the user's shell tells ROS which domain, rmw or settings to take.

    Args:
        order: what is run, as a process too.
        folder: the player's.
        ros: its ROS; None where this machine has none.

    Raises:
        SystemFault: this machine has no ROS.
    """
    run = folder.parent / "run"
    request = play_request(
        order.entry.algorithm.spec,
        order.configuration,
        run=str(run),
        folder=str(folder),
        mark=f"SLAMHIVE_RUN={run}",
    )
    if request is None:
        return None
    if ros is None:
        raise SystemFault(f"the player {what_it_takes()}")
    for name in ("home", "tmp", "code"):
        (folder / name).mkdir(parents=True)
    # Of all that our interpreter has, the player's gets slamhive alone: it is another Python.
    (folder / "code" / "slamhive").symlink_to(Path(slamhive.__file__).parent)
    (folder / "request.json").write_text(request.to_json())
    variables = {
        **dict(ros.variables),
        "PATH": os.environ.get("PATH", os.defpath),
        "HOME": str(folder / "home"),
        "TMPDIR": str(folder / "tmp"),
        "LANG": "C.UTF-8",
        "PYTHONPATH": os.pathsep.join([str(folder / "code"), *ros.paths]),
        "PYTHONNOUSERSITE": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        VARIABLE: str(folder / "request.json"),
    }

    if request.ros == 2:
        variables["ROS_LOG_DIR"] = str(folder / "home")

    def of_node() -> dict[str, str]:
        told: dict[str, str] = json.loads((folder / NODE_FILE).read_text())["variables"]
        home = str(folder.parent / "home")
        own = {name: home for name in ("ROS_HOME", "ROS_LOG_DIR") if name in told}
        return told | own

    program = {"argv": (ros.python, "-P", "-m", "slamhive.playback.player"), "cwd": str(folder)}
    return PreparedPlayer(program | {"env": variables}, folder / READY_FILE, of_node)


def other_processors(cpus: tuple[int, ...]) -> set[int]:
    """Return the processors on which nothing is measured, all of ours where there are no others."""
    everything = os.sched_getaffinity(os.getpid())
    return everything.difference(cpus) or everything


class _elsewhere:  # noqa: N801 - reads as a statement
    """Lets what this thread starts run on all processors but some, if there are others."""

    def __init__(self, cpus: tuple[int, ...]) -> None:
        self._cpus = cpus

    def __enter__(self) -> None:
        self._before = os.sched_getaffinity(0)
        os.sched_setaffinity(0, other_processors(self._cpus))

    def __exit__(self, *_: object) -> None:
        os.sched_setaffinity(0, self._before)
