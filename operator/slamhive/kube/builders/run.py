# SPDX-License-Identifier: Apache-2.0
"""The Job of a run's attempt: the algorithm, the monitor beside it, and what a player adds."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import yaml

from slamhive.contract.environment import SETTINGS_FOLDER, program_variables
from slamhive.contract.posefiles import FRAMES
from slamhive.jobs.requests import RenderRequest
from slamhive.kube.api.kinds import Kind, reference
from slamhive.kube.builders.common import (
    WHOLE_NODE,
    Manifest,
    annotation,
    away_from_runs,
    claim,
    container,
    downward,
    equal_resources,
    from_field,
    job,
    joined_name,
    label,
    mount,
    passed_on,
    pod_spec,
    request_text,
    scratch,
    segment,
    variables,
)
from slamhive.kube.builders.request import module
from slamhive.model.base import quantity, seconds
from slamhive.model.errors import InputError
from slamhive.model.variant import VariantDescription
from slamhive.monitor.spec import TASK_LIMIT
from slamhive.plan import run_configuration, whole_cores

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.kube.settings import Settings
    from slamhive.model.algorithm import Algorithm, AlgorithmSpec
    from slamhive.model.configuration import RunConfiguration
    from slamhive.model.dataset import Dataset

_Dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # ten times as fast where libyaml is there

ALGORITHM = "algorithm"
MONITOR = "monitor"
RENDER = "render"
MEMORY, SHARED_MEMORY = "memory", "/dev/shm"  # noqa: S108
"""The volume that the algorithm has as shared memory, and its place."""

GRACE_SECONDS = 30
_SPARE_SECONDS = 3600
_MONITOR_RESOURCES = equal_resources("200m", "64Mi", logs="64Mi")
_RENDER_MEMORY = "256Mi"
_RUN = "/slamhive"
_FRAMES = "/slamhive-frames.txt"
_LOGS = "4Gi"
_SCRATCH = "2Gi"
_UNTIL_IT_WATCHES = """
left=600
while [ $left -gt 0 ] && [ ! -e /slamhive-run/config.yaml ]; do
    sleep 0.05
    left=$((left - 1))
done
"""
"""It ends without an error too: an algorithm that ran before it was watched is said to have."""


@dataclass(frozen=True)
class Companion:
    """Additions of a player to a run's pod: containers, volumes, mounts, variables and arguments.

    Attributes:
        containers: containers beside the algorithm.
        init_containers: containers after the monitor and before the algorithm.
        volumes: volumes that they share.
        mounts: what the algorithm sees of those.
        variables: variables that the algorithm gets.
        arguments: what is added to the algorithm's command.
        least_memory: bytes that /dev/shm, the volume `MEMORY`, has at least.
    """

    containers: tuple[Manifest, ...] = ()
    init_containers: tuple[Manifest, ...] = ()
    volumes: tuple[Manifest, ...] = ()
    mounts: tuple[Manifest, ...] = ()
    variables: Mapping[str, str] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    least_memory: int = 0


NO_COMPANION = Companion()


@lru_cache(maxsize=512)
def _as_yaml(text: str) -> str:
    """Return JSON as YAML that people like to read."""
    return str(yaml.dump(json.loads(text), Dumper=_Dumper, sort_keys=False, allow_unicode=True))


def least_requests(resources: Mapping[str, Any], settings: Settings) -> dict[str, float]:
    """Return the least requests of a run's pod, by resource: a player may come on top.

    Args:
        resources: ``resources`` of its resolved spec.
        settings: the operator's.
    """
    monitor = _MONITOR_RESOURCES["requests"]
    asked = {name: quantity(monitor[name]) + quantity(resources[name]) for name in ("cpu", "memory")}
    if resources.get("exclusiveNodes"):
        asked[WHOLE_NODE] = 1.0
    return asked | ({settings.pods.gpu_resource: float(gpus)} if (gpus := resources.get("gpu")) else {})


def job_name(run: str, attempt: int) -> str:
    """Return the name of an attempt's Job."""
    return joined_name(run, str(attempt))


def configuration(
    run: str, spec: Mapping[str, Any], dataset: Dataset, description: Mapping[str, Any]
) -> RunConfiguration:
    """Return the configuration for a run's algorithm: that of a workstation for the same variant.

    Args:
        run: name of the run.
        spec: its resolved spec.
        dataset: the Dataset that it names.
        description: what the preparation said of its variant, as it stands in the Dataset's status.
    """
    recording = VariantDescription.model_validate(dict(description))
    return run_configuration(run, spec, dataset, recording, whole_cores(spec["resources"]["cpu"]))


@dataclass(frozen=True)
class _AttemptInputs:
    """Inputs for an attempt's Job: run, algorithm, configuration, variant, number and companion."""

    run: Mapping[str, Any]
    spec: Mapping[str, Any]
    algorithm: AlgorithmSpec
    configuration: RunConfiguration
    variant: VariantDescription
    attempt: int
    companion: Companion

    @property
    def folder(self) -> str:
        """Return the attempt's folder on the results volume, for a subPathExpr."""
        # With the pod's uid: a node that comes back after its pod was replaced can't write into the new pod's
        # folder.
        return f"runs/{segment(self.run['metadata']['uid'], 'the uid')}/$(POD_UID)"


