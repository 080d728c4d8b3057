# SPDX-License-Identifier: Apache-2.0
"""Dataset: a recording, its sensors with calibration, and its ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from slamhive.model.algorithm import RecordingFormat, RelativePath
from slamhive.model.base import CATALOGUE_TITLE, HTTPS, Choice, Model, Resource, Scalar, Sha256, optional
from slamhive.model.errors import InputError, suggestion
from slamhive.model.repair import Repair, SensorRepair
from slamhive.model.sensors import ROLE_TYPES, ROLES, STAND_INS, Extrinsics, Role, Sensor, SensorType
from slamhive.model.synthetic import SyntheticRecording
from slamhive.model.variant import PreparingProgram, misnamed
from slamhive_eval.errors import OptionError
from slamhive_eval.formats.columns import TableFormat

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class DataFile(Model):
    """A file of a recording."""

    path: RelativePath = Field(description="Path below the dataset's folder on the dataset volume.")
    url: str | None = Field(
        default=None, pattern=HTTPS, description="Address to fetch it from when it is absent."
    )
    sha256: Sha256 | None = Field(default=None, description="Checksum of the file.")

    @model_validator(mode="after")
    def _verifiable(self) -> Self:
        if self.url is not None and self.sha256 is None:
            raise ValueError("a url needs its sha256")
        return self


class Recording(Model):
    """Source of the sensors' messages: files, or a generator."""

    format: RecordingFormat = Field(default=RecordingFormat.ROSBAG1, description="Format of the recording.")
    files: list[DataFile] = Field(default_factory=list, description="Files, in the order of time.")
    synthetic: SyntheticRecording | None = Field(default=None, description="A generated recording.")
    duration_seconds: float | None = Field(
        default=None, gt=0, description="Length of the files, s: what no sensor's messages go beyond."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.files and self.synthetic is not None:
            raise ValueError("give either files or synthetic")
        return self


class TruthFormat(Choice):
    """Formats of files with ground truth."""

    TUM = "Tum"
    EUROC = "Euroc"
    KITTI = "Kitti"
    RELATIONS = "Relations"
    TABLE = "Table"
    CONTROL_POINTS = "ControlPoints"


class TruthColumn(Choice):
    """Kinds of columns in a table of ground truth, such as time, position and orientation."""

    T = "t"
    SEC = "sec"
    NSEC = "nsec"
    FRAME = "frame"
    TX = "tx"
    TY = "ty"
    TZ = "tz"
    QX = "qx"
    QY = "qy"
    QZ = "qz"
    QW = "qw"
    ROLL = "roll"
    PITCH = "pitch"
    YAW = "yaw"
    MATRIX = "matrix"
    NOTHING = "_"


def _plain_column(value: object) -> object:
    if value is True:
        raise ValueError("YAML reads y as true; the columns of the position are tx, ty, tz")
    return value


class TruthTable(Model):
    """A table of poses or positions: what its columns are."""

    columns: list[Annotated[TruthColumn, BeforeValidator(_plain_column)]] = Field(
        default_factory=lambda: [TruthColumn.T, TruthColumn.TX, TruthColumn.TY, TruthColumn.TZ],
        min_length=1,
        max_length=100,
        description="From the first on; more columns are passed over. Time: t, or sec with or without nsec, "
        "or frame; without any, line k from 0 is frame k. matrix: twelve columns, the 3×4 pose by rows. "
        "_: passed over.",
    )
    delimiter: Literal[",", ";", "\t", " "] | None = optional(
        "What separates columns, a space for any white space; default: what the first line has."
    )
    skip: int = Field(default=0, ge=0, le=10**6, description="Lines passed over at the top, such as names.")
    time_unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="Unit of t.")
    angle_unit: Literal["rad", "deg"] = Field(default="rad", description="Unit of roll, pitch and yaw.")
    rotation: Literal["Pose", "Inverse"] = Field(
        default="Pose",
        description="Pose: turns vectors of the frame into the world, R = Rz(yaw) Ry(pitch) Rx(roll). "
        "Inverse: vectors of the world into the frame.",
    )
    rate: float | None = optional("Frames a second, where lines have frames and there is no times.", gt=0)
    start_time: float = Field(default=0.0, description="Time of frame 0, s.")
    min_interval: float = Field(
        default=0.0, ge=0, description="Poses less than so many seconds after the last one kept are dropped."
    )

    @model_validator(mode="after")
    def _readable(self) -> Self:
        try:
            self.form  # noqa: B018 - making it checks it
        except OptionError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def form(self) -> TableFormat:
        """Return the format for the evaluator's reader.

        Raises:
            OptionError: columns that make no position over time.
        """
        return TableFormat(
            columns=tuple(map(str, self.columns)),
            delimiter=self.delimiter,
            skip=self.skip,
            time_unit=self.time_unit,
            angle_unit=self.angle_unit,
            rotation=self.rotation,
            rate=self.rate,
            start_time=self.start_time,
            min_interval=self.min_interval,
        )


