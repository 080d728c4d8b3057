# SPDX-License-Identifier: Apache-2.0
"""Reports of containers as they end, parsed.

An algorithm has the same user as its monitor, so nothing in them is trusted.

Whatever a message holds, reading it raises nothing, and what comes out can be written into a status: text
without control characters, numbers that JSON and the API server hold, times that are times.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
import unicodedata
import zlib
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, TypeVar

from pydantic import ValidationError

from slamhive.contract.lines import telling_line
from slamhive.contract.metrics import LARGEST_INTEGER, keep_values
from slamhive.model.base import Model
from slamhive.model.results import Frames, Machine, Reason, TrajectoryInfo, Usage
from slamhive.model.variant import VariantDescription
from slamhive.playback.outcome import Played

MESSAGE_BYTES = 16 * 1024
DESCRIPTION_BYTES = 1 << 20
_DEPTH = 12
_SENTENCE = 1000
_POD = re.compile(r"[0-9A-Za-z-]{1,64}")
_COLOURS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
# Control, format and surrogate characters: they move a terminal's cursor, turn text round, or can't be
# encoded.
_HIDDEN = frozenset({"Cc", "Cf", "Cs"})
_MONITORS = frozenset(
    {
        Reason.ALGORITHM_FAILED,
        Reason.DEADLINE_EXCEEDED,
        Reason.OUTPUT_TOO_LARGE,
        Reason.OUT_OF_MEMORY,
        Reason.SYSTEM_FAULT,
    }
)
"""Reasons that a monitor may give: an algorithm can't have itself repeated for ever by forging another."""
_PLAYERS = frozenset({Reason.ALGORITHM_FAILED, Reason.SYSTEM_FAULT})
_JOBS = frozenset(
    {Reason.DATASET_MISSING, Reason.INVALID_PARAMETERS, Reason.PREPARATION_FAILED, Reason.SYSTEM_FAULT}
)


@dataclass(frozen=True)
class Report:
    """Report on an attempt, from its monitor or from a Job that read the monitor's file.

    Attributes:
        reason: why it ended the algorithm, or what it saw of its end.
        message: a sentence about it.
        started_at: when the algorithm's first process began, ISO 8601.
        finished_at: when its last one had ended.
        usage: what the algorithm took.
        trajectory: the estimate, when it can be used.
        trajectory_problem: what is wrong with it otherwise.
        trajectory_missing: whether there is none. A file without a pose is a trajectory of 0 poses.
        metrics_problem: what is wrong with metrics.json.
        frames: frames as the algorithm counted them.
        cpu_model: the processor.
        machine: what else it told of the machine.
        pod: identity of the pod whose folder it was read in, where that was not known.
        played: how playing to it ended, for a ROS node.
        metrics: what the algorithm and its player say of themselves, latency for one.
    """

    reason: Reason | None = None
    message: str | None = None
    started_at: str | None = None
    finished_at: str | None = None
    usage: Usage | None = None
    trajectory: TrajectoryInfo | None = None
    trajectory_problem: str | None = None
    trajectory_missing: bool = False
    metrics_problem: str | None = None
    frames: Frames | None = None
    cpu_model: str | None = None
    machine: Machine | None = None
    pod: str | None = None
    played: Played | None = None
    metrics: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Failure:
    """Error of a Job of ours that could not do what it was asked, in its own words."""

    reason: Reason
    message: str


def clean(text: object, limit: int = _SENTENCE) -> str:
    """Return a text without what a terminal or an API server would stumble over, at most so long.

    Newlines and tabs stay; of a longer text the end is cut off.
    """
    shown = "".join(
        character
        for character in _COLOURS.sub("", str(text)[: 4 * limit])
        if character in "\n\t" or unicodedata.category(character) not in _HIDDEN
    )
    # Where the kubelet cuts a character in two, the API has U+FFFD in its place.
    shown = shown.strip("\ufffd").strip()
    return shown if len(shown) <= limit else shown[: limit - 1] + "…"


def tail(text: object, limit: int = 2048) -> str | None:
    """Return the last lines of a log, cleaned; None when there are none."""
    shown = clean(str(text or "")[-limit:], limit)
    return shown or None


def last_line(text: str | None) -> str:
    """Return the last line of a log that says something."""
    return clean(telling_line(text or ""), 300)


def read_object(text: object, limit: int = MESSAGE_BYTES) -> dict[str, Any] | None:
    """Return the JSON object that a text holds, cleaned; None when it holds none that can be passed on."""
    found = _loaded(text, limit)
    try:
        return None if found is None else _plain(found, _DEPTH)
    except ValueError:
        return None


