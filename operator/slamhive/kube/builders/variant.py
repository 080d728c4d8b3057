# SPDX-License-Identifier: Apache-2.0
"""The Job that prepares a variant of a dataset, and the name by which all runs that need it find it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.data.files.https import CERTIFICATES
from slamhive.data.recordings.version import VERSION
from slamhive.jobs.requests import FetchedAsset, PrepareRequest
from slamhive.kube.builders.common import (
    Manifest,
    claim,
    config_map,
    container,
    equal_resources,
    label,
    mount,
    pod_spec,
    variables,
)
from slamhive.kube.builders.request import KEPT_SECONDS, REQUEST, TMP, module, request_job
from slamhive.model.base import ObjectMeta, seconds
from slamhive.model.canonical import digest, normalize
from slamhive.model.catalogue import FOLDERS
from slamhive.model.run import InputOptions, essential
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.kube.settings import PreparationJobs, Settings
    from slamhive.model.algorithm import Algorithm, Asset
    from slamhive.model.dataset import Dataset
    from slamhive.model.formats import DataFormat
    from slamhive.model.sensors import Role

PREPARE = "prepare"
_PROSE = ("description", "homepage", "license", "attributes")
_MATTERS = ("frameRate", "resolution", "start", "duration", "lidar", "perturb", "remap")
_HASH_LENGTH = 20
_SCRATCH = "2Gi"
_CATALOGUE, _CERTIFICATES = "/slamhive/catalogue", "/slamhive/certificates"


def variant_name(  # noqa: PLR0917 - all that makes a variant another
    dataset: Dataset,
    roles: Iterable[Role],
    options: InputOptions,
    formats: Iterable[DataFormat],
    assets: Iterable[Asset],
    topics: Sequence[str] = (),
) -> str:
    """Return the name of a variant: equal wishes have equal names.

    Args:
        dataset: what it is made of.
        roles: the sensors that the algorithm takes.
        options: the run's input options; pace and rate change nothing of the recording.
        formats: formats that the algorithm reads, the preferred first.
        assets: files that the algorithm needs; those with a url are fetched by the same Job.
        topics: topics that it is given beside its sensors'.
    """
    declared = dataset.spec.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    parts = {
        "dataset": {
            "name": dataset.name,
            "spec": {key: declared[key] for key in declared if key not in _PROSE},
        },
        "roles": [str(role) for role in roles],
        "input": _input(options),
        "formats": [str(item) for item in formats],
        "assets": sorted([asset["sha256"], asset["url"]] for asset in _fetched(assets)),
        "version": VERSION,
    }
    if topics:
        parts["topics"] = sorted(topics)
    return "v-" + digest(normalize(parts))[:_HASH_LENGTH]


def variant_request(dataset: Dataset, algorithm: Algorithm, spec: Mapping[str, Any]) -> PrepareRequest:
    """Return the request to the preparation for a run.

    Args:
        dataset: the Dataset that the run names.
        algorithm: its Algorithm.
        spec: its resolved spec.
    """
    mode = algorithm.spec.mode(SensorMode(spec["sensors"]))
    return PrepareRequest(
        dataset=dataset.replace(metadata=ObjectMeta(name=dataset.name)),
        roles=list(mode.needs),
        input=InputOptions.model_validate(_input(InputOptions.model_validate(spec["input"]))),
        formats=algorithm.spec.formats(mode),
        assets=[FetchedAsset.model_validate(asset) for asset in _fetched(algorithm.spec.assets)],
        topics=mode.topics,
    )


def _input(options: InputOptions) -> Manifest:
    """Return the options that change what a recording is."""
    body = essential(options.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_defaults=True))
    return {key: body[key] for key in _MATTERS if body.get(key)}


def _fetched(assets: Iterable[Asset]) -> list[dict[str, str | None]]:
    return [{"name": asset.name, "url": asset.url, "sha256": asset.sha256} for asset in assets if asset.url]


def variant_job_name(variant: str) -> str:
    """Return the name of the Job that prepares a variant."""
    return f"{PREPARE}-{variant}"


def _sources(wanted: PreparationJobs) -> list[tuple[str, str, str]]:
    """Return the sources to fetch from and certificates to trust: volume, folder, ConfigMap."""
    found = [
        ("catalogue", _CATALOGUE, wanted.catalogue),
        ("certificates", _CERTIFICATES, wanted.certificates),
    ]
    return [one for one in found if one[2]]


def _environment(wanted: PreparationJobs) -> dict[str, str]:
    found = {"HOME": "/tmp", "TMPDIR": "/tmp", "LANG": "C.UTF-8"}  # noqa: S108
    if wanted.catalogue:
        found[FOLDERS] = _CATALOGUE
    if wanted.certificates:
        found[CERTIFICATES] = f"{_CERTIFICATES}/ca.crt"
    return found | wanted.environment


def variant_job(
    *,
    namespace: str,
    name: str,
    dataset: Dataset,
    algorithm: Algorithm,
    spec: Mapping[str, Any],
    settings: Settings,
    owners: Sequence[Manifest],
) -> Manifest:
    """Return the Job that prepares a variant.

    Args:
        namespace: of the Dataset.
        name: of the variant.
        dataset: what it is made of.
        algorithm: the Algorithm of a run that needs it.
        spec: that run's resolved spec.
        settings: the operator's.
        owners: references to all that need it; it goes when the last of them goes.

    Raises:
        InputError: the request doesn't fit into an object.
    """
    wanted = settings.preparation
    body = container(
        PREPARE,
        settings.image,
        settings.image_pull_policy,
        command=module("prepare"),
        env=variables(_environment(wanted)),
        mounts=[
            mount("data", "/slamhive/data"),
            REQUEST,
            TMP,
            *(mount(name, path, read_only=True) for name, path, _ in _sources(wanted)),
        ],
        resources=equal_resources(wanted.cpu, wanted.memory, logs="4Gi"),
    )
    return request_job(
        namespace,
        variant_job_name(name),
        pod_spec(settings),
        role=PREPARE,
        containers=[body],
        claims=[claim("data", settings.volumes.data.claim)],
        deadline_seconds=math.ceil(seconds(wanted.timeout)),
        request=variant_request(dataset, algorithm, spec).as_json(),
        volumes=[config_map(name, source) for name, _, source in _sources(wanted)],
        scratch_size=_SCRATCH,
        labels={label("variant"): name, label("dataset"): dataset.name},
        owners=owners,
        ttl_seconds=None if owners else KEPT_SECONDS,
    )
