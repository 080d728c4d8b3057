# SPDX-License-Identifier: Apache-2.0
"""Support for adapters of evalio's pipelines: compiled ports of odometries behind one interface.

evalio takes scans in row-major order, stamped with their start, points with the time since then. It answers
in the frame of the IMU, which is the lidar's own where the extrinsics between the two are left at identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from adapter_recording import Recording, decode_cloud, decode_imu, inertial_order, scan_window
from adapter_support import NANOSECONDS, AdapterError, Run, Sensor, Stopwatch, Trajectory, write_results
from evalio._cpp.helpers import DataType, Field, PointCloudMetadata, fill_col_row_major, pc2_to_evalio
from evalio.types import SE3, ImuMeasurement, ImuParams, LidarMeasurement, LidarParams, Stamp

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evalio.pipelines import Pipeline

POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("t", "<u4"),
        ("range", "<u4"),
        ("ring", "<u2"),
        ("padding", "<u2"),
    ]
)
FIELDS = [
    Field(name=name, datatype=datatype, offset=POINT.fields[name][1])
    for name, datatype in {
        "x": DataType.FLOAT32,
        "y": DataType.FLOAT32,
        "z": DataType.FLOAT32,
        "intensity": DataType.FLOAT32,
        "t": DataType.UINT32,
        "range": DataType.UINT32,
        "ring": DataType.UINT16,
    }.items()
]

Instant = str
"""Instant of a scan that a pipeline's pose belongs to: start, middle or end."""


@dataclass(frozen=True)
class Scan:
    """A scan as evalio takes it.

    Attributes:
        times: `(n,)`, seconds after the header stamp, or None.
        size: Number of its finite points.
        measurement: The scan; its stamp is set when it is handed over.
    """

    times: np.ndarray | None
    size: int
    measurement: LidarMeasurement


@dataclass(frozen=True)
class Layout:
    """Decodes scans to evalio's order of points.

    Attributes:
        rows: Rings of the lidar.
        columns: Points of a ring.
        grid: Whether every ring has all its points, missing ones as zeros; or else no missing ones.
    """

    rows: int
    columns: int
    grid: bool

    @classmethod
    def of(cls, lidar: Sensor, grid: bool) -> Layout:
        """Take the layout from the lidar's calibration, which a grid can't do without."""
        if grid:
            return cls(int(lidar.detail("rings")), int(lidar.detail("columns")), grid)
        return cls(int(lidar.details.get("rings") or 1), int(lidar.details.get("columns") or 1), grid)

    def decode(self, message: Any, sensor: Sensor) -> Scan:
        """Decode a sensor_msgs/PointCloud2.

        Raises:
            AdapterError: A grid is wanted, but the points have no ring or exceed it.
        """
        cloud = decode_cloud(message, sensor)
        points = np.zeros(len(cloud.points), POINT)
        points["x"], points["y"], points["z"] = cloud.points.T
        points["range"] = np.linalg.norm(cloud.points, axis=1) * 1000
        if cloud.intensities is not None:
            points["intensity"] = cloud.intensities
        if cloud.times is not None and len(points):
            points["t"] = np.rint((cloud.times - cloud.times.min()) * NANOSECONDS)
        if cloud.rings is not None:
            points["ring"] = cloud.rings
        if self.grid:
            if cloud.rings is None:
                raise AdapterError(f"{sensor.topic} has no field with the ring of a point, which is needed")
            points = self._arrange(points, sensor)
        size = len(points)
        metadata = PointCloudMetadata(
            stamp=Stamp.from_nsec(0),
            width=size,
            height=1,
            point_step=POINT.itemsize,
            row_step=size * POINT.itemsize,
            is_bigendian=0,
            is_dense=1,
        )
        measurement = pc2_to_evalio(metadata, FIELDS, points.tobytes())
        if size:
            fill_col_row_major(measurement)
        return Scan(cloud.times, len(cloud.points), measurement)

    def _arrange(self, points: np.ndarray, sensor: Sensor) -> np.ndarray:
        ticks, column = np.unique(points["t"], return_inverse=True)
        if len(ticks) > self.columns or len(ticks) * self.rows < len(points):
            # No time per column: the order of the points in their ring has to do.
            order = np.lexsort((points["t"], points["ring"]))
            firsts = np.searchsorted(points["ring"][order], np.arange(self.rows))
            column = np.empty(len(points), int)
            column[order] = np.arange(len(points)) - firsts[np.minimum(points["ring"][order], self.rows - 1)]
        if points["ring"].max(initial=0) >= self.rows or column.max(initial=0) >= self.columns:
            size = f"{self.rows} rings of {self.columns} columns"
            raise AdapterError(f"{sensor.topic} has more points than the {size} in config.yaml")
        grid = np.zeros((self.rows, self.columns), POINT)
        grid["ring"] = np.arange(self.rows)[:, None]
        if len(ticks) <= self.columns:
            grid["t"][:, : len(ticks)] = ticks
        grid[points["ring"], column] = points
        return grid.reshape(-1)


