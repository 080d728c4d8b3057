# SPDX-License-Identifier: Apache-2.0
"""Structural schemas of CRDs: unknown fields are pruned, defaults filled in, and what does not fit refused.

Of the rules in CEL two kinds are known: that a value never changes, and that a text matches a pattern. The
others are checked on a real API server alone (tests/cluster/test_crds.py).
"""

from __future__ import annotations

import copy
import json
import re
from datetime import datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

Schema = dict[str, Any]
Problem = tuple[str, str, str]
"""Field, reason and sentence of a cause in a Status."""

_MATCHES = re.compile(r"^self\.matches\('(.*)'\)$", re.DOTALL)
_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
}
_SIZES = {str: ("Length", "chars long"), list: ("Items", "items"), dict: ("Properties", "properties")}
_KEPT_AT_ROOT = ("apiVersion", "kind", "metadata")


def loads(text: str | bytes) -> Any:
    """Return the value of JSON as a real server reads and writes it: whole numbers without a fraction."""

    def number(digits: str) -> float:
        value = float(digits)
        return int(value) if value.is_integer() and abs(value) < 1e21 else value

    return json.loads(text, parse_float=number)


def settled(schema: Schema, body: dict[str, Any]) -> dict[str, Any]:
    """Return an object without unknown fields and with all defaults."""
    kept = {name: body[name] for name in _KEPT_AT_ROOT if name in body}
    result: dict[str, Any] = _settled(schema, {k: v for k, v in body.items() if k not in _KEPT_AT_ROOT})
    return kept | {name: value for name, value in result.items() if name not in _KEPT_AT_ROOT}


def _settled(schema: Schema, value: Any) -> Any:
    if isinstance(value, list):
        return [_settled(schema.get("items") or {}, item) for item in value]
    if not isinstance(value, dict):
        return value
    properties = schema.get("properties") or {}
    others = schema.get("additionalProperties")
    keeps = schema.get("x-kubernetes-preserve-unknown-fields") or others is True
    result = {}
    for name, item in value.items():
        inner = properties.get(name, others if isinstance(others, dict) else None)
        if inner is None:
            if keeps:
                result[name] = item
        elif item is not None or inner.get("nullable"):
            result[name] = _settled(inner, item)
        elif "default" not in inner:
            result[name] = None
    for name, inner in properties.items():
        if name not in result and "default" in inner:
            result[name] = _settled(inner, copy.deepcopy(inner["default"]))
    return result


def problems(schema: Schema, body: dict[str, Any], before: dict[str, Any] | None = None) -> list[Problem]:
    """Return the faults of an object.

    Args:
        schema: the schema.
        body: the object, settled.
        before: what it was, where it is changed.
    """
    found: list[Problem] = []
    for name, inner in (schema.get("properties") or {}).items():
        if name in body and name not in _KEPT_AT_ROOT:
            old = None if before is None else before.get(name)
            found += _problems(inner, body[name], name, old, changed=before is not None)
    return found + [
        (name, "FieldValueRequired", "Required value")
        for name in schema.get("required") or ()
        if name not in body
    ]


def _problems(schema: Schema, value: Any, path: str, old: Any, *, changed: bool) -> Iterator[Problem]:
    if value is None and schema.get("nullable"):
        return
    wrong = _wrong_type(schema, value)
    if wrong is not None:
        word = _word(value)
        yield path, "FieldValueTypeInvalid", f'Invalid value: "{word}": {path} in body {wrong}: "{word}"'
        return
    enum = schema.get("enum")
    if enum is not None and value not in enum:
        allowed = ", ".join(json.dumps(item) for item in enum)
        shown = json.dumps(value)
        yield path, "FieldValueNotSupported", f"Unsupported value: {shown}: supported values: {allowed}"
    for wrong in (*_bounds(schema, value), *_choices(schema, value)):
        yield path, "FieldValueInvalid", f"Invalid value: {json.dumps(value)}: {path} in body {wrong}"
    for name in schema.get("required") or ():
        if isinstance(value, dict) and name not in value:
            yield f"{path}.{name}", "FieldValueRequired", "Required value"
    yield from _rules(schema, value, path, old, changed=changed)
    for name, inner, item, former in _parts(schema, value, old):
        yield from _problems(inner, item, f"{path}{name}", former, changed=changed and former is not None)


