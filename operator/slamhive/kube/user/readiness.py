# SPDX-License-Identifier: Apache-2.0
"""Readiness of a cluster for ``slamhive doctor``: its answer, our kinds, operator, figures and rights."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from slamhive import __version__
from slamhive.kube.api.errors import ApiError, Forbidden, NotFound
from slamhive.kube.api.kinds import Kind
from slamhive.kube.api.transport import Request
from slamhive.kube.served import what_crds_lack
from slamhive.kube.user.connecting import connected, find_target
from slamhive.kube.user.together import together
from slamhive.model.errors import SlamHiveError
from slamhive.model.readiness import ReadinessRow, State, limited, missing, there

if TYPE_CHECKING:
    from slamhive.kube.api.kinds import Object
    from slamhive.kube.user.api import UserApi
    from slamhive.kube.user.connecting import ConnectedCluster

PATIENCE_SECONDS = 4.0
_HERE = "sweeps run on this machine alone"
_OPERATOR = "app.kubernetes.io/name=slamhive,app.kubernetes.io/component=operator"
_VERSION = "app.kubernetes.io/version"
_RIGHTS = (
    ("create", Kind.SWEEP.resource, "submit"),
    ("list", Kind.MAPPING_RUN.resource, "status"),
    ("patch", Kind.SWEEP.resource, "cancel"),
    ("get", "pods/log", "logs"),
    ("create", "pods/exec", "fetch --files"),
)
"""Verb, resource, and the command that needs the right."""


async def look(context: str | None = None, namespace: str | None = None) -> list[ReadinessRow]:
    """Return the parts of a cluster that are there; one that doesn't answer costs a few seconds.

    Args:
        context: name of a context of the kubeconfig; default: the current one.
        namespace: default: that of the context.
    """
    try:
        target = find_target(context, namespace)
    except SlamHiveError as error:
        found, _, helps = str(error).partition("; ")
        return [missing("cluster", found, _HERE, helps)]
    named = (
        f"context {target.context!r}, namespace {target.namespace}" if target.context else target.namespace
    )
    try:
        async with asyncio.timeout(PATIENCE_SECONDS), connected(target) as cluster:
            looks = (_version(cluster, named), _operator(cluster), _figures(cluster), _rights(cluster))
            return await together(looks)
    except TimeoutError:
        helps = "is the cluster up, and can it be reached from here? kubectl version"
        found = f"{named}: no answer within {PATIENCE_SECONDS:g} s"
        return [missing("cluster", found, _HERE, helps)]
    except SlamHiveError as error:
        found, _, helps = str(error).partition(": its administrator ")
        return [
            missing("cluster", found, _HERE, f"its administrator {helps}" if helps else "kubectl version")
        ]


async def _version(cluster: ConnectedCluster, named: str) -> ReadinessRow:
    told = f"{named}, Kubernetes {await cluster.api.server_version()}, with our CRDs"
    lacking, _, helps = (await what_crds_lack(cluster.api) or "").partition("; ")
    if lacking:
        return limited("cluster", f"{told}; {lacking}", "what they don't know is refused or lost", helps)
    return there("cluster", told)


async def _operator(cluster: ConnectedCluster) -> ReadinessRow:
    check, where = "operator", cluster.namespace
    path = f"/apis/apps/v1/namespaces/{where}/deployments"
    query = {"labelSelector": _OPERATOR}
    try:
        answer = await cluster.api.json(
            Request("list", "deployments.apps", where, "GET", path, query=query), attempts=1
        )
    except (Forbidden, NotFound):
        return ReadinessRow(check, State.UNKNOWN, f"this user may not look for one in {where}")
    found = answer.get("items") or []
    if not found:
        told = f"none in {where}; one of another namespace may serve it"
        return ReadinessRow(
            check, State.UNKNOWN, told, "without one nothing starts", "slamhive status says more"
        )
    version = str((found[0]["metadata"].get("labels") or {}).get(_VERSION, "unknown"))
    told = f"version {version}"
    if not (found[0].get("status") or {}).get("availableReplicas"):
        helps = f"kubectl --namespace {where} describe deployment {found[0]['metadata']['name']}"
        return missing(check, f"{told}, not available", "nothing starts", helps)
    if version != __version__:
        costs = "fields of the newer version are refused or left out by the older one"
        return limited(check, f"{told}, here is {__version__}", costs, "bring both to the same version")
    return there(check, told)


async def _figures(cluster: ConnectedCluster) -> ReadinessRow:
    check = "metrics API"
    try:
        await cluster.api.pod_metrics(cluster.namespace)
    except Forbidden:
        return ReadinessRow(check, State.UNKNOWN, "this user may not read it")
    except ApiError:
        costs = "no live CPU and memory while runs go on; the figures of finished ones are the monitor's"
        return missing(check, "it does not answer", costs, "its administrator installs metrics-server")
    return there(check, "it answers")


async def _rights(cluster: ConnectedCluster) -> ReadinessRow:
    may = await together(_may(cluster, verb, resource) for verb, resource, _ in _RIGHTS)
    lacking = [right for right, allowed in zip(_RIGHTS, may, strict=True) if allowed is False]
    if None in may:
        return ReadinessRow("rights", State.UNKNOWN, "the cluster does not tell which rights this user has")
    if not lacking:
        return there("rights", ", ".join(command for _, _, command in _RIGHTS))
    words = ", ".join(f"{verb} {resource}" for verb, resource, _ in lacking)
    costs = f"no {', '.join(command for _, _, command in lacking)}"
    helps = f"its administrator grants them in {cluster.namespace}"
    return limited("rights", f"this user may not {words}", costs, helps)


async def _may(cluster: ConnectedCluster, verb: str, resource: str) -> bool | None:
    """Tell whether the user has a right; None where the cluster doesn't tell."""
    named, _, subresource = resource.partition("/")
    plural, _, group = named.partition(".")
    asked = {
        "namespace": cluster.namespace,
        "verb": verb,
        "resource": plural,
        "group": group,
        "subresource": subresource,
    }
    body: Object = {
        "apiVersion": "authorization.k8s.io/v1",
        "kind": "SelfSubjectAccessReview",
        "spec": {"resourceAttributes": asked},
    }
    try:
        answer = await _review(cluster.api, body)
    except ApiError:
        return None
    return bool((answer.get("status") or {}).get("allowed"))


async def _review(api: UserApi, body: Object) -> Object:
    path = "/apis/authorization.k8s.io/v1/selfsubjectaccessreviews"
    request = Request("create", "selfsubjectaccessreviews", "of this user", "POST", path, body=body)
    return await api.json(request, attempts=1)
