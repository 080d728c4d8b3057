# SPDX-License-Identifier: Apache-2.0
"""Judgement of an attempt with a player: joins how the program ended with how playing ended.

Workstation and operator use the same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from slamhive.model.results import Reason

if TYPE_CHECKING:
    from slamhive.engine import AttemptEnd
    from slamhive.playback.outcome import Played


def judge(end: AttemptEnd, played: Played | None) -> AttemptEnd:
    """Return the end of an attempt in the light of playing's.

    Args:
        end: As its supervisor says.
        played: As the player says, None where nothing was to be played.
    """
    if played is None or end.reason not in {None, Reason.ALGORITHM_FAILED, Reason.CANCELLED}:
        return end
    if played.completed:
        remark = "; ".join(filter(None, (end.remark, played.message))) or None
        return replace(end, exit_code=0, signal=None, reason=None, message=None, remark=remark)
    if played.reason is not None:
        return replace(end, reason=Reason(played.reason), message=played.message)
    if end.reason is Reason.CANCELLED:
        return replace(end, reason=Reason.SYSTEM_FAULT, message="the player was killed")
    return end
