# SPDX-License-Identifier: Apache-2.0
"""Making and reading of variants in tests of perturbations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.highlevel import AnyReader

from slamhive.data.making.preparation import prepare
from slamhive.model.algorithm import DataFormat
from slamhive.model.run import InputOptions

if TYPE_CHECKING:
    from pathlib import Path


def read(path: Path) -> dict[str, list[Any]]:
    """Read the messages of a bag by topic."""
    found: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    return found


def stamps(messages: list[Any]) -> Any:
    return np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages])


def make(
    entry: Any, roles: Any, cache: Any, perturb: Any, form: Any = DataFormat.ROSBAG1, **options: Any
) -> Any:
    asked = InputOptions.model_validate(options | {"perturb": perturb})
    return prepare(entry, roles, asked, (form,), cache)
