# SPDX-License-Identifier: Apache-2.0
"""One run as the player sees it: master, ready, play, settle, write, end."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.playback.player.processes import AlgorithmProcesses
from slamhive.playback.player.programs import Master, RosProgram, play_bag
from slamhive.playback.player.recorder import Recorder, Track, merge_metrics, write_atomically
from slamhive.playback.protocol import MASTER_FILE, READY_FILE, REPORT_FILE, PlayError

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.playback.player.node import Ears
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
        self._numbers: dict[str, Any] = {}
        self._master: Master | None = None
        self._bag: RosProgram | None = None
        self._silent = False

    def run(self) -> int:
        """Play, and return the exit status: 0 unless playing itself failed."""
        status = 0
        try:
            self._play()
        except PlayError as error:
            status = 1
            self._tell("Failed", reason=error.reason, message=str(error))
            sys.stderr.write(f"{error}\n")
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
        if not Path(request.recording).is_file():
            raise PlayError(f"{request.recording} isn't there to be played")
        self._master = Master(self._folder, request.port, self._stopped)
        # rospy looks for the master as soon as it is imported.
        from slamhive.playback.player.node import Ears, release_bag  # noqa: PLC0415

        ears = Ears(request.poses, request.frames, self._recorder)
        if request.keyframes is not None and self._keyframes is not None:
            ears.hear_poses(request.keyframes, self._keyframes)
        self._master.set_simulated_time()
        self._bag = play_bag(self._folder, request.recording, request.rate, request.topics | request.remap)
        write_atomically(self._folder / MASTER_FILE, json.dumps({"uri": self._master.uri}) + "\n")
        self._tell("Waiting")
        (self._folder / READY_FILE).touch()
        if not self._wait_until_ready(ears):
            return
        begin, begun = time.time(), time.monotonic()
        self._tell("Playing", playStart=begin)
        release_bag()
        if self._wait_for_bag():
            seconds = time.monotonic() - begun
            self._numbers["playSeconds"] = round(seconds, 3)
            if self._settle():
                self._silent = ears.has_poses and not self._recorder.count
                self._tell("Ended", playEnd=self._last_word())

    def _wait_until_ready(self, ears: Ears) -> bool:
        """Wait until the node takes its sensors' topics; its time counts from its first process."""
        request = self._request
        wanted = list(request.topics.values())
        seen: float | None = None
        taken_at: float | None = None
        while not self._stopped():
            self._check()
            now = time.monotonic()
            if seen is None:
                seen = now if self._algorithm.seen() else None
            elif not self._algorithm.lives():
                return False
            missing = sorted(set(wanted) - set(self._master.taken(wanted))) if self._master else wanted
            if not missing and ears.linked:
                taken_at = taken_at or now
                # Some nodes announce their poses with the first one; who has announced them is waited for.
                late = now > taken_at + _POSE_LINK_SECONDS
                if ears.has_poses or (late and not self._announces(request.poses.topic)):
                    return True
            if seen is not None and now > seen + request.ready_seconds:
                if not missing and ears.linked:
                    return True  # its poses may be of another type; it may write its trajectory itself
                what = f"did not subscribe to {', '.join(missing)}" if missing else "could not be heard"
                raise PlayError(f"the node {what} in {request.ready_seconds:g} s", "AlgorithmFailed")
            time.sleep(_LOOK_SECONDS)
        return False

    def _announces(self, topic: str) -> bool:
        return self._master is not None and self._master.has_publisher(topic)

    def _check(self) -> None:
        if self._master is not None:
            self._master.check()
        if self._bag is not None and self._bag.status is not None:
            raise PlayError(f"rosbag play ended before it began: {self._bag.last_line()}")

    def _wait_for_bag(self) -> bool:
        """Wait for the end of the bag; False when the algorithm ended first, or we are to go."""
        while self._bag is not None and self._bag.status is None:
            if self._stopped() or not self._algorithm.lives():
                return False
            if self._master is not None:
                self._master.check()
            time.sleep(_LOOK_SECONDS)
        if self._bag is not None and self._bag.status:
            raise PlayError(f"rosbag play failed: {self._bag.last_line()}")
        return True

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
            merge_metrics(output / "metrics.json", recorder.metrics() | self._numbers)
        if self._keyframes is not None and self._keyframes.count:
            write_atomically(output / "trajectory.keyframes.txt", self._keyframes.final())
        if not recorder.count:
            return
        final, online = recorder.final(), recorder.online()
        write_atomically(output / "trajectory.txt", final)
        if online != final:
            write_atomically(output / "trajectory.online.txt", online)
        write_atomically(output / "latency.csv", recorder.table())
        merge_metrics(output / "metrics.json", recorder.metrics() | self._numbers)

    def _end(self) -> None:
        """End the algorithm, then what we started; keep the poses as published if it wrote its own."""
        if not self._stopped():
            self._algorithm.end(self._request.end_seconds, self._stopped)
        for program in (self._bag, self._master):
            if program is not None:
                program.end()
        path = self._output / "trajectory.txt"
        if self._recorder.count and path.is_file() and not path.is_symlink():
            online = self._recorder.online()
            if path.stat().st_size != len(online) or path.read_text(errors="replace") != online:
                write_atomically(self._output / "trajectory.online.txt", online)

    def _tell(self, state: str, **fields: Any) -> None:
        self._report |= {"state": state, **fields}
        write_atomically(self._output / REPORT_FILE, json.dumps(self._report, indent=1) + "\n")
