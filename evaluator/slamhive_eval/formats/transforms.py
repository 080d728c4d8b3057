# SPDX-License-Identifier: Apache-2.0
"""Frames and the transforms between them over time, as ROS publishes them on /tf and /tf_static."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.association import interpolate
from slamhive_eval.errors import TrajectoryError, did_you_mean
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive_eval.rotation import FloatArray

Edge = tuple[str, str]
"""Parent and child."""
Step = tuple[Edge, bool]
"""A transform on the way between two frames, and whether it is gone through backwards."""

BUFFER_SECONDS = 10.0
"""Transforms further apart have none between them; as much as tf2 keeps by default."""


class Frames:
    """A tree of frames, whose transforms may move."""

    def __init__(self) -> None:
        self._edges: dict[Edge, list[tuple[float, tuple[float, ...]]]] = {}

    def add(
        self, parent: str, child: str, stamp: float, pose: tuple[float, ...], *, static: bool = False
    ) -> None:
        """Add a transform.

        Args:
            parent: Frame that the pose is in; a leading slash doesn't count.
            child: Frame whose pose it is.
            stamp: Time in s.
            pose: x, y, z in m and the quaternion's x, y, z, w.
            static: Whether it holds at all times; the last one does.
        """
        edge = (parent.lstrip("/"), child.lstrip("/"))
        if static:
            self._edges[edge] = [(stamp, pose)]
        else:
            self._edges.setdefault(edge, []).append((stamp, pose))

    def __iter__(self) -> Iterator[Edge]:
        """Parent and child of each transform."""
        return iter(self._edges)

    @property
    def names(self) -> list[str]:
        """All frames in alphabetical order."""
        return sorted({name for edge in self._edges for name in edge})

    def split(self, pair: str) -> tuple[str, str]:
        """The two frames of ``PARENT.CHILD``, whose names may have dots themselves.

        Raises:
            TrajectoryError: One of them is none.
        """
        names = set(self.names)
        parts = pair.split(".")
        splits = [(".".join(parts[:k]), ".".join(parts[k:])) for k in range(1, len(parts))]
        for parent, child in splits:
            if parent.lstrip("/") in names and child.lstrip("/") in names:
                return parent.lstrip("/"), child.lstrip("/")
        for name in splits[0] if splits else (pair,) * bool(pair):
            if name.lstrip("/") not in names:
                raise TrajectoryError(
                    f"name two frames as in map.base_link; {name!r} is none"
                    f"{did_you_mean(name, names) or f'; there are {_listed(names)}'}"
                )
        only = f", not only {pair!r}" if pair else ""
        raise TrajectoryError(f"name two frames as in map.base_link{only}; there are {_listed(names)}")

    def steps(self, parent: str, child: str) -> list[Step]:
        """The transforms on the way from a frame to another.

        Raises:
            TrajectoryError: No transforms lead there, or a frame on the way has two parents.
        """
        down = [(edge, False) for edge in self._up(child)]
        # Up from the parent to the root and down again to the child; what both share cancels.
        up = [(edge, True) for edge in self._up(parent)]
        root = [chain[-1][0][0] if chain else name for chain, name in ((down, child), (up, parent))]
        if root[0] != root[1]:
            raise TrajectoryError(f"no transforms lead from {parent!r} to {child!r}")
        while down and up and down[-1][0] == up[-1][0]:
            down.pop()
            up.pop()
        return [*up, *reversed(down)]

    def moving(self, steps: list[Step]) -> list[Edge]:
        """Those of the transforms that have more than one stamp."""
        return [edge for edge, _ in steps if len(self._edges[edge]) > 1]

    def fixed_pose(self, parent: str, child: str) -> FloatArray | None:
        """The pose of a frame in another, (4, 4), by the first transform of each; None without any."""
        try:
            steps = self.steps(parent, child)
        except TrajectoryError:
            return None
        first = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
        for edge, backwards in steps:
            step = self._trajectory(edge).select(slice(1))
            first = _composed(first, step.positions, step.quaternions, backwards=backwards)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = first.matrices[0], first.positions[0]
        return pose

    def trajectory(self, parent: str, child: str) -> Trajectory:
        """The pose of a frame in another over time.

        The stamps are those of the moving transform that has most; other moving ones are interpolated
        there, linear and by slerp, and times at which one of them has no transform within 10 s are left out.

        Raises:
            TrajectoryError: No transforms lead there, they have no time in common, or one is no pose.
        """
        steps = self.steps(parent, child)
        if not steps:
            raise TrajectoryError(f"a frame in itself doesn't move: {parent!r}")
        moving = self.moving(steps) or [steps[0][0]]
        base = self._trajectory(max(moving, key=lambda edge: len(self._edges[edge])))
        n = len(base)
        result = Trajectory(base.stamps, np.zeros((n, 3)), np.tile((0.0, 0.0, 0.0, 1.0), (n, 1)))
        known = np.ones(n, dtype=bool)
        for edge, backwards in steps:
            step = self._trajectory(edge)
            if len(step) == 1:
                positions, quaternions = np.repeat(step.positions, n, 0), np.repeat(step.quaternions, n, 0)
            else:
                found, positions, quaternions = interpolate(step, base.stamps, BUFFER_SECONDS)
                known &= found
            result = _composed(result, positions, quaternions, backwards=backwards)
        if not known.any():
            raise TrajectoryError(
                f"the transforms from {parent!r} to {child!r} have no time in common: "
                + ", ".join(f"{a} to {b}" for a, b in moving)
            )
        return result.select(np.flatnonzero(known))

    def _trajectory(self, edge: Edge) -> Trajectory:
        stamps = np.array([stamp for stamp, _ in self._edges[edge]])
        poses = np.array([pose for _, pose in self._edges[edge]])
        order = np.argsort(stamps, kind="stable")
        try:
            return Trajectory(stamps[order], poses[order, :3], poses[order, 3:])
        except TrajectoryError as error:
            raise TrajectoryError(f"transform from {edge[0]!r} to {edge[1]!r}: {error}") from None

    def _up(self, frame: str) -> list[Edge]:
        """The transforms from a frame up to its root."""
        parents: dict[str, str] = {}
        for parent, child in self._edges:
            if child in parents:
                parents[child] += f"\n{parent}"
            else:
                parents[child] = parent
        chain: list[Edge] = []
        while frame in parents:
            parent = parents[frame]
            if "\n" in parent:
                raise TrajectoryError(f"the frame {frame!r} has several parents: {_listed(parent.split())}")
            if len(chain) > len(parents):
                raise TrajectoryError(f"the transforms go round in a circle at {frame!r}")
            chain.append((parent, frame))
            frame = parent
        return chain


def _composed(
    before: Trajectory, positions: FloatArray, quaternions: FloatArray, *, backwards: bool
) -> Trajectory:
    if backwards:
        quaternions = rotation.conjugate(quaternions)
        positions = -rotation.rotate(quaternions, positions)
    return Trajectory(
        before.stamps,
        before.positions + rotation.rotate(before.quaternions, positions),
        rotation.multiply(before.quaternions, quaternions),
    )


def _listed(names: object) -> str:
    shown = sorted(names)  # type: ignore[call-overload]
    return ", ".join(shown[:12]) + (", …" if len(shown) > 12 else "")
