# SPDX-License-Identifier: Apache-2.0
"""Recording whose messages have passed, as judgements between its sensors take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.data.doctor.watching import WatchedRecording
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.data.recordings.reading import Recording
    from slamhive_eval import Trajectory


@dataclass(frozen=True)
class Examined:
    """All that is known of a recording once its messages have passed, for judgements between its sensors.

    Attributes:
        entry: The dataset.
        recording: Its open recording.
        watched: The times of its messages, and the watchers.
        truth: Its ground truth; None where it has no poses, or can't be read.
        is_sample: Whether no more than some messages of each sensor have passed.
        progress: Called with the name of a sensor whose frames are looked at again, and the share done.
    """

    entry: DatasetEntry
    recording: Recording
    watched: WatchedRecording
    truth: Trajectory | None
    is_sample: bool = False
    progress: Callable[[str, float], None] = lambda *_: None
