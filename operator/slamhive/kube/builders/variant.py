# SPDX-License-Identifier: Apache-2.0
"""The Job that prepares a variant of a dataset, and the name by which all runs that need it find it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.kube.builders.common import (
    Manifest,
    claim,
    container,
    downward,
    equal_resources,
    job,
    label,
    mount,
    pod_spec,
    request_text,
    scratch,
    variables,
)
from slamhive.model.base import seconds
from slamhive.model.canonical import digest, normalize
from slamhive.model.sensors import SensorMode

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.kube.settings import Settings
    from slamhive.model.algorithm import AlgorithmSpec
    from slamhive.model.dataset import Dataset

PREPARE = "prepare"
_MATTERS = ("frameRate", "resolution", "start", "duration", "lidar", "remap")
_HASH_LENGTH = 20
_SCRATCH = "2Gi"
_KEPT_SECONDS = 3600


def variant_request(dataset: Dataset, algorithm: AlgorithmSpec, spec: Mapping[str, Any]) -> Manifest:
    """Return what the preparation for a run is asked for.

    Args:
        dataset: the Dataset that the run names.
        algorithm: what its Algorithm says.
        spec: the run's resolved spec.
    """
    mode = algorithm.mode(SensorMode(spec["sensors"]))
    options = {key: spec["input"][key] for key in _MATTERS if spec["input"].get(key)}
    assets = [
        {"name": asset.name, "url": asset.url, "sha256": asset.sha256}
        for asset in algorithm.assets
        if asset.url is not None
    ]
    manifest = {
        "apiVersion": dataset.api_version,
        "kind": dataset.kind,
        "metadata": {"name": dataset.name},
        "spec": dataset.spec.as_json(),
    }
    return {
        "dataset": manifest,
        "roles": [str(role) for role in mode.needs],
        "input": options,
        "formats": [str(item) for item in algorithm.recording],
        "assets": assets,
    }


def variant_name(request: Mapping[str, Any], version: int) -> str:
    """Return the name of the variant that a request asks for: equal requests have equal names.

    Args:
        request: as `variant_request` returns it.
        version: of the preparation.
    """
    assets = sorted((asset["sha256"], asset["url"]) for asset in request["assets"])
    parts = {
        "dataset": {"name": request["dataset"]["metadata"]["name"], "spec": request["dataset"]["spec"]},
        "roles": request["roles"],
        "input": request["input"],
        "formats": request["formats"],
        "assets": [list(asset) for asset in assets],
        "version": version,
    }
    return "v-" + digest(normalize(parts))[:_HASH_LENGTH]


def variant_job_name(variant: str) -> str:
    """Return the name of the Job that prepares a variant."""
    return f"{PREPARE}-{variant}"


def variant_job(
    namespace: str, request: Mapping[str, Any], variant: str, owners: Sequence[Manifest], settings: Settings
) -> Manifest:
    """Return the Job that prepares a variant.

    Args:
        namespace: of the Dataset.
        request: as `variant_request` returns it.
        variant: its name.
        owners: references to all that need it; it goes when the last of them goes.
        settings: the operator's.

    Raises:
        InputError: the request doesn't fit into an object.
    """
    wanted = settings.preparation
    body = container(
        PREPARE,
        settings.image,
        settings,
        command=["python3", "-P", "-m", "slamhive.jobs.prepare"],
        env=variables({"HOME": "/tmp", "TMPDIR": "/tmp", "LANG": "C.UTF-8"}),  # noqa: S108
        mounts=[
            mount("data", "/slamhive/data"),
            mount("request", "/slamhive/request", read_only=True),
            mount("tmp", "/tmp"),  # noqa: S108
        ],
        resources=equal_resources(wanted.cpu, wanted.memory, logs="4Gi"),
    )
    pod = pod_spec(settings) | {
        # The pod's own deadline leaves its last words, which the Job's would delete with it.
        "activeDeadlineSeconds": math.ceil(seconds(wanted.timeout)),
        "containers": [body],
        "volumes": [
            downward("request", label("request"), "request.json"),
            claim("data", settings.volumes.data.claim),
            scratch("tmp", _SCRATCH),
        ],
    }
    return job(
        namespace,
        variant_job_name(variant),
        pod,
        labels={
            label("role"): PREPARE,
            label("variant"): variant,
            label("dataset"): request["dataset"]["metadata"]["name"],
        },
        owners=owners,
        annotations={label("request"): request_text(request)},
        ttl_seconds=None if owners else _KEPT_SECONDS,
    )
