# SPDX-License-Identifier: Apache-2.0
"""Algorithms and Datasets as the cluster holds them, parsed once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import ValidationError

from slamhive.archive import CatalogEntry
from slamhive.kube.api.kinds import Key, Kind
from slamhive.model.algorithm import Algorithm
from slamhive.model.base import Resource, explain
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, UnknownNameError
from slamhive.plan import FixedCatalog, algorithm_hash

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.api.kinds import Object
    from slamhive.kube.store import Store

R = TypeVar("R", bound=Resource)
V = TypeVar("V")

_PARTS = ("apiVersion", "kind", "metadata", "spec")
_KEPT = 10_000


def parse(kind: type[R], body: dict[str, Any]) -> R:
    """Return an object of the API as a record of the language.

    Raises:
        InputError: it does not follow the language where the CRD could not tell; one sentence a line.
    """
    try:
        return kind.model_validate({part: body[part] for part in _PARTS if part in body})
    except ValidationError as error:
        lines = [
            f"{'.'.join(map(str, item['loc']))}: {explain(item)}, found {str(item['input'])[:100]!r}"
            for item in error.errors()
        ]
        raise InputError("\n".join(lines)) from None


class Catalogue:
    """The catalog of each namespace.

    Algorithms and Datasets never change, so what was parsed of a uid holds.
    """

    def __init__(self) -> None:
        self._parsed: dict[str, Resource | InputError] = {}
        self._hashes: dict[str, str] = {}
        self._entries: dict[str, CatalogEntry] = {}

    def algorithm(self, store: Store, namespace: str, name: str) -> Algorithm:
        """Return an Algorithm.

        Raises:
            UnknownNameError: there is none of this name.
            InputError: it is wrong.
        """
        return self._parse(Algorithm, _named(store, Kind.ALGORITHM, namespace, name))

    def dataset(self, store: Store, namespace: str, name: str) -> Dataset:
        """Return a Dataset.

        Raises:
            UnknownNameError: there is none of this name.
            InputError: it is wrong.
        """
        return self._parse(Dataset, _named(store, Kind.DATASET, namespace, name))

    def all(self, store: Store, namespace: str) -> FixedCatalog:
        """Return all of a namespace that can be used."""
        found: list[object] = []
        for kind, model in ((Kind.ALGORITHM, Algorithm), (Kind.DATASET, Dataset)):
            for body in store.of(kind, namespace):
                try:
                    found.append(self._parse(model, body))
                except InputError:
                    continue
        return FixedCatalog.of(found)

    def algorithm_hash(self, algorithm: Algorithm) -> str:
        """Return the hash of what an Algorithm says of its program."""
        uid = algorithm.metadata.uid or ""
        return _remember(self._hashes, uid, lambda: algorithm_hash(algorithm.spec))

    def entry(self, resource: Algorithm | Dataset) -> CatalogEntry:
        """Return an Algorithm or Dataset as the archive keeps it."""
        uid = resource.metadata.uid or ""
        return _remember(self._entries, uid, lambda: CatalogEntry.of(resource))

    def _parse(self, kind: type[R], body: dict[str, Any]) -> R:
        uid = body["metadata"]["uid"]
        # By uid: an object that was deleted and made anew with other contents has another one.
        found = _remember(self._parsed, uid, lambda: _attempt(kind, body))
        if isinstance(found, InputError):
            raise found
        if not isinstance(found, kind):
            raise TypeError(f"uid {uid} is a {found.kind}")
        return found


def _attempt(kind: type[R], body: dict[str, Any]) -> R | InputError:
    try:
        return parse(kind, body)
    except InputError as error:
        return InputError(f"{kind.__name__} {body['metadata']['name']!r}: {error}")


def _remember(known: dict[str, V], key: str, make: Callable[[], V]) -> V:
    if key not in known:
        # What is gone is never asked for again; to begin anew costs a parse of each that is still there.
        if len(known) >= _KEPT:
            known.clear()
        known[key] = make()
    return known[key]


def _named(store: Store, kind: Kind, namespace: str, name: str) -> Object:
    body = store.get(Key(kind, namespace, name))
    if body is None:
        known = [found["metadata"]["name"] for found in store.of(kind, namespace)]
        raise UnknownNameError(str(kind).lower(), name, known)
    return body
