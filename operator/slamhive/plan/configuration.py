# SPDX-License-Identifier: Apache-2.0
"""The unified configuration of a run: the same on a workstation and on a cluster."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.model.base import quantity
from slamhive.model.configuration import DatasetView, InputView, RecordingPlace, RunConfiguration
from slamhive.model.formats import folder_files
from slamhive.model.run import Perturbation
from slamhive.plan.misleading import misled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.model.configuration import PreparedRecording
    from slamhive.model.dataset import Dataset


def whole_cores(cpu: str) -> int:
    """Return the number of threads that a run with so many processors is told to use: at least one."""
    return max(1, math.ceil(quantity(cpu)))


def run_configuration(
    run: str, spec: Mapping[str, Any], dataset: Dataset, recording: PreparedRecording, cores: int
) -> RunConfiguration:
    """Return the configuration for a run's algorithm.

    Args:
        run: name of the run.
        spec: its spec as ``resolve`` returns it.
        dataset: the Dataset that it names, as declared.
        recording: the variant that was prepared for it.
        cores: processors that it may use.
    """
    options = spec["input"]
    perturb = Perturbation.model_validate(options["perturb"]) if options.get("perturb") else None
    declared = dataset.spec
    return RunConfiguration(
        run=run,
        algorithm=spec["algorithmRef"]["name"],
        mode=spec["sensors"],
        dataset=DatasetView(
            name=dataset.name,
            recording=recording_place(recording, f"dataset/{recording.recording}"),
            start_time=recording.start_time,
            duration_seconds=recording.duration_seconds,
            gravity_aligned=declared.has_level_truth,
        ),
        sensors={role.value: view for role, view in misled(recording.sensors, perturb).items()},
        parameters=spec["parameters"],
        input=InputView(
            pace=options["pace"],
            frame_rate=recording.frame_rate,
            recorded_frame_rate=recording.recorded_frame_rate,
            resolution=recording.resolution,
            rate=options.get("rate") or 1.0,
            duration=recording.duration_seconds,
        ),
        seed=spec["seed"],
        cores=cores,
    )


def recording_place(recording: PreparedRecording, path: str) -> RecordingPlace:
    """Return the place of a prepared recording and, in a folder of files, those of each sensor's data.

    Args:
        recording: the recording.
        path: its path as the algorithm sees it.
    """
    encodings = {
        role: view.camera.encoding if view.camera else None for role, view in recording.sensors.items()
    }
    files = folder_files(recording.format, encodings)
    return RecordingPlace(format=recording.format, path=path, files=files or None)
