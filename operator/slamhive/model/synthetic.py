# SPDX-License-Identifier: Apache-2.0
"""A synthetic recording: what a Dataset writes where another names files.

The same specification gives the same recording, byte for byte, so a Dataset of this kind needs no download:
`slamhive.data.synthetic.generate` makes it. Free attributes that meta-analysis plots against derive from it.
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from slamhive.model.base import Choice, Model

REST_SECONDS = 3.0
"""Rest before the platform starts to move and after it stopped, s."""

NOMINAL_LAP_METRES = 30.3
"""Length of one lap on level ground, m; height changes and sway add about 1 %."""

DEFAULT_SPEED = 1.25
"""Mean speed while moving when neither speed nor duration is given, m/s."""


class SyntheticSensor(Choice):
    """Sensors that the platform can carry, each with its own pose, at no right angle to the body."""

    LIDAR = "Lidar"
    IMU = "Imu"
    STEREO = "Stereo"
    RGBD = "Rgbd"
    LASER_SCAN = "LaserScan"
    ODOMETRY = "Odometry"
    GNSS = "Gnss"
    MAGNETOMETER = "Magnetometer"
    BAROMETER = "Barometer"


FIXED_RATES = {
    SyntheticSensor.LASER_SCAN: 10.0,
    SyntheticSensor.ODOMETRY: 50.0,
    SyntheticSensor.GNSS: 5.0,
    SyntheticSensor.MAGNETOMETER: 50.0,
    SyntheticSensor.BAROMETER: 10.0,
}
"""Messages per second of sensors whose rate can't be chosen, Hz."""


class SyntheticRig(Choice):
    """Mountings of the sensors. The lidar is the same on all; the stereo pair is on Askew and Euroc."""

    ASKEW = "Askew"
    EUROC = "Euroc"
    MAV = "Mav"


class SyntheticScene(Choice):
    """Surroundings: the furnished room, a long corridor, or an open field."""

    ROOM = "Room"
    CORRIDOR = "Corridor"
    FIELD = "Field"


class SyntheticSpectrum(Choice):
    """Carriers whose way of shaking a vibration can have."""

    WALKER = "Walker"
    VEHICLE = "Vehicle"


HIGHEST_FREQUENCY = {SyntheticSpectrum.WALKER: 9.9, SyntheticSpectrum.VEHICLE: 26.25}
"""Highest frequency that a carrier's vibration has, Hz."""


class SyntheticLidar(Model):
    """A spinning lidar; every column is taken at its own time and pose."""

    rings: Annotated[int, Field(ge=4, le=128)] = Field(
        default=32, description="Beams, spread evenly from -22 to 18 degrees of elevation."
    )
    columns: Annotated[int, Field(ge=36, le=4096)] = Field(default=720, description="Firings per revolution.")
    rate: Annotated[float, Field(ge=1.0, le=50.0)] = Field(
        default=10.0, description="Revolutions per second, Hz."
    )
    min_range: Annotated[float, Field(ge=0.0, le=5.0)] = Field(
        default=0.5, description="Returns nearer than this are dropped, m."
    )
    max_range: Annotated[float, Field(ge=2.0, le=200.0)] = Field(
        default=60.0, description="Returns farther than this are dropped, m."
    )

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> Self:
        if self.max_range <= self.min_range:
            raise ValueError(f"maxRange {self.max_range} must be greater than minRange {self.min_range}")
        return self


class SyntheticImu(Model):
    """An inertial measurement unit with white noise and a bias that walks."""

    rate: Annotated[float, Field(ge=20.0, le=1000.0)] = Field(
        default=200.0, description="Samples per second, Hz."
    )


class SyntheticCamera(Model):
    """The cameras: all of one size and rate, each with its own lens and pose."""

    width: Annotated[int, Field(ge=64, le=1920)] = Field(
        default=480, description="Columns at scale 1, pixels."
    )
    height: Annotated[int, Field(ge=48, le=1440)] = Field(default=360, description="Rows at scale 1, pixels.")
    rate: Annotated[float, Field(ge=1.0, le=60.0)] = Field(default=15.0, description="Frames per second, Hz.")
    scale: Annotated[float, Field(ge=0.1, le=2.0)] = Field(
        default=1.0,
        description=(
            "Renders the same view directly at this share of width and height, intrinsics scaled alike."
        ),
    )
    exposure_seconds: Annotated[float, Field(ge=0.0, le=0.1)] = Field(
        default=0.0,
        description=(
            "Time the shutter is open, s; 0 gives sharp images. Stamps are those of the middle of the"
            " exposure."
        ),
    )

    @model_validator(mode="after")
    def _exposure_fits_the_rate(self) -> Self:
        if self.exposure_seconds * self.rate > 1.0:
            raise ValueError(
                f"exposureSeconds {self.exposure_seconds} is longer than a frame takes at rate {self.rate}: "
                f"at most {1.0 / self.rate:.4f} is possible"
            )
        return self


