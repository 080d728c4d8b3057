# SPDX-License-Identifier: Apache-2.0
"""Files of a home's runs, and the ground truth of their datasets: for pages, figures and bridges."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.local.home.removed import absence, run_parts
from slamhive.model.results import IMPORTED
from slamhive.runfiles.artifacts import ArtifactFolder
from slamhive.runfiles.clocks import CONFIGURATIONS, LATENCIES
from slamhive.runfiles.ground_truth import DatasetTruths
from slamhive.runfiles.trajectories import TRAJECTORIES, USAGES

if TYPE_CHECKING:
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.ground_truth import DatasetTruth

_DRAWN = tuple(dict.fromkeys((*TRAJECTORIES, *USAGES, *CONFIGURATIONS, *LATENCIES)))
_OF_IMPORTS = frozenset({"traj.txt", "profiling.csv", "config.yaml"})
"""Files that may be read of a folder that was imported from elsewhere."""


class HomeFiles:
    """The run folders of a home, those that runs were imported from, and ground truth.

    Args:
        home: folder that holds the runs' folders; None for none.
        ground_truth: folder of files named after datasets, looked into first.
    """

    def __init__(self, home: Path | None, ground_truth: Path | None = None) -> None:
        self._home = home
        self._truths = DatasetTruths(ground_truth, home)

    def place(self, record: RunRecord) -> ArtifactFolder | None:
        """Return the folder of a run in the home, or the one that it was imported from; None if not there."""
        if not record.folder:
            return None
        folder = Path(record.folder)
        if record.labels.get("source") == IMPORTED:
            return ArtifactFolder(folder, allowed=_OF_IMPORTS) if folder.is_dir() else None
        parts = run_parts(record.folder)
        if self._home is None or parts is None or self.absence(record) is not None:
            return None
        runs = self._home / "runs"
        return ArtifactFolder(runs, parts) if runs.joinpath(*parts).is_dir() else None

    def absence(self, record: RunRecord) -> str | None:
        """Return the reason that a run's files aren't here, if somebody removed them: part of a sentence."""
        return absence(self._home, record.folder)

    def seen(self, folder: str | None) -> str:
        """Return a text that tells which files that pages draw of a run are here, and their sizes.

        Args:
            folder: of the run, as its record has it.
        """
        parts, gone = run_parts(folder), absence(self._home, folder)
        places = [Path(folder)] if folder else []
        if self._home is not None and parts is not None:
            places.append(self._home.joinpath("runs", *parts))
        here = [place for place in dict.fromkeys(places) if place.is_dir()]
        found = [f"{name} {size}" for place in here for name in _DRAWN if (size := _size(place / name))]
        return "\n".join([*("folder" for _ in here), *found, *([gone] if gone else [])])

    def truth(self, dataset: str, label: str | None) -> DatasetTruth | None:
        """Return the ground truth of a dataset, also filed under its label, if it is at hand."""
        return self._truths.find(dataset, label)


def _size(path: Path) -> int:
    """Return the bytes of a file, 0 where it isn't there."""
    try:
        return path.stat().st_size
    except OSError:
        return 0
