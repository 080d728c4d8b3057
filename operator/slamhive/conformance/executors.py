# SPDX-License-Identifier: Apache-2.0
"""Port of what starts an algorithm for a check: a process here, a container, a cluster."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from slamhive_eval import EvaluationError, read_tum

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.conformance.damaging import Damage
    from slamhive.model.algorithm import Mode, Pace
    from slamhive.model.results import RunRecord
    from slamhive_eval import Trajectory

_MOST_BYTES = 64 << 20


@dataclass(frozen=True)
class CheckStart:
    """One start of the algorithm.

    Attributes:
        mode: the sensor mode.
        number: of equal starts, which this is.
        timeout: how long it may take, s.
        damage: what its recording lacks; None: nothing.
        stop_after: when it is told to end, s after its start; None: it ends by itself.
        pace: the pace; None: the algorithm's first.
    """

    mode: Mode
    timeout: float
    number: int = 0
    damage: Damage | None = None
    stop_after: float | None = None
    pace: Pace | None = None


@dataclass(frozen=True, eq=False)
class CheckEnd:
    """Outcome of one start of an algorithm in a check: the run's record, trajectory and exit.

    Attributes:
        record: the run, as it would be recorded.
        text: the trajectory as it was written, empty where there is none.
        trajectory: the same, read; None where it has no pose or can't be read.
        exit_code: of the program, None where a signal ended it or nobody knows.
        signal: that ended it.
        settings: settings files that were rendered, with whether the program opened them; None: that can't be
            told.
        stop_seconds: from being told to end until it had ended.
        absent: why its trajectory can't be looked at, empty where it can.
    """

    record: RunRecord
    text: bytes = b""
    trajectory: Trajectory | None = None
    exit_code: int | None = None
    signal: int | None = None
    settings: dict[str, bool | None] = field(default_factory=dict)
    stop_seconds: float | None = None
    absent: str = ""


def read_poses(path: Path) -> tuple[bytes, Trajectory | None]:
    """Return a trajectory as it was written, and read; nothing of one that is too long, or has no pose."""
    if not path.is_file() or path.stat().st_size > _MOST_BYTES:
        return b"", None
    text = path.read_bytes()
    try:
        return text, read_tum(path)
    except EvaluationError:  # written without a pose
        return text, None


class CheckExecutor(Protocol):
    """Interface to start an algorithm for a check and get the outcome: on this machine or on a cluster."""

    @property
    def name(self) -> str:
        """Return the executor's name for users."""

    def objection(self, start: CheckStart) -> str | None:
        """Say why something can't be started like this here, None where it can."""

    def run(self, start: CheckStart) -> CheckEnd:
        """Start the algorithm and wait for its end, which is certain to come.

        Raises:
            SlamHiveError: it can't be started here at all.
        """
