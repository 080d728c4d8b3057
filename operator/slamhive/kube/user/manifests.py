# SPDX-License-Identifier: Apache-2.0
"""Manifests to submit to a cluster: from files, standard input and the catalog, and what they would change.

One is compared with the cluster's object of the same name; the patch makes them equal.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.kinds import Kind, Object
from slamhive.kube.reconciling import catalogue
from slamhive.model.base import API_VERSION
from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError, ManifestError
from slamhive.model.loading import FROZEN, GROWING, parse, read_text, to_object

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from slamhive.kube.api.kinds import Object
    from slamhive.model.base import Resource

STDIN = "-"

_SHOWN = 5
_VALUE_LENGTH = 60
_MISSING = object()


@dataclass(frozen=True)
class Manifest:
    """An object to be in a cluster.

    Attributes:
        kind: its kind.
        item: the object as a record of the language.
        spec: its spec as it was written.
        source: where it stands, for sentences about it.
    """

    kind: Kind
    item: Resource
    spec: Object
    source: str

    @property
    def name(self) -> str:
        """Return the object's name."""
        return self.item.name

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"

    @property
    def metadata(self) -> Object:
        """Return the metadata that a user sets; what only a server knows is left out."""
        wanted = self.item.metadata.model_dump(exclude_unset=True)
        return {key: wanted[key] for key in ("name", "labels", "annotations") if wanted.get(key)}

    @property
    def body(self) -> Object:
        """Return the object that is sent."""
        return {"metadata": self.metadata, "spec": self.spec}


def read_manifests(paths: Sequence[Path], stdin: str | None = None) -> list[Manifest]:
    """Return the objects of manifest files.

    Args:
        paths: the files; ``-`` is standard input.
        stdin: what that holds.

    Raises:
        InputError: with a sentence for each mistake: file, line, field and what is allowed.
    """
    found: dict[tuple[str, str], Manifest] = {}
    problems: list[str] = []
    for path in paths:
        is_stdin = str(path) == STDIN
        source = "stdin" if is_stdin else str(path)
        documents = parse((stdin or "") if is_stdin else read_text(path), source)
        if not documents:
            raise ManifestError(f"{source}: empty; expected an object with apiVersion: {API_VERSION}")
        for document in documents:
            try:
                item = to_object(document)
            except ManifestError as error:
                problems += str(error).splitlines()
                continue
            manifest = Manifest(Kind(item.kind), item, document.value.get("spec") or {}, document.where(()))
            known = found.setdefault((item.kind, item.name), manifest)
            if known is not manifest:
                problems.append(f"{manifest.source}: {manifest} stands in {known.source} already")
    if problems:
        raise ManifestError("\n".join(problems))
    return [*found.values()]


def entry_of(item: Resource, source: str) -> Manifest:
    """Return an entry of the catalog as a manifest."""
    spec = item.model_dump(mode="json", by_alias=True, exclude_unset=True)["spec"]
    return Manifest(Kind(item.kind), item, spec, source)


def common_namespace(manifests: Sequence[Manifest], asked: str | None) -> str | None:
    """Return the namespace that manifests name; None when none does.

    Raises:
        InputError: they name several, or another one than was asked for.
    """
    named = {item.item.metadata.namespace: item for item in manifests if item.item.metadata.namespace}
    for name, manifest in named.items():
        if asked is not None and name != asked:
            raise InputError(
                f"{manifest.source}: {manifest}: metadata.namespace is {name!r}, but -n says {asked!r}"
            )
    if len(named) > 1:
        raise InputError(
            f"metadata.namespace: {', '.join(sorted(map(str, named)))}: one at a time is allowed"
        )
    return next(iter(named), None)


@dataclass(frozen=True)
class ManifestDifference:
    """Difference between an object in a cluster and its manifest, with the patch that makes them equal.

    Attributes:
        frozen: what differs and may not change, as sentences.
        changes: what differs and may, as sentences.
        patch: the merge patch for the latter.
    """

    frozen: list[str] = field(default_factory=list)
    changes: list[str] = field(default_factory=list)
    patch: Object = field(default_factory=dict)


def compare(manifest: Manifest, present: Object) -> ManifestDifference:
    """Say what differs between a manifest and the object of its name, defaults filled in on both sides."""
    try:
        there = catalogue.parse(type(manifest.item), present)
    except InputError as error:
        return ManifestDifference(frozen=[f"the cluster's object is not valid here: {error}"])
    here_spec, there_spec = _plain(manifest.item), _plain(there)
    immutable = FROZEN.get(str(manifest.kind), ())
    result = ManifestDifference()
    for name in here_spec.keys() | there_spec.keys():
        before, after = there_spec.get(name), here_spec.get(name)
        # A manifest that says nothing of cancelling does not take it back.
        if before == after or (name == "cancel" and "cancel" not in manifest.spec):
            continue
        told = list(_told(f"spec.{name}", before, after))
        frozen = immutable is None or name in immutable
        if frozen and not _has_grown(str(manifest.kind), name, before, after):
            result.frozen.extend(told)
        else:
            result.changes.extend(told)
            wanted = normalize(manifest.item.as_json()["spec"]).get(name)
            result.patch.setdefault("spec", {})[name] = _merge(present["spec"].get(name), wanted)
    for name in ("labels", "annotations"):
        _marks(manifest, present, name, result)
    return ManifestDifference(sorted(result.frozen), sorted(result.changes), result.patch)


def bounded(sentences: list[str]) -> str:
    """Return the first few sentences as one."""
    more = len(sentences) - _SHOWN
    return "; ".join(sentences[:_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def _marks(manifest: Manifest, present: Object, name: str, result: ManifestDifference) -> None:
    """Note labels or annotations that the manifest sets otherwise; it has no say in others."""
    have = present["metadata"].get(name) or {}
    fresh = {key: value for key, value in manifest.metadata.get(name, {}).items() if have.get(key) != value}
    if fresh:
        result.patch.setdefault("metadata", {})[name] = fresh
        result.changes.extend(
            f"metadata.{name}.{key}: {_shown(have.get(key, _MISSING))} → {_shown(value)}"
            for key, value in fresh.items()
        )


def _has_grown(kind: str, name: str, before: Any, after: Any) -> bool:
    """Tell whether a field differs in nothing but numbers in it that may be raised, and that are."""
    fields = [way.partition(".")[2] for way in GROWING.get(kind, ()) if way.partition(".")[0] == name]
    if not fields:
        return False
    raised = [(before[field], after[field]) for field in fields if before[field] != after[field]]
    return before | after == before | {field: after[field] for field in fields} and all(
        old is not None and new is not None and old < new for old, new in raised
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
