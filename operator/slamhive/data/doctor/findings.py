# SPDX-License-Identifier: Apache-2.0
"""Findings: what is wrong with a recording, under a stable code, with the line that repairs it."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.model.variant import OpenFinding, Severity

if TYPE_CHECKING:
    from collections.abc import Mapping


__all__ = ["BY_NUMBER", "Finding", "Severity", "sensor_repair"]

BY_NUMBER = ("drop", "dropLeading")
"""Repairs that count messages."""


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
        repair: What to add to the Dataset's spec; empty where no line of the manifest helps.
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

    @property
    def repair_line(self) -> str | None:
        """Return the repair as one line of YAML, to be put into the spec; None where there is none."""
        if not self.repair:
            return None
        return ", ".join(f"{key}: {json.dumps(value)}" for key, value in self.repair.items())

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
            "repair": self.repair_line,
        }

    @property
    def as_known(self) -> OpenFinding:
        """Return the finding as runs need it."""
        return OpenFinding(
            code=self.code,
            severity=self.severity,
            sensor=self.sensor,
            message=self.message,
            repair=self.repair_line,
        )


def sensor_repair(sensor: str, **repair: Any) -> dict[str, Any]:
    """Return the repair of a sensor's messages, for `Finding.repair`; keys as in `slamhive.model.repair`."""
    return {"repair": {"sensors": {str(sensor): repair}}}
