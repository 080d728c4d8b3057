# SPDX-License-Identifier: Apache-2.0
"""Rule by which a MappingRun is settled: Sweeps end, runs are archived and their files deleted by it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

FILES = "slamhive.io/files"
"""Annotation of runs whose Sweep keeps no files (``Delete``): the collector removes them once settled."""


def is_settled(run: Mapping[str, Any]) -> bool:
    """Tell whether nothing more will be written of a run: it has ended, and was measured if it can be.

    Args:
        run: the object as the API has it, however little of it is there.
    """
    status = run.get("status") or {}
    if status.get("phase") != "Succeeded":
        return status.get("phase") in {"Failed", "Cancelled"}
    wanted = (run.get("spec") or {}).get("evaluate", True) and status.get("trajectory")
    told = any(item.get("type") == "Evaluated" for item in status.get("conditions") or ())
    return not wanted or bool(status.get("results")) or told
