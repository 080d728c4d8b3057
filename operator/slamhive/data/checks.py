# SPDX-License-Identifier: Apache-2.0
"""What makes a stream of messages unusable, said in one sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from slamhive.data.recordings import Scan

_DAY = 86_400 * 10**9


def check_stamps(scan: Scan, where: str) -> None:
    """Check that a sensor's stamps can be those of a sensor.

    Args:
        scan: Times of its messages.
        where: What they are, for the message.

    Raises:
        DataError: A stamp is zero, goes back, or is more than a day from the one before it.
    """
    stamps = scan.stamps
    if not len(stamps):
        raise DataError(f"{where}: no messages")
    wrong = np.flatnonzero(stamps <= 0)
    if wrong.size:
        which = "all stamps are" if wrong.size == len(stamps) else f"the stamp of message {wrong[0] + 1} is"
        raise DataError(
            f"{where}: {which} {stamps[wrong[0]] / 1e9:g} s; the driver did not stamp the messages"
        )
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if back.size:
        k = int(back[0])
        raise DataError(
            f"{where}: stamps must not decrease, but message {k + 2} of {len(stamps)} is stamped "
            f"{seconds_text(stamps[k + 1])}, after {seconds_text(stamps[k])}"
            + (f" ({back.size} times in all)" if back.size > 1 else "")
        )
    jump = np.flatnonzero(steps > _DAY)
    if jump.size:
        k = int(jump[0])
        raise DataError(
            f"{where}: message {k + 2} of {len(stamps)} is stamped {seconds_text(stamps[k + 1])}, "
            f"{steps[k] / _DAY:.0f} days after the one before it"
        )


def seconds_text(nanoseconds: int) -> str:
    """Write a stamp in s with every digit of its ns."""
    whole, rest = divmod(int(nanoseconds), 10**9)
    return f"{whole}.{rest:09d} s"
