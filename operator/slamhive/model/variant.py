# SPDX-License-Identifier: Apache-2.0
"""Description of a prepared variant: what its preparation reports, as the Dataset's status keeps it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, StringConstraints

from slamhive.model.base import Scalar  # noqa: TC001 - the type of a field
from slamhive.model.configuration import PreparedRecording
from slamhive.model.sensors import Extrinsics  # noqa: TC001 - the type of a field

FolderName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=128)]
"""A folder's own name: no path, so that it leads nowhere else."""

TruthKind = Literal["poses", "positions", "points", "relations"]
"""Kinds of ground truth: poses, positions without orientation, control points, or relations between times."""


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
