# SPDX-License-Identifier: Apache-2.0
"""Figures that describe one trajectory, for ``slamhive-eval traj``: length, duration, gaps, speeds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.coverage import is_keyframes

if TYPE_CHECKING:
    from slamhive_eval.trajectory import Trajectory

GAP_PERIODS = 5.0
"""A step longer than so many median steps is a gap."""


def describe(trajectory: Trajectory) -> dict[str, Any]:
    """Figures of a trajectory.

    Returns:
        ``poses``; ``start``, ``end`` and ``duration`` in s; ``pathLength`` in m; ``extent``, the size along
        x, y and z in m; ``medianStep`` and ``longestStep`` between stamps in s; ``gaps``, the number of
        steps longer than five median ones; ``equalStamps``; ``meanSpeed`` and ``maxSpeed`` in m/s;
        ``turned``, all rotation from pose to pose in degrees; ``keyframes``; ``oriented``. What takes two
        poses or a step in time is None without.
    """
    steps = np.diff(trajectory.stamps)
    moving = steps > 0
    lengths = rotation.vector_norm(np.diff(trajectory.positions, axis=0))
    duration = float(trajectory.stamps[-1] - trajectory.stamps[0])
    median = float(np.median(steps)) if len(steps) else None
    q = trajectory.quaternions
    turned = rotation.angle(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
    return {
        "poses": len(trajectory),
        "start": float(trajectory.stamps[0]),
        "end": float(trajectory.stamps[-1]),
        "duration": duration,
        "pathLength": trajectory.path_length,
        "extent": np.ptp(trajectory.positions, axis=0).tolist(),
        "medianStep": median,
        "longestStep": float(steps.max()) if len(steps) else None,
        "gaps": int(np.count_nonzero(steps > GAP_PERIODS * median)) if median else 0,
        "equalStamps": int(np.count_nonzero(~moving)),
        "meanSpeed": trajectory.path_length / duration if duration > 0 else None,
        "maxSpeed": float((lengths[moving] / steps[moving]).max()) if moving.any() else None,
        "turned": float(np.rad2deg(turned.sum())) if trajectory.oriented else None,
        "keyframes": is_keyframes(trajectory),
        "oriented": trajectory.oriented,
    }