class SyntheticVibration(Model):
    """Vibration of the moving platform, as by engines, wheels or steps: sines in each coordinate."""

    amplitude_metres: Annotated[float, Field(ge=0.0, le=0.02)] = Field(
        default=0.002, description="Standard deviation of the displacement along each axis of the world, m."
    )
    amplitude_degrees: Annotated[float, Field(ge=0.0, le=2.0)] = Field(
        default=0.1, description="Standard deviation of roll, pitch and yaw that it adds, degrees."
    )
    min_frequency: Annotated[float, Field(ge=0.5, le=20.0)] = Field(
        default=2.5, description="Lowest frequency, Hz."
    )
    max_frequency: Annotated[float, Field(ge=0.5, le=20.0)] = Field(
        default=5.0, description="Highest frequency, Hz."
    )

    spectrum: SyntheticSpectrum | None = Field(
        default=None,
        description=(
            "Carrier whose frequencies it has instead of the band from minFrequency to maxFrequency: Walker, "
            "as of a person with the platform in the hands, or Vehicle. The amplitudes are then those of the "
            "strongest axes, whose strongest frequency has them as standard deviation. Null: the band."
        ),
    )

    @property
    def highest_frequency(self) -> float:
        """Return the highest frequency that it can have, Hz."""
        return self.max_frequency if self.spectrum is None else HIGHEST_FREQUENCY[self.spectrum]

    @model_validator(mode="after")
    def _band_is_not_reversed(self) -> Self:
        if self.max_frequency < self.min_frequency:
            raise ValueError(
                f"maxFrequency {self.max_frequency} must not be less than minFrequency {self.min_frequency}"
            )
        return self


