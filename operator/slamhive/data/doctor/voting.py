# SPDX-License-Identifier: Apache-2.0
"""Streams that tell how a body turned, and which of them is to blame where they disagree: the fewer.

Kinds of sensors count, as two cameras have one clock. Ground truth is of another system, and counts half.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.model.sensors import SensorType
from slamhive.model.variant import TRUTH

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.data.doctor.matching import Match
    from slamhive.data.doctor.turning import Array

SEEING = (SensorType.CAMERA, SensorType.LIDAR)
"""Kinds of sensors whose turning is that of what they see."""
_SEEN_SECONDS = 0.004
"""Error of sights of cameras and LiDARs, beyond their noise, where clocks are right."""
_TRUTH_WEIGHT = 0.5


@dataclass(frozen=True, eq=False)
class TurningSensor:
    """Sensor, or ground truth, and how its turns fit those of the reference.

    Attributes:
        name: Of the sensor, or ``groundTruth``.
        kind: Type of the sensor, or ``groundTruth``.
        first: Its first time, s.
        body: Rotation of its frame in the body as stated, shape (3, 3).
        fit: How it fits; None of the reference itself.
        is_upright: Whether its specific forces, on average, say that z of the body is up.
    """

    name: str
    kind: str
    first: float
    body: Array
    fit: Match | None = None
    is_upright: bool = False

    @property
    def where(self) -> str:
        """Return the field of the manifest."""
        return TRUTH if self.kind == TRUTH else f"sensors.{self.name}"

    @property
    def error(self) -> float:
        """Return the error of the offset to the reference, s."""
        return self.fit.error + _SEEN_SECONDS * (self.kind in SEEING) if self.fit is not None else 0.0

    @property
    def drift(self) -> tuple[float, float]:
        """Return the drift against the reference and its error, s/s."""
        return (self.fit.drift, self.fit.drift_error) if self.fit is not None else (0.0, 0.0)

    def offset(self, time: float) -> float:
        """Return the offset to the reference at a time, s."""
        return self.fit.at(time) if self.fit is not None else 0.0


def most(
    streams: Sequence[TurningSensor], agree: Callable[[TurningSensor, TurningSensor], bool]
) -> tuple[list[TurningSensor], TurningSensor]:
    """Return the streams that agree with one another, and the surest of them: the reference, if it is one.

    Args:
        streams: The reference, then others.
        agree: Tells of two whether they do.
    """

    def together(one: TurningSensor) -> list[TurningSensor]:
        # The surest first: one that hardly tells agrees with all, and must not bring these together.
        found = [one]
        for other in sorted(streams, key=lambda stream: stream.error):
            if other is not one and all(agree(other, member) for member in found):
                found.append(other)
        return found

    def votes(members: list[TurningSensor]) -> float:
        kinds = {member.kind for member in members}
        return len(kinds) - (1.0 - _TRUTH_WEIGHT) * (TRUTH in kinds)

    # Of as many those of the first are right, which is the reference.
    members = max((together(one) for one in streams), key=votes)
    return members, min(members, key=lambda one: (one is not streams[0], one.error))
