# SPDX-License-Identifier: Apache-2.0
"""Runs of a home with their files: records of its archive, folders and ground truth as pages find them."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from slamhive.archive import Archive
from slamhive.runfiles.homefiles import HomeFiles

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from slamhive.archive.records import CatalogEntry
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth


class Here:
    """Access to the runs of a home: their records in the archive, their folders and ground truth.

    Args:
        archive: the archive, open.
        home: folder that holds the runs' folders; None where there is an archive alone.

    Attributes:
        archive: the archive.
    """

    def __init__(self, archive: Archive, home: Path | None) -> None:
        self.archive = archive
        self._files = HomeFiles(home)

    @classmethod
    @contextmanager
    def open(cls, url: str, home: Path | None) -> Iterator[Here]:
        """Open a home's archive to read from it."""
        with Archive.open(url, read_only=True) as archive:
            yield cls(archive, home)

    def record(self, uid: str) -> RunRecord | None:
        """Return a run by its UID."""
        return self.archive.get(uid)

    def place(self, record: RunRecord) -> ArtifactFolder | None:
        """Return a run's folder, if it is there."""
        return self._files.place(record)

    def truth(self, record: RunRecord) -> DatasetTruth | None:
        """Return the ground truth of a run's dataset, if it is at hand."""
        dataset = str((record.spec.get("datasetRef") or {}).get("name"))
        return self._files.truth(dataset, record.labels.get("dataset"))

    def algorithms(self) -> list[CatalogEntry]:
        """Return the algorithms as runs used them."""
        return self.archive.catalog("Algorithm")
