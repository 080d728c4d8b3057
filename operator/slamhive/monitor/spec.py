# SPDX-License-Identifier: Apache-2.0
"""Specifications for supervisor and sidecar: JSON that the executor or the operator writes."""

from __future__ import annotations

import json
import math
from dataclasses import MISSING, dataclass, fields
from typing import TYPE_CHECKING, Any, Self

from slamhive.contract.posefiles import PoseFiles

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

MEBIBYTE = 1 << 20
OUTPUT_LIMIT = "8Gi"
OUTPUT_FILES = 100_000
TASK_LIMIT = 4096
"""Processes and threads that an algorithm may have at the same time."""
"""To what a run's output may grow where nobody says otherwise, here and on a cluster."""
TERMINATION_MESSAGE = "/dev/termination-log"


class SpecError(ValueError):
    """A specification is wrong; the message names the field and what is allowed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Specification:
    """A JSON object with camelCase keys; what each field may hold is checked."""

    def __post_init__(self) -> None:
        for field in fields(self):
            allowed, accepts = _RULES[field.name]
            if not accepts(getattr(self, field.name)):
                raise SpecError(f"{camel(field.name)} must be {allowed}, not {getattr(self, field.name)!r}")

    def to_json(self) -> str:
        """Return the specification as a JSON object with camelCase keys."""
        return json.dumps({camel(field.name): getattr(self, field.name) for field in fields(self)}) + "\n"

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Read a specification.

        Raises:
            SpecError: It isn't a JSON object, or a field is missing, unknown or out of bounds.
        """
        try:
            values = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise SpecError(f"not JSON: {error}") from None
        if not isinstance(values, dict):
            raise SpecError("a specification is a JSON object")
        names = {camel(field.name): field for field in fields(cls)}
        if unknown := sorted(values.keys() - names.keys()):
            raise SpecError(f"unknown field {unknown[0]}; known are {', '.join(sorted(names))}")
        required = (name for name, field in names.items() if field.default is MISSING)
        if missing := sorted(name for name in required if name not in values):
            raise SpecError(f"{missing[0]} is missing")
        return cls(**{names[key].name: _tuple(value) for key, value in values.items()})


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisorSpec(Specification):
    """One run as its supervisor sees it.

    Attributes:
        argv: The algorithm's command; the program is looked up on the PATH of `env`.
        cwd: Its working directory.
        env: Its complete environment; only `SLAMHIVE_SUPERVISOR` is added.
        log_path: Where its stdout and stderr go.
        usage_path: CPU and memory over time, as CSV.
        summary_path: The outcome, written last.
        process_path: Who runs, so that orphans of a dead supervisor are found.
        output_directory: Where the algorithm writes; `metrics.json` is read from it.
        cpus: Processors the algorithm is pinned to; empty for no pinning.
        timeout_seconds: Wall time the algorithm may take.
        memory_limit_bytes: Memory its whole process tree may take.
        output_limit_bytes: Size to which `output_directory` may grow.
        output_file_limit: How many files and folders it may hold.
        log_limit_bytes: How much of the log is kept: its beginning and its end in equal parts.
        task_limit: How many processes (with a cgroup: and threads) may live at the same time.
        interval_seconds: Time between two samples.
        data_seconds: Length of the recording, for CPU seconds per second of data.
        frames: Frames of the recording, for an algorithm that doesn't count what it was offered.
        includes_reader: The algorithm reads the recording by itself and can't tell what that costs.
        poses: Files in which it writes its poses in its own way, as `PoseFiles.as_json` has them.
        is_played: A player plays the recording to it; once that is done, how it ends says nothing.
        cgroup: `auto` makes one where it can be made, `none` measures by /proc.
        contained: The container that is started in place of a process, as `ContainedSpec.as_json` has it;
            `argv` is then what it runs, for messages alone.
        kill_grace_seconds: Time between SIGTERM and SIGKILL.
        parent_pid: The process whose end ends the run; None for whoever started the supervisor.
    """

    argv: tuple[str, ...]
    cwd: str
    env: Mapping[str, str]
    log_path: str
    usage_path: str
    summary_path: str
    process_path: str
    output_directory: str | None = None
    cpus: tuple[int, ...] = ()
    timeout_seconds: float | None = None
    memory_limit_bytes: int | None = None
    output_limit_bytes: int | None = None
    output_file_limit: int | None = OUTPUT_FILES
    log_limit_bytes: int = 10 * MEBIBYTE
    task_limit: int | None = TASK_LIMIT
    interval_seconds: float = 0.1
    data_seconds: float | None = None
    frames: int | None = None
    includes_reader: bool = False
    poses: Mapping[str, Any] | None = None
    is_played: bool = False
    cgroup: str = "auto"
    contained: Mapping[str, Any] | None = None
    kill_grace_seconds: float = 5.0
    parent_pid: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ContainedSpec:
    """A container that a container engine has created and not started.

    Attributes:
        engine: The engine's command, with what stands before its first word.
        identity: The container's id.
        removal: Words that remove a container, running or not, before its id.
        pid_path: Where the engine writes the pid of its first process; None: it has to be asked.
    """

    engine: tuple[str, ...]
    identity: str
    removal: tuple[str, ...] = ("rm", "--force")
    pid_path: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the fields by their names in JSON."""
        words = {"engine": list(self.engine), "removal": list(self.removal)}
        return {**words, "identity": self.identity, "pidPath": self.pid_path}

    @classmethod
    def from_json(cls, value: Any) -> ContainedSpec:
        """Read the fields.

        Raises:
            ValueError: It is no such object.
        """
        if not isinstance(value, dict) or value.keys() != {"engine", "identity", "pidPath", "removal"}:
            raise ValueError("a container has engine, identity, pidPath and removal")
        engine, removal, pid_path = _tuple(value["engine"]), _tuple(value["removal"]), value["pidPath"]
        path = pid_path is None or _path(pid_path)
        if not (_texts(engine) and _texts(removal) and _text(value["identity"]) and path):
            raise ValueError("a container has commands, an id and an absolute path or null")
        return cls(engine=engine, identity=value["identity"], removal=removal, pid_path=pid_path)


@dataclass(frozen=True, slots=True, kw_only=True)
class SidecarSpec(Specification):
    """One run as the sidecar in its pod sees it.

    Attributes:
        container: What the algorithm's container carries in its environment as SLAMHIVE_CONTAINER.
        run_directory: The run folder: summary.json, usage.csv and config.yaml are written there, `output`
            in it is the algorithm's.
        configuration: The unified configuration, copied into the run folder.
        timeout_seconds: Wall time the algorithm may take from its first process on.
        memory_limit_bytes: The container's memory limit, for the message; the kernel enforces it.
        output_limit_bytes: Size to which the algorithm's output may grow.
        output_file_limit: How many files and folders it may hold.
        task_limit: How many processes and threads may live at the same time.
        companions: Containers that start before the algorithm's and hide what they are, as the player does.
        data_seconds: Length of the recording, for CPU seconds per second of data.
        frames: Frames of the recording, for an algorithm that doesn't count what it was offered.
        includes_reader: The algorithm reads the recording by itself and can't tell what that costs.
        poses: Files in which it writes its poses in its own way, as `PoseFiles.as_json` has them.
        interval_seconds: Time between two samples.
        kill_grace_seconds: Time between SIGTERM and SIGKILL.
        termination_message: Where the kubelet looks for the container's last word.
    """

    container: str
    run_directory: str
    configuration: str | None = None
    timeout_seconds: float | None = None
    memory_limit_bytes: int | None = None
    output_limit_bytes: int | None = None
    output_file_limit: int | None = OUTPUT_FILES
    task_limit: int | None = TASK_LIMIT
    companions: int = 0
    data_seconds: float | None = None
    frames: int | None = None
    includes_reader: bool = False
    poses: Mapping[str, Any] | None = None
    interval_seconds: float = 0.1
    kill_grace_seconds: float = 5.0
    termination_message: str = TERMINATION_MESSAGE


def camel(name: str) -> str:
    """Return a field's name as JSON has it."""
    first, *rest = name.split("_")
    return first + "".join(part.capitalize() for part in rest)


