# SPDX-License-Identifier: Apache-2.0
"""Schemas that the API server serves beside those of this version: CRDs are a chart of their own.

What older CRDs don't know of a status the server refuses, or drops without a word.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.model.base import GROUP, VERSION
from slamhive.model.loading import KINDS
from slamhive.model.status import STATUSES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from slamhive.kube.api.client import Api

_SHOWN = 3
HELP = "bring them to this version: helm upgrade slamhive-crds helm/slamhive-crds, or kubectl apply -f crds/"


async def what_crds_lack(api: Api) -> str | None:
    """Return a sentence on the fields and words of this version that the cluster's CRDs don't know.

    Returns:
        Empty where they lack nothing, as newer ones don't; None where this account may not see it.

    Raises:
        ApiError: see ``slamhive.kube.api.errors``.
    """
    served = await api.schemas(GROUP, VERSION)
    if not served.keys() >= STATUSES.keys():
        return None
    lacking = sorted(
        f"{kind}.{word}" for kind in STATUSES for word in {*_own(kind)} - {*_words(served[kind], {}, "")}
    )
    if not lacking:
        return ""
    shown = ", ".join(lacking[:_SHOWN])
    more = f" and {len(lacking) - _SHOWN} more" if len(lacking) > _SHOWN else ""
    return f"the CRDs are older than this version and don't know {shown}{more}; {HELP}"


def _own(kind: str) -> Iterator[str]:
    """Yield the fields and words of a kind as this version has them."""
    for model, place in ((KINDS[kind], ""), (STATUSES[kind], "status")):
        schema = model.model_json_schema(by_alias=True)
        schema.get("properties", {}).pop("metadata", None)
        yield from _words(schema, schema.get("$defs", {}), place)


def _words(node: Mapping[str, Any], known: Mapping[str, Any], place: str) -> Iterator[str]:
    """Yield the fields and words of a schema, such as ``status.usage`` and ``status.phase=Failed``."""
    if "$ref" in node:
        node = known[str(node["$ref"]).rpartition("/")[2]]
    for option in node.get("anyOf", ()):
        yield from _words(option, known, place)
    for name, item in node.get("properties", {}).items():
        way = f"{place}.{name}".lstrip(".")
        yield way
        yield from _words(item, known, way)
    for below in (node.get("items"), node.get("additionalProperties")):
        if isinstance(below, dict):
            yield from _words(below, known, f"{place}[]")
    for word in node.get("enum", ()):
        yield f"{place}={word}"
