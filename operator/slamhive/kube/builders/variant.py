# SPDX-License-Identifier: Apache-2.0
"""The Job that prepares a variant of a dataset, and the name by which all runs that need it find it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.contract.environment import THREAD_VARIABLES
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
    scratch,
    variables,
)
from slamhive.kube.builders.request import KEPT_SECONDS, REQUEST, TMP, module, request_job
from slamhive.model.base import ObjectMeta, quantity, seconds
from slamhive.model.canonical import digest, normalize
from slamhive.model.catalogue import FOLDERS
from slamhive.model.errors import InputError
from slamhive.model.run import InputOptions, essential
from slamhive.model.sensors import SensorMode
from slamhive.model.variant import program_digest
from slamhive.plan import whole_cores

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.kube.settings import PreparationJobs, Settings
    from slamhive.model.algorithm import Algorithm, Asset
    from slamhive.model.dataset import Dataset
    from slamhive.model.formats import DataFormat
    from slamhive.model.sensors import Role
    from slamhive.model.variant import PreparingProgram

PREPARE, SHOW, PROGRAM = "prepare", "show", "program"
_APART = ("description", "homepage", "license", "attributes", "preparations")
_MATTERS = ("frameRate", "resolution", "start", "duration", "lidar", "perturb", "preparedBy", "remap")
_WORK, _SEEN, _FOLDERS = "/slamhive/work", "/slamhive", ("in", "own")
"""Folders of a program as we see them and as it sees them, as on a workstation."""
_HASH_LENGTH = 20
_SCRATCH, _LOGS = "2Gi", "4Gi"
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
            "spec": {key: declared[key] for key in declared if key not in _APART},
        },
        "roles": [str(role) for role in roles],
        "input": _input(options),
        "formats": [str(item) for item in formats],
        "assets": sorted([asset["sha256"], asset["url"]] for asset in _fetched(assets)),
        "version": VERSION,
    }
    if topics:
        parts["topics"] = sorted(topics)
    if options.program is not None:
        program = dataset.spec.preparation(options.program)
        gives = {role: given.as_json() for role, given in program.given.items()}
        parts["program"] = {"digest": program_digest(program), "gives": gives}
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
    options = InputOptions.model_validate(spec["input"])
    program = dataset.spec.preparation(options.program) if options.program else None
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
        resources=equal_resources(wanted.cpu, wanted.memory, logs=_LOGS),
    )
    before: list[Manifest] = []
    volumes: list[Manifest] = []
    labels: dict[str, str] = {}
    if program is not None:
        before = [_showing(body), _program(program, settings)]
        body["volumeMounts"] += [mount(name, f"{_WORK}/{name}", read_only=True) for name in _FOLDERS]
        # The kubelet counts all folders that go with a pod against what its containers may take together.
        room = quantity(_LOGS) + len(_FOLDERS) * quantity(program.disk)
        body["resources"] = equal_resources(wanted.cpu, wanted.memory, logs=str(math.ceil(room)))
        volumes = [scratch(name, program.disk) for name in _FOLDERS]
        labels = {label("preparation"): str(options.program)}
    return request_job(
        namespace,
        variant_job_name(name),
        pod_spec(settings),
        role=PREPARE,
        containers=[*before, body],
        claims=[claim("data", settings.volumes.data.claim)],
        deadline_seconds=math.ceil(seconds(wanted.timeout) + (seconds(program.timeout) if program else 0)),
        request=variant_request(dataset, algorithm, spec).as_json(),
        volumes=[*(config_map(name, source) for name, _, source in _sources(wanted)), *volumes],
        scratch_size=_SCRATCH,
        labels={label("variant"): name, label("dataset"): dataset.name, **labels},
        owners=owners,
        ttl_seconds=None if owners else KEPT_SECONDS,
    )


def _showing(body: Manifest) -> Manifest:
    """Return the container that lays out what a program is given: ours, a step earlier."""
    mounts = [*body["volumeMounts"], *(mount(name, f"{_WORK}/{name}") for name in _FOLDERS)]
    return body | {"name": SHOW, "command": module("prepare", "--show"), "volumeMounts": mounts}


def _program(program: PreparingProgram, settings: Settings) -> Manifest:
    """Return the container of a program of the Dataset, which sees its frames and nothing else.

    Raises:
        InputError: it has no image.
    """
    if program.image is None:
        raise InputError("input.preparedBy: the program names no image, which a cluster needs")
    values = {"SLAMHIVE_IN": f"{_SEEN}/in", "SLAMHIVE_OUT": f"{_SEEN}/own/out"}
    values |= {"HOME": f"{_SEEN}/own/home", "TMPDIR": f"{_SEEN}/own/tmp", "LANG": "C.UTF-8"}
    cpu = settings.preparation.cpu
    values |= dict.fromkeys(THREAD_VARIABLES, str(whole_cores(cpu)))
    body = container(
        PROGRAM,
        program.image,
        settings.image_pull_policy,
        command=program.command,
        env=variables(values),
        mounts=[
            mount("in", f"{_SEEN}/in", read_only=True),
            mount("own", f"{_SEEN}/own"),
            mount("own", "/tmp", subPath="tmp"),  # noqa: S108
        ],
        resources=equal_resources(cpu, program.memory, logs=_LOGS),
    )
    return body | {"workingDir": _SEEN}
