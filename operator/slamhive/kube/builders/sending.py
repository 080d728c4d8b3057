# SPDX-License-Identifier: Apache-2.0
"""The Job that hands out files of run folders to a user's command, made by that user."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.jobs.send import COMMAND
from slamhive.kube.builders.common import (
    Manifest,
    beside_runs,
    claim,
    container,
    equal_resources,
    mount,
    variables,
)
from slamhive.kube.builders.request import ENVIRONMENT, TMP, request_job
from slamhive.kube.builders.restoring import store_mounts, store_volumes
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.kube.settings import StoreReference

SEND = "send"
RESULTS = "results"

_LONGEST_SECONDS = 24 * 3600
_UNASKED_SECONDS = 180
_KEPT_SECONDS = 30
_TAKEN = (
    "securityContext",
    "serviceAccountName",
    "nodeSelector",
    "tolerations",
    "affinity",
    "imagePullSecrets",
)
"""Fields of one of the operator's pods that tell how pods have to be in this namespace."""


def sender_job(
    namespace: str, name: str, like: Mapping[str, Any], store: StoreReference | None = None
) -> Manifest:
    """Return the Job whose pod sees the results volume, read only.

    It ends by itself when nobody has asked it for three minutes, and goes half a minute later.

    Args:
        namespace: where it goes.
        name: its name.
        like: spec of a pod of the operator's: of a run, or of the collector.
        store: object storage that folders were moved to; None for none.

    Raises:
        InputError: that pod has no results volume.
    """
    found = {volume["name"]: volume for volume in like.get("volumes") or ()}
    source = (found.get(RESULTS) or {}).get("persistentVolumeClaim")
    ours = [*(like.get("initContainers") or ()), *like["containers"]][0]
    if source is None:
        raise InputError(f"the pods of namespace {namespace} have no volume {RESULTS!r}")
    body = container(
        SEND,
        ours["image"],
        ours.get("imagePullPolicy", "IfNotPresent"),
        command=[*COMMAND, "--wait", str(_UNASKED_SECONDS)],
        env=variables(ENVIRONMENT | {"PYTHONDONTWRITEBYTECODE": "1"}),
        mounts=[
            mount(RESULTS, "/slamhive/results", read_only=True),
            TMP,
            *(store_mounts(store) if store else []),
        ],
        # The storage's library alone takes 100 MiB.
        resources=equal_resources("200m", "384Mi" if store else "128Mi", logs="64Mi"),
    )
    # A user's command can't read the operator's settings: how pods have to be here is taken from one of its
    # pods.
    taken = {key: like[key] for key in _TAKEN if like.get(key)}
    if affinity := beside_runs(taken.pop("affinity", {})):
        taken["affinity"] = affinity
    pod = taken | {
        "restartPolicy": "Never",
        "automountServiceAccountToken": False,
        "enableServiceLinks": False,
        "terminationGracePeriodSeconds": 1,
    }
    return request_job(
        namespace,
        name,
        pod,
        role=SEND if store else "read",
        containers=[body],
        claims=[claim(RESULTS, source["claimName"], read_only=True)],
        deadline_seconds=_LONGEST_SECONDS,
        volumes=store_volumes(store) if store else [],
        ttl_seconds=_KEPT_SECONDS,
    )
