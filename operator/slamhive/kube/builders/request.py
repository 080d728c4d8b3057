# SPDX-License-Identifier: Apache-2.0
"""The Jobs that run a program of ours: by a request, which the pod reads as a file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.kube.builders.common import Manifest, downward, job, label, mount, request_text, scratch

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

REQUEST = mount("request", "/slamhive/request", read_only=True)
TMP = mount("tmp", "/tmp")  # noqa: S108
ENVIRONMENT = {"HOME": "/tmp", "LANG": "C.UTF-8"}  # noqa: S108
KEPT_SECONDS = 3600


def module(name: str, *options: str) -> list[str]:
    """Return the command of a program of ours."""
    return ["python3", "-P", "-m", f"slamhive.jobs.{name}", *options]


def request_job(
    namespace: str,
    name: str,
    pod: Manifest,
    *,
    role: str,
    containers: Sequence[Manifest],
    claims: Sequence[Manifest],
    deadline_seconds: int,
    request: Mapping[str, Any] | None = None,
    volumes: Sequence[Manifest] = (),
    scratch_size: str = "16Mi",
    labels: Mapping[str, str] | None = None,
    owners: Sequence[Manifest] = (),
    notes: Mapping[str, str] | None = None,
    ttl_seconds: int | None = KEPT_SECONDS,
) -> Manifest:
    """Return a Job whose containers run one after the other.

    Args:
        namespace: where it goes.
        name: its name.
        pod: what all pods have in common there.
        role: its purpose.
        containers: its containers, the main one last.
        claims: volumes that stay.
        deadline_seconds: how long it may take. It is the pod's, which leaves its last words; the Job's would
            delete them with the pod.
        request: what its programs are asked for; they mount ``REQUEST``.
        volumes: further volumes.
        scratch_size: size of ``TMP``.
        labels: further labels.
        owners: references to its owners.
        notes: annotations of the Job alone.
        ttl_seconds: how long it stays when it has finished; None: as long as its owners.

    Raises:
        InputError: the request doesn't fit into an object.
    """
    *before, main = containers
    asked = label("request")
    body = {
        "activeDeadlineSeconds": deadline_seconds,
        "containers": [main],
        "volumes": [
            *([] if request is None else [downward("request", asked, "request.json")]),
            *claims,
            scratch("tmp", scratch_size),
            *volumes,
        ],
    }
    return job(
        namespace,
        name,
        pod | body | ({"initContainers": before} if before else {}),
        labels={label("role"): role, **(labels or {})},
        owners=owners,
        annotations={} if request is None else {asked: request_text(request)},
        notes=notes,
        ttl_seconds=ttl_seconds,
    )
