# SPDX-License-Identifier: Apache-2.0
"""Reading manifests as kubectl reads them, with errors that name the file, the line and the field.

Differences to PyYAML's own loader, each one a trap: ``1e-3`` is a number, ``10.0`` is ten, ``12:30``
and dates are text, a key may not stand twice, and nothing but plain values can be made.
"""

from __future__ import annotations

import json
import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import ValidationError
from yaml.composer import Composer

from slamhive.model.algorithm import Algorithm
from slamhive.model.base import API_VERSION, explain
from slamhive.model.canonical import normalize
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, ManifestError, suggestion
from slamhive.model.evaluation import Evaluation
from slamhive.model.run import MappingRun
from slamhive.model.sweep import Sweep

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pydantic_core import ErrorDetails

Kind = Algorithm | Dataset | MappingRun | Evaluation | Sweep

KINDS: dict[str, type[Kind]] = {
    "Algorithm": Algorithm,
    "Dataset": Dataset,
    "Evaluation": Evaluation,
    "MappingRun": MappingRun,
    "Sweep": Sweep,
}

_MAX_BYTES = 4 * 1024 * 1024
_MAX_NODES = 500_000
_MAX_CHARACTERS = 4 * _MAX_BYTES
_MAX_DIGITS = 400
_INT = re.compile(
    r"^[-+]?(0b_*[01][01_]*|0o_*[0-7][0-7_]*|0x_*[0-9a-fA-F][0-9a-fA-F_]*|0[0-7_]*|[1-9][0-9_]*)$"
)
_FLOAT = re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")
_WORDS: dict[str, bool | None] = (
    dict.fromkeys(("true", "True", "TRUE", "yes", "Yes", "YES", "on", "On", "ON", "y", "Y"), True)
    | dict.fromkeys(("false", "False", "FALSE", "no", "No", "NO", "off", "Off", "OFF", "n", "N"), False)
    | dict.fromkeys(("", "~", "null", "Null", "NULL"), None)
)

Path_ = tuple[str | int, ...]

_PLAIN = "plain"
_STRING = "tag:yaml.org,2002:str"
_TAGS = {_PLAIN, *(f"tag:yaml.org,2002:{name}" for name in ("int", "float", "bool", "null"))}


class _Nodes(Composer):
    """Tells plain scalars from tagged ones; what plain ones mean is decided by the reader."""

    nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        self.nodes += 1
        if self.nodes > _MAX_NODES:
            raise yaml.YAMLError(f"more than {_MAX_NODES} values")
        return super().compose_node(parent, index)

    def resolve(self, kind: Any, value: Any, implicit: Any) -> Any:
        if kind is yaml.ScalarNode and implicit[0]:
            return _PLAIN
        return super().resolve(kind, value, implicit)  # type: ignore[misc]


class _Loader(_Nodes, yaml.SafeLoader):
    """PyYAML's own parser: slow, and its sentences say what is wrong."""


_PARSER: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


class _FastLoader(_Nodes, _PARSER):  # type: ignore[misc]
    """libyaml's parser, where PyYAML has it.

    Nodes are put together in Python all the same: libyaml's own way ends the process when they are nested
    too deeply.
    """

    def __init__(self, text: str) -> None:
        _PARSER.__init__(self, text)
        Composer.__init__(self)


class _Reader:
    """Turns YAML nodes into plain values; what aliases repeat is held once and counts each time."""

    def __init__(self, source: str) -> None:
        self.source = source
        self._count = self._characters = 0
        self._scalars: dict[int, Any] = {}

    def value(self, node: yaml.Node) -> Any:
        self._count += 1
        if self._count > _MAX_NODES:
            raise ManifestError(f"{self.source}: more than {_MAX_NODES} values")
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item) for item in node.value]
        self._add(len(node.value))
        if id(node) not in self._scalars:
            self._scalars[id(node)] = self._scalar(node)
        return self._scalars[id(node)]

    def _add(self, characters: int) -> None:
        self._characters += characters
        if self._characters > _MAX_CHARACTERS:
            most = f"{_MAX_CHARACTERS} characters"
            raise ManifestError(f"{self.source}: its values have more than {most}, those of aliases repeated")

    def _mapping(self, node: yaml.MappingNode) -> dict[str, Any]:
        result: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise ManifestError(f"{self.source}:{line}: a key must be text")
            self._add(len(key_node.value))
            key = self._text(key_node)
            if _merges(key_node):
                for source in _sources(value_node):
                    extra = self.value(source)
                    if not isinstance(extra, dict):
                        raise ManifestError(f"{self.source}:{line}: << takes a mapping")
                    merged = extra | merged
                continue
            if key in result:
                raise ManifestError(f"{self.source}:{line}: the key {key!r} stands twice")
            result[key] = self.value(value_node)
        return merged | result

    def _text(self, node: yaml.Node) -> str:
        """Return a scalar's text, pairs of surrogates (as JSON escapes them) joined."""
        text = str(node.value)
        try:
            return text.encode("utf-16", "surrogatepass").decode("utf-16")
        except UnicodeDecodeError:
            line = node.start_mark.line + 1
            raise ManifestError(f"{self.source}:{line}: half a character (a lone surrogate)") from None

    def _scalar(self, node: yaml.Node) -> Any:
        text = self._text(node)
        line = node.start_mark.line + 1
        if node.tag == _STRING:
            return text
        if node.tag not in _TAGS:
            raise ManifestError(f"{self.source}:{line}: the tag {node.tag} is not supported")
        if text in _WORDS:
            return _WORDS[text]
        if _INT.match(text):
            if len(text) > _MAX_DIGITS:
                raise ManifestError(f"{self.source}:{line}: an integer of {len(text)} characters")
            return _integer(text)
        if _FLOAT.match(text):
            return normalize(float(text), f"{self.source}:{line}")
        if text.lower().lstrip("+-") in {".inf", ".nan"}:
            raise ManifestError(f"{self.source}:{line}: {text} is not a finite number")
        return text


