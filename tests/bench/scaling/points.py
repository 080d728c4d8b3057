# SPDX-License-Identifier: Apache-2.0
"""The Sweep of the benchmark: its points, and the error that each is played to have."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

from testcluster.lab import sweep

if TYPE_CHECKING:
    from collections.abc import Mapping

POINT = "size"
"""The parameter that tells the points apart."""


def error_at(value: float) -> float:
    """Return the ATE that a run is played to have, m, by its parameter."""
    return zlib.crc32(str(int(value)).encode()) % 1000 / 1000


def large_sweep(
    name: str, count: int, window: int, *, retained: int, first: int = 1, **spec: Any
) -> dict[str, Any]:
    """Return a Sweep of so many points, which are evaluated, archived and deleted.

    Args:
        name: its name.
        count: number of its points.
        window: how many run at a time.
        retained: how many finished runs keep their objects.
        first: parameter of its first point.
        spec: further fields.
    """
    # A range, not a list of values: the Sweep stays as small as those that people write.
    axis = {"path": f"parameters.{POINT}", "range": {"from": first, "to": first + count - 1, "count": count}}
    fields = {
        "matrix": [axis],
        "parallelism": window,
        "retention": {"runs": retained},
        "cachePolicy": "Rerun",
    }
    return sweep(name, template={"evaluate": True}, **(fields | spec))


def point_of(run: Mapping[str, Any]) -> int:
    """Return the parameter of a run's point."""
    return int(run["spec"]["parameters"][POINT])
