# SPDX-License-Identifier: Apache-2.0
"""Reading YAML as kubectl reads it, with errors that name the file and the line.

Differences to PyYAML's own loader, each one a trap: ``1e-3`` is a number, ``10.0`` is ten, ``12:30``
and dates are text, a key may not stand twice, and nothing but plain values can be made. One that kubectl has
too is refused: ``0123`` would be 83.
"""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import yaml
from yaml.composer import Composer

from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError, ManifestError

if TYPE_CHECKING:
    from collections.abc import Container, Sequence
    from pathlib import Path

_MAX_BYTES = 4 * 1024 * 1024
_MAX_NODES = 500_000
_MAX_CHARACTERS = 4 * _MAX_BYTES
_MAX_DIGITS = 400
_INT = re.compile(
    r"^[-+]?(0b_*[01][01_]*|0o_*[0-7][0-7_]*|0x_*[0-9a-fA-F][0-9a-fA-F_]*|0[0-7_]*|[1-9][0-9_]*)$"
)
_ZEROS = re.compile(r"^[-+]?0[0-7_]+$")
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


class _TooMuchError(ManifestError):
    """More than a manifest may hold: reading ends."""


class _NodeReader:
    """Turns YAML nodes into plain values; what aliases repeat is held once and counts each time.

    Attributes:
        problems: a sentence for each value that can't be taken; it counts as null.
    """

    def __init__(self, source: str) -> None:
        self.source = source
        self.problems: list[str] = []
        self._count = self._characters = 0
        self._scalars: dict[int, Any] = {}

    def value(self, node: yaml.Node) -> Any:
        self._count += 1
        if self._count > _MAX_NODES:
            raise _TooMuchError(f"{self.source}: more than {_MAX_NODES} values")
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item) for item in node.value]
        self._add(len(node.value))
        if id(node) not in self._scalars:
            try:
                self._scalars[id(node)] = self._scalar(node)
            except InputError as error:
                self.problems.append(str(error))
                self._scalars[id(node)] = None
        return self._scalars[id(node)]

    def _add(self, characters: int) -> None:
        self._characters += characters
        if self._characters > _MAX_CHARACTERS:
            most = f"{_MAX_CHARACTERS} characters"
            raise _TooMuchError(f"{self.source}: its values have more than {most}, those of aliases repeated")

    def _mapping(self, node: yaml.MappingNode) -> dict[str, Any]:
        result: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        for key_node, value_node in node.value:
            try:
                key = self._key(key_node, result)
                if _merges(key_node):
                    merged = self._merged(key_node, value_node) | merged
                    continue
            except _TooMuchError:
                raise
            except ManifestError as error:
                self.problems.append(str(error))
                continue
            result[key] = self.value(value_node)
        return merged | result

    def _key(self, node: yaml.Node, taken: Container[str]) -> str:
        where = f"{self.source}:{node.start_mark.line + 1}"
        if not isinstance(node, yaml.ScalarNode):
            raise ManifestError(f"{where}: a key must be text")
        self._add(len(node.value))
        key = self._text(node)
        if key in taken:
            raise ManifestError(f"{where}: the key {key!r} stands twice")
        return key

    def _merged(self, key: yaml.Node, node: yaml.Node) -> dict[str, Any]:
        """Return the values that << takes in, the mappings that win first."""
        result: dict[str, Any] = {}
        for source in _sources(node):
            extra = self.value(source)
            if not isinstance(extra, dict):
                raise ManifestError(f"{self.source}:{key.start_mark.line + 1}: << takes a mapping")
            result = extra | result
        return result

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
            found = _integer(text)
            if _ZEROS.match(text) and found != int(text):
                raise ManifestError(
                    f"{self.source}:{line}: {text} is octal and means {found}: write {int(text)}, "
                    f"0o{text.lstrip('+-0')} if {found} is meant, or quotes around it if it is text"
                )
            return found
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
    """One YAML document; its nodes say where a field stands, when somebody asks.

    Attributes:
        source: the file.
        value: its value.
        problems: a sentence for each value in it that can't be taken, in whose place null stands.
    """

    def __init__(self, source: str, value: Any, root: yaml.Node, problems: Sequence[str] = ()) -> None:
        self.source = source
        self.value = value
        self.problems = problems
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

    def locate(self, sentence: str) -> Path_:
        """Return the field that a sentence begins with, such as ``spec.matrix[2].values[0]: …``.

        What follows its colon is followed too where it names a field below: ``spec.input: pace: …``. Keys
        may hold dots.
        """
        path: list[str | int] = []
        value, rest = self.value, sentence
        while True:
            found = _leading(value, rest)
            if found is None:
                return tuple(path)
            part, rest = found
            path.append(part)
            value = value[part]
            rest = rest.removeprefix(": ").removeprefix(".")


def _leading(value: Any, text: str) -> tuple[str | int, str] | None:
    """Return the key or index of a value that a text begins with, and the rest of the text."""
    if isinstance(value, list):
        match = _INDEX.match(text)
        if match is None or int(match[1]) >= len(value):
            return None
        return int(match[1]), text[match.end() :]
    keys = value if isinstance(value, dict) else ()
    fits = [key for key in keys if text.startswith(key) and key and text[len(key) : len(key) + 1] in _ENDS]
    key = max(fits, key=len, default=None)
    return None if key is None else (key, text[len(key) :])


_INDEX = re.compile(r"\[(\d{1,9})\]")
_ENDS = {".", "[", ":", ""}


def parse(text: str, source: str) -> list[Document]:
    """Read all documents of a YAML text.

    Raises:
        ManifestError: it is not YAML, or holds what a manifest may not; one sentence a line.
    """
    documents, problems = read_documents(text, source)
    problems = [sentence for document in documents for sentence in document.problems] + problems
    if problems:
        raise ManifestError("\n".join(problems))
    return documents


def read_documents(text: str, source: str) -> tuple[list[Document], list[str]]:
    """Read the documents of a YAML text as far as it is YAML.

    Returns:
        The documents, which keep their own problems, and a sentence if the text goes on with what isn't YAML.
    """
    if len(text) > _MAX_BYTES:
        return [], [f"{source}: larger than {_MAX_BYTES} bytes"]
    documents: list[Document] = []
    # libyaml wants UTF-8: for what has no such form PyYAML's own parser has a sentence.
    try:
        with suppress(yaml.YAMLError, RecursionError, UnicodeEncodeError):
            _read(_FastLoader(text), source, documents)
            return documents, []
        documents = []
        _read(_Loader(text), source, documents)
    except _TooMuchError as error:
        return documents, [str(error)]
    except (yaml.YAMLError, RecursionError) as error:
        return documents, [f"{source}{_problem(error)}"]
    return documents, []


def _read(loader: _Loader | _FastLoader, source: str, documents: list[Document]) -> None:
    try:
        while loader.check_node():
            node = loader.get_node()
            reader = _NodeReader(source)
            value = None if node is None else reader.value(node)
            if node is not None and (value is not None or reader.problems):
                documents.append(Document(source, value, node, list(dict.fromkeys(reader.problems))))
    finally:
        loader.dispose()


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