def _loaded(text: object, limit: int = MESSAGE_BYTES) -> dict[str, Any] | None:
    """Return the JSON object that a text holds as it stands there."""
    if not isinstance(text, str) or len(text) > limit:
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def read_report(text: object) -> Report | None:
    """Return the report in a monitor's termination message; None when it is none."""
    found = read_object(text)
    if found is None or found.get("v") != 1 or "error" in found:
        return None
    trajectory = _model(TrajectoryInfo, found.get("trajectory"))
    if trajectory is not None and not _is_sha256(trajectory.sha256):
        trajectory = None
    problem = found.get("trajectoryProblem")
    missing = found.get("trajectoryMissing") is True
    if trajectory is None and not problem:
        problem, missing = "the monitor told of no trajectory", True
    return Report(
        reason=_reason(found.get("reason"), _MONITORS),
        message=_text(found.get("message")),
        started_at=_time(found.get("startedAt")),
        finished_at=_time(found.get("finishedAt")),
        usage=_model(Usage, found.get("usage")),
        trajectory=None if problem else trajectory,
        trajectory_problem=clean(problem) if problem else None,
        trajectory_missing=missing,
        metrics_problem=_text(found.get("metricsProblem")),
        frames=_model(Frames, found.get("frames")),
        cpu_model=_text(found.get("cpuModel"), 200),
        machine=_model(Machine, found.get("machine")),
        pod=pod if isinstance(pod := found.get("pod"), str) and _POD.fullmatch(pod) else None,
        played=_played(found.get("played")),
        metrics=_metrics((_loaded(text) or {}).get("metrics")),
    )


def _played(value: object) -> Played | None:
    if not isinstance(value, dict):
        return None
    reason = _reason(value.get("reason"), _PLAYERS)
    return Played(value.get("completed") is True, reason, _text(value.get("message")))


def _metrics(value: object) -> dict[str, Any]:
    """Return the algorithm's own values: as the monitor kept them, whoever wrote the message."""
    return keep_values(value).values if isinstance(value, dict) else {}


def read_failure(text: object) -> Failure | None:
    """Return the failure that a Job's termination message tells of; None when it tells of none."""
    error = (read_object(text) or {}).get("error")
    if not isinstance(error, dict):
        return None
    reason = _reason(error.get("reason"), _JOBS) or Reason.SYSTEM_FAULT
    return Failure(reason, _text(error.get("message"), 4000) or "it gave no reason")


def read_left(text: object) -> dict[str, str]:
    """Return the reasons for folders not brought back, by their run's UID, as a termination message says."""
    left = (read_object(text) or {}).get("left")
    if not isinstance(left, dict):
        return {}
    return {str(uid): _text(why, _SENTENCE) or "it gave no reason" for uid, why in left.items()}


def read_description(text: object) -> VariantDescription | None:
    """Return the variant in a preparation's termination message; None when it can't be read."""
    packed = (read_object(text) or {}).get("z")
    if not isinstance(packed, str):
        return None
    try:
        unpacking = zlib.decompressobj()
        # Bounded, as a few KiB of zlib can unfold to gigabytes.
        plain = unpacking.decompress(base64.b64decode(packed, validate=True), DESCRIPTION_BYTES)
        if not unpacking.eof:
            return None
        found = read_object(plain.decode(), DESCRIPTION_BYTES)
        return VariantDescription.model_validate(found)
    except (binascii.Error, zlib.error, ValueError):  # pydantic's error is a ValueError
        return None


def moment(text: object) -> float | None:
    """Return a time that the API server wrote, in s since 1970."""
    if not isinstance(text, str):
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()


def _plain(value: Any, depth: int) -> Any:
    if depth < 0:
        raise ValueError("nested too deeply")
    if isinstance(value, dict):
        return {clean(key, 200): _plain(item, depth - 1) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item, depth - 1) for item in value]
    if isinstance(value, str):
        return clean(value, MESSAGE_BYTES)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("not a finite number")
    if isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        raise ValueError("too large a number")
    return value


_AnyModel = TypeVar("_AnyModel", bound=Model)


def _model(kind: type[_AnyModel], value: object) -> _AnyModel | None:
    if not isinstance(value, dict):
        return None
    try:
        return kind.model_validate(value)
    except ValidationError:
        return None


def _reason(value: object, allowed: frozenset[Reason]) -> Reason | None:
    return next((reason for reason in allowed if reason == value), None)


def _text(value: object, limit: int = _SENTENCE) -> str | None:
    return clean(value, limit) or None if isinstance(value, str) else None


def _time(value: object) -> str | None:
    found = moment(value)
    if found is None or not 0 <= found < 2**35:
        return None
    return datetime.fromtimestamp(found, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _is_sha256(text: str) -> bool:
    return len(text) == 64 and not text.strip("0123456789abcdef")
