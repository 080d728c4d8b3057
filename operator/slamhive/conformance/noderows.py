# SPDX-License-Identifier: Apache-2.0
"""Judgement of what came of starts of ROS nodes, which are played to. Pure; nothing is started here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.derived import late_seconds
from slamhive.conformance.findings import Finding, failed, passed, warned
from slamhive.conformance.rows import difference, ran

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.conformance.executors import CheckEnd
    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.model.results import RunRecord
    from slamhive.model.rosnodes import RosNode

_IN_VAIN = 0.1
"""Share of the frames that may have been waited for in vain, as while a system begins."""


def latency(ended: Sequence[CheckEnd]) -> Finding:
    """Say how long poses took, of starts in real time."""
    check = "latency"
    slowest = max((one.record for one in ended), key=lambda record: _latency(record).get("max", -1.0))
    took = _latency(slowest)
    if not took:
        how = "stamp poses with the time of their frame, not with that of publishing them"
        return warned(check, "no frame has a pose that was published while it was played", how)
    told = ", ".join(f"{took[name]:.3f} s ({name})" for name in ("median", "p95", "max") if name in took)
    prepared = slowest.provenance.prepared
    rate = prepared.frame_rate if prepared is not None and prepared.frame_rate else np.nan
    speed = (slowest.spec.get("input") or {}).get("rate") or 1.0
    late = late_seconds(np.array([took.get("max", 0.0)]), np.array([rate]), np.array([speed]))
    told = f"from a frame to its pose: {told}"
    if np.isnan(late[0]):
        return passed(check, told)
    how = "it falls behind: is its queue as long as realtime.queue says? input.rate plays slower"
    return warned(check, told, how)


def _latency(record: RunRecord) -> dict[str, float]:
    found = record.metrics.get("latencySeconds")
    numbers = found if isinstance(found, dict) else {}
    return {name: float(value) for name, value in numbers.items() if isinstance(value, int | float)}


def stepped(spec: AlgorithmSpec, node: RosNode, ended: Sequence[CheckEnd]) -> Finding:
    """Say whether starts frame by frame, where nothing is dropped for want of time, gave equal poses."""
    check = "stepped"
    verdict = ran(ended)
    if verdict.answer == "fail":
        return failed(check, verdict.found, verdict.help)
    records = [one.record for one in ended]
    offered = sum((one.frames.offered or 0) for one in records if one.frames is not None)
    in_vain = sum(_number(one, "framesWaitedForInVain") for one in records)
    told, equal = f"{len(ended)} runs are equal to the byte", True
    if len({one.trajectory.sha256 if one.trajectory else None for one in records}) > 1:
        told, equal = difference([one.trajectory for one in ended])
        told = f"{len(ended)} runs {told}"
    told += f"; {in_vain:.0f} of {offered} frames had no pose after {node.step}"
    if in_vain > _IN_VAIN * max(offered, 1):
        how = "give ros1.step or ros2.step more time; of a node that answers fewer frames Stepped says little"
        return warned(check, told, how)
    if equal:
        return passed(check, told)
    how = "threads or limits of wall time in it decide, not dropped frames: compare medians of repeated runs"
    return failed(check, told, how) if spec.deterministic == "Yes" else warned(check, told, how)


def _number(record: RunRecord, name: str) -> float:
    found = record.metrics.get(name)
    return float(found) if isinstance(found, int | float) else 0.0