def _parts(schema: Schema, value: Any, old: Any) -> Iterator[tuple[str, Schema, Any, Any]]:
    if isinstance(value, list):
        for index, item in enumerate(value):
            yield f"[{index}]", schema.get("items") or {}, item, None
    elif isinstance(value, dict):
        others = schema.get("additionalProperties")
        for name, item in value.items():
            inner = (schema.get("properties") or {}).get(name, others)
            if isinstance(inner, dict):
                yield f".{name}", inner, item, old.get(name) if isinstance(old, dict) else None


def _wrong_type(schema: Schema, value: Any) -> str | None:
    wanted = schema.get("type")
    if schema.get("x-kubernetes-int-or-string"):
        wanted = "integer or string"
        fits = isinstance(value, int | str) and not isinstance(value, bool)
    elif wanted is None:
        return None
    else:
        fits = isinstance(value, _TYPES[wanted]) and (wanted == "boolean" or not isinstance(value, bool))
        fits = fits or (wanted == "integer" and isinstance(value, float) and value.is_integer())
    return None if fits else f"must be of type {wanted}"


def _word(value: Any) -> str:
    if value is None:
        return "null"
    return next(
        word
        for word in ("boolean", "integer", "number", "string", "array", "object")
        if isinstance(value, _TYPES[word])
    )


def _bounds(schema: Schema, value: Any) -> Iterator[str]:
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield from _numeric_bounds(schema, value)
    for kind, (suffix, what) in _SIZES.items():
        if isinstance(value, kind):
            if len(value) < schema.get(f"min{suffix}", 0):
                yield f"should be at least {schema[f'min{suffix}']} {what}"
            if len(value) > schema.get(f"max{suffix}", len(value)):
                yield f"should be at most {schema[f'max{suffix}']} {what}"
    if isinstance(value, str):
        if "pattern" in schema and not re.search(schema["pattern"], value):
            yield f"should match '{schema['pattern']}'"
        if schema.get("format") == "date-time" and not _is_time(value):
            yield f'must be of type date-time: "{value}"'


def _numeric_bounds(schema: Schema, value: float) -> Iterator[str]:
    least, most, exclusive = (schema.get(name) for name in ("minimum", "maximum", "exclusiveMinimum"))
    if least is not None and (value < least or (exclusive and value == least)):
        yield f"should be greater than {'' if exclusive else 'or equal to '}{least}"
    if most is not None and value > most:
        yield f"should be less than or equal to {most}"


def _is_time(value: str) -> bool:
    try:
        return datetime.fromisoformat(value).tzinfo is not None and "T" in value
    except ValueError:
        return False


def _choices(schema: Schema, value: Any) -> Iterator[str]:
    for word, least, most in (("anyOf", 1, None), ("oneOf", 1, 1)):
        if word in schema:
            fitting = sum(not [*_problems(one, value, "", None, changed=False)] for one in schema[word])
            if fitting < least or (most is not None and fitting > most):
                yield f"must validate one and only one schema ({word})"


def _rules(schema: Schema, value: Any, path: str, old: Any, *, changed: bool) -> Iterator[Problem]:
    for rule in schema.get("x-kubernetes-validations") or ():
        text = rule["rule"]
        pattern = _MATCHES.match(text)
        broken = changed and value != old if text == "self == oldSelf" else False
        if pattern is not None:
            broken = not re.search(pattern[1].replace("\\\\", "\\"), value)
        if broken:
            shown = json.dumps(value if isinstance(value, str) else _word(value))
            yield path, "FieldValueInvalid", f"Invalid value: {shown}: {rule['message']}"
