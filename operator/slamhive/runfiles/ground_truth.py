# SPDX-License-Identifier: Apache-2.0
"""Ground truth for plots: found where it is at hand, never made or fetched."""

from __future__ import annotations

import glob
import math
import re
import time
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.model.errors import SlamHiveError
from slamhive_eval import ControlPoints, EvaluationError, Trajectory, read_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.model.dataset import Dataset

_KEPT = 8
_KEPT_SECONDS = 60.0
_DIGITS = re.compile(r"-[0-9a-f]{16}")
"""Suffix behind a dataset's name in the name of the folder that was generated of it."""


@dataclass(frozen=True, eq=False)
class DatasetTruth:
    """Ground truth of a dataset.

    Attributes:
        poses: over time; of control points their positions.
        T_body_frame: pose in the body of the frame that they are poses of, (4, 4).
        are_points: whether they are control points, between which nothing is known.
    """

    poses: Trajectory
    T_body_frame: npt.NDArray[np.float64]
    are_points: bool = False


class DatasetTruths:
    """Looks for ground truth in a folder of files named after datasets, then in a home.

    Args:
        folder: with DATASET.txt (TUM) or DATASET.csv (EuRoC); None for none.
        home: a workstation's home; None for none.
        clock: monotonic time, s.
    """

    def __init__(
        self,
        folder: Path | None = None,
        home: Path | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folders = [place for place in (folder, home and home / "groundtruth") if place is not None]
        self._home = home
        self._clock = clock
        self._kept: OrderedDict[str, tuple[float, DatasetTruth]] = OrderedDict()

    def find(self, dataset: str, label: str | None = None) -> DatasetTruth | None:
        """Return the ground truth of a dataset; None where there is none here, or none of poses.

        Args:
            dataset: its name.
            label: another name that files may have.
        """
        now = self._clock()
        read, kept = self._kept.get(dataset, (-math.inf, None))
        if now - read < _KEPT_SECONDS:
            return kept
        truth = self._in_folders(dataset, label) or self._in_home(dataset)
        self._kept.pop(dataset, None)
        if truth is not None:  # what is missing may come any moment: with an import, with a preparation
            self._kept[dataset] = (now, truth)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return truth

    def _in_folders(self, dataset: str, label: str | None) -> DatasetTruth | None:
        folders = [folder for folder in self._folders if folder.is_dir()]
        if not folders:
            return None
        from slamhive.data.store.truthfolders import GroundTruthFolder  # noqa: PLC0415 - with the models of datasets

        for folder in folders:
            for name in dict.fromkeys((dataset, label)):
                if name is None or "/" in name or name.startswith("."):
                    continue
                try:
                    return DatasetTruth(GroundTruthFolder(folder).read(name), np.eye(4))
                except (SlamHiveError, EvaluationError, OSError):
                    continue
        return None

    def _in_home(self, dataset: str) -> DatasetTruth | None:
        if self._home is None:
            return None
        try:
            return _of_home(self._home, dataset)
        except (SlamHiveError, EvaluationError, OSError):
            return None


def _of_home(home: Path, dataset: str) -> DatasetTruth | None:
    from slamhive.local.home.catalog import load_datasets  # noqa: PLC0415 - a cluster's dashboard never needs it
    from slamhive.local.home.folder import Home  # noqa: PLC0415

    place = load_datasets(Home.at(home)).get(dataset)
    is_made_here = place is not None and place.dataset.spec.recording.synthetic is not None
    if place is None or (is_made_here and place.dataset.spec.repair is None):
        made = _generated(home, place.dataset if place is not None else None, dataset)
        return DatasetTruth(read_tum(made), np.eye(4)) if made is not None else None
    if is_made_here or place.dataset.spec.is_to_fetch:
        from slamhive.data.store.datasets import is_made, materialise  # noqa: PLC0415
        from slamhive.local.home.catalog import DatasetPlace  # noqa: PLC0415

        datasets = home / "datasets"
        if not is_made(place.dataset, place.folder, datasets):
            return None
        entry = materialise(place.dataset, place.folder, datasets)
        place = DatasetPlace(entry.dataset, entry.root)
    truth = place.dataset.spec.ground_truth
    if truth is None or truth.file is None or not (place.folder / truth.file).is_file():
        return None
    # Readers of recordings come with these: seconds and megabytes.
    from slamhive.data.recordings.entries import DatasetEntry  # noqa: PLC0415
    from slamhive.data.store.groundtruth import ground_truth  # noqa: PLC0415

    found = ground_truth(DatasetEntry(place.dataset, place.folder))
    if found is not None and isinstance(found.poses, ControlPoints):
        return DatasetTruth(found.poses.trajectory, found.T_body_frame, are_points=True)
    if found is None or not isinstance(found.poses, Trajectory):
        return None
    return DatasetTruth(found.poses, found.T_body_frame)


def _generated(home: Path, declared: Dataset | None, dataset: str) -> Path | None:
    """Return the ground truth that was generated with a dataset's recording; of several the current one's.

    A dataset that stands beside a sweep, in its file, is not in the home's catalog: then it is the latest.

    Args:
        home: the home.
        declared: the dataset as the catalog has it.
        dataset: its name.
    """
    if "/" in dataset:
        return None
    folders = home.glob(f"datasets/{glob.escape(dataset)}-*")
    made = [path / "groundtruth.txt" for path in folders if _DIGITS.fullmatch(path.name[len(dataset) :])]
    made = sorted((path for path in made if path.is_file()), key=lambda path: path.stat().st_mtime)
    if len(made) > 1 and declared is not None:
        from slamhive.data.store.datasets import made_folder  # noqa: PLC0415 - brings the generator

        current = made_folder(declared, home / "datasets") / "groundtruth.txt"
        if current in made:
            return current
    return made[-1] if made else None
