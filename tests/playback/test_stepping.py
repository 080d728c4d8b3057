# SPDX-License-Identifier: Apache-2.0
"""Frames that wait for poses: what a node answers, and when, is made up."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.playback.player.playing import Clockwork
from slamhive.playback.player.wire import Message

if TYPE_CHECKING:
    from collections.abc import Callable

MS = 1_000_000
PATIENCE = 0.02
SCANS = 6


def message(topic: str, at: int) -> Message:
    return Message(at * MS, topic, struct.pack("<4xII", 0, at * MS))


def recording() -> list[Message]:
    """Return scans that come at their start every 10 ms, and samples every 2 ms."""
    times = [("/points", at) for at in range(10, 10 + 10 * SCANS, 10)]
    times += [("/imu", at) for at in range(10, 12 + 10 * SCANS, 2)]
    return [message(topic, at) for topic, at in sorted(times, key=lambda one: (one[1], one[0] == "/imu"))]


class MadeUpNode:
    """A recorder and an outlet at once: whatever is published may be answered."""

    def __init__(self, answers: Callable[[list[Message]], set[int]]) -> None:
        self.played: list[Message] = []
        self._answers = answers
        self.waits = 0

    def publish(self, message: Message) -> None:
        self.played.append(message)

    def tick(self, now: int) -> None:
        """Hear the time."""

    def wait_for_pose(self, frame: int, seconds: float) -> bool:
        self.waits += seconds > 0
        return frame // MS in self._answers(self.played)


def play(answers: Callable[[list[Message]], set[int]]) -> dict[str, Any]:
    request = SimpleNamespace(
        frames=SimpleNamespace(topic="/points"), rate=1.0, stepped=True, step_seconds=PATIENCE
    )
    node = MadeUpNode(answers)
    clockwork = Clockwork(request, node, node)  # type: ignore[arg-type]
    assert clockwork.run(recording(), lambda: True)
    assert node.played == recording()
    return clockwork.numbers()


def scans(played: list[Message]) -> set[int]:
    return {one.time // MS for one in played if one.topic == "/points"}


def at_once(played: list[Message]) -> set[int]:
    return scans(played)


def with_samples_up_to_its_end(played: list[Message]) -> set[int]:
    newest = max((one.time // MS for one in played if one.topic == "/imu"), default=0)
    return {at for at in scans(played) if newest >= at + 10}


@pytest.mark.parametrize(
    ("answers", "in_vain", "behind"),
    [
        (at_once, 0, False),
        # Two by which it shows; the last has all that it needs.
        (with_samples_up_to_its_end, 2, True),
        (lambda _: set(), SCANS, False),
        # One scan that takes long is no sign.
        (lambda played: scans(played) - ({20} if len(scans(played)) == 2 else set()), 1, False),
    ],
    ids=["at once", "behind", "never", "once late"],
)
def test_frames_wait_for_poses(
    answers: Callable[[list[Message]], set[int]], in_vain: int, behind: bool
) -> None:
    numbers = play(answers)
    assert numbers["framesWaitedForInVain"] == in_vain
    assert numbers["answersAfterNextFrame"] is behind
    assert numbers["heldSeconds"] >= in_vain * PATIENCE - 0.001
