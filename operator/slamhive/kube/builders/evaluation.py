# SPDX-License-Identifier: Apache-2.0
"""The Jobs that measure finished runs, by our evaluator or another, and that read what a monitor left."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from slamhive.kube.builders.common import (
    ANNOTATION_LIMIT,
    Manifest,
    claim,
    container,
    downward,
    equal_resources,
    job,
    label,
    mount,
    owner_reference,
    pod_spec,
    request_text,
    scratch,
    segment,
    variables,
)
from slamhive.model.canonical import digest

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from slamhive.kube.settings import Settings
    from slamhive.model.evaluation import Evaluator

EVALUATE = "evaluate"
LINKS = "links"
EVALUATOR = "evaluator"
REPORT = "report"
READ = "read"

_HASH_LENGTH = 20
_KEPT_SECONDS = 3600
_DEADLINE_SECONDS = 2 * 3600
_READ_SECONDS = 600
_SCRATCH = "2Gi"
_HEAD = 4096
_MODULE = ("python3", "-P", "-m", "slamhive.jobs.evaluate")


def batches(runs: Iterable[Mapping[str, Any]], size: int) -> Iterator[list[Mapping[str, Any]]]:
    """Split runs so that each batch has at most so many and its request fits into an object.

    Args:
        runs: as they stand in requests.
        size: most runs of a batch.
    """
    batch: list[Mapping[str, Any]] = []
    # A request is an annotation of the pod, and the API server bounds those.
    room = ANNOTATION_LIMIT - _HEAD
    used = 0
    for run in runs:
        length = len(json.dumps(run, ensure_ascii=False, separators=(",", ":")).encode()) + 1
        if batch and (len(batch) == size or used + length > room):
            yield batch
            batch, used = [], 0
        batch.append(run)
        used += length
    if batch:
        yield batch


def evaluator_job_name(namespace: str, request: Mapping[str, Any], settings_hash: str, attempt: int) -> str:
    """Return the name of the Job that measures a batch: the same batch has the same name."""
    parts = {
        "namespace": namespace,
        "evaluation": request.get("evaluation"),
        "runs": sorted(run["uid"] for run in request["runs"]),
        "settings": settings_hash,
        # With the attempt: a batch that failed is tried again under a name that is free.
        "attempt": attempt,
    }
    return f"{EVALUATE}-{digest(parts)[:_HASH_LENGTH]}"


def evaluator_job(
    namespace: str,
    request: Mapping[str, Any],
    *,
    settings_hash: str,
    attempt: int,
    owners: Sequence[Manifest],
    settings: Settings,
    evaluator: Evaluator | None = None,
) -> Manifest:
    """Return the Job that measures a batch of runs.

    Args:
        namespace: of the runs.
        request: ``evaluation``, ``settings`` and ``runs`` as the evaluator reads them.
        settings_hash: of how is measured.
        attempt: number of the attempt at this batch, from 1.
        owners: references to what it goes with; without, it goes an hour after its end.
        settings: the operator's.
        evaluator: a container that measures in the place of ours.

    Raises:
        InputError: the request doesn't fit into an object, or an identity in it is no segment of a path.
    """
    for run in request["runs"]:
        segment(run["uid"], "the uid")
    name = evaluator_job_name(namespace, request, settings_hash, attempt)
    work = _custom(evaluator, settings) if evaluator else _ours(settings)
    volumes = [
        downward("request", label("request"), "request.json"),
        claim("results", settings.volumes.results.claim),
        claim("data", settings.volumes.data.claim),
        scratch("tmp", _SCRATCH),
    ]
    if evaluator:
        volumes.append(scratch("runs", "64Mi"))
    pod = pod_spec(settings) | work | {"activeDeadlineSeconds": _DEADLINE_SECONDS, "volumes": volumes}
    for body in (*pod.get("initContainers", []), *pod["containers"]):
        for place in body["volumeMounts"]:
            if place["mountPath"] == "/slamhive/output":
                place["subPath"] = f"evaluations/{name}"
    return job(
        namespace,
        name,
        pod,
        labels={
            label("role"): EVALUATE,
            label("evaluation"): request.get("evaluation") or settings_hash[:63],
        },
        owners=owners,
        annotations={label("request"): request_text(request)},
        ttl_seconds=None if owners else _KEPT_SECONDS,
    )


def log_container(*, custom: bool) -> str:
    """Return the name of the container whose log carries the results."""
    return REPORT if custom else EVALUATE


def _mounts(*, writable: bool = True) -> list[Manifest]:
    return [
        mount("request", "/slamhive/request", read_only=True),
        mount("results", "/slamhive/results", read_only=True),
        mount("results", "/slamhive/output", read_only=not writable),
        mount("data", "/slamhive/groundtruth", read_only=True, subPath="groundtruth"),
        mount("tmp", "/tmp"),  # noqa: S108
    ]


def _container(
    name: str, image: str, command: Sequence[str], mounts: Iterable[Manifest], settings: Settings
) -> Manifest:
    wanted = settings.evaluation
    return container(
        name,
        image,
        settings,
        command=command,
        env=variables({"HOME": "/tmp", "TMPDIR": "/tmp", "LANG": "C.UTF-8"}),  # noqa: S108
        mounts=mounts,
        resources=equal_resources(wanted.cpu, wanted.memory, logs="4Gi"),
    )


def _ours(settings: Settings) -> Manifest:
    image = settings.measuring_image
    return {"containers": [_container(EVALUATE, image, _MODULE, _mounts(), settings)]}


def _custom(evaluator: Evaluator, settings: Settings) -> Manifest:
    image = settings.measuring_image
    report = ("python3", "-P", "-m", "slamhive.jobs.report")
    links = mount("runs", "/slamhive/runs")
    return {
        "initContainers": [
            _container(LINKS, image, [*_MODULE, "--links"], [*_mounts(writable=False), links], settings),
            _container(
                EVALUATOR,
                evaluator.image,
                evaluator.command,
                [*_mounts(), links | {"readOnly": True}],
                settings,
            ),
        ],
        # The foreign evaluator is an init container, so that our own reads what it left after it has ended.
        "containers": [_container(REPORT, image, report, _mounts(writable=False), settings)],
    }


def read_job_name(run_uid: str, pod_uid: str) -> str:
    """Return the name of the Job that reads what a monitor left."""
    return f"{READ}-{digest({'run': run_uid, 'pod': pod_uid})[:_HASH_LENGTH]}"


def read_job(*, run: Mapping[str, Any], pod_uid: str, settings: Settings) -> Manifest:
    """Return the Job that reads the summary of an attempt whose monitor left no last words.

    Args:
        run: the MappingRun as the API server returned it; it owns the Job.
        pod_uid: identity of the attempt's pod.
        settings: the operator's.

    Raises:
        InputError: an identity is no segment of a path.
    """
    metadata = run["metadata"]
    run_uid = metadata["uid"]
    path = f"runs/{segment(run_uid, 'the uid')}/{segment(pod_uid, 'the uid')}/summary.json"
    body = container(
        READ,
        settings.image,
        settings,
        command=["python3", "-P", "-m", "slamhive.jobs.read"],
        env=variables({"HOME": "/tmp", "LANG": "C.UTF-8"}),  # noqa: S108
        mounts=[
            mount("results", "/slamhive/results", read_only=True),
            mount("request", "/slamhive/request", read_only=True),
            mount("tmp", "/tmp"),  # noqa: S108
        ],
        resources=equal_resources("100m", "128Mi", logs="64Mi"),
    )
    pod = pod_spec(settings) | {
        "activeDeadlineSeconds": _READ_SECONDS,
        "containers": [body],
        "volumes": [
            downward("request", label("request"), "request.json"),
            claim("results", settings.volumes.results.claim),
            scratch("tmp", "16Mi"),
        ],
    }
    return job(
        metadata["namespace"],
        read_job_name(run_uid, pod_uid),
        pod,
        labels={label("role"): READ, label("run"): metadata["name"]},
        owners=[owner_reference(run)],
        annotations={label("request"): request_text({"path": path})},
        ttl_seconds=_KEPT_SECONDS,
    )
