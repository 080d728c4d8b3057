# SPDX-License-Identifier: Apache-2.0
"""One run as the player sees it: wire, ready, play, settle, write, end."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.playback.player.processes import AlgorithmProcesses
from slamhive.playback.player.recorder import Recorder, Track, merge_metrics, write_atomically
from slamhive.playback.protocol import NODE_FILE, READY_FILE, REPORT_FILE, PlayError

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.playback.player.wire import Wire
    from slamhive.playback.protocol import PlayRequest

_LOOK_SECONDS = 0.02
_POSE_LINK_SECONDS = 2.0
"""A node that takes its sensors' topics gets so long to announce its poses; some do it with the first."""
_SETTLE_LIMIT_SECONDS = 30.0


class Session:
    """Plays once.

    Args:
        request: What to play to whom.
        stopped: Asked whether we were told to go.
    """

    def __init__(self, request: PlayRequest, stopped: Callable[[], bool]) -> None:
        self._request = request
        self._stopped = stopped
        self._folder = Path(request.folder)
        self._output = Path(request.output)
        self._algorithm = AlgorithmProcesses(request.algorithm)
        self._recorder = Recorder(request.frames, request.poses.moved)
        known = request.keyframes
        self._keyframes = Track(request.frames.time_offset + known.moved) if known is not None else None
        self._report: dict[str, Any] = {}
        # The player reads the recording: the algorithm's CPU has nothing of it.
        self._numbers: dict[str, Any] = {"readerCpuSeconds": 0.0}
        self._wire: Wire | None = None
        self._silent = False

    def run(self) -> int:
        """Play, and return the exit status: 0 unless playing itself failed."""
        status = 0
        try:
            self._play()
        except PlayError as error:
            sys.stderr.write(f"{error}\n")
            # Whoever tells a container to end tells us and what we started, which may be gone before we look.
            if self._wire is None or not self._stopped():
                status = 1
                self._tell("Failed", reason=error.reason, message=str(error))
        finally:
            self._write()
            self._end()
        while self._request.stay and not self._stopped():
            time.sleep(_LOOK_SECONDS * 5)
        return status

    def _play(self) -> None:
        request = self._request
        if (self._output / REPORT_FILE).exists():
            raise PlayError("the player was started again in the middle of the run")
        self._folder.mkdir(parents=True, exist_ok=True)
        if not Path(request.recording).exists():
            raise PlayError(f"{request.recording} isn't there to be played")
        wire = self._wire = self._connect()
        write_atomically(self._folder / NODE_FILE, json.dumps({"variables": dict(wire.variables)}) + "\n")
        self._tell("Waiting")
        # Whoever watches a node that dies looks before all is written: who read the recording is known now.
        merge_metrics(self._output / "metrics.json", self._numbers)
        (self._folder / READY_FILE).touch()
        if not self._wait_until_ready(wire):
            return
        begin, begun = time.time(), time.monotonic()
        self._tell("Playing", playStart=begin)
        played = wire.play(self._goes_on)
        self._numbers |= wire.numbers()
        if played:
            self._numbers["playSeconds"] = round(time.monotonic() - begun, 3)
            if self._settle():
                self._silent = wire.has_poses and not self._recorder.count
                self._tell("Ended", playEnd=self._last_word(), message=wire.remark())

    def _connect(self) -> Wire:
        """Return the wire to a node of the request's ROS, which alone is imported."""
        asked = (self._request, self._folder, self._recorder, self._keyframes, self._stopped)
        if self._request.ros == 1:
            from slamhive.playback.player.ros1.wire import Ros1Wire  # noqa: PLC0415

            return Ros1Wire(*asked)
        from slamhive.playback.player.ros2.wire import Ros2Wire  # noqa: PLC0415

        return Ros2Wire(*asked)

    def _wait_until_ready(self, wire: Wire) -> bool:
        """Wait until the node takes its sensors' topics; its time counts from its first process."""
        request = self._request
        seen: float | None = None
        taken_at: float | None = None
        while not self._stopped():
            wire.check()
            now = time.monotonic()
            if seen is None:
                seen = now if self._algorithm.seen() else None
            elif not self._algorithm.lives():
                return False
            obstacle = wire.obstacle()
            if obstacle is None:
                taken_at = taken_at or now
                # Some nodes announce their poses with the first one; who has announced them is waited for.
                late = now > taken_at + _POSE_LINK_SECONDS
                if wire.has_poses or (late and not wire.announces_poses):
                    return True
            if seen is not None and now > seen + request.ready_seconds:
                if obstacle is None:
                    return True  # its poses may be of another type; it may write its trajectory itself
                raise PlayError(obstacle.sentence(request.ready_seconds), obstacle.reason)
            time.sleep(_LOOK_SECONDS)
        return False

    def _goes_on(self) -> bool:
        """Tell whether to go on; not when the algorithm has ended, or we are to go."""
        if self._wire is not None:
            self._wire.check()
        return not self._stopped() and self._algorithm.lives()

    def _settle(self) -> bool:
        """Wait until no more poses come, at most as long as the recording lasts; False as before."""
        request = self._request
        quiet = request.settle_seconds
        limit = max(_SETTLE_LIMIT_SECONDS, (request.data_seconds or 0.0) / request.rate)
        begin = time.time()
        while not self._stopped() and self._algorithm.lives():
            now, last = time.time(), (self._latest() or 0) / 1e9
            if now > max(last, begin) + quiet or now > begin + limit:
                return True
            time.sleep(_LOOK_SECONDS)
        return False

    def _last_word(self) -> float:
        """Return the time the algorithm was done, s: of its last pose, or of the last played to it."""
        return (self._latest() or time.time_ns()) / 1e9

    def _latest(self) -> int | None:
        """Return the time of the last pose, ns, that of a keyframe included."""
        tracks = (self._recorder, self._keyframes)
        return max((track.latest for track in tracks if track and track.latest is not None), default=None)

    def _write(self) -> None:
        """Write what was heard. The algorithm still runs, so that whoever watches it finds all at its end."""
        recorder, output = self._recorder, self._output
        if self._silent:  # a node that publishes poses, but tracked nothing
            write_atomically(output / "trajectory.txt", "# the node published no pose\n")
        if self._keyframes is not None and self._keyframes.count:
            write_atomically(output / "trajectory.keyframes.txt", self._keyframes.final())
        if recorder.count:
            final, online = recorder.final(), recorder.online()
            write_atomically(output / "trajectory.txt", final)
            if online != final:
                write_atomically(output / "trajectory.online.txt", online)
            write_atomically(output / "latency.csv", recorder.table())
            if covariances := recorder.covariances():
                write_atomically(output / "covariances.csv", covariances)
        # That the player read the recording holds where nothing was played too.
        played = recorder.count or "playSeconds" in self._numbers
        merge_metrics(output / "metrics.json", self._figures() if played else self._numbers)

    def _end(self) -> None:
        """End the algorithm, then what we started; keep the poses as published if it wrote its own."""
        path = self._output / "trajectory.txt"
        ended = self._wire is not None and self._report.get("state") == "Ended"
        unheard = self._unheard() if ended and not self._recorder.count else ""
        if not self._stopped():
            self._algorithm.end(self._request.end_seconds, self._stopped)
        if self._wire is not None:
            self._wire.end()
        if unheard and not path.exists():  # nor did it write its poses itself
            self._tell("Failed", reason="AlgorithmFailed", message=unheard)
        if self._recorder.count and path.is_file() and not path.is_symlink():
            online = self._recorder.online()
            if path.stat().st_size != len(online) or path.read_text(errors="replace") != online:
                write_atomically(self._output / "trajectory.online.txt", online)

    def _unheard(self) -> str:
        """Return the sentence for a node of which no poses were heard, with those that it publishes."""
        found = ", ".join(self._wire.published()) if self._wire is not None else ""
        topic, field = self._request.poses.topic, f"ros{self._request.ros}.poses"
        elsewhere = f"it publishes {found}" if found else "it publishes none elsewhere"
        return f"the node published no poses on {topic} ({field} of its Algorithm); {elsewhere}"

    def _figures(self) -> dict[str, Any]:
        """Return the numbers that become results."""
        factor = self._recorder.factor(self._request.rate, stepped=self._request.stepped)
        known = {} if factor is None else {"realTimeFactor": factor}
        return self._recorder.metrics() | known | self._numbers

    def _tell(self, state: str, **fields: Any) -> None:
        self._report |= {"state": state, **fields}
        write_atomically(self._output / REPORT_FILE, json.dumps(self._report, indent=1) + "\n")