def run_job(
    *,
    run: Mapping[str, Any],
    spec: Mapping[str, Any],
    algorithm: Algorithm,
    configuration: RunConfiguration,
    description: Mapping[str, Any],
    attempt: int,
    settings: Settings,
    companion: Companion = NO_COMPANION,
) -> Manifest:
    """Return the Job of an attempt.

    Args:
        run: the MappingRun as the API server returned it; it owns the Job.
        spec: its resolved spec.
        algorithm: its Algorithm.
        configuration: what the algorithm is told.
        description: what the preparation said of its variant.
        attempt: number of the attempt, from 1.
        settings: the operator's.
        companion: what a player adds.

    Raises:
        InputError: a sentence about what makes it impossible, such as an Algorithm without an image.
    """
    variant = VariantDescription.model_validate(dict(description))
    plan = _AttemptInputs(run, spec, algorithm.spec, configuration, variant, attempt, companion)
    metadata = run["metadata"]
    pod = pod_spec(settings) | {
        # By this the monitor sees the algorithm's processes.
        "shareProcessNamespace": True,
        "terminationGracePeriodSeconds": GRACE_SECONDS,
        # The monitor ends what takes too long; this ends what killed the monitor, and leaves its figures.
        "activeDeadlineSeconds": math.ceil(seconds(spec["timeout"])) + _SPARE_SECONDS,
        "initContainers": [*_render(plan, settings), _monitor(plan, settings), *companion.init_containers],
        "containers": [_algorithm(plan, settings), *companion.containers],
        "volumes": [*_volumes(plan, settings), *_render_volumes(plan), *companion.volumes],
    }
    if spec.get("priorityClassName"):
        pod["priorityClassName"] = spec["priorityClassName"]
    if spec["resources"].get("exclusiveNodes"):
        pod["affinity"] = away_from_runs(settings.pods.affinity)
    # Part by part: those that the runs of a Sweep have in common are written once.
    parts = ({name: value} for name, value in configuration.as_json().items())
    text = "".join(_as_yaml(json.dumps(part)) for part in parts)
    return job(
        metadata["namespace"],
        job_name(metadata["name"], attempt),
        pod,
        labels=_labels(plan),
        owners=[reference(Kind.MAPPING_RUN, run, controller=True)],
        annotations={label("configuration"): annotation(text, "the configuration")} | _render_request(plan),
        passed_labels=passed_on(metadata.get("labels"), settings),
        passed_annotations=passed_on(metadata.get("annotations"), settings),
    )


def _labels(plan: _AttemptInputs) -> dict[str, str]:
    metadata = plan.run["metadata"]
    given = metadata.get("labels") or {}
    kept = {label(word): given[label(word)] for word in ("sweep", "point", "slot") if label(word) in given}
    return kept | {
        label("role"): "run",
        label("run"): metadata["name"],
        label("algorithm"): plan.spec["algorithmRef"]["name"],
        label("dataset"): plan.spec["datasetRef"]["name"],
        label("attempt"): str(plan.attempt),
    }


def _algorithm(plan: _AttemptInputs, settings: Settings) -> Manifest:
    spec, algorithm, companion = plan.spec, plan.algorithm, plan.companion
    if algorithm.image is None:
        raise InputError(f"algorithm {spec['algorithmRef']['name']!r} has no image, so it runs on no cluster")
    variant = segment(plan.variant.folder, "the variant's folder")
    # /tmp is a volume of the pod's own.
    values = program_variables(
        run=_RUN,
        seed=spec["seed"],
        cores=whole_cores(spec["resources"]["cpu"]),
        home="/tmp",  # noqa: S108
        scratch="/tmp",  # noqa: S108
        settings_files=bool(algorithm.files),
    )
    values |= {"SLAMHIVE_CONTAINER": ALGORITHM, **companion.variables}
    wanted = spec["resources"]
    gpus = {settings.pods.gpu_resource: str(wanted["gpu"])} if wanted.get("gpu") else {}
    body = container(
        ALGORITHM,
        algorithm.image,
        settings.image_pull_policy,
        command=[*algorithm.command, *companion.arguments],
        env=[from_field("POD_UID", "metadata.uid"), *variables(values)],
        mounts=[
            mount("configuration", "/slamhive/config.yaml", read_only=True, subPath="config.yaml"),
            mount("data", "/slamhive/dataset", read_only=True, subPath=f"variants/{variant}"),
            mount("results", "/slamhive/output", subPathExpr=f"{plan.folder}/output"),
            *_assets(algorithm),
            *_settings_files(plan),
            mount("tmp", "/tmp"),  # noqa: S108
            mount(MEMORY, SHARED_MEMORY),
            *companion.mounts,
        ],
        resources=equal_resources(wanted["cpu"], wanted["memory"], logs=_LOGS, extra=gpus),
    )
    return body | {"workingDir": "/slamhive"}


