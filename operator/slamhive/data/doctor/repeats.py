# SPDX-License-Identifier: Apache-2.0
"""Judgement of images and scans that are the one before them again, as drivers send that lost one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.model.repair import MOST_DROPPED
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from slamhive.data.doctor.examined import Examined

_PIECE = 4096
"""Bytes that are compared before whole messages are."""
_MOVED = 1e-3
"""Metres between two frames that a sensor at rest doesn't move by."""
_LONG = 5
"""Repeats in a row beyond which a simulator without noise is at rest, where no truth tells."""
_IMAGES = "images", "a picture of another instant than its stamp bends every visual path"
_SCANS = "scans", "odometry stands still there and leaps in the next one, which may cost it the track"


def is_same(before: bytes, raw: bytes) -> bool:
    """Tell whether two messages are the same but for sequence number and stamp."""
    if len(before) != len(raw):
        return False
    middle = slice(len(raw) // 2, len(raw) // 2 + _PIECE)
    return before[middle] == raw[middle] and before[12:] == raw[12:]


def _in_a_row(numbers: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return of each number how long its run of consecutive ones is."""
    runs = np.cumsum(np.diff(numbers, prepend=-1) != 1)
    return np.asarray(np.bincount(runs)[runs], dtype=np.int64)


def judge_repeats(examined: Examined) -> Iterator[Finding]:
    """Yield frames that are the one before them again, but for those taken at rest by the ground truth."""
    truth = examined.truth
    for name, watchers in examined.watched.watchers.items():
        for watcher in watchers:
            of, repeated = watcher.of, np.array(watcher.repeated, dtype=np.int64)
            scan = examined.watched.scans[of.sensor.topic]
            # Of messages with one stamp, `stamps.equal` tells.
            again = repeated[scan.stamps[repeated] != scan.stamps[repeated - 1]]
            times = scan.stamps[again] / 1e9 + of.sensor.time_offset
            lengths, longest = _in_a_row(again), _LONG
            # A simulator without noise gives the same frame as long as nothing moves.
            if truth is not None and len(truth) > 1:
                spans = times[:, np.newaxis] + [-1 / (of.sensor.rate or 10.0), 0.0]
                places = np.stack([np.interp(spans, truth.stamps, axis) for axis in truth.positions.T])
                moves = np.linalg.norm(np.diff(places, axis=2), axis=0)[:, 0] > _MOVED
                # Ones at rest that are as short as those in motion are of the same fault.
                longest = int(lengths[moves].max(initial=0))
            again, times = again[lengths <= longest], times[lengths <= longest]
            if not len(again):
                continue
            share = len(again) / max(1, of.messages)
            is_lidar = of.sensor.type is SensorType.LIDAR
            what, harm = _SCANS if is_lidar else _IMAGES
            drop = again.tolist() if len(again) <= MOST_DROPPED else None
            yield Finding(
                "points.duplicate" if is_lidar else "images.duplicate",
                Severity.WARNING,
                f"{of.where}: {len(again)} {what} ({share:.1%}) on {of.sensor.topic} are the one before them "
                f"again under another stamp, the first at {times[0]:.3f} s: {harm}; leave them out",
                name,
                len(again),
                float(times[0]),
                100 * share,
                "%",
                repair=sensor_repair(name, drop=drop) if drop else {},
            )
