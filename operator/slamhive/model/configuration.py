# SPDX-License-Identifier: Apache-2.0
"""The unified configuration: the one file in which an algorithm finds all it is told."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from slamhive.model.algorithm import Pace
from slamhive.model.base import API_VERSION, Model, Scalar
from slamhive.model.formats import DataFormat
from slamhive.model.sensors import Role, Sensor, SensorMode


class RecordingPlace(Model):
    """The prepared recording, relative to the run folder."""

    format: DataFormat
    path: str
    files: dict[str, str] | None = Field(
        default=None, description="In a folder of files, where each sensor's are, relative to path."
    )


class DatasetView(Model):
    """Description of the dataset in config.yaml: as much as an algorithm may know."""

    name: str
    recording: RecordingPlace
    start_time: float | None = None
    duration_seconds: float | None = None
    gravity_aligned: bool = False


class SensorView(Sensor):
    """A sensor as it is after preparation, with its name in the dataset."""

    name: str


class PreparedRecording(Model):
    """Description of a prepared recording (variant), as far as an algorithm is to know it."""

    format: DataFormat
    recording: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=128, description="Name of its file or folder."
    )
    sensors: dict[Role, SensorView]
    start_time: float
    duration_seconds: float = Field(ge=0)
    frame_rate: float | None = None
    recorded_frame_rate: float | None = Field(default=None, gt=0)
    resolution: float = 1.0


class InputView(Model):
    """The input options as they take effect."""

    pace: Pace
    frame_rate: float | None = None
    recorded_frame_rate: float | None = None
    resolution: float = 1.0
    start: float = 0.0
    duration: float | None = None
    rate: float = 1.0


class RunConfiguration(Model):
    """The file config.yaml of a run folder."""

    api_version: str = API_VERSION
    kind: Literal["RunConfiguration"] = "RunConfiguration"
    run: str
    algorithm: str
    mode: SensorMode
    dataset: DatasetView
    sensors: dict[str, SensorView]
    parameters: dict[str, Scalar] = Field(default_factory=dict)
    input: InputView
    seed: int
    cores: int
