# SPDX-License-Identifier: Apache-2.0
"""Outcome of playing: the player's report, read for the supervisor and the operator."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, NamedTuple

from slamhive.contract.files import read_regular
from slamhive.playback.protocol import REPORT_FILE

if TYPE_CHECKING:
    from pathlib import Path

_REPORT_BYTES = 64 << 10
_REASONS = ("AlgorithmFailed", "SystemFault")


class Played(NamedTuple):
    """Outcome of playing a recording to a ROS node: completed, or why it failed.

    Attributes:
        completed: The recording was played to its end and the node was asked to end. How it ends then says
            nothing of its poses: many nodes crash when they are told to go.
        reason: Why playing failed, None if it didn't.
        message: What went wrong, or was odd where it didn't fail.
    """

    completed: bool
    reason: str | None = None
    message: str | None = None


def read_report(output: Path | str) -> Played | None:
    """Read the player's report from an output folder, None if there is none that makes sense."""
    try:
        found = json.loads(read_regular(f"{output}/{REPORT_FILE}", _REPORT_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    message = str(found.get("message") or "")[:1000]
    if found.get("state") != "Failed":
        return Played(found.get("state") == "Ended", message=message or None)
    reason = found.get("reason")
    return Played(False, reason if reason in _REASONS else _REASONS[1], message or "the player failed")