def configure(
    run: Run, pipeline: Pipeline, parameters: Mapping[str, Any], layout: Layout, limits: tuple[float, float]
) -> None:
    """Set a pipeline up.

    Args:
        run: The run.
        pipeline: The pipeline.
        parameters: Its parameters by evalio's names.
        layout: How its scans come.
        limits: Least and greatest range of a point in m.

    Raises:
        AdapterError: evalio doesn't know a parameter.
    """
    defaults = pipeline.default_params()
    # evalio tells 1 from 1.0, which YAML and JSON do not.
    typed = {name: type(defaults.get(name, value))(value) for name, value in parameters.items()}
    unknown = pipeline.set_params(defaults | typed)
    if unknown:
        raise AdapterError(f"evalio's {pipeline.name()} has no parameter {', '.join(unknown)}")
    lidar = run.sensor("lidar")
    pipeline.set_lidar_params(
        LidarParams(
            num_rows=layout.rows,
            num_columns=layout.columns,
            min_range=limits[0],
            max_range=limits[1],
            rate=lidar.rate or 10.0,
        )
    )
    if "imu" in run.sensors:
        imu = run.sensor("imu")
        noise = imu.details
        pipeline.set_imu_params(
            ImuParams(
                gyro=noise["gyroscopeNoise"],
                accel=noise["accelerometerNoise"],
                gyro_bias=noise["gyroscopeRandomWalk"],
                accel_bias=noise["accelerometerRandomWalk"],
                gravity=np.array([0.0, 0.0, run.gravity_magnitude]),
                rate=imu.rate or 200.0,
            )
        )
        pipeline.set_imu_T_lidar(SE3.from_mat(np.linalg.inv(imu.T_body_sensor) @ lidar.T_body_sensor))
    pipeline.initialize()


def run_pipeline(run: Run, pipeline: Pipeline, layout: Layout, instant: Instant, delay: int = 0) -> None:
    """Feed the recording to a pipeline that is set up, and write the results.

    Args:
        run: The run.
        pipeline: The pipeline.
        layout: How its scans come.
        instant: Which instant of a scan its poses belong to.
        delay: How many scans its poses are behind. A pose that is the one before over again is left out.
    """
    lidar = run.sensor("lidar")
    inertial = "imu" in run.sensors
    decoders = {"lidar": layout.decode} | ({"imu": decode_imu} if inertial else {})
    recording = Recording(run, decoders)
    items = inertial_order(recording.items(), lidar) if inertial else recording.items()
    trajectory, watch, empty = Trajectory(), Stopwatch(), 0
    stamps: list[int] = []
    latest = None
    for item in items:
        if item.role == "imu":
            sample, stamp = item.data, Stamp.from_nsec(item.stamp)
            pipeline.add_imu(ImuMeasurement(stamp, sample.gyroscope, sample.accelerometer))
            continue
        if not item.data.size:
            empty += 1
            continue
        start, end = scan_window(item, lidar)
        stamps.append({"start": start, "middle": (start + end) // 2, "end": end}[instant])
        item.data.measurement.stamp = Stamp.from_nsec(start)
        with watch.frame():
            pipeline.add_lidar(item.data.measurement)
        for _, estimate in pipeline.saved_estimates():
            pose = estimate.to_mat()
            if len(stamps) > delay and (latest is None or not np.array_equal(pose, latest)):
                trajectory.add(stamps[-1 - delay], pose)
            latest = pose if delay else None
    write_results(run, trajectory, watch, recording.cpu_seconds, recording.dropped["lidar"] + empty)
