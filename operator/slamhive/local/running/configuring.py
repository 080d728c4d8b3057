# SPDX-License-Identifier: Apache-2.0
"""Configuration of a run on this machine, and the settings files that follow from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.contract.environment import SETTINGS_FOLDER
from slamhive.model.configuration import PreparedRecording
from slamhive.model.errors import InputError
from slamhive.plan import resolve, run_configuration, whole_cores
from slamhive.templating import render

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.data.making.preparation import Variant
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.base import Scalar
    from slamhive.model.configuration import RunConfiguration
    from slamhive.model.dataset import Dataset
    from slamhive.model.sensors import SensorMode
    from slamhive.templating import RenderedFile

SHOWN_RUN = "/slamhive"
"""Run folder in what is rendered for people: that of a pod."""


def configured(
    run: str, spec: Mapping[str, Any], dataset: Dataset, variant: Variant, cores: int
) -> RunConfiguration:
    """Return the configuration of a run's algorithm.

    Args:
        run: name of the run.
        spec: its resolved spec.
        dataset: the Dataset that it names.
        variant: what was prepared of it.
        cores: processors that it may use.
    """
    recording = PreparedRecording(
        format=variant.format,
        recording=variant.path.name,
        sensors=variant.sensors,
        start_time=variant.start_time,
        duration_seconds=variant.duration_seconds,
        frame_rate=variant.frame_rate,
        recorded_frame_rate=variant.recorded_frame_rate,
        resolution=variant.resolution,
    )
    return run_configuration(run, spec, dataset, recording, cores)


def rendered_for(
    bench: Workbench, name: str, dataset: str, parameters: Mapping[str, Scalar], mode: SensorMode | None
) -> list[RenderedFile]:
    """Return the settings files that a run of an algorithm on a dataset would read.

    The recording is prepared for it unless it was before, as its sensors are known only then.

    Args:
        bench: what runs share.
        name: the algorithm.
        dataset: the dataset.
        parameters: values that differ from the defaults.
        mode: the sensor mode; None: the only one.

    Raises:
        InputError: one of them isn't known, they don't fit, or a template can't be rendered.
    """
    algorithm = bench.workshop.algorithm(name).algorithm
    declared = bench.workshop.dataset(dataset).dataset
    if not algorithm.spec.templates:
        raise InputError(f"algorithm {name!r} has no settings files: there is no spec.files")
    asked = {
        "algorithmRef": {"name": name},
        "datasetRef": {"name": dataset},
        "parameters": dict(parameters),
        "sensors": algorithm.spec.mode(mode).name.value,
    }
    spec = resolve(asked, algorithm, declared, where="run")
    variant = bench.prepare(spec, algorithm)
    cores = whole_cores(spec["resources"]["cpu"])
    # Asked for anew: only preparing generates or fetches it, and so completes its manifest.
    told = configured("render", spec, bench.dataset(dataset).dataset, variant, cores)
    return render(algorithm.spec.templates, told.as_json(), SHOWN_RUN, f"{SHOWN_RUN}/{SETTINGS_FOLDER}")
