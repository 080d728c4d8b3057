# SPDX-License-Identifier: Apache-2.0
"""Sweeps over what the actor does, an edit of their dataset, and a watcher that remembers."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

from slamhive.engine import PointState
from slamhive.local.running.runner import Watcher
from slamhive.model.sweep import Sweep

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.local.home.catalog import DatasetPlace, Workshop
    from slamhive.local.home.folder import Home
    from slamhive.local.running.runner import Job
    from slamhive.model.results import Phase, RunRecord


class Notes(Watcher):
    """A watcher that remembers what it was told."""

    def __init__(self) -> None:
        self.phases: list[tuple[int, Phase]] = []
        self.active: list[set[int]] = []
        self.records: list[RunRecord] = []

    def phase(self, job: Job, index: int, phase: Phase) -> None:
        self.phases.append((index, phase))
        self.active.append({point for point, state in enumerate(job.states) if state == PointState.ACTIVE})

    def finished(self, job: Job, record: RunRecord) -> None:
        self.records.append(record)


def sweep_of(acts: Sequence[str], name: str = "acts", **fields: object) -> Sweep:
    """Return a sweep over acts."""
    template = {"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "tiny"}}
    template |= fields.pop("template", {})  # type: ignore[arg-type]
    return Sweep.model_validate(
        {
            "metadata": {"name": name},
            "spec": {
                "template": {"spec": template},
                "matrix": [{"path": "parameters.act", "values": list(acts)}],
                **fields,
            },
        }
    )


def edit_recording(workshop: Workshop, home: Home, **fields: Any) -> DatasetPlace:
    """Edit how the synthetic dataset is generated, as in the sweep's file, and return what it was.

    The home gets recordings of its own: those of all tests are not to be more, nor fewer.
    """
    folder = home.path / "datasets"
    if folder.is_symlink():
        shared = folder.resolve()
        folder.unlink()
        shutil.copytree(shared, folder)
    place = workshop.dataset_places["tiny"]
    spec = place.dataset.spec
    recording = spec.recording.replace(synthetic=spec.recording.synthetic.replace(**fields))
    edited = place.dataset.replace(spec=spec.replace(recording=recording))
    workshop.dataset_places["tiny"] = type(place)(edited, place.folder)
    return place
