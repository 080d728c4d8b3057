# SPDX-License-Identifier: Apache-2.0
"""Playing of messages by the clock, or frame by frame: the same for all that can publish bytes."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Any

from slamhive.playback.player.poses import NANOSECONDS
from slamhive.playback.player.recorder import quantile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from slamhive.playback.player.recorder import Recorder
    from slamhive.playback.player.wire import Message, Outlet
    from slamhive.playback.protocol import PlayRequest

_TICK_SECONDS = 0.01
"""Between two of the clock's messages, as `rosbag play --clock` has it: enough for timers of 20 ms."""
_FRESH = round(0.005 * NANOSECONDS)
"""Age of the clock's last message at which a message that is played brings another, ns."""
_LOOK_SECONDS = 0.05
_SHOWN = 2
"""Frames in a row whose pose came behind the next frame, by which a node shows that it answers no sooner."""


class Clockwork:
    """Plays messages in the rhythm in which they were recorded, with the clock beside them.

    Stepped, time stands before each frame until the pose of the last one has come, or patience is at an end:
    what comes between two frames still comes in its rhythm, so that no queue of the node's overflows. A node
    that waits for what follows a frame, such as inertial samples up to a scan's end, may answer one only when
    the next has come: where that shows, the pose of the frame before the last is waited for instead.

    Args:
        request: Speed, and whether time stands before frames.
        recorder: Knows which frames have a pose.
        outlet: Publishes.
    """

    def __init__(self, request: PlayRequest, recorder: Recorder, outlet: Outlet) -> None:
        self._request = request
        self._recorder = recorder
        self._outlet = outlet
        self._goes_on: Callable[[], bool] = lambda: True
        self._first = self._told = 0
        self._begin = self._held = 0.0
        self._next_tick = self._next_look = 0.0
        self._late: list[float] = []
        self._frames: deque[int] = deque(maxlen=2)
        self._unmet: int | None = None
        self._impatient = self._behind = 0

    def run(self, messages: Iterable[Message], goes_on: Callable[[], bool]) -> bool:
        """Play messages, in the order of their times, and return whether it went to their end."""
        self._goes_on = goes_on
        frames, rate = self._request.frames.topic, self._request.rate
        for message in messages:
            if not self._begin:
                self._first, self._begin = message.time, time.monotonic()
            due = self._begin + (message.time - self._first) / NANOSECONDS / rate
            if not self._wait_until(due + self._held):
                return False
            if message.topic == frames:
                if self._request.stepped and not self._wait_for_pose():
                    return False
                self._frames.append(message.stamp)
            if message.time - self._told > _FRESH:
                self._tick(message.time)
            self._late.append(time.monotonic() - due - self._held)
            self._outlet.publish(message)
        return not self._request.stepped or self._wait_for_pose(at_end=True)

    def numbers(self) -> dict[str, Any]:
        """Return the lateness of messages, and the time that stood, for metrics.json."""
        late = sorted(self._late) or [0.0]
        found: dict[str, Any] = {
            "playerLateSeconds": {"p99": round(quantile(late, 0.99), 6), "max": round(late[-1], 6)}
        }
        if self._request.stepped:
            found |= {"heldSeconds": round(self._held, 3), "framesWaitedForInVain": self._impatient}
            found["answersAfterNextFrame"] = self._is_behind
        return found

    @property
    def _is_behind(self) -> bool:
        return self._behind >= _SHOWN

    def _wait_for_pose(self, *, at_end: bool = False) -> bool:
        """Let time stand until the last frame has its pose, or the one before of a node that is behind."""
        if self._unmet is not None and not self._is_behind:
            self._behind = self._behind + 1 if self._recorder.wait_for_pose(self._unmet, 0.0) else 0
        self._unmet = None
        known = list(self._frames)
        if self._is_behind and not at_end:
            known = known[:-1]
        if not known:
            return True
        begin = now = time.monotonic()
        patience = begin + self._request.step_seconds
        while not self._recorder.wait_for_pose(known[-1], min(patience - now, _LOOK_SECONDS)):
            now = time.monotonic()
            if not self._goes_on():
                return False
            if now >= patience:
                self._impatient += 1
                self._unmet = known[-1]
                break
        self._held += time.monotonic() - begin
        return True

    def _wait_until(self, due: float) -> bool:
        while True:
            now = time.monotonic()
            if now >= self._next_look:
                if not self._goes_on():
                    return False
                self._next_look = now + _LOOK_SECONDS
            if now >= due:
                return True
            if now >= self._next_tick:
                gone = (now - self._begin - self._held) * self._request.rate
                self._next_tick = now + _TICK_SECONDS
                self._tick(self._first + round(gone * NANOSECONDS))
            time.sleep(max(min(due, self._next_tick, self._next_look) - time.monotonic(), 0.0))

    def _tick(self, now: int) -> None:
        if now > self._told:
            self._told = now
            self._next_tick = time.monotonic() + _TICK_SECONDS
            self._outlet.tick(now)
