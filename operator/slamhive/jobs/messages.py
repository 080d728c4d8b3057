# SPDX-License-Identifier: Apache-2.0
"""Termination messages of Jobs: what a Job tells the operator as it ends. `slamhive.kube.reports` reads them.

::

    {"v": 1, "z": BASE64}                       zlib of the JSON of a variant's description
    {"v": 1, "error": {"reason", "message"}}    why a Job could not do what it was asked
    {"v": 1, ...}                               anything else that is small
"""

from __future__ import annotations

import base64
import json
import zlib
from typing import TYPE_CHECKING, Any

from slamhive.model.configuration import SensorView
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from slamhive.model.results import Reason

MESSAGE_BYTES = 4096
"""The kubelet keeps no more of a container's termination message."""

_DIGITS = 12


def described(description: Mapping[str, Any]) -> str:
    """Return the termination message that carries a variant's description.

    What doesn't fit goes in this order: values of sensors that are the language's defaults, poses that are
    said twice, digits beyond the twelfth, what may be why programs fail, free attributes, poses of sensors
    that the variant doesn't hold. Nothing of the first four is needed to configure or to measure a run.

    Args:
        description: plain JSON values, ``sensors`` as `SensorView` writes them.

    Raises:
        SystemFault: it doesn't fit even so.
    """
    text = ""
    for candidate in _shorter_and_shorter(description):
        packed = zlib.compress(json.dumps(candidate, separators=(",", ":")).encode(), 9)
        text = json.dumps({"v": 1, "z": base64.b64encode(packed).decode("ascii")}, separators=(",", ":"))
        if len(text) <= MESSAGE_BYTES:
            return text
    raise SystemFault(
        f"the description of the variant takes {len(text)} bytes, a termination message holds {MESSAGE_BYTES}"
    )


def _shorter_and_shorter(description: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    found = dict(description)
    yield found
    views = {role: SensorView.model_validate(view) for role, view in found["sensors"].items()}
    found["sensors"] = {
        role: view.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        for role, view in views.items()
    }
    yield found
    held = {view.name: view.T_body_sensor for view in views.values()}
    poses = found.pop("extrinsics", {})
    others = {name: pose for name, pose in poses.items() if held.get(name) != pose}
    yield found | {"extrinsics": others}
    # The window decides which poses count: it keeps its digits.
    window = {key: found[key] for key in ("startTime", "durationSeconds")}
    found = _rounded(found) | window
    yield found | {"extrinsics": _rounded(others)}
    found.pop("suspicion", None)
    yield found | {"extrinsics": _rounded(others)}
    found.pop("attributes", None)
    yield found | {"extrinsics": _rounded(others)}
    yield found


def failed(reason: Reason, message: str) -> str:
    """Return the termination message of a Job that failed, shortened to what the kubelet keeps."""
    # Names of files may hold bytes that are no text.
    message = message.encode("utf-8", "replace").decode()
    limit = len(message)
    while True:
        shown = message if limit >= len(message) else message[:limit] + "…"
        error = {"reason": str(reason), "message": shown}
        text = json.dumps({"v": 1, "error": error}, ensure_ascii=False, separators=(",", ":"))
        excess = len(text.encode()) - MESSAGE_BYTES
        if excess <= 0:
            return text
        limit = max(0, min(limit, len(message)) - max(1, excess // 4))


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}")
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return value
