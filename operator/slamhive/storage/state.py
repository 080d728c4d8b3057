# SPDX-License-Identifier: Apache-2.0
"""Outcome of the offloader's last walk, on the results volume, for who asks where results are."""

from __future__ import annotations

import time
from datetime import datetime
from typing import TYPE_CHECKING, Literal

from pydantic import ValidationError

from slamhive.model.base import Model

if TYPE_CHECKING:
    from pathlib import Path

STATE = ".offload.json"
_BYTES = 1 << 16
_LOOK_SECONDS = 30.0


class OffloadState(Model):
    """Outcome of a walk of the offloader.

    Attributes:
        v: version of the form.
        since: when it ended; with a problem, when the first one ended that had one.
        url: of the object storage.
        reason: what kept it from going on, in one word.
        problem: the same in a sentence; None where all went that may go.
        moved: run folders that it moved.
        waiting: run folders that may go and are still on the volume.
        stays: run folders that can't be copied.
    """

    v: Literal[1] = 1
    since: datetime
    url: str
    reason: str = "NothingMoved"
    problem: str | None = None
    moved: int = 0
    waiting: int = 0
    stays: int = 0

    def sentence(self) -> str | None:
        """Return the sentence that an owner has to know; None where all is well."""
        when = f"{self.since:%Y-%m-%d %H:%M} UTC"
        if self.problem:
            return (
                f"{self.reason} since {when}: run folders stay on the results volume "
                f"({self.waiting:,} wait): {self.problem}"
            )
        if self.stays:
            return (
                f"{self.stays:,} run folders can't be moved to {self.url} and stay on the results volume: "
                "the log of the offloader's Job says why"
            )
        return None


class OffloadingWatch:
    """Word that the offloader left, looked at twice a minute.

    Args:
        results: the results volume; None where it isn't mounted.
    """

    def __init__(self, results: Path | None) -> None:
        self._results = results
        self._next = 0.0
        self._sentence: str | None = None

    def sentence(self) -> str | None:
        """Return the sentence that an owner has to know; None where all is well, or nothing is said."""
        now = time.monotonic()
        if self._results is not None and now >= self._next:
            self._next = now + _LOOK_SECONDS
            state = read_state(self._results)
            self._sentence = state.sentence() if state is not None else None
        return self._sentence


def read_state(results: Path) -> OffloadState | None:
    """Return the end of the last walk; None where nothing, or nothing that can be read, says it."""
    try:
        with (results / STATE).open("rb") as file:
            return OffloadState.model_validate_json(file.read(_BYTES))
    except (OSError, ValidationError):
        return None