def _integer(text: str) -> int:
    digits = text.replace("_", "")
    bare = digits.lstrip("+-")
    if len(bare) > 1 and bare.startswith("0") and bare.isdigit():
        return (-1 if digits.startswith("-") else 1) * int(bare, 8)
    return int(digits, 0)


def _merges(key: yaml.ScalarNode) -> bool:
    return key.value == "<<" and not key.style


def _sources(node: yaml.Node) -> list[yaml.Node]:
    """Return the mappings that a << names, the ones that win first."""
    return list(node.value) if isinstance(node, yaml.SequenceNode) else [node]


def _below(node: yaml.Node, part: str | int) -> tuple[yaml.Node, int] | None:
    """Return a value in a mapping or list and the line on which it is named, None where it isn't there."""
    if isinstance(node, yaml.SequenceNode):
        if isinstance(part, int) and 0 <= part < len(node.value):
            item = node.value[part]
            return item, item.start_mark.line + 1
        return None
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    for key, value in pairs:
        if key.value == part and not _merges(key):
            return value, key.start_mark.line + 1
    found = (_below(source, part) for key, value in pairs if _merges(key) for source in _sources(value))
    return next((place for place in found if place is not None), None)


class Document:
    """One YAML document; its nodes say where a field stands, when somebody asks."""

    def __init__(self, source: str, value: Any, root: yaml.Node) -> None:
        self.source = source
        self.value = value
        self._root = root

    def where(self, path: Path_) -> str:
        """Return ``file:line`` of a field, or of the nearest one around it."""
        node, line = self._root, self._root.start_mark.line + 1
        for part in path:
            below = _below(node, part)
            if below is None:
                break
            node, line = below
        return f"{self.source}:{line}"


def parse(text: str, source: str) -> list[Document]:
    """Read all documents of a YAML text.

    Raises:
        ManifestError: it is not YAML, or holds what a manifest may not.
    """
    if len(text) > _MAX_BYTES:
        raise ManifestError(f"{source}: larger than {_MAX_BYTES} bytes")
    # libyaml wants UTF-8: for what has no such form PyYAML's own parser has a sentence.
    with suppress(yaml.YAMLError, RecursionError, UnicodeEncodeError):
        return _documents(_FastLoader(text), source)
    try:
        return _documents(_Loader(text), source)
    except (yaml.YAMLError, RecursionError) as error:
        raise ManifestError(f"{source}{_problem(error)}") from None


def _documents(loader: _Loader | _FastLoader, source: str) -> list[Document]:
    documents = []
    try:
        while loader.check_node():
            node = loader.get_node()
            if node is not None and (value := _Reader(source).value(node)) is not None:
                documents.append(Document(source, value, node))
    finally:
        loader.dispose()
    return documents


def _problem(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return ": not YAML: nested too deeply"
    mark = getattr(error, "problem_mark", None)
    line = f":{mark.line + 1}" if mark is not None else ""
    return f"{line}: not YAML: {getattr(error, 'problem', None) or str(error).partition(chr(10))[0]}"


def read_text(path: Path) -> str:
    """Return a text file's content.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None


def load_file(path: Path) -> list[Kind]:
    """Return the objects of a manifest file.

    Raises:
        InputError: it cannot be read or does not follow the language.
    """
    documents = parse(read_text(path), str(path))
    if not documents:
        raise ManifestError(f"{path}: empty; expected an object with apiVersion: {API_VERSION}")
    return [to_object(document) for document in documents]


def to_object(document: Document) -> Kind:
    """Turn a document into an object of its kind.

    Raises:
        ManifestError: with one line per mistake, each with file, line, field and what is allowed.
    """
    value = document.value
    if not isinstance(value, dict):
        raise ManifestError(f"{document.where(())}: expected an object with apiVersion: {API_VERSION}")
    if value.get("apiVersion") != API_VERSION:
        where = document.where(("apiVersion",))
        raise ManifestError(
            f"{where}: apiVersion: found {value.get('apiVersion')!r}, expected {API_VERSION!r}"
        )
    kind = value.get("kind")
    if kind not in KINDS:
        hint = suggestion(str(kind), KINDS)
        raise ManifestError(f"{document.where(('kind',))}: kind: unknown kind {kind!r}{hint}")
    try:
        # JSON mode is strict about types, as an API server is, and takes words for enumerations.
        plain = json.dumps({key: item for key, item in value.items() if key != "status"})
        return KINDS[kind].model_validate_json(plain, strict=True)
    except ValidationError as error:
        lines = [_sentence(document, value, item, KINDS[kind]) for item in error.errors()]
        raise ManifestError("\n".join(dict.fromkeys(lines))) from None


def _sentence(document: Document, value: Any, error: ErrorDetails, model: type[Kind]) -> str:
    path = tuple(_real_path(value, error["loc"]))
    field = ".".join(str(part) for part in path)
    match error["type"]:
        case "extra_forbidden":
            known = _fields_at(model, path[:-1])
            text = f"unknown field {path[-1]!r}{suggestion(str(path[-1]), known)}"
        case "missing":
            text = "needed, but missing"
        case _:
            text = explain(error)
            found = error.get("input")
            if error["type"] != "value_error" and isinstance(found, str | int | float | bool | None):
                text += f", found {found!r}"
    return f"{document.where(path)}: {field}: {text}" if field else f"{document.where(path)}: {text}"


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
