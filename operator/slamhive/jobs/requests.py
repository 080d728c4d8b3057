# SPDX-License-Identifier: Apache-2.0
"""Requests to Jobs, as JSON: what to prepare, to evaluate, to read or to bring back."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, StringConstraints

from slamhive.analysis.subjects import SubjectItem
from slamhive.model.algorithm import RelativePath, SettingsFile
from slamhive.model.base import Model, Name, Sha256
from slamhive.model.dataset import Dataset
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role


class FetchedAsset(Model):
    """A file that an algorithm needs, to be fetched."""

    name: RelativePath
    url: str = Field(pattern=r"^https://")
    sha256: Sha256


class PrepareRequest(Model):
    """A variant to make."""

    dataset: Dataset
    roles: list[Role] = Field(min_length=1)
    input: InputOptions = Field(default_factory=InputOptions)
    formats: list[DataFormat] = Field(min_length=1)
    assets: list[FetchedAsset] = Field(default_factory=list)
    topics: list[str] | None = None


class RenderRequest(Model):
    """Settings files to render before an algorithm starts."""

    files: list[SettingsFile] = Field(min_length=1)
    run: str = Field(pattern=r"^/", description="The run folder as the algorithm sees it.")


class EvaluateRequest(Model):
    """Runs to measure; each is looked at by itself, so that a bad one spoils no other."""

    evaluation: Name | None = None
    settings: EvaluationSettings = Field(default_factory=EvaluationSettings)
    runs: list[dict[str, Any]]


class RunItem(SubjectItem):
    """A run to measure."""

    uid: str
    name: Name
    folder: RelativePath
    sha256: Sha256 | None = None
    dataset: Name


class ReadRequest(Model):
    """A file to read."""

    path: RelativePath


class RestoreRequest(Model):
    """Run folders to bring back from object storage."""

    folders: list[Annotated[str, StringConstraints(pattern=r"^runs/[A-Za-z0-9-]+/[A-Za-z0-9-]+$")]] = Field(
        min_length=1
    )
