# SPDX-License-Identifier: Apache-2.0
"""The kinds of objects that the operator watches, and how each is addressed in the API."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

from slamhive.model.base import GROUP, VERSION, Choice

if TYPE_CHECKING:
    from collections.abc import Mapping

Object = dict[str, Any]
"""An object of the API in plain JSON, or a part of one."""
MANAGER = "slamhive"
"""Value of the label ``app.kubernetes.io/managed-by`` on everything that the operator makes."""


class Label(Choice):
    """Labels on what the operator makes; the names are part of the public language."""

    MANAGED_BY = "app.kubernetes.io/managed-by"
    ROLE = "slamhive.io/role"
    RUN = "slamhive.io/run"
    SWEEP = "slamhive.io/sweep"
    POINT = "slamhive.io/point"
    SLOT = "slamhive.io/slot"
    ALGORITHM = "slamhive.io/algorithm"
    DATASET = "slamhive.io/dataset"
    VARIANT = "slamhive.io/variant"
    PREPARATION = "slamhive.io/preparation"
    EVALUATION = "slamhive.io/evaluation"
    ATTEMPT = "slamhive.io/attempt"


class Role(Choice):
    """Purposes of the operator's Jobs: values of the label ``slamhive.io/role``."""

    RUN = "run"
    PREPARE = "prepare"
    EVALUATE = "evaluate"
    COLLECT = "collect"
    READ = "read"
    RESTORE = "restore"
    OFFLOAD = "offload"
    SEND = "send"


class Kind(Choice):
    """A kind of object that the operator watches."""

    ALGORITHM = "Algorithm"
    DATASET = "Dataset"
    MAPPING_RUN = "MappingRun"
    EVALUATION = "Evaluation"
    SWEEP = "Sweep"
    JOB = "Job"
    POD = "Pod"

    @property
    def group(self) -> str:
        """Return the API group; the core group is empty."""
        return {Kind.JOB: "batch", Kind.POD: ""}.get(self, GROUP)

    @property
    def version(self) -> str:
        """Return the version of the API group."""
        return "v1" if self in _BUILT_IN else VERSION

    @property
    def api_version(self) -> str:
        """Return the value of ``apiVersion`` in manifests."""
        return f"{self.group}/{self.version}" if self.group else self.version

    @property
    def plural(self) -> str:
        """Return the resource's name in addresses and roles."""
        return f"{self.lower()}s"

    @property
    def resource(self) -> str:
        """Return the resource with its group, as kubectl writes it."""
        return f"{self.plural}.{self.group}" if self.group else self.plural

    @property
    def is_ours(self) -> bool:
        """Tell whether the kind is defined by our CRDs."""
        return self not in _BUILT_IN

    def path(self, namespace: str, name: str = "", subresource: str = "") -> str:
        """Return the address of a collection, an object or a subresource on the API server."""
        root = "/apis" if self.group else "/api"
        parts = [f"{root}/{self.api_version}/namespaces", quote(namespace, safe=""), self.plural]
        parts += [quote(part, safe="") for part in (name, subresource) if part]
        return "/".join(parts)


_BUILT_IN = frozenset({Kind.JOB, Kind.POD})
OUR_KINDS = tuple(kind for kind in Kind if kind.is_ours)


class Key(NamedTuple):
    """The address of one object."""

    kind: Kind
    namespace: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.namespace}/{self.name}"


def key_of(kind: Kind, obj: Object) -> Key:
    """Return the address of an object."""
    metadata = obj["metadata"]
    return Key(kind, metadata.get("namespace", ""), metadata["name"])


def labels_of(obj: Mapping[str, Any]) -> dict[str, str]:
    """Return an object's labels."""
    return obj["metadata"].get("labels") or {}


def annotations_of(obj: Mapping[str, Any]) -> dict[str, str]:
    """Return an object's annotations."""
    return obj["metadata"].get("annotations") or {}


def owners_of(obj: Mapping[str, Any]) -> list[Object]:
    """Return an object's references to its owners."""
    return obj["metadata"].get("ownerReferences") or []


def owner_uids(obj: Mapping[str, Any]) -> list[str]:
    """Return the uids of an object's owners."""
    return [owner["uid"] for owner in owners_of(obj)]


def reference(kind: Kind, obj: Mapping[str, Any], *, controller: bool = False) -> Object:
    """Return the owner reference that makes an object the owner of others."""
    metadata = obj["metadata"]
    body = {
        "apiVersion": kind.api_version,
        "kind": str(kind),
        "name": metadata["name"],
        "uid": metadata["uid"],
        "blockOwnerDeletion": False,
    }
    return body | ({"controller": True} if controller else {})
