# SPDX-License-Identifier: Apache-2.0
"""Resources that the fake API server serves: those of our CRDs, and the few built-in ones around them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from fakeapi.schema import loads

CRDS = Path(__file__).resolve().parents[3] / "crds"
VERBS = ["create", "delete", "get", "list", "patch", "watch"]


@dataclass(frozen=True)
class Resource:
    """A collection of objects of one kind.

    Attributes:
        group: its API group; the core group is empty.
        version: version of the group.
        plural: its name in addresses.
        kind: kind of its objects.
        namespaced: whether its objects live in namespaces.
        has_status: whether ``status`` is a subresource.
        has_generation: whether a change of the spec is counted.
        schema: what a CRD says of its objects; None for built-in resources, which are taken as they come.
    """

    group: str
    version: str
    plural: str
    kind: str
    namespaced: bool = True
    has_status: bool = False
    has_generation: bool = False
    schema: dict[str, Any] | None = field(default=None, compare=False, repr=False)

    @property
    def api_version(self) -> str:
        """Return the value of ``apiVersion`` in manifests."""
        return f"{self.group}/{self.version}" if self.group else self.version

    @property
    def name(self) -> str:
        """Return the resource with its group, as sentences of the server name it."""
        return f"{self.plural}.{self.group}" if self.group else self.plural

    @property
    def described_kind(self) -> str:
        """Return the kind with its group, as other sentences name it."""
        return f"{self.kind}.{self.group}" if self.group else self.kind

    @property
    def described(self) -> list[dict[str, Any]]:
        """Return the resource and its subresource as discovery has them."""
        entry = {
            "name": self.plural,
            "singularName": self.kind.lower(),
            "namespaced": self.namespaced,
            "kind": self.kind,
            "verbs": VERBS,
        }
        status = entry | {"name": f"{self.plural}/status", "singularName": "", "verbs": ["get", "patch"]}
        return [entry, status] if self.has_status else [entry]


PODS = Resource("", "v1", "pods", "Pod", has_status=True, has_generation=True)
JOBS = Resource("batch", "v1", "jobs", "Job", has_status=True, has_generation=True)
EVENTS = Resource("", "v1", "events", "Event")
NAMESPACES = Resource("", "v1", "namespaces", "Namespace", namespaced=False)
NODES = Resource("", "v1", "nodes", "Node", namespaced=False, has_status=True)
LIMIT_RANGES = Resource("", "v1", "limitranges", "LimitRange")
QUOTAS = Resource("", "v1", "resourcequotas", "ResourceQuota")
PRIORITY_CLASSES = Resource("scheduling.k8s.io", "v1", "priorityclasses", "PriorityClass", namespaced=False)

WORKLOADS = Resource("kueue.x-k8s.io", "v1beta2", "workloads", "Workload", has_status=True)
"""Kueue's picture of a Job; served only where a test installs Kueue."""


@cache
def resources() -> tuple[Resource, ...]:
    """Return all resources."""
    ours = []
    for path in sorted(CRDS.glob("*.yaml")):
        spec = yaml.load(path.read_bytes(), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))["spec"]  # noqa: S506
        [version] = spec["versions"]
        names = spec["names"]
        schema = loads(json.dumps(version["schema"]["openAPIV3Schema"]))
        ours.append(
            Resource(
                *(spec["group"], version["name"], names["plural"], names["kind"]),
                has_status="status" in version["subresources"],
                has_generation=True,
                schema=schema,
            )
        )
    return (PODS, JOBS, EVENTS, NAMESPACES, NODES, LIMIT_RANGES, QUOTAS, PRIORITY_CLASSES, WORKLOADS, *ours)


def named(word: str) -> Resource:
    """Return a resource by its kind or plural, as kubectl takes them.

    Raises:
        KeyError: none has this name.
    """
    for resource in resources():
        if word.lower() in {resource.kind.lower(), resource.plural}:
            return resource
    raise KeyError(f"the fake API server serves no {word!r}")


def at(group: str, version: str, plural: str) -> Resource | None:
    """Return a resource by its address; None where there is none."""
    for resource in resources():
        if (resource.group, resource.version, resource.plural) == (group, version, plural):
            return resource
    return None
