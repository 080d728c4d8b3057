# SPDX-License-Identifier: Apache-2.0
"""Sizes of objects that a cluster refuses, counted before it is asked."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slamhive.model.base import Resource

ANNOTATION_BYTES = 262_144
"""All annotations of an object; `kubectl apply` keeps a copy of the manifest in one."""
OBJECT_BYTES = (3 << 19) - (64 << 10)
"""The 1.5 MiB that etcd takes in a request, without room for an object's status."""
_COPY = "kubectl.kubernetes.io/last-applied-configuration"
_ESCAPED = "<>&"
"""Characters that kubectl's copy has in six bytes each."""


def size_refused(item: Resource) -> str | None:
    """Return a sentence on an object that is too large for a cluster; None where it isn't."""
    size = len(_text(item).encode())
    if size <= OBJECT_BYTES:
        return None
    return (
        f"{item.kind} {item.name}: {size:,} bytes, a cluster takes at most {OBJECT_BYTES:,} of an object: "
        "write a range in the place of long lists, shorter texts, or several objects"
    )


def apply_refused(item: Resource) -> str | None:
    """Return a sentence on an object that is too large for `kubectl apply`; None where it isn't."""
    text, noted = _text(item), item.metadata.annotations
    size = len(text.encode()) + 1 + 5 * sum(text.count(character) for character in _ESCAPED)
    size += len(_COPY) + sum(len(key.encode()) + len(value.encode()) for key, value in noted.items())
    if size <= ANNOTATION_BYTES:
        return None
    return (
        f"{item.kind} {item.name}: {size:,} bytes are too many for kubectl apply, which copies manifests "
        f"into an annotation of at most {ANNOTATION_BYTES:,}: slamhive submit, kubectl create and "
        "kubectl apply --server-side take it"
    )


def _text(item: Resource) -> str:
    body = item.model_dump(mode="json", by_alias=True, exclude_unset=True)
    return json.dumps(body, separators=(",", ":"), ensure_ascii=False)