def _tuple(value: object) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _text(value: object) -> bool:
    return isinstance(value, str) and value != "" and "\0" not in value


def _path(value: object) -> bool:
    return isinstance(value, str) and value.startswith("/") and "\0" not in value


def _texts(value: object) -> bool:
    return (
        isinstance(value, tuple)
        and len(value) > 0
        and _text(value[0])
        and all(isinstance(item, str) and "\0" not in item for item in value)
    )


def _environment(value: object) -> bool:
    return isinstance(value, dict) and all(
        _text(key) and "=" not in key and isinstance(item, str) and "\0" not in item
        for key, item in value.items()
    )


def _pose_files(value: object) -> bool:
    try:
        PoseFiles.from_json(value)
    except ValueError:
        return False
    return True


def _contained(value: object) -> bool:
    try:
        ContainedSpec.from_json(value)
    except ValueError:
        return False
    return True


def _processors(value: object) -> bool:
    return isinstance(value, tuple) and all(_integer(item, 0) for item in value)


def _integer(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _positive(value: object) -> bool:
    return _number(value) and value > 0  # type: ignore[operator]


def _optional(accepts: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: value is None or accepts(value)


_PATH_RULE = ("an absolute path", _path)
_SIZE_RULE = ("a whole number above 0 or null", _optional(lambda value: _integer(value, 1)))
_TIME_RULE = ("a number of seconds above 0 or null", _optional(_positive))
_RULES: dict[str, tuple[str, Callable[[object], bool]]] = {
    "argv": ("a list of strings that begins with a program", _texts),
    "cwd": _PATH_RULE,
    "env": ("a map from names to strings", _environment),
    "log_path": _PATH_RULE,
    "usage_path": _PATH_RULE,
    "summary_path": _PATH_RULE,
    "process_path": _PATH_RULE,
    "output_directory": ("an absolute path or null", _optional(_path)),
    "cpus": ("a list of processor numbers", _processors),
    "timeout_seconds": _TIME_RULE,
    "memory_limit_bytes": _SIZE_RULE,
    "output_limit_bytes": _SIZE_RULE,
    "output_file_limit": _SIZE_RULE,
    "log_limit_bytes": ("a whole number of at least 4096", lambda value: _integer(value, 4096)),
    "task_limit": _SIZE_RULE,
    "interval_seconds": (
        "a number of seconds from 0.01 to 10",
        lambda value: _number(value) and 0.01 <= value <= 10,  # type: ignore[operator]
    ),
    "companions": ("a whole number, 0 or more", lambda value: _integer(value, 0)),
    "data_seconds": _TIME_RULE,
    "frames": ("a whole number, 0 or more, or null", _optional(lambda value: _integer(value, 0))),
    "includes_reader": ("true or false", lambda value: isinstance(value, bool)),
    "is_played": ("true or false", lambda value: isinstance(value, bool)),
    "poses": ("a description of files with poses or null", _optional(_pose_files)),
    "contained": ("a container that was created or null", _optional(_contained)),
    "cgroup": ("auto or none", lambda value: value in ("auto", "none")),
    "kill_grace_seconds": (
        "a number of seconds, 0 or more",
        lambda value: _number(value) and value >= 0,  # type: ignore[operator]
    ),
    "container": ("the name of a container", _text),
    "run_directory": _PATH_RULE,
    "configuration": ("an absolute path or null", _optional(_path)),
    "termination_message": _PATH_RULE,
    "parent_pid": ("a process id or null", _optional(lambda value: _integer(value, 1))),
}
