# SPDX-License-Identifier: Apache-2.0
"""Prepared variants: programs that make them, their descriptions, and findings of their recordings."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import ConfigDict, Field, StringConstraints, model_validator

from slamhive.model.algorithm import LocalProgram
from slamhive.model.base import Choice, Duration, Image, Model, Quantity, Scalar, optional
from slamhive.model.canonical import digest
from slamhive.model.configuration import PreparedRecording
from slamhive.model.errors import suggestion
from slamhive.model.run import NO_PROGRAM
from slamhive.model.sensors import ROLE_TYPES, Extrinsics, Role, SensorType

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


class GivenSensor(Model):
    """Sensor that a preparing program gives: a picture for each frame of a camera, of the same view."""

    follows: Role = Field(description="Role of the camera whose frames, calibration and mounting it has.")
    depth_scale: float | None = optional("Depth: units of its images per metre.", gt=0)


class PreparingProgram(Model):
    """Program that makes other frames of those of a Dataset, such as masked images, or depth."""

    description: str = Field(default="", description="One sentence.")
    image: Image | None = optional("Container image.")
    command: list[str] = Field(
        default_factory=list, description="Program in the container; default: its own."
    )
    local: LocalProgram | None = optional("How to run it without a container.")
    gives: dict[str, GivenSensor] | None = optional("Sensors by role that the recording hasn't got.")
    memory: Quantity = Field(default="4Gi", description="Memory.")
    disk: Quantity = Field(default="20Gi", description="Disk space for what it writes.")
    timeout: Duration = Field(default="1h", description="Longest time for a recording.")

    @model_validator(mode="after")
    def _is_program(self) -> Self:
        if self.image is None and self.local is None:
            raise ValueError("give an image, or local for a program without a container")
        roles = [str(role) for role in Role]
        for name in self.gives or {}:
            if name not in roles:
                raise ValueError(f"gives: unknown role {name!r}{suggestion(name, roles)}")
        for role, given in self.given.items():
            if ROLE_TYPES[role] not in {SensorType.CAMERA, SensorType.DEPTH_CAMERA}:
                raise ValueError(f"gives.{role}: only cameras can be given, and it is a {ROLE_TYPES[role]}")
            if ROLE_TYPES[given.follows] is not SensorType.CAMERA or given.follows in self.given:
                raise ValueError(
                    f"gives.{role}.follows: expected the role of a recorded camera, found {given.follows!r}"
                )
            if (ROLE_TYPES[role] is SensorType.DEPTH_CAMERA) != (given.depth_scale is not None):
                raise ValueError(f"gives.{role}.depthScale: needed for depth, and for nothing else")
        return self

    @property
    def given(self) -> dict[Role, GivenSensor]:
        """Return the sensors that it gives, by role."""
        return {Role(name): given for name, given in (self.gives or {}).items()}

    def recorded(self, roles: Iterable[Role]) -> tuple[Role, ...]:
        """Return the roles that a recording must fill so that the program can give those of a run."""
        given = self.given
        return tuple(dict.fromkeys(given[role].follows if role in given else role for role in roles))


def program_title(name: str, dataset: str) -> str:
    """Return the name for a preparing program in sentences."""
    return f"the preparation {name!r} of dataset {dataset!r}"


def program_digest(program: PreparingProgram) -> str:
    """Return the digest that tells a preparing program from others, where only its image's name is known."""
    return digest({"image": program.image, "command": program.command})


_PROGRAM_NAME = re.compile(r"[a-z0-9]([-a-z0-9]{0,38}[a-z0-9])?")


def misnamed(names: Iterable[str]) -> str | None:
    """Return a sentence on a preparing program's name that can't be one; None where there is no such."""
    for name in names:
        if name == NO_PROGRAM:
            return f"preparations: {name!r} means no program; choose another name"
        if not _PROGRAM_NAME.fullmatch(name):
            allowed = "lower-case letters, digits and -, at most 40"
            return f"preparations: {name!r} can't be a name; expected {allowed}"
    return None


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
    prepared_by: str | None = optional("Digest of the program that made its frames.", max_length=64)
    findings: list[str] | None = Field(default=None, description="Codes of what is wrong with its recording.")
    suspicion: str | None = Field(
        default=None, max_length=SUSPICION_LENGTH, description="What may be why programs fail on it."
    )
