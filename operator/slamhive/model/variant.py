# SPDX-License-Identifier: Apache-2.0
"""Description of a prepared variant, and findings of its recording, as statuses and homes keep them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import ConfigDict, Field, StringConstraints

from slamhive.model.base import Choice, Model, Scalar
from slamhive.model.configuration import PreparedRecording
from slamhive.model.sensors import Extrinsics  # noqa: TC001 - the type of a field

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

FolderName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=128)]
"""A folder's own name: no path, so that it leads nowhere else."""

TruthKind = Literal["poses", "positions", "points", "relations"]
"""Kinds of ground truth: poses, positions without orientation, control points, or relations between times."""

SUSPICION_LENGTH = 1000
"""Characters of a description, which has 4096 bytes in all, compressed."""
TRUTH = "groundTruth"
"""Sensor of findings of the ground truth."""


class Severity(Choice):
    """Weight of a finding: errors keep runs from working, warnings change figures, notes explain."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


class OpenFinding(Model):
    """Finding of a recording that its dataset's manifest doesn't repair, as far as runs need it."""

    model_config = ConfigDict(extra="ignore")

    code: str = Field(max_length=64)
    severity: Severity
    sensor: str | None = Field(default=None, max_length=253, description="None: the recording as a whole.")
    message: str
    repair: str | None = Field(default=None, description="Line of the manifest that repairs it.")

    def concerns(self, sensors: Collection[str]) -> bool:
        """Tell whether runs with the sensors of some names read what it is of."""
        return self.sensor is None or self.sensor in sensors

    @property
    def sentence(self) -> str:
        """Return its message with its code, and what repairs it."""
        repair = f"; in its spec: {self.repair}" if self.repair else ""
        return f"{self.message} ({self.code}{repair})"


def preventing(findings: Iterable[OpenFinding], sensors: Collection[str]) -> OpenFinding | None:
    """Return the finding that makes runs with the sensors of some names impossible; None where none does.

    An error of the ground truth prevents none: it concerns what a run is measured by.
    """
    return next((one for one in findings if one.severity is Severity.ERROR and one.concerns(sensors)), None)


def suspicion(findings: Iterable[OpenFinding], sensors: Collection[str]) -> str | None:
    """Return the finding that a program with some sensors may have failed of; None where there is none.

    Args:
        findings: the gravest first.
        sensors: names of the sensors that it was given.
    """
    found = [one for one in findings if one.severity is not Severity.NOTE and one.concerns(sensors)]
    if not found:
        return None
    others = ", ".join(dict.fromkeys(one.code for one in found[1:] if one.code != found[0].code))
    return f"its recording may be why: {found[0].sentence}{f'; also {others}' if others else ''}"


def open_codes(findings: Iterable[OpenFinding], sensors: Collection[str]) -> list[str] | None:
    """Return the codes of errors and warnings that results with the sensors of some names are to be seen by.

    None where there is none.
    """
    codes = {
        one.code
        for one in findings
        if one.severity is not Severity.NOTE and (one.concerns(sensors) or one.sensor == TRUTH)
    }
    return sorted(codes) or None


class VariantDescription(PreparedRecording):
    """A variant on the data volume, as its preparation writes it and the operator reads it."""

    model_config = ConfigDict(extra="ignore")

    folder: FolderName = Field(description="Its folder below variants/.")
    frames: int = Field(ge=0, le=2**53)
    recorded_seconds: float | None = Field(default=None, ge=0)
    key: str = Field(max_length=128)
    source_sha256: str = Field(max_length=64)
    dataset_sha256: str = Field(max_length=64)
    size_bytes: int = Field(default=0, ge=0, le=2**53)
    ground_truth: TruthKind | None = None
    T_body_frame: Extrinsics | None = Field(default=None, alias="T_body_frame")
    extrinsics: dict[str, Extrinsics] = Field(default_factory=dict)
    gravity_aligned: bool | None = Field(
        default=None, description="Whether the ground truth's z axis points up; None in earlier ones."
    )
    attributes: dict[str, Scalar] = Field(default_factory=dict, description="To select and plot by.")
    preparation_version: int = 1
    findings: list[str] | None = Field(default=None, description="Codes of what is wrong with its recording.")
    suspicion: str | None = Field(
        default=None, max_length=SUSPICION_LENGTH, description="What may be why programs fail on it."
    )
