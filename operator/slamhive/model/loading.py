# SPDX-License-Identifier: Apache-2.0
"""Manifests: from YAML to objects of the five kinds, with all mistakes that each has.

What is wrong in an object is taken out of it and told, and the rest is judged again: so a mistake hides no
other one, neither here nor in what is asked of the object afterwards.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from slamhive.model.algorithm import Algorithm
from slamhive.model.base import API_VERSION, explain, proposal
from slamhive.model.dataset import Dataset
from slamhive.model.errors import ManifestError, suggestion
from slamhive.model.evaluation import Evaluation
from slamhive.model.reading import Document, Path_, parse, read_documents, read_text
from slamhive.model.run import MappingRun, MappingRunSpec
from slamhive.model.sweep import IMMUTABLE, Sweep

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pydantic_core import ErrorDetails

__all__ = [
    "FROZEN",
    "GROWING",
    "KINDS",
    "Document",
    "Judged",
    "Kind",
    "judge",
    "load_file",
    "parse",
    "read_documents",
    "read_text",
    "to_object",
]

Kind = Algorithm | Dataset | MappingRun | Evaluation | Sweep

KINDS: dict[str, type[Kind]] = {
    "Algorithm": Algorithm,
    "Dataset": Dataset,
    "Evaluation": Evaluation,
    "MappingRun": MappingRun,
    "Sweep": Sweep,
}

FROZEN: dict[str, tuple[str, ...] | None] = {
    "Algorithm": None,
    "Dataset": None,
    "MappingRun": tuple(
        field.alias or name for name, field in MappingRunSpec.model_fields.items() if name != "cancel"
    ),
    "Sweep": IMMUTABLE,
}
"""Fields of a kind's spec that may not change, None for all of them."""

GROWING: dict[str, tuple[str, ...]] = {"Sweep": ("search.trials",)}
"""Numbers inside of these that may be raised all the same."""


def load_file(path: Path) -> list[Kind]:
    """Return the objects of a manifest file.

    Raises:
        InputError: it cannot be read or does not follow the language.
    """
    documents = parse(read_text(path), str(path))
    if not documents:
        raise ManifestError(empty(str(path)))
    judged = [judge(document) for document in documents]
    problems = [sentence for one in judged for sentence in one.problems]
    if problems:
        raise ManifestError("\n".join(problems))
    return [one.item for one in judged if one.item is not None]


def empty(source: str) -> str:
    """Return the complaint about a file that holds no object."""
    return f"{source}: empty; expected an object with apiVersion: {API_VERSION}"


def to_object(document: Document) -> Kind:
    """Turn a document into an object of its kind.

    Raises:
        ManifestError: with one line per mistake, each with file, line, field and what is allowed.
    """
    judged = judge(document)
    if judged.item is None or judged.problems:
        raise ManifestError("\n".join(judged.problems))
    return judged.item


_ROUNDS = 8
_GONE = object()
_NAMES = (("metadata",), ("metadata", "name"))
_Places = dict[Path_, list[int]]


@dataclass
class Judged:
    """Result of checking a document: the object that it holds, and the mistakes in it.

    Attributes:
        document: the document.
        item: the object, without what is wrong in it; None where too little is right.
        problems: a sentence for each mistake: file, line, field and what is allowed.
        lost: the fields that were taken out, as paths into the document.
        places: of lists that lost items, the numbers that the others had.
    """

    document: Document
    item: Kind | None = None
    problems: list[str] = field(default_factory=list)
    lost: list[Path_] = field(default_factory=list)
    places: _Places = field(default_factory=dict)

    @property
    def named(self) -> tuple[str, str] | None:
        """Return the kind and name that it has or would have."""
        value = self.document.value if isinstance(self.document.value, dict) else {}
        metadata = value.get("metadata")
        name = metadata.get("name") if isinstance(metadata, dict) else None
        kind = value.get("kind")
        return (kind, name) if isinstance(name, str) and isinstance(kind, str) else None


def judge(document: Document) -> Judged:
    """Return the object of a document, and all that is wrong with it."""
    value = document.value
    judged = Judged(document, problems=list(document.problems))
    if not isinstance(value, dict):
        if not document.problems:
            sentence = f"{document.where(())}: expected an object with apiVersion: {API_VERSION}"
            judged.problems.append(sentence)
        return judged
    if value.get("apiVersion") != API_VERSION:
        where = document.where(("apiVersion",))
        found = value.get("apiVersion")
        judged.problems.append(f"{where}: apiVersion: found {found!r}, expected {API_VERSION!r}")
    kind = value.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        hint = suggestion(str(kind), KINDS)
        judged.problems.append(f"{document.where(('kind',))}: kind: unknown kind {kind!r}{hint}")
        return judged
    _Judge(judged, KINDS[kind]).judge()
    return judged