class Hole(Model):
    """A span in which the ground truth is not to be trusted."""

    start: float = Field(description="Seconds, as the stamps.")
    end: float = Field(description="Seconds, as the stamps.")


class GroundTruth(Model):
    """Ground truth of a dataset: where the reference poses are and what they mean."""

    file: RelativePath | None = Field(default=None, description="File below the dataset's folder.")
    times: RelativePath | None = Field(
        default=None,
        description="File with a stamp a line, for Kitti and for tables whose lines have frames.",
    )
    topic: str | None = Field(default=None, description="Topic of the recording that carries the poses.")
    format: TruthFormat = Field(default=TruthFormat.TUM, description="Format of the file.")
    table: TruthTable | None = optional("Table, ControlPoints: what the columns are.")
    frame: str = Field(default="body", description="Whose pose it is: body, or the name of a sensor.")
    T_body_frame: Extrinsics | None = Field(
        default=None,
        alias="T_body_frame",
        description="Pose of a marker frame in the body, when it is neither.",
    )
    holes: list[Hole] = Field(default_factory=list, description="Spans to leave out.")
    sha256: Sha256 | None = Field(default=None, description="Checksum of the file.")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.file is None) == (self.topic is None):
            raise ValueError("give either file or topic")
        return self

    @model_validator(mode="after")
    def _has_its_table(self) -> Self:
        has_table = self.format in (TruthFormat.TABLE, TruthFormat.CONTROL_POINTS)
        if self.table is not None and not has_table:
            raise ValueError("table: only the formats Table and ControlPoints take it")
        if self.format is TruthFormat.TABLE and self.table is None:
            raise ValueError("table: the format Table needs it: table.columns says what the columns are")
        if has_table and self.file is None:
            raise ValueError(f"file: the format {self.format} needs it")
        table = self.columns
        if table is not None and table.form.by_frames and table.rate is None and self.times is None:
            raise ValueError("table.columns: there is no time; name t or sec, or give table.rate or times")
        return self

    @property
    def columns(self) -> TruthTable | None:
        """Return the columns of a table; None for other formats."""
        if self.format is TruthFormat.CONTROL_POINTS:
            return self.table or TruthTable()
        return self.table


