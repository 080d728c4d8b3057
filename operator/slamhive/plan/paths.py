# SPDX-License-Identifier: Apache-2.0
"""Paths: the names by which a Sweep sets fields of a MappingRun's spec.

A path is kept as a tuple of keys. All that follows ``parameters.`` or a map by role, such as
``input.remap.``, is one literal key, since names of parameters may hold dots. Values are checked field by
field against the model, so that a mistake is found once in the axis and not in each of 80,000 points.
"""

from __future__ import annotations

import json
import types
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, get_args

from pydantic import TypeAdapter, ValidationError
from pydantic.alias_generators import to_camel

from slamhive.model.base import Choice, Model, explain
from slamhive.model.canonical import normalize
from slamhive.model.errors import InputError, suggestion
from slamhive.model.run import OF_ROLES, MappingRunSpec
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pydantic.fields import FieldInfo

Path = tuple[str, ...]
Settings = dict[Path, Any]

ALGORITHM: Path = ("algorithmRef", "name")
DATASET: Path = ("datasetRef", "name")
SENSORS: Path = ("sensors",)
INPUT = "input"
PACE: Path = (INPUT, "pace")
REPETITION: Path = ("repetition",)
SEED: Path = ("seed",)
PARAMETERS: Path = ("parameters",)
REMAP: Path = (INPUT, "remap")
PREPARED_BY: Path = (INPUT, "preparedBy")

_ALIASES = {"algorithm": ALGORITHM, "dataset": DATASET}
_FOR_ALL = {
    REPETITION: "the number of a repetition cannot be set; use spec.repetitions",
    ("priorityClassName",): "results don't depend on it, so combinations can't differ in it; use "
    "spec.priorityClassName",
    ("cancel",): "combinations can't be cancelled; leave them out by spec.exclude",
}
"""Fields that a Sweep's combinations cannot set, and what is there instead."""
PERTURB: Path = (INPUT, "perturb")
_BY_ROLE = (REMAP, *((*PERTURB, to_camel(name)) for name in OF_ROLES))
_MAPS = (PARAMETERS, *_BY_ROLE)
_ROLES = [str(role) for role in Role]


def _models_in(annotation: Any) -> Iterator[type[Model]]:
    options = get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    return (item for item in options if isinstance(item, type) and issubclass(item, Model))


def _walk(model: type[Model], prefix: Path = ()) -> Iterator[tuple[Path, FieldInfo]]:
    for name, field in model.model_fields.items():
        path = (*prefix, field.alias or name)
        yield path, field
        for inner in _models_in(field.annotation):
            yield from _walk(inner, path)


_FIELDS = dict(_walk(MappingRunSpec))
OBJECTS = frozenset(path[:-1] for path in _FIELDS if len(path) > 1)
"""Paths of fields that hold other fields."""
LEAVES = frozenset(_FIELDS) - OBJECTS - set(_MAPS)
"""Paths of fields that hold one value."""
KNOWN = sorted(
    [*map(".".join, LEAVES - _FOR_ALL.keys()), *_ALIASES, "parameters.NAME"]
    + [f"{'.'.join(path)}.{role}" for path in _BY_ROLE for role in _ROLES]
)
"""All paths as they are written."""


class Collected:
    """A block whose InputErrors are taken in as problems, one a line; what follows it goes on."""

    def __init__(self, problems: list[str]) -> None:
        self._problems = problems

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        if not isinstance(error, InputError):
            return False
        self._problems += str(error).splitlines()
        return True


def bounded(problems: list[str], limit: int = 20) -> list[str]:
    """Return at most so many sentences, and one that tells how many more there are."""
    more = len(problems) - limit
    return problems[:limit] + ([f"… and {more} more"] if more > 0 else [])


def written(path: Path) -> str:
    """Return a path as it is written in a manifest, without aliases."""
    return ".".join(path)


def parse_path(text: str, where: str) -> Path:
    """Return the path of a field by its written form.

    Raises:
        InputError: no MappingRun has such a field.
    """
    if text in _ALIASES:
        return _ALIASES[text]
    for prefix in _MAPS:
        start = written(prefix) + "."
        if text.startswith(start) and len(text) > len(start):
            key = text.removeprefix(start)
            if prefix in _BY_ROLE and key not in _ROLES:
                raise InputError(f"{where}: unknown role {key!r}{suggestion(key, _ROLES)}")
            return (*prefix, key)
    path = tuple(text.split("."))
    if path in _FIELDS:
        return path
    hint = "parameters.NAME" if text == "parameters." else text
    raise InputError(f"{where}: {text!r} is no field of a MappingRun's spec{suggestion(hint, KNOWN)}")