def _assets(algorithm: AlgorithmSpec) -> list[Manifest]:
    """Return the files that preparation fetched; those with a path are in the image."""
    fetched = [asset for asset in algorithm.assets if asset.url is not None]
    return [
        mount("data", f"/slamhive/assets/{asset.name}", read_only=True, subPath=f"assets/{asset.sha256}")
        for asset in fetched
    ]


def _settings_files(plan: _AttemptInputs) -> list[Manifest]:
    """Return the mount of the files that were rendered for the algorithm."""
    if not plan.algorithm.files:
        return []
    place = f"{plan.folder}/{SETTINGS_FOLDER}"
    return [mount("results", f"{_RUN}/{SETTINGS_FOLDER}", read_only=True, subPathExpr=place)]


def _render(plan: _AttemptInputs, settings: Settings) -> list[Manifest]:
    """Return the container that renders the algorithm's settings files before all others start."""
    if not plan.algorithm.files:
        return []
    body = container(
        RENDER,
        settings.image,
        settings.image_pull_policy,
        command=module("render"),
        env=[
            from_field("POD_UID", "metadata.uid"),
            *variables({"HOME": "/tmp", "LANG": "C.UTF-8"}),  # noqa: S108
        ],
        mounts=[
            mount("render", f"{_RUN}/request", read_only=True),
            mount("configuration", f"{_RUN}/configuration", read_only=True),
            mount("results", f"{_RUN}/run", subPathExpr=plan.folder),
        ],
        # It has ended when the algorithm starts, whose own processors it may have.
        resources=equal_resources(plan.spec["resources"]["cpu"], _RENDER_MEMORY, logs="64Mi"),
    )
    return [body]


def _render_request(plan: _AttemptInputs) -> dict[str, str]:
    if not plan.algorithm.files:
        return {}
    request = RenderRequest(files=plan.algorithm.files, run=_RUN)
    return {label(RENDER): request_text(request.as_json())}


def _render_volumes(plan: _AttemptInputs) -> list[Manifest]:
    return [downward(RENDER, label(RENDER), "request.json")] if plan.algorithm.files else []


def _monitor(plan: _AttemptInputs, settings: Settings) -> Manifest:
    told = {
        "container": ALGORITHM,
        "runDirectory": "/slamhive-run",
        "configuration": "/slamhive-config/config.yaml",
        "timeoutSeconds": seconds(plan.spec["timeout"]),
        "memoryLimitBytes": int(quantity(plan.spec["resources"]["memory"])),
        "outputLimitBytes": int(quantity(settings.output_limit)),
        "outputFileLimit": settings.output_files,
        "taskLimit": TASK_LIMIT,
        "companions": len(plan.companion.init_containers),
        "dataSeconds": plan.configuration.dataset.duration_seconds,
        "frames": plan.variant.frames,
        "includesReader": plan.algorithm.includes_reader,
        "intervalSeconds": 0.1,
        "terminationMessage": "/dev/termination-log",
    }
    output = plan.algorithm.output_of(plan.algorithm.mode(plan.configuration.mode))
    if files := output.pose_files(_FRAMES):
        told["poses"] = files
    variant = segment(plan.variant.folder, "the variant's folder")
    frames = mount("data", _FRAMES, read_only=True, subPath=f"variants/{variant}/{FRAMES}")
    values = {
        "SLAMHIVE_CONTAINER": MONITOR,
        "SLAMHIVE_SIDECAR": json.dumps(told, separators=(",", ":")),
        "HOME": "/tmp",  # noqa: S108
    }
    body = container(
        MONITOR,
        settings.image,
        settings.image_pull_policy,
        # A signal to end that comes before the monitor listens waits until it does.
        command=["env", "--block-signal=TERM", "python3", "-P", "-m", "slamhive.monitor.sidecar"],
        env=[
            from_field("POD_UID", "metadata.uid"),
            from_field("NODE_NAME", "spec.nodeName"),
            *variables(values),
        ],
        mounts=[
            mount("results", "/slamhive-run", subPathExpr=plan.folder),
            mount("configuration", "/slamhive-config", read_only=True),
            # The file alone: whose recording it is and what it holds is none of the monitor's.
            *([frames] if output.counts_frames else ()),
        ],
        resources=_MONITOR_RESOURCES,
    )
    # The algorithm starts when the monitor watches, and is closed to it: not while Python itself starts.
    watches = {"exec": {"command": ["sh", "-c", _UNTIL_IT_WATCHES]}}
    return body | {"restartPolicy": "Always", "lifecycle": {"postStart": watches}}


def _volumes(plan: _AttemptInputs, settings: Settings) -> list[Manifest]:
    half = int(quantity(plan.spec["resources"]["memory"]) / 2)
    return [
        downward("configuration", label("configuration"), "config.yaml"),
        claim("results", settings.volumes.results.claim),
        # A variant that is gone must not become an empty folder.
        claim("data", settings.volumes.data.claim, read_only=True),
        scratch("tmp", _SCRATCH),
        # What is written there counts as the memory of who writes it, as it does on a workstation.
        scratch(MEMORY, str(max(half, plan.companion.least_memory)), memory=True),
    ]