class DatasetSpec(Model):
    """A recording with what is known about it."""

    description: str = Field(default="", description="One sentence.")
    homepage: str | None = Field(default=None, description="Page of those who published the data.")
    license: str | None = Field(default=None, description="Licence of the data.")
    catalogue: str | None = Field(
        default=None,
        pattern=CATALOGUE_TITLE,
        description="The sequence of the catalogue that it is, FAMILY/SEQUENCE; without a recording it is "
        "fetched when it is first needed.",
    )
    recording: Recording = Field(default_factory=Recording, description="The sensors' messages.")
    sensors: dict[str, Sensor] = Field(
        default_factory=dict,
        description="Sensors by name; a name that is a role fills it. Empty for a synthetic recording, which "
        "brings its own, and where no topic of the recording is a sensor's.",
    )
    ground_truth: GroundTruth | None = Field(default=None, description="Reference poses.")
    repair: Repair | None = optional(
        "What the preparation changes in the recording's messages, and in the stamps of its ground truth."
    )
    preparations: dict[str, PreparingProgram] | None = optional(
        "Programs by name that make other frames of the recording's: runs name one as input.preparedBy.",
        max_length=32,
    )
    gravity_aligned: bool = Field(default=False, description="Whether the ground truth's z axis points up.")
    attributes: dict[str, Scalar] = Field(
        default_factory=dict, description="Free attributes to select and plot by, such as loops: 2."
    )

    @model_validator(mode="after")
    def _has_a_source(self) -> Self:
        recording = self.recording
        if not recording.files and recording.synthetic is None and self.catalogue is None:
            raise ValueError("recording: give either files or synthetic, or a sequence as catalogue")
        return self

    @property
    def is_to_fetch(self) -> bool:
        """Tell whether its recording comes from the catalogue, by its name alone."""
        return self.catalogue is not None and not self.recording.files and self.recording.synthetic is None

    @model_validator(mode="after")
    def _names_programs(self) -> Self:
        if misfit := misnamed(self.preparations or {}):
            raise ValueError(misfit)
        return self

    def preparation(self, name: str) -> PreparingProgram:
        """Return the program of a name that prepares the recording.

        Raises:
            InputError: there is none.
        """
        known = self.preparations or {}
        if name not in known:
            raise InputError(f"input.preparedBy: no preparation {name!r}{suggestion(name, known)}")
        return known[name]

    def recorded_roles(self, roles: Iterable[Role], program: str | None) -> tuple[Role, ...]:
        """Return the roles that the recording must fill for runs of some roles.

        Args:
            roles: what the runs take.
            program: the program that prepares it; None: none, and unknown ones count as none.
        """
        found = (self.preparations or {}).get(program or "")
        return found.recorded(roles) if found else tuple(roles)

    @model_validator(mode="after")
    def _names_a_frame(self) -> Self:
        truth = self.ground_truth
        known = {"body", *self.sensors}
        if truth and self.sensors and truth.T_body_frame is None and truth.frame not in known:
            raise ValueError(
                f"groundTruth.frame: unknown frame {truth.frame!r}{suggestion(truth.frame, known)}"
            )
        return self

    @model_validator(mode="after")
    def _repairs_what_it_has(self) -> Self:
        # A generated recording, or the catalogue's, brings sensors and truth of its own.
        is_whole = bool(self.recording.files)
        if is_whole and (misfit := self.repair_misfit):
            raise ValueError(misfit)
        return self

    @property
    def repair_misfit(self) -> str | None:
        """Return a sentence on a repair of what the dataset hasn't got; None where there is none."""
        if self.repair is None:
            return None
        if self.repair.ground_truth is not None and self.ground_truth is None:
            return "repair.groundTruth: the dataset has no ground truth"
        return next(self.repair.misfits(self.sensors), None)

    @property
    def topic_repairs(self) -> dict[str, SensorRepair]:
        """Return the repairs of messages by topic."""
        return self.repair.of_topics(self.sensors) if self.repair else {}

    @property
    def told_sensors(self) -> dict[str, Sensor]:
        """Return its sensors as its repair leaves their messages: what algorithms are told of them."""
        repairs = self.topic_repairs
        return {
            name: repairs[sensor.topic].told(sensor) if sensor.topic in repairs else sensor
            for name, sensor in self.sensors.items()
        }

    @property
    def known_attributes(self) -> dict[str, Scalar]:
        """Its free attributes, and those that follow from how it is generated."""
        generated = {} if self.recording.synthetic is None else self.recording.synthetic.attributes()
        return generated | self.attributes

    @property
    def has_level_truth(self) -> bool:
        """Tell whether the ground truth's z axis points up: it is declared, or the recording is synthetic."""
        return self.gravity_aligned or self.recording.synthetic is not None

    def sensor_for(self, role: Role, remap: dict[str, str] | None = None) -> str:
        """Return the name of the sensor that fills a role.

        Raises:
            InputError: no sensor does, or the one asked for does not exist.
        """
        return sensor_for(role, self.sensors, remap)


def sensor_for(role: Role, sensors: Iterable[str], remap: Mapping[str, str] | None = None) -> str:
    """Return the name of the dataset's sensor that fills a role.

    Args:
        role: the role.
        sensors: names of the dataset's sensors.
        remap: the run's choice of sensors for roles.

    Raises:
        InputError: no sensor does, or the one asked for does not exist.
    """
    names = set(sensors)
    asked = (remap or {}).get(role)
    if asked is not None:
        if asked not in names:
            raise InputError(f"input.remap.{role}: unknown sensor {asked!r}{suggestion(asked, names)}")
        return asked
    for candidate in STAND_INS.get(role, (role,)):
        if candidate in names:
            return candidate
    has = ", ".join(sorted(names)) or "no sensor"
    raise InputError(f"no sensor for the role {role.value!r}; the dataset has: {has}")


def fills(role: Role, types: Mapping[str, SensorType]) -> bool:
    """Tell whether one of a dataset's sensors fills a role by its name.

    Args:
        role: the role.
        types: kinds of the sensors by name.
    """
    return any(types.get(str(name)) is ROLE_TYPES[role] for name in STAND_INS.get(role, (role,)))


def modes_with(name: str, sensors: Mapping[str, Sensor]) -> list[str]:
    """Return the modes that a dataset's sensors serve and that need the sensor of a name."""
    types = {one: sensor.type for one, sensor in sensors.items()}
    return [
        str(mode)
        for mode, roles in ROLES.items()
        if all(fills(role, types) for role in roles) and name in {sensor_for(role, sensors) for role in roles}
    ]


class Dataset(Resource):
    """The catalog entry of a dataset."""

    kind: Literal["Dataset"] = "Dataset"
    spec: DatasetSpec