class SyntheticRecording(Model):
    """A platform driving laps, in a textured room or elsewhere: everything that makes one such recording."""

    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = Field(
        default=1, description="Decides the room, its textures, the path's sway and all noise."
    )
    sensors: Annotated[tuple[SyntheticSensor, ...], Field(min_length=1)] = Field(
        default=(SyntheticSensor.LIDAR, SyntheticSensor.IMU), description="What is recorded."
    )
    loops: Annotated[float, Field(gt=0.0, le=100.0)] = Field(
        default=1.0, description="Laps of about 30 m; a whole number returns to the start."
    )
    speed: Annotated[float, Field(ge=0.1, le=6.0)] | None = Field(
        default=None,
        description="Mean speed while moving, m/s. Null: 1.25, or what durationSeconds asks for.",
    )
    duration_seconds: Annotated[float, Field(ge=7.0, le=3600.0)] | None = Field(
        default=None,
        description=(
            "Length of the recording with 3 s of rest at either end, s. Null: follows from loops and speed."
        ),
    )
    motion: Annotated[float, Field(ge=0.0, le=3.0)] = Field(
        default=1.0,
        description="Scale of roll, pitch, sway and height changes; 1 is a walking person, 0 a trolley.",
    )
    light: Annotated[float, Field(ge=0.02, le=2.0)] = Field(
        default=1.0, description="Scale of the light; noise of the image sensor doesn't shrink with it."
    )
    noise: Annotated[float, Field(ge=0.0, le=20.0)] = Field(
        default=1.0, description="Scale of all sensor noise and of IMU biases; 0 gives perfect sensors."
    )
    scene: SyntheticScene | None = Field(
        default=None,
        description=(
            "What is around the platform. Room, or null: a furnished hall. Corridor: two walls with door "
            "frames, 30 m long, walked to and fro. Field: even ground with trees and bushes, for sensors "
            "other than cameras."
        ),
    )
    people: Annotated[int, Field(ge=0, le=20)] | None = Field(
        default=None,
        description="Number of people who walk about, seen by lidars, cameras and depth alike. Null: none.",
    )
    vibration: SyntheticVibration | None = Field(
        default=None,
        description=(
            "Vibration of the platform, seen alike by ground truth and all sensors. Null: none. An "
            "acceleration that changes between frames is what visual-inertial algorithms start from."
        ),
    )
    rig: SyntheticRig | None = Field(
        default=None,
        description=(
            "How the IMU is mounted. Askew, or null: turned by 109 degrees against the left camera. "
            "Euroc: by 89 degrees, about the optical axis, as EuRoC's. The released VINS-Mono fails "
            "on about three of four rigs between 90 and 120 degrees, by the last digits of the rotation; "
            "it runs on both of these. Mav: stereo pair and IMU as they are on EuRoC's vehicle, by its "
            "published calibration, looking down by 22 degrees: the IMU's x axis stays off the vertical."
        ),
    )
    lidar: SyntheticLidar = Field(
        default=SyntheticLidar.model_construct(), description="The lidar, when it is among the sensors."
    )
    imu: SyntheticImu = Field(
        default=SyntheticImu.model_construct(), description="The IMU, when it is among the sensors."
    )
    camera: SyntheticCamera = Field(
        default=SyntheticCamera.model_construct(),
        description="The cameras, when Stereo or Rgbd is among the sensors.",
    )
    header_offset_seconds: Annotated[float, Field(ge=-1.0, le=1.0)] = Field(
        default=0.0, description="Record time in the bag minus time stamp in the header, s."
    )
    depth_offset_seconds: Annotated[float, Field(ge=0.0, le=0.1)] = Field(
        default=0.0,
        description="Depth images are taken (and stamped) this much after their colour images, s.",
    )

    @model_validator(mode="after")
    def _motion_is_determined_once(self) -> Self:
        if self.speed is not None and self.duration_seconds is not None:
            raise ValueError("speed and durationSeconds exclude each other: with loops, one gives the other")
        if self.mean_speed > 6.0:
            raise ValueError(
                f"durationSeconds {self.duration_seconds} is too short for loops {self.loops:g}: that is "
                f"{self.mean_speed:.1f} m/s, at most 6 is allowed"
            )
        if len(set(self.sensors)) != len(self.sensors):
            raise ValueError("sensors names one of them twice")
        return self

    @model_validator(mode="after")
    def _vibration_can_be_measured(self) -> Self:
        shaken = self.vibration
        if shaken is not None and shaken.highest_frequency * 4.0 > self.imu.rate:
            what = "maxFrequency" if shaken.spectrum is None else f"spectrum {shaken.spectrum} with up to"
            raise ValueError(
                f"vibration: {what} {shaken.highest_frequency:g} is more than a quarter of "
                f"imu.rate {self.imu.rate:g}: samples would be too far apart to follow it"
            )
        return self

    @model_validator(mode="after")
    def _scene_can_be_seen(self) -> Self:
        seen = [one for one in self.sensors if one in {SyntheticSensor.STEREO, SyntheticSensor.RGBD}]
        if self.scene is SyntheticScene.FIELD and seen:
            raise ValueError(
                f"scene: Field has no texture for cameras, found {', '.join(seen)} among the sensors; "
                "leave them out, or take Room or Corridor"
            )
        return self

    @property
    def moving_seconds(self) -> float:
        """Time between the two rests, s."""
        if self.duration_seconds is not None:
            return self.duration_seconds - 2.0 * REST_SECONDS
        return self.loops * NOMINAL_LAP_METRES / (DEFAULT_SPEED if self.speed is None else self.speed)

    @property
    def total_seconds(self) -> float:
        """Length of the recording, rests included, s."""
        return self.moving_seconds + 2.0 * REST_SECONDS

    @property
    def mean_speed(self) -> float:
        """Nominal speed while moving, m/s."""
        return self.loops * NOMINAL_LAP_METRES / self.moving_seconds

    def attributes(self) -> dict[str, float]:
        """Give the Dataset's free attributes that follow from this specification."""
        shaken = {} if self.vibration is None else {"vibrationMetres": self.vibration.amplitude_metres}
        return shaken | {
            "loops": self.loops,
            "speed": round(self.mean_speed, 3),
            "motion": self.motion,
            "light": self.light,
            "noise": self.noise,
            "exposureSeconds": self.camera.exposure_seconds,
            "lengthMetres": round(self.loops * NOMINAL_LAP_METRES, 1),
        }
