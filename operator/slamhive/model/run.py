# SPDX-License-Identifier: Apache-2.0
"""MappingRun: one algorithm on one dataset with one set of parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator
from pydantic.alias_generators import to_camel

from slamhive.model.algorithm import Pace
from slamhive.model.base import Duration, Model, Name, Quantity, Reference, Resource, Scalar, optional
from slamhive.model.errors import suggestion
from slamhive.model.sensors import Role, SensorMode

if TYPE_CHECKING:
    from collections.abc import Mapping


class LidarInput(Model):
    """Filter of LiDAR scans: range of the points and number of rings that are kept."""

    min_range: float | None = Field(default=None, ge=0, description="Points nearer than this go, in m.")
    max_range: float | None = Field(default=None, gt=0, description="Points farther than this go, in m.")
    rings: int | None = Field(default=None, gt=0, description="Rings to keep, evenly spaced.")


class LidarPerturbation(Model):
    """Perturbation of LiDAR scans."""

    range_noise: float | None = optional("Sigma of noise on each point's range, m.", ge=0, le=10)
    drop_points: float | None = optional("Share of the points left out.", ge=0, le=0.99)
    sector: float | None = optional(
        "Degrees of azimuth, centred behind the sensor (-x), without points.", ge=0, le=350
    )
    rain: float | None = optional("Share of the points that return from nearer, as of drops.", ge=0, le=0.99)
    drop_scans: float | None = optional("Share of the scans left out.", ge=0, le=0.95)


class ImagesPerturbation(Model):
    """Perturbation of a camera's images, in pixels and brightness of those that were recorded."""

    blur: float | None = optional("Motion along the rows during the exposure, px.", ge=0, le=200)
    motion_blur: float | None = optional(
        "Time of exposure, ms, over which images are blurred by the platform's turning.", ge=0, le=100
    )
    noise: float | None = optional("Sigma of noise on each value, of 255.", ge=0, le=128)
    gamma: float | None = optional("Exponent of the brightness from 0 to 1; 1: none.", ge=0.1, le=10)
    exposure_step: float | None = optional(
        "Stops by which every second second is brighter, darker below 0.", ge=-8, le=8
    )
    jpeg_quality: int | None = optional("Quality of a JPEG that they pass through.", ge=1, le=100)
    drop_frames: float | None = optional("Share of the frames left out.", ge=0, le=0.95)
    duplicate_frames: float | None = optional(
        "Share of the frames that show the image before them.", ge=0, le=0.95
    )
    occlusion: float | None = optional("Share of the image that is black, one rectangle.", ge=0, le=0.95)


class ImuPerturbation(Model):
    """Perturbation of an IMU's samples; biases, noise and ranges are of each axis."""

    accelerometer_bias: float | None = optional("Added to each axis, m/s².", ge=-20, le=20)
    gyroscope_bias: float | None = optional("Added to each axis, rad/s.", ge=-10, le=10)
    accelerometer_noise: float | None = optional("Sigma of noise on each sample, m/s².", ge=0, le=20)
    gyroscope_noise: float | None = optional("Sigma of noise on each sample, rad/s.", ge=0, le=10)
    accelerometer_range: float | None = optional("Largest value, m/s²; beyond it saturates.", gt=0, le=2000)
    gyroscope_range: float | None = optional("Largest value, rad/s; beyond it saturates.", gt=0, le=100)
    rate: float | None = optional("Samples per second.", gt=0, le=100_000)


class Perturbation(Model):
    """Perturbation of the recording: what is made worse on purpose, alike for equal seeds."""

    seed: int | None = optional("Seed of what is random; default: 1.", ge=0, le=2**31 - 1)
    lidar: LidarPerturbation | None = optional("Of LiDAR scans.")
    images: ImagesPerturbation | None = optional("Of images of cameras.")
    imu: ImuPerturbation | None = optional("Of samples of the IMU.")
    time_offset: dict[str, Annotated[float, Field(ge=-100, le=100)]] = Field(
        default_factory=dict, description="Seconds added to the stamps of a role's sensor."
    )
    drift: dict[str, Annotated[float, Field(ge=-0.1, le=0.1)]] = Field(
        default_factory=dict,
        description="Seconds added for each second since the first stamp of a role's sensor.",
    )
    jitter: dict[str, Annotated[float, Field(ge=0, le=10)]] = Field(
        default_factory=dict,
        description="Sigma of noise on the stamps of a role's sensor, s; their order stays.",
    )
    late: dict[str, Annotated[float, Field(ge=0, le=5)]] = Field(
        default_factory=dict,
        description="Seconds by which messages of a role's sensor are delivered later; stamps stay.",
    )
    swapped: dict[str, Annotated[float, Field(ge=0, le=1)]] = Field(
        default_factory=dict,
        description="Share of a role's messages that are delivered in the place of a neighbour; stamps stay.",
    )
    rotation: dict[str, Annotated[float, Field(ge=0, le=180)]] = Field(
        default_factory=dict,
        description="Degrees by which a role's sensor is told turned, about a random axis.",
    )
    translation: dict[str, Annotated[float, Field(ge=0, le=100)]] = Field(
        default_factory=dict,
        description="Metres by which a role's sensor is told shifted, in a random direction.",
    )

    @model_validator(mode="after")
    def _names_roles(self) -> Self:
        roles = [str(role) for role in Role]
        for field in OF_ROLES:
            for key in getattr(self, field):
                if key not in roles:
                    raise ValueError(f"{to_camel(field)}: unknown role {key!r}{suggestion(key, roles)}")
        return self


