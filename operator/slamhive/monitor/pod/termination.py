# SPDX-License-Identifier: Apache-2.0
"""Termination message of the sidecar: the essence of summary.json in at most 4 KiB. The operator reads it.

The kubelet takes 4 KiB of a container, shares 12 KiB among all containers of a pod, and cuts what is longer.
Cut JSON says nothing: where a pod was given more than three containers, the operator has the file read.
"""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

from slamhive.contract.metrics import MOST_BYTES, keep_values

if TYPE_CHECKING:
    from collections.abc import Mapping

LIMIT_BYTES = 4096
_OTHER_BYTES = LIMIT_BYTES - MOST_BYTES - len(',"metrics":')
VERSION = 1
_TAKEN_OVER = (
    "reason",
    "message",
    "startedAt",
    "finishedAt",
    "usage",
    "trajectory",
    "trajectoryProblem",
    "trajectoryMissing",
    "metricsProblem",
    "frames",
    "played",
    "cpuModel",
    "machine",
    "pod",
)
# Of these, in this order, as much goes as must; what can't be shortened goes altogether.
_GIVEN_UP = (
    "message",
    "trajectoryProblem",
    "metricsProblem",
    "cpuModel",
    "machine",
    "frames",
    "played",
    "trajectory",
    "usage",
)
_SHORTEST_TEXT = 40


def termination_message(summary: Mapping[str, Any]) -> bytes:
    """Return the part of a summary.json for the kubelet: compact JSON of at most `LIMIT_BYTES`."""
    told = {"v": VERSION, **{name: _rounded(summary[name]) for name in _TAKEN_OVER if name in summary}}
    for name in _GIVEN_UP:
        surplus = len(_encode(told)) - _OTHER_BYTES
        if surplus <= 0:
            break
        text = told.get(name)
        if isinstance(text, str):
            told[name] = _shortened(text, surplus)
        elif name in told:
            told[name] = None
    metrics = summary.get("metrics")
    if isinstance(metrics, dict):
        # All that is kept, or a run would have other columns here than on a workstation. A file that is read
        # later may be another's than the monitor's, so what is too much is left out here too.
        told["metrics"] = keep_values(metrics).values
    return _encode(told)


def write_message(path: str, message: bytes) -> None:
    """Write the message in place: the kubelet mounts the file, so that it can't be replaced.

    Raises:
        OSError: It can't be written.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
    try:
        while message:
            message = message[os.write(descriptor, message) :]
    finally:
        os.close(descriptor)


def _shortened(text: str, surplus: int) -> str:
    """Cut at least so many bytes of its JSON off a text's end, but leave its beginning."""
    room = len(_encode(text)) - surplus - len("…".encode())
    low, high = min(_SHORTEST_TEXT, len(text)), len(text)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if len(_encode(text[:middle])) <= room else (low, middle - 1)
    return text if low == len(text) else text[:low] + "…"


def _encode(value: Any) -> bytes:
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode(
        "utf-8", "replace"
    )  # half a character can't be encoded, and the algorithm may send one


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return round(value, 6) if isinstance(value, float) else value