def flatten(
    fields: Mapping[str, Any],
    where: str,
    problems: list[str],
    *,
    strict: bool = False,
    lose: Callable[[str], None] = lambda _: None,
) -> Settings:
    """Return the single fields that a mapping of paths or of nested fields sets.

    Args:
        fields: field or path to value, such as ``{"parameters.a": 1, "input": {"pace": "Lockstep"}}``.
        where: the field that holds the mapping, for sentences about mistakes.
        problems: receives one sentence for each mistake.
        strict: whether nesting and outside names alone are allowed, as in a manifest of a MappingRun.
        lose: told of each key that sets nothing for a mistake.
    """
    result: Settings = {}
    for key, value in fields.items():
        before = len(problems)
        found: Settings = {}
        with Collected(problems):
            path = _parse_key(key, f"{where}.{key}", strict=strict)
            found = _assign(path, value, f"{where}.{key}", problems, strict=strict)
        if len(problems) > before:
            lose(key)
        twice = sorted(found.keys() & result.keys())
        problems.extend(f"{where}.{key}: sets {written(path)} a second time" for path in twice)
        result |= found
    return result


def _parse_key(key: str, where: str, *, strict: bool) -> Path:
    outside = [path[0] for path in _FIELDS if len(path) == 1]
    if strict and key not in outside:
        raise InputError(f"{where}: unknown field {key!r}{suggestion(key, outside)}")
    return parse_path(key, where)


def assign(path: Path, value: Any, where: str) -> Settings:
    """Return the single fields that a value sets at a path, checked and normalised.

    Raises:
        InputError: the value doesn't fit the field; one sentence a line.
    """
    problems: list[str] = []
    result = _assign(path, value, where, problems, strict=False)
    if problems:
        raise InputError("\n".join(problems))
    return result


def field_type(path: Path) -> Any:
    """Return the type of a single field of the spec."""
    if path[:-1] in _MAPS:
        return get_args(_FIELDS[path[:-1]].annotation)[1]
    return _FIELDS[path].annotation


def sets_one_field(path: Path) -> bool:
    """Tell whether a value at a path sets that field alone, and not those of an object or a map."""
    return path not in OBJECTS and path not in _MAPS


def _assign(path: Path, value: Any, where: str, problems: list[str], *, strict: bool) -> Settings:
    if sets_one_field(path):
        with Collected(problems):
            if path in _FOR_ALL and not strict:
                raise InputError(f"{where}: {_FOR_ALL[path]}")
            return {path: check(path, value, where)}
        return {}
    if not isinstance(value, dict):
        problems.append(f"{where}: {written(path)} takes a mapping of fields, found {value!r}")
        return {}
    result: Settings = {}
    for key, item in value.items():
        with Collected(problems):
            inner = parse_path(f"{written(path)}.{key}", f"{where}.{key}")
            if path not in _MAPS and inner[: len(path) + 1] != (*path, key):
                raise InputError(f"{where}.{key}: write nested fields one below the other")
            result |= _assign(inner, item, f"{where}.{key}", problems, strict=False)
    return result


@cache
def _adapter(path: Path) -> TypeAdapter[Any]:
    if path[:-1] in _MAPS:
        return TypeAdapter(get_args(_FIELDS[path[:-1]].annotation)[1])
    field = _FIELDS[path]
    constrained: Any = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
    return TypeAdapter(constrained)


def check(path: Path, value: Any, where: str) -> Any:
    """Return the value of a single field as plain normalised JSON.

    Raises:
        InputError: the value has the wrong type or is out of bounds.
    """
    plain = normalize(value, where)
    adapter = _adapter(path)
    try:
        valid = adapter.validate_json(json.dumps(plain), strict=True)
    except ValidationError as error:
        raise InputError(f"{where}: {_mistake(path, plain, error)}") from None
    return normalize(adapter.dump_python(valid, mode="json"), where)


def _mistake(path: Path, value: Any, error: ValidationError) -> str:
    words = _words(_FIELDS[path].annotation) if path in _FIELDS else []
    if words and isinstance(value, str):
        return f"unknown value {value!r}{suggestion(value, words)}"
    if path[:-1] == PARAMETERS:
        return f"a parameter is a number, a text, true, false or null, found {value!r}"
    first = error.errors()[0]
    return f"{explain(first)}, found {value!r}"


def _words(annotation: Any) -> list[str]:
    options = get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    return [
        str(word) for item in options if isinstance(item, type) and issubclass(item, Choice) for word in item
    ]