OF_ROLES = ("time_offset", "drift", "jitter", "late", "swapped", "rotation", "translation")
"""Fields of a perturbation that go by role."""
STAMPS, DELIVERY = ("timeOffset", "drift", "jitter"), ("late", "swapped")
TOLD = ("rotation", "translation")
"""Those of them that move stamps, times of delivery, and what an algorithm is told, as they are written."""
_NEUTRAL = {"gamma": 1}
_RANDOM = frozenset(
    {"rangeNoise", "dropPoints", "rain", "dropScans", "noise", "dropFrames", "duplicateFrames"}
    | {"occlusion", "swapped", "accelerometerNoise", "gyroscopeNoise", "jitter", *TOLD}
)
DEFAULT_SEED = 1


def neutral(option: str) -> float:
    """Return the value of a perturbation, such as ``images.gamma``, with which it changes nothing."""
    return _NEUTRAL.get(option.rpartition(".")[2], 0)


def is_random(option: str) -> bool:
    """Tell whether a perturbation, such as ``images.noise`` or ``jitter.imu``, goes by the seed."""
    return not _RANDOM.isdisjoint(option.split("."))


def without_idle(perturb: Mapping[str, Any]) -> dict[str, Any]:
    """Return a perturbation as it stands in a spec, without the fields that change nothing; may be empty.

    The seed is one of them where nothing is random.
    """
    found: dict[str, Any] = {}
    for block, fields in perturb.items():
        if block != "seed" and fields:
            kept = {k: v for k, v in fields.items() if v is not None and v != neutral(f"{block}.{k}")}
            found |= {block: kept} if kept else {}
    drawn = any(is_random(f"{block}.{key}") for block, fields in found.items() for key in fields)
    seed = perturb.get("seed")
    return found | ({"seed": seed} if drawn and seed not in {None, DEFAULT_SEED} else {})


NO_PROGRAM = "none"
"""Value of `InputOptions.prepared_by` that means the recording as it is."""


def essential(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ``input`` of a spec that hashes are of: without what changes nothing of the recording."""
    rest = {key: value for key, value in options.items() if key != "perturb"}
    if rest.get("preparedBy") == NO_PROGRAM:
        del rest["preparedBy"]
    perturb = without_idle(options.get("perturb") or {})
    return rest | ({"perturb": perturb} if perturb else {})


class InputOptions(Model):
    """Options of a run's input: pace, and what is taken of the recording and its sensors."""

    pace: Pace | None = Field(
        default=None, description="Lockstep, Realtime or Stepped; default: the algorithm's first."
    )
    frame_rate: float | None = Field(
        default=None, gt=0, description="Frames per second of cameras and LiDARs; default: as recorded."
    )
    resolution: float = Field(default=1.0, gt=0, le=1, description="Scale of images in each direction.")
    start: Duration | None = Field(default=None, description="Time to leave out at the beginning.")
    duration: Duration | None = Field(default=None, description="Length to keep.")
    rate: float | None = Field(default=None, gt=0, le=100, description="Speed of playback in real time.")
    lidar: LidarInput | None = Field(default=None, description="Filter of LiDAR scans.")
    perturb: Perturbation | None = Field(default=None, description="What is made worse on purpose.")
    prepared_by: str | None = optional(
        "Program of the Dataset's preparations that makes other frames of what is left; none: no program.",
        max_length=40,
    )
    remap: dict[str, str] = Field(
        default_factory=dict, description="Sensor of the dataset for a role, such as camera: back."
    )

    @property
    def program(self) -> str | None:
        """Return the name of the program that prepares the recording; None where none does."""
        return None if self.prepared_by == NO_PROGRAM else self.prepared_by


class Resources(Model):
    """Processors, memory and GPUs that a run may use; requests equal limits."""

    cpu: Quantity = Field(default="1", description="Processors; on a workstation whole cores.")
    memory: Quantity = Field(default="4Gi", description="Memory.")
    gpu: int | None = Field(default=None, ge=1, description="GPUs.")
    exclusive_nodes: bool | None = optional(
        "Whether no other run may be on its node; on a workstation: whether it runs alone."
    )

    @field_validator("exclusive_nodes")
    @classmethod
    def _only_what_is_asked_for(cls, value: bool | None) -> bool | None:
        return value or None  # one hash for what is the same


class MappingRunSpec(Model):
    """One mapping run."""

    algorithm_ref: Reference = Field(description="The Algorithm.")
    dataset_ref: Reference = Field(description="The Dataset.")
    sensors: SensorMode | None = Field(default=None, description="Sensor mode; default: the only one.")
    parameters: dict[str, Scalar] = Field(default_factory=dict, description="The algorithm's parameters.")
    input: InputOptions = Field(
        default_factory=InputOptions, description="Options of the input: pace, rates, resolution, span."
    )
    repetition: int = Field(default=0, ge=0, le=100_000, description="Number of the repetition.")
    seed: int = Field(default=1, ge=0, le=2**31 - 1, description="Seed for the algorithm.")
    resources: Resources = Field(default_factory=Resources, description="Processors, memory and GPUs.")
    timeout: Duration = Field(default="1h", description="Longest time from the algorithm's first process.")
    retries: int = Field(
        default=2, ge=0, le=10, description="Further attempts after infrastructure failures."
    )
    evaluate: bool = Field(default=True, description="Whether to evaluate the trajectory.")
    priority_class_name: Name | None = optional("PriorityClass of its pods; default: the chart's.")
    cancel: bool = Field(default=False, description="Whether to end the run.")


class MappingRun(Resource):
    """A run as an object of its own."""

    kind: Literal["MappingRun"] = "MappingRun"
    spec: MappingRunSpec


UNHASHED = ("timeout", "retries", "evaluate", "priorityClassName", "cancel")
"""Fields of the spec that do not change what a run produces."""
