# SPDX-License-Identifier: Apache-2.0
"""What the player's report says about how a run ended."""

from __future__ import annotations

import json
import os
import stat
from typing import TYPE_CHECKING, NamedTuple

from slamhive.playback.protocol import REPORT_FILE

if TYPE_CHECKING:
    from pathlib import Path

_REPORT_BYTES = 64 << 10
_REASONS = ("AlgorithmFailed", "SystemFault")


class Played(NamedTuple):
    """How playing ended.

    Attributes:
        completed: The recording was played to its end and the node was asked to end. How it ends then says
            nothing of its poses: many nodes crash when they are told to go.
        reason: Why playing failed, None if it didn't.
        message: What went wrong.
    """

    completed: bool
    reason: str | None = None
    message: str | None = None


def read_report(output: Path | str) -> Played | None:
    """Read the player's report from an output folder, None if there is none that makes sense."""
    try:
        descriptor = os.open(
            f"{output}/{REPORT_FILE}", os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        )
        with open(descriptor, "rb") as file:  # noqa: PTH123
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                return None
            found = json.loads(file.read(_REPORT_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    if found.get("state") != "Failed":
        return Played(found.get("state") == "Ended")
    reason = found.get("reason")
    return Played(
        False,
        reason if reason in _REASONS else _REASONS[1],
        str(found.get("message") or "the player failed")[:1000],
    )
