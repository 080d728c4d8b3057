# SPDX-License-Identifier: Apache-2.0
"""Folders with the ground truth of imported runs, a file a dataset.

Whoever draws a path looks into them, so nothing of the language is imported here.
"""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from slamhive.model.errors import DataError
from slamhive_eval import read_trajectory

if TYPE_CHECKING:
    from slamhive_eval import Trajectory

_SUFFIXES = (".txt", ".csv", ".tum", ".txt.gz", ".csv.gz")


def catalog_name(name: str) -> str:
    """Return a name as the catalog writes names: lower case letters, digits, dots and dashes.

    >>> catalog_name("MH_01_easy")
    'mh-01-easy'
    """
    return re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-.") or "unnamed"


class GroundTruthFolder:
    """Ground truth by the dataset's name, each file read once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[str, Trajectory] = {}

    def path(self, dataset: str) -> Path:
        """Return the file of a dataset: ``NAME.txt``, ``NAME.csv``, or one of EuRoC's places in ``NAME/``.

        Raises:
            DataError: there is none.
        """
        names = [entry.name for entry in sorted(self._folder.iterdir())] if self._folder.is_dir() else []
        for suffix in _SUFFIXES:
            for name in names:
                if catalog_name(name.removesuffix(suffix)) == catalog_name(dataset) and name.endswith(suffix):
                    return self._folder / name
        for place in ("groundtruth.txt", "data.csv", "state_groundtruth_estimate0/data.csv"):
            for parent in (dataset, f"{dataset}/mav0"):
                if (self._folder / parent / place).is_file():
                    return self._folder / parent / place
        raise DataError(
            f"{self._folder}: no ground truth of the dataset {dataset!r}; "
            f"expected {dataset}.txt (TUM) or {dataset}.csv (EuRoC)"
        )

    def read(self, dataset: str) -> Trajectory:
        """Return the ground truth of a dataset.

        Raises:
            DataError: there is none.
            EvaluationError: it can't be read.
        """
        if dataset not in self._read:
            self._read[dataset] = read_trajectory(self.path(dataset))
        return self._read[dataset]

    def copy(self, dataset: str, folder: Path) -> bool:
        """Put a dataset's file into another such folder, under the dataset's name in the catalog.

        What is there already stays.

        Returns:
            Whether the folder now holds what this one does.

        Raises:
            DataError: there is no ground truth of the dataset.
            OSError: it can't be written.
        """
        source = self.path(dataset)
        content = source.read_bytes()
        try:
            return GroundTruthFolder(folder).path(dataset).read_bytes() == content
        except DataError:
            suffix = next((ending for ending in reversed(_SUFFIXES) if source.name.endswith(ending)), "")
            name = f"{catalog_name(dataset)}{suffix or source.suffix}"
            descriptor, aside = tempfile.mkstemp(dir=folder, prefix=".")
            try:
                with os.fdopen(descriptor, "wb") as stream:
                    stream.write(content)
                Path(aside).chmod(0o644)
                Path(aside).replace(folder / name)
            except OSError:
                Path(aside).unlink(missing_ok=True)
                raise
        return True
