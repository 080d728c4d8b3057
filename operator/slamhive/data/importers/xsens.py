# SPDX-License-Identifier: Apache-2.0
"""Samples of the Xsens IMU of MulRan and HeLiPR, whose columns are told apart by what is in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.importers.contents import imu_stream
from slamhive.data.importers.scans import mean_rate
from slamhive.data.importers.tables import read_table, rows
from slamhive.model.errors import DataError
from slamhive.model.sensors import Sensor

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers.contents import SensorStream

    Array = npt.NDArray[np.float64]

_GRAVITY, _TOLERANCE = 9.81, 1.0
_VECTORS = ((8, 10), (11, 13), (14, 16))
"""Columns of the three vectors, counted from the stamp as 0: behind a quaternion and Euler angles."""
_WIDE = 17


def xsens_stream(path: Path, pose: Array, notes: list[str]) -> SensorStream | None:
    """Return the IMU's stream; None where the file has orientations alone.

    Columns 8 to 16 are three vectors: angular velocity, acceleration and magnetic field, but readers of these
    data disagree on their order. The acceleration is the one whose length is 9.81 m/s² typically; of the
    others the magnetic field is the one whose length varies less, in proportion.

    Args:
        path: xsens_imu.csv: ns and 16 numbers a line.
        pose: T_body_sensor, (4, 4).
        notes: To which is added what was found.

    Raises:
        DataError: It is damaged, or no vector is an acceleration.
    """
    first = next(rows(path), None)
    if first is not None and len(first[1]) < _WIDE:
        notes.append(f"{path.name}: {len(first[1])} columns, no angular velocity and acceleration: no IMU")
        return None
    table = read_table(path, _WIDE - 1, "a stamp in ns and 16 numbers", stamp="ns")
    table = table.ascending("IMU samples", notes)
    vectors = {columns: table.values[:, columns[0] - 1 : columns[1]] for columns in _VECTORS}
    lengths = {columns: np.linalg.norm(vector, axis=1) for columns, vector in vectors.items()}
    forces = min(_VECTORS, key=lambda columns: abs(float(np.median(lengths[columns])) - _GRAVITY))
    typical = float(np.median(lengths[forces]))
    if abs(typical - _GRAVITY) > _TOLERANCE:
        raise DataError(
            f"{path}: none of the columns 8 to 16 are an acceleration: 9.81 m/s² typically; the nearest are "
            f"{forces[0]} to {forces[1]} with {typical:.3g}"
        )
    others = [columns for columns in _VECTORS if columns != forces]
    rates = max(others, key=lambda columns: _variation(lengths[columns]))
    notes.append(
        f"{path.name}: acceleration from the columns {forces[0]} to {forces[1]} ({typical:.2f} m/s² "
        f"typically), angular velocity from {rates[0]} to {rates[1]}; the stamp is column 0"
    )
    sensor = {"type": "Imu", "topic": "/imu", "frameId": "imu", "rate": mean_rate(table.stamps)}
    declared = Sensor.model_validate(sensor | {"T_body_sensor": pose.tolist(), "imu": {}})
    return imu_stream("imu", declared, table.stamps, vectors[rates], vectors[forces])


def _variation(lengths: Array) -> float:
    mean = float(lengths.mean())
    return float(lengths.std()) / mean if mean > 0 else np.inf
