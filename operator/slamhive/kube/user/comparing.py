# SPDX-License-Identifier: Apache-2.0
"""Comparison of a manifest with the cluster's object of the same name, and the patch that makes them equal.

``slamhive submit`` uses it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.kube.reconciling.catalogue import parse
from slamhive.model.canonical import normalize
from slamhive.model.crd_rules import FROZEN
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.kube.kinds import Object
    from slamhive.kube.user.manifests import Manifest


_SHOWN = 5
_VALUE_LENGTH = 60
_MISSING = object()


@dataclass(frozen=True)
class Difference:
    """What an object lacks to be equal to its manifest.

    Attributes:
        frozen: what differs and may not change, as sentences.
        changes: what differs and may, as sentences.
        patch: the merge patch for the latter.
    """

    frozen: list[str] = field(default_factory=list)
    changes: list[str] = field(default_factory=list)
    patch: Object = field(default_factory=dict)


def compare(manifest: Manifest, present: Object) -> Difference:
    """Say what differs between a manifest and the object of its name, defaults filled in on both sides."""
    try:
        there = parse(type(manifest.item), present)
    except InputError as error:
        return Difference(frozen=[f"the cluster's object is not valid here: {error}"])
    here_spec, there_spec = _plain(manifest.item), _plain(there)
    immutable = FROZEN.get(str(manifest.kind), ())
    result = Difference()
    for name in here_spec.keys() | there_spec.keys():
        before, after = there_spec.get(name), here_spec.get(name)
        # A manifest that says nothing of cancelling does not take it back.
        if before == after or (name == "cancel" and "cancel" not in manifest.spec):
            continue
        told = list(_told(f"spec.{name}", before, after))
        if immutable is None or name in immutable:
            result.frozen.extend(told)
        else:
            result.changes.extend(told)
            wanted = normalize(manifest.item.as_json()["spec"]).get(name)
            result.patch.setdefault("spec", {})[name] = _merge(present["spec"].get(name), wanted)
    for name in ("labels", "annotations"):
        _marks(manifest, present, name, result)
    return Difference(sorted(result.frozen), sorted(result.changes), result.patch)


def bounded(sentences: list[str]) -> str:
    """Return the first few sentences as one."""
    more = len(sentences) - _SHOWN
    return "; ".join(sentences[:_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def _marks(manifest: Manifest, present: Object, name: str, result: Difference) -> None:
    """Note labels or annotations that the manifest sets otherwise; it has no say in others."""
    have = present["metadata"].get(name) or {}
    fresh = {key: value for key, value in manifest.metadata.get(name, {}).items() if have.get(key) != value}
    if fresh:
        result.patch.setdefault("metadata", {})[name] = fresh
        result.changes.extend(
            f"metadata.{name}.{key}: {_shown(have.get(key, _MISSING))} → {_shown(value)}"
            for key, value in fresh.items()
        )


def _plain(item: Any) -> Object:
    plain: Object = normalize(item.spec.model_dump(mode="json", by_alias=True))
    return plain


def _told(path: str, before: Any, after: Any) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in [*before, *(key for key in after if key not in before)]:
            if before.get(key, _MISSING) != after.get(key, _MISSING):
                yield from _told(f"{path}.{key}", before.get(key, _MISSING), after.get(key, _MISSING))
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for number, (old, new) in enumerate(zip(before, after, strict=True)):
            if old != new:
                yield from _told(f"{path}[{number}]", old, new)
    else:
        yield f"{path}: {_shown(before)} → {_shown(after)}"


def _shown(value: Any) -> str:
    if value is _MISSING:
        return "absent"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _VALUE_LENGTH else text[: _VALUE_LENGTH - 1] + "…"


def _merge(before: Any, after: Any) -> Any:
    """Return the merge patch that makes one value of the other: what is absent becomes null."""
    if not (isinstance(before, dict) and isinstance(after, dict)):
        return after
    gone = dict.fromkeys(before.keys() - after.keys())
    return gone | {key: _merge(before.get(key), value) for key, value in after.items()}
