# SPDX-License-Identifier: Apache-2.0
"""LiDAR odometry: point-to-plane ICP of each scan against the points of some scans before it.

Simple on purpose: replace it with your own. It has no loop closure and no idea of what it sees.
"""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

NEIGHBOURS = 8  # that make a plane


class Odometry:
    """Registers scan after scan.

    Args:
        voxel: Of a scan and of the map one point is kept in each cube of this size, m.
        max_range: Points farther away are ignored, m.
        iterations: Steps of ICP at most.
    """

    def __init__(self, voxel: float, max_range: float, iterations: int) -> None:
        self.voxel, self.max_range, self.iterations = voxel, max_range, iterations
        self.pose = np.eye(4)  # of the LiDAR at the end of the last scan, in the frame of the first
        self.motion = np.eye(4)  # from the end of one scan to the end of the next
        self.last_added = None  # pose of the scan that was put into the map last
        self.map = np.empty((0, 3))
        self.tree = None

    def register(self, points: np.ndarray, times: np.ndarray | None) -> np.ndarray:
        """Take in a scan and return the pose of the LiDAR at its end.

        Args:
            points: `(n, 3)`, m, in the LiDAR's frame.
            times: `(n,)`, s; None: all of one moment.

        Returns:
            `(4, 4)`.
        """
        near = np.linalg.norm(points, axis=1) < self.max_range
        points, times = points[near], None if times is None else times[near]
        points = thin(self._at_the_end(points, times), self.voxel)
        guess = self.pose @ self.motion  # it goes on as it went
        pose = guess if self.tree is None else self._align(points, guess)
        self.motion = np.linalg.inv(self.pose) @ pose
        self.pose = pose
        if self.last_added is None or is_far(np.linalg.inv(self.last_added) @ pose, self.voxel):
            self._add(points)
        return pose

    def _at_the_end(self, points: np.ndarray, times: np.ndarray | None) -> np.ndarray:
        """Move points to where the LiDAR would see them at the end of the scan."""
        if times is None or not len(points) or np.ptp(times) == 0:
            return points
        before_end = (times.max() - times) / np.ptp(times)  # 1: the first point, 0: the last
        back = np.linalg.inv(self.motion)
        turns = Rotation.from_rotvec(before_end[:, None] * Rotation.from_matrix(back[:3, :3]).as_rotvec())
        return turns.apply(points) + before_end[:, None] * back[:3, 3]

    def _align(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Return the pose for which points lie best on the planes of the map, found near a guess."""
        for _ in range(self.iterations):
            seen = move(pose, points)
            distances, nearest = self.tree.query(seen, distance_upper_bound=2 * self.voxel)
            found = np.isfinite(distances)
            if found.sum() < 10:
                break
            a, b, n = seen[found], self.map[nearest[found]], self.normals[nearest[found]]
            error = np.einsum("ij,ij->i", n, b - a)
            w = 1 / (1 + (error / (0.2 * self.voxel)) ** 2) ** 2  # Geman-McClure: far ones count less
            J = np.hstack([np.cross(a - pose[:3, 3], n), n])
            H = (w[:, None] * J).T @ J + 1e-6 * np.eye(6)
            step = np.linalg.solve(H, J.T @ (w * error))
            turn = Rotation.from_rotvec(step[:3]).as_matrix()
            pose = pose.copy()
            pose[:3, :3] = turn @ pose[:3, :3]
            pose[:3, 3] += step[3:]
            if np.abs(step).max() < 1e-4:
                break
        return pose

    def _add(self, points: np.ndarray) -> None:
        """Put a scan into the map, and find the plane around each point."""
        centre = self.pose[:3, 3]
        kept = self.map[np.linalg.norm(self.map - centre, axis=1) < self.max_range]
        self.map = thin(np.vstack([kept, move(self.pose, points)]), self.voxel / 2)
        self.tree = cKDTree(self.map)
        self.last_added = self.pose
        _, nearest = self.tree.query(self.map, k=min(NEIGHBOURS, len(self.map)))
        around = self.map[nearest.reshape(len(self.map), -1)]
        spread = around - around.mean(axis=1, keepdims=True)
        self.normals = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0]


def is_far(motion: np.ndarray, voxel: float) -> bool:
    """Tell whether a motion shows something new: half a voxel, or 5 degrees."""
    return bool(np.linalg.norm(motion[:3, 3]) > voxel / 2 or np.trace(motion[:3, :3]) < 1 + 2 * np.cos(0.087))


def move(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points moved by a pose."""
    return points @ T[:3, :3].T + T[:3, 3]


def thin(points: np.ndarray, voxel: float) -> np.ndarray:
    """Return the first point of each cube."""
    cubes = np.floor(points / voxel).astype(np.int64) + 2**20
    _, first = np.unique(cubes @ [1, 2**21, 2**42], return_index=True)
    return points[np.sort(first)]