class _Judge:
    """Judges one document by the model of its kind, until what is left of it is right."""

    def __init__(self, judged: Judged, model: type[Kind]) -> None:
        self._judged = judged
        self._document = judged.document
        self._model = model
        self._rest = {key: item for key, item in judged.document.value.items() if key != "status"}
        # Lines with a value that couldn't be read: what the model says of the null in its place is no news.
        self._unread = {sentence.split(": ")[0] for sentence in judged.document.problems}
        self._lost: dict[Path_, bool] = {}

    def judge(self) -> None:
        """Fill in the object and what is wrong."""
        for _ in range(_ROUNDS):
            plain = _compact(self._rest, (), self._judged.places) if self._lost else self._rest
            try:
                # JSON mode is strict about types, as an API server is, and takes words for enumerations.
                self._judged.item = self._model.model_validate_json(json.dumps(plain), strict=True)
                break
            except ValidationError as error:
                if not self._learn(plain, error.errors()):
                    break
        self._judged.lost = list(self._lost)

    def _learn(self, plain: Any, errors: list[ErrorDetails]) -> bool:
        """Tell of mistakes and take them out; tell whether the rest can be judged again."""
        told = []
        wrong: list[tuple[Path_, bool]] = []
        for error in errors:
            path = self._original(tuple(_real_path(plain, error["loc"])))
            counts_good_items = error["type"] == "too_short" and any(
                error["loc"] == other["loc"][: len(error["loc"])] for other in errors if other is not error
            )
            follows = counts_good_items or self._follows(path)
            if not follows and self._document.where(path) not in self._unread:
                told.append(_sentence(self._document, path, error, self._model))
            missing = error["type"] == "missing"
            wrong.append((path[:-1] if missing else path, error["type"] == "extra_forbidden"))
        problems = self._judged.problems
        problems += [sentence for sentence in dict.fromkeys(told) if sentence not in problems]
        # A wrong name is no reason not to look at the rest.
        unnamed = [path for path, _ in wrong if path in _NAMES]
        wrong = [(path, is_extra) for path, is_extra in wrong if path not in _NAMES]
        if unnamed:
            self._rest = self._rest | {"metadata": {"name": "unnamed"}}
        if not all(path for path, _ in wrong):
            return False
        if not self._lost:
            self._rest = json.loads(json.dumps(self._rest))
        for path, is_extra in wrong:
            self._lost[path] = is_extra
            _take_out(self._rest, path)
        return True

    def _original(self, path: Path_) -> Path_:
        """Return the path of a field before items of lists were taken out."""
        result: Path_ = ()
        for part in path:
            kept = self._judged.places.get(result)
            result = (*result, kept[part] if kept is not None and isinstance(part, int) else part)
        return result

    def _follows(self, path: Path_) -> bool:
        """Tell whether a mistake may come of what was taken out before, and is none by itself.

        An unknown field that is taken out can only be missed where it stood: it may be a known one misspelt.
        """
        return any(
            path == lost or (lost[:-1] == path if is_extra else lost[: len(path)] == path)
            for lost, is_extra in self._lost.items()
        )


def _compact(value: Any, path: Path_, places: _Places) -> Any:
    """Return a value without what was taken out; note for each list the numbers that its items had."""
    if isinstance(value, dict):
        return {key: _compact(item, (*path, key), places) for key, item in value.items()}
    if not isinstance(value, list):
        return value
    kept = [number for number, item in enumerate(value) if item is not _GONE]
    if len(kept) < len(value):
        places[path] = kept
    return [_compact(value[number], (*path, number), places) for number in kept]


def _take_out(value: Any, path: Path_) -> None:
    """Take out a field, where it isn't gone already with what was around it."""
    for part in path[:-1]:
        fits = part in value if isinstance(value, dict) else isinstance(value, list)
        value = value[part] if fits else _GONE
    if isinstance(value, dict):
        value.pop(path[-1], None)
    elif isinstance(value, list):
        value[int(path[-1])] = _GONE


def _sentence(document: Document, path: Path_, error: ErrorDetails, model: type[Kind]) -> str:
    named = ".".join(str(part) for part in path)
    match error["type"]:
        case "extra_forbidden":
            known = _fields_at(model, path[:-1])
            text = f"unknown field {path[-1]!r}{suggestion(str(path[-1]), known)}"
        case "missing":
            text = "needed, but missing"
        case _:
            text = explain(error)
            found = error.get("input")
            if error["type"] != "value_error":
                text += f", found {_found(found)}"
            text += proposal(found) if path == _NAMES[1] else ""
    return f"{document.where(path)}: {named}: {text}" if named else f"{document.where(path)}: {text}"


def _found(value: Any) -> str:
    """Return a value as a sentence shows it; of what has parts its kind alone."""
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    return repr(value)


def _real_path(value: Any, location: tuple[str | int, ...]) -> Iterator[str | int]:
    """Leave out the parts of a pydantic location that name union members rather than fields."""
    for number, part in enumerate(location):
        if isinstance(value, dict):
            if part in value or number == len(location) - 1:
                yield part
                value = value.get(str(part))
        elif isinstance(value, list) and isinstance(part, int) and part < len(value):
            yield part
            value = value[part]


def _fields_at(model: Any, path: Path_) -> list[str]:
    """Return the names of the fields that a place of a manifest may have."""
    schema = model.model_json_schema(by_alias=True)
    definitions = schema.get("$defs", {})
    current: Any = schema
    for part in path:
        current = _resolve(current, definitions)
        if isinstance(part, int):
            current = current.get("items", {})
        else:
            current = current.get("properties", {}).get(part) or current.get("additionalProperties") or {}
    current = _resolve(current, definitions)
    return list(current.get("properties", {}))


def _resolve(schema: Any, definitions: dict[str, Any]) -> Any:
    for option in schema.get("anyOf", []):
        if "$ref" in option or "properties" in option or "items" in option:
            schema = option
            break
    if "$ref" in schema:
        return definitions[schema["$ref"].rsplit("/", 1)[-1]]
    return schema
