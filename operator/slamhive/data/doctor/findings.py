# SPDX-License-Identifier: Apache-2.0
"""Findings: what is wrong with a recording, under a stable code."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.model.base import Choice

if TYPE_CHECKING:
    from collections.abc import Mapping


class Severity(Choice):
    """Weight of a finding: errors keep runs from working, warnings change figures, notes explain."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """A fault, or an oddity, of a recording.

    Attributes:
        code: Its stable name, such as ``points.times.unit``.
        severity: How much it weighs.
        message: A sentence: the field, what was found, what it does to which algorithms, and what helps.
        sensor: Name of the sensor; ``groundTruth`` of the truth; None of the recording as a whole.
        count: How many messages have it.
        first: Sensor time of the first of them, s.
        value: What was measured, in ``unit``.
        unit: Unit of the value.
        repair: The change of the sensor's messages that would undo it, for a preparation that repairs; empty
            where none does.
    """

    code: str
    severity: Severity
    message: str
    sensor: str | None = None
    count: int = 1
    first: float | None = None
    value: float | None = None
    unit: str | None = None
    repair: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the finding as plain values."""
        return {
            "code": self.code,
            "severity": str(self.severity),
            "sensor": self.sensor,
            "count": self.count,
            "first": self.first,
            "value": self.value,
            "unit": self.unit,
            "message": self.message,
        }


def sensor_repair(sensor: str, **repair: Any) -> dict[str, Any]:
    """Return the repair of a sensor's messages, for `Finding.repair`."""
    return {"repair": {"sensors": {sensor: repair}}}
