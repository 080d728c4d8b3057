# SPDX-License-Identifier: Apache-2.0
"""Runs that what is known of their recordings makes impossible; nothing is read to know it."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.data.inspecting.known import FINDINGS, known
from slamhive.data.store.datasets import DatasetEntry, is_made, materialise
from slamhive.model.errors import SlamHiveError
from slamhive.plan import impossible, probed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from slamhive.local.home.catalog import DatasetPlace, Workshop
    from slamhive.local.home.folder import Home
    from slamhive.model.sweep import Sweep
    from slamhive.model.variant import OpenFinding
    from slamhive.plan import Plan


def impossible_runs(
    plans: Iterable[tuple[Sweep, Plan]], workshop: Workshop, home: Home
) -> Iterator[tuple[Sweep, str]]:
    """Yield a sentence on each dataset and mode that won't be run, by what checks and runs found before."""
    for sweep, points in plans:
        found = {name: _known(name, workshop, home) for name in points.dataset_names()}
        for sentence in impossible(probed(points), found):
            yield sweep, sentence


def at_hand(place: DatasetPlace, home: Home) -> DatasetEntry | None:
    """Return a dataset whose files are there, None where they would have to be made or fetched.

    Raises:
        SlamHiveError: they aren't what was said of them.
        OSError: they can't be looked at.
    """
    files = place.dataset.spec.recording.files
    if files and all((place.folder / file.path).exists() for file in files):
        return DatasetEntry(place.dataset, place.folder)
    if not is_made(place.dataset, place.folder, home.path / "datasets"):
        return None
    return materialise(place.dataset, place.folder, home.path / "datasets")


def _known(name: str, workshop: Workshop, home: Home) -> list[OpenFinding]:
    place = workshop.dataset_places.get(name)
    with suppress(SlamHiveError, OSError):  # who runs it meets it, and says it
        entry = at_hand(place, home) if place else None
        return (known(entry, home.path / FINDINGS) if entry else None) or []
    return []
