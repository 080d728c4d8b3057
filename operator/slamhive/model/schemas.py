# SPDX-License-Identifier: Apache-2.0
"""JSON Schemas of the five kinds, for editors: completion, descriptions and mistakes while one types.

``python -m slamhive.model.schemas schemas/`` writes them; a test compares the committed files with the
models. They say less than slamhive does: rules between fields and what the catalog allows are
``slamhive validate``'s.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from slamhive.model.base import API_VERSION, QUANTITY_PATTERN
from slamhive.model.errors import UnknownNameError
from slamhive.model.loading import KINDS
from slamhive.model.run import MappingRunSpec

Schema = dict[str, Any]

DRAFT = "http://json-schema.org/draft-07/schema#"
"""The draft that editors read best."""
ANY = "slamhive"
"""Name of the schema that takes an object of any kind."""
_TEMPLATE = "RunTemplate"
_PARTIAL = "FieldsOfARun"


def schema_names() -> list[str]:
    """Return the names of all schemas: those of the kinds, and the one for all of them."""
    return [*KINDS, ANY]


def file_name(name: str) -> str:
    """Return the name of a schema's file."""
    return f"{name.lower()}.json"


def schema(name: str) -> Schema:
    """Return the JSON Schema of a kind, or the one that takes any of them.

    Args:
        name: a kind, in capitals or not, or ``slamhive``.

    Raises:
        UnknownNameError: there is no such kind.
    """
    known = {one.lower(): one for one in schema_names()}
    if name.lower() not in known:
        raise UnknownNameError("kind", name, schema_names(), "KIND")
    kind = known[name.lower()]
    return {"$schema": DRAFT} | (_any() if kind == ANY else _kind(kind))


def text(name: str) -> str:
    """Return a schema as it stands in its file."""
    return json.dumps(schema(name), indent=1, ensure_ascii=False) + "\n"


def editor_line(place: str) -> str:
    """Return the first line of a manifest that tells an editor where its schema is."""
    return f"# yaml-language-server: $schema={place}\n"


def _kind(kind: str) -> Schema:
    made = KINDS[kind].model_json_schema(by_alias=True)
    definitions = made["$defs"]
    if _TEMPLATE in definitions:
        partial = MappingRunSpec.model_json_schema(by_alias=True)
        definitions |= partial.pop("$defs")
        # Axes may set what a run needs, so a template needs nothing.
        definitions[_PARTIAL] = {key: item for key, item in partial.items() if key != "required"}
        spec = definitions[_TEMPLATE]["properties"]["spec"]
        definitions[_TEMPLATE]["properties"]["spec"] = {
            "$ref": f"#/$defs/{_PARTIAL}",
            "description": spec["description"],
        }
    made = dict(_plain(made))
    made["properties"]["apiVersion"] = {"const": API_VERSION, "description": "Version of the language."}
    made["properties"]["kind"] = {"const": kind, "description": "What the object is."}
    made["properties"]["status"] = {"description": "What a cluster writes; it is not read."}
    made["required"] = ["apiVersion", "kind", *made["required"]]
    made["definitions"] = made.pop("$defs")
    return made | {"title": kind, "description": KINDS[kind].__doc__ or kind}


def _any() -> Schema:
    """Return a schema that chooses by ``kind``, so that an editor tells the mistakes of that kind alone."""
    chosen = []
    definitions: Schema = {}
    for kind in KINDS:
        definitions[kind] = _below(_kind(kind), kind)
        condition = {"properties": {"kind": {"const": kind}}, "required": ["kind"]}
        chosen.append({"if": condition, "then": {"$ref": f"#/definitions/{kind}"}})
    return {
        "title": "SLAM Hive",
        "description": "An object of any kind.",
        "type": "object",
        "required": ["apiVersion", "kind"],
        "properties": {"kind": {"enum": list(KINDS)}},
        "allOf": chosen,
        "definitions": definitions,
    }


def _plain(node: Any) -> Any:
    """Return a schema in the draft's words; quantities may be whole numbers, titles of fields go."""
    if isinstance(node, list):
        return [_plain(item) for item in node]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        rest = {key: _plain(item) for key, item in node.items() if key not in {"$ref", "default"}}
        reference = {"$ref": node["$ref"].replace("#/$defs/", "#/definitions/")}
        # In this draft nothing beside a reference counts.
        return {**rest, "allOf": [reference]} if rest else reference
    if node.get("pattern") == QUANTITY_PATTERN:
        rest = {key: item for key, item in node.items() if key not in {"pattern", "type", "title"}}
        choices = [{"type": "integer", "minimum": 0}, {"type": "string", "pattern": QUANTITY_PATTERN}]
        return {**rest, "anyOf": choices}
    return {
        key: {name: _plain(item) for name, item in value.items()}
        if key in {"properties", "$defs"}
        else value
        if key in {"default", "examples", "enum", "const"}
        else _plain(value)
        for key, value in node.items()
        if key != "title"
    }


def _below(node: Any, kind: str) -> Any:
    """Return a schema for a place below ``definitions`` of another one."""
    if isinstance(node, list):
        return [_below(item, kind) for item in node]
    if not isinstance(node, dict):
        return node
    place = f"#/definitions/{kind}/definitions/"
    return {
        key: value.replace("#/definitions/", place) if key == "$ref" else _below(value, kind)
        for key, value in node.items()
    }


def write(folder: Path, names: list[str]) -> list[Path]:
    """Write schemas into a folder, and return their files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / file_name(name) for name in names]
    for name, path in zip(names, files, strict=True):
        path.write_text(text(name), encoding="utf-8")
    return files


if __name__ == "__main__":
    write(Path(sys.argv[1]), schema_names())
