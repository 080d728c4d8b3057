# SPDX-License-Identifier: Apache-2.0
"""Manifests to submit to a cluster: from files, from standard input, and from the catalog."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.kube.kinds import Kind, Object
from slamhive.model.base import API_VERSION
from slamhive.model.errors import InputError, ManifestError
from slamhive.model.loading import parse, read_text, to_object

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from slamhive.model.base import Resource


STDIN = "-"


@dataclass(frozen=True)
class Manifest:
    """An object to be in a cluster.

    Attributes:
        kind: its kind.
        item: the object as a record of the language.
        spec: its spec as it was written.
        source: where it stands, for sentences about it.
        from_catalog: whether nobody gave it: what was given names it.
    """

    kind: Kind
    item: Resource
    spec: Object
    source: str
    from_catalog: bool = False

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
        """Return what is sent."""
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
    return Manifest(Kind(item.kind), item, spec, source, from_catalog=True)


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
