# SPDX-License-Identifier: Apache-2.0
"""Result archives that ``evo_res`` reads, and error arrays for numpy.

An archive holds info.json, stats.json and one .npy an array, under the names that evo 1.38 gives them.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval.errors import FileError
from slamhive_eval.metrics import RELATION_UNITS
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive_eval.metrics import Relation
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

_RELATIONS: dict[Relation, str] = {
    "trans_part": "translation part",
    "rot_part": "rotation part",
    "full": "full transformation",
    "angle_deg": "rotation angle in degrees",
    "angle_rad": "rotation angle in radians",
    "point_distance": "point distance",
    "point_distance_error_ratio": "point distance error ratio",
}
_ALIGNMENTS = {
    "none": "not aligned",
    "origin": "with origin alignment",
    "se3": "with SE(3) Umeyama alignment",
    "sim3": "with Sim(3) Umeyama alignment",
    "scale": "scale corrected",
    "yaw": "with yaw alignment",
}


@dataclass(frozen=True, eq=False)
class ErrorSeries:
    """Errors of one estimate with where and when they are.

    Attributes:
        metric: ``ape`` or ``rpe``.
        relation: What the errors are of.
        errors: In the relation's unit, shape (k,), k ≥ 1.
        reference: Associated ground truth, m poses.
        estimate: Associated estimate, aligned, m poses.
        pairs: Indices (i, j) of an rpe, shape (k, 2), each error standing at j; None for an ape, k = m.
        method: The alignment's.
        transform: The alignment, shape (4, 4); None for none.
        reference_name: As it shall be called.
        estimate_name: As it shall be called; evo_res labels results by it.
        detail: Further words for the title, such as the delta.
    """

    metric: str
    relation: Relation
    errors: FloatArray
    reference: Trajectory
    estimate: Trajectory
    pairs: IndexArray | None = None
    method: str = "none"
    transform: FloatArray | None = None
    reference_name: str = "reference"
    estimate_name: str = "estimate"
    detail: str = ""

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """Errors, stamps (s), seconds from the start and distances (m) along both paths, shape (k,) each."""
        ends: IndexArray | slice = slice(None) if self.pairs is None else self.pairs[:, 1]
        found = {"error_array": self.errors}
        if self.pairs is None or len(self.pairs) == len(self.errors):
            stamps = self.estimate.stamps
            found |= {
                "seconds_from_start": (stamps - stamps[0])[ends],
                "timestamps": stamps[ends],
                "distances_from_start": self.reference.distances[ends],
                "distances": self.estimate.distances[ends],
            }
        if self.transform is not None:
            found["alignment_transformation_sim3"] = self.transform
        return found

    @property
    def title(self) -> str:
        """Title that names the measured error and the alignment, in evo's words, on several lines."""
        unit = RELATION_UNITS[self.relation]
        relation = f"{_RELATIONS[self.relation]} ({unit or 'unit-less'})"
        lines = [f"{self.metric.upper()} w.r.t. {relation}", self.detail]
        return "\n".join(line for line in (*lines, f"({_ALIGNMENTS[self.method]})") if line)


def write_evo_zip(path: str | Path, series: ErrorSeries) -> None:
    """Write a result archive for ``evo_res``.

    Args:
        path: Where to.
        series: The errors. Distances of an rpe are those along the whole path, where evo cuts corners
            from pair to pair.

    Raises:
        FileError: It can't be written.
    """
    statistics = Statistics.of(series.errors)
    unit = RELATION_UNITS[series.relation] or "unit-less"
    info = {
        "title": series.title,
        "ref_name": series.reference_name,
        "est_name": series.estimate_name,
        "label": f"{series.metric.upper()} ({unit})",
    }
    try:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("info.json", json.dumps(info))
            archive.writestr("stats.json", json.dumps(statistics.as_dict() if statistics else {}))
            for name, array in series.arrays.items():
                data = io.BytesIO()
                np.save(data, array)
                archive.writestr(f"{name}.npy", data.getvalue())
    except OSError as error:
        raise FileError(path, f"can't be written: {error.strerror or error}") from error


def write_error_arrays(path: str | Path, series: ErrorSeries) -> None:
    """Write the same arrays, the pairs of an rpe and the compared positions, as one .npz for numpy.

    Args:
        path: Where to.
        series: The errors.

    Raises:
        FileError: It can't be written.
    """
    arrays: dict[str, FloatArray | IndexArray] = {
        **series.arrays,
        "reference_positions": series.reference.positions,
        "estimate_positions": series.estimate.positions,
    }
    if series.pairs is not None:
        arrays["pairs"] = series.pairs
    try:
        with open(path, "wb") as file:  # noqa: PTH123 - savez would append .npz to a path
            np.savez_compressed(file, allow_pickle=False, **arrays)
    except OSError as error:
        raise FileError(path, f"can't be written: {error.strerror or error}") from error
