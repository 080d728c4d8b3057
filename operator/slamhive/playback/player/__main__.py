# SPDX-License-Identifier: Apache-2.0
"""Entry of the player: the request comes in SLAMHIVE_PLAYER, as JSON or as the path of a file with it."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from pathlib import Path

from slamhive.playback.player.session import Session
from slamhive.playback.protocol import VARIABLE, PlayRequest

_PR_SET_DUMPABLE = 4


def main() -> int:
    """Play once and return the exit status."""
    # As the monitor does it, which is not there where ROS is: the algorithm has our user, and is not to see
    # what we hold. Our mark in the environment is closed too: the monitor knows us by the order of starts.
    ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0)
    text = os.environ.pop(VARIABLE, "")
    try:
        request = PlayRequest.from_json(
            text if text.startswith("{") else Path(text).read_text(encoding="utf-8")
        )
    except (OSError, ValueError) as error:
        sys.stderr.write(f"{VARIABLE}: {error}\n")
        return 2
    told: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _frame: told.append(number))
    return Session(request, lambda: bool(told)).run()


if __name__ == "__main__":
    status = main()
    sys.stderr.flush()
    # rospy's threads would keep an interpreter from ending that has heard all it wanted.
    os._exit(status)
