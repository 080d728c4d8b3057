# SPDX-License-Identifier: Apache-2.0
"""Admission of new objects by PriorityClasses, LimitRanges (what containers ask for) and ResourceQuotas."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fakeapi.refusals import forbidden
from fakeapi.resources import LIMIT_RANGES, PODS, PRIORITY_CLASSES, QUOTAS, Resource

from slamhive.model.base import quantity

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.api.kinds import Object


def insist(resource: Resource, body: Object, others: Callable[[Resource, str], list[Object]]) -> None:
    """Check that an object may be created.

    Args:
        resource: of what.
        body: the object.
        others: returns the objects of a resource in a namespace.

    Raises:
        Refusal: it may not.
    """
    if not resource.namespaced:
        return
    name, namespace = body["metadata"]["name"], body["metadata"]["namespace"]
    if resource is PODS:
        wanted = body["spec"].get("priorityClassName")
        if wanted and wanted not in {one["metadata"]["name"] for one in others(PRIORITY_CLASSES, "")}:
            raise forbidden("pods", name, f"no PriorityClass with name {wanted} was found")
        for limits in others(LIMIT_RANGES, namespace):
            why = _above(limits, body)
            if why:
                raise forbidden(resource.name, name, why)
    for quota in others(QUOTAS, namespace):
        item = f"count/{resource.name}"
        hard = quota["spec"]["hard"].get(item)
        used = len(others(resource, namespace))
        if hard is not None and used >= int(hard):
            figures = f"requested: {item}=1, used: {item}={used}, limited: {item}={hard}"
            raise forbidden(resource.name, name, f"exceeded quota: {quota['metadata']['name']}, {figures}")


def _above(limits: Object, pod: Object) -> str:
    containers = [
        *(pod["spec"].get("initContainers") or ()),
        *pod["spec"]["containers"],
    ]
    for limit in limits["spec"]["limits"]:
        for what, most in (limit.get("max") or {}).items() if limit["type"] == "Container" else ():
            for container in containers:
                asked = ((container.get("resources") or {}).get("limits") or {}).get(what)
                if asked is not None and quantity(asked) > quantity(most):
                    return f"maximum {what} usage per Container is {most}, but limit is {asked}"
    return ""
