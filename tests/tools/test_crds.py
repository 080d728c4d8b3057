# SPDX-License-Identifier: Apache-2.0
"""The committed CRDs are those of the models, and structural as an API server asks."""

from __future__ import annotations

import copy
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import crds
import pytest
import yaml
from crd_rules import EXTRA, LENGTHS, RULES

from slamhive.model.loading import FROZEN, KINDS, load_file
from slamhive.model.run import MappingRunSpec

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
FORBIDDEN = {"$ref", "$defs", "title", "const", "prefixItems", "definitions", "uniqueItems", "propertyNames"}
EXAMPLES = sorted([*ROOT.glob("examples/**/*.yaml"), *ROOT.glob("images/algorithms/*/algorithm.yaml")])


@cache
def _schema(kind: str) -> dict[str, Any]:
    found: dict[str, Any] = crds.definition(kind)["spec"]["versions"][0]["schema"]["openAPIV3Schema"]
    return found


def _nodes(schema: dict[str, Any], path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    yield path, schema
    for name, item in schema.get("properties", {}).items():
        yield from _nodes(item, f"{path}.{name}")
    for key in ("items", "additionalProperties"):
        if key in schema:
            yield from _nodes(schema[key], f"{path}[]")


_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "boolean": (bool,),
    "number": (int, float),
    "integer": (int,),
}


def _problems(schema: dict[str, Any], value: Any, path: str = "") -> Iterator[str]:
    """Say what an API server would: unknown fields, wrong types, missing fields, bounds, enumerations."""
    kind = schema.get("type")
    if kind is not None and (
        not isinstance(value, _TYPES[kind]) or (isinstance(value, bool) and kind != "boolean")
    ):
        yield f"{path}: {value!r} is no {kind}"
        return
    if "enum" in schema and value not in schema["enum"]:
        yield f"{path}: {value!r} not in {schema['enum']}"
    if "pattern" in schema and isinstance(value, str) and not re.search(schema["pattern"], value):
        yield f"{path}: {value!r} does not match"
    if isinstance(value, list) and not schema.get("minItems", 0) <= len(value) <= schema["maxItems"]:
        yield f"{path}: {len(value)} items"
    for number, item in enumerate(value if isinstance(value, list) else ()):
        yield from _problems(schema["items"], item, f"{path}[{number}]")
    if isinstance(value, dict):
        yield from _problems_of_fields(schema, value, path)


def _problems_of_fields(schema: dict[str, Any], value: dict[str, Any], path: str) -> Iterator[str]:
    yield from (f"{path}.{name}: missing" for name in schema.get("required", []) if name not in value)
    for name, item in value.items():
        inner = schema.get("properties", {}).get(name) or schema.get("additionalProperties")
        if inner is not None:
            yield from _problems(inner, item, f"{path}.{name}")
        elif crds.KEEP not in schema:
            yield f"{path}.{name}: unknown"


def _filled(schema: dict[str, Any], value: Any) -> Any:
    """Fill in defaults as an API server does: from outside to inside."""
    if isinstance(value, dict):
        value = {key: item for key, item in value.items() if item is not None or crds.KEEP in schema}
        for name, item in schema.get("properties", {}).items():
            if name not in value and "default" in item:
                value[name] = copy.deepcopy(item["default"])
        known = schema.get("properties", {})
        inner = schema.get("additionalProperties", {})
        return {key: _filled(known.get(key, inner), item) for key, item in value.items()}
    if isinstance(value, list):
        return [_filled(schema.get("items", {}), item) for item in value]
    return value


def test_committed_files_are_those_of_the_models() -> None:
    committed = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "crds").glob("*.yaml")}
    assert committed == crds.files(), "run: make crds"


@pytest.mark.parametrize("kind", KINDS)
def test_schemas_are_structural(kind: str) -> None:
    for path, node in _nodes(_schema(kind)):
        assert not FORBIDDEN & node.keys(), path
        free = crds.KEEP in node or "x-kubernetes-int-or-string" in node
        assert "type" in node or free, path
        assert not {"properties", "additionalProperties"} <= node.keys(), path
        assert ("items" in node) == (node.get("type") == "array"), path
        assert not ("anyOf" in node and "x-kubernetes-int-or-string" not in node), path
        assert node.get("type") != "array" or "maxItems" in node, path
        assert set(node.get("required", [])) <= set(node.get("properties", {})), path
        assert "default" not in node or node["default"] is not None, path


@pytest.mark.parametrize("kind", KINDS)
def test_defaults_are_valid_and_patterns_are_re2(kind: str) -> None:
    for path, node in _nodes(_schema(kind)):
        if "default" in node:
            assert list(_problems(node, _filled(node, node["default"]), path)) == []
        pattern = node.get("pattern", "")
        assert not re.search(r"\(\?[=!<]|\\[1-9]", pattern), path
        re.compile(pattern)


@pytest.mark.parametrize("kind", KINDS)
def test_rules_name_fields_that_there_are(kind: str) -> None:
    for path, node in _nodes(_schema(kind)["properties"]["spec"], "spec"):
        for rule in node.get("x-kubernetes-validations", []) if "properties" in node else ():
            for name in re.findall(r"\b(?:self|oldSelf)\.(\w+)", rule["rule"]):
                assert name in node["properties"], (path, rule)
            message = rule["message"].split(":")[0].split(".")[0]
            assert message in node["properties"] or message in path.split("."), (path, rule)


def test_tables_name_models_and_fields_that_there_are() -> None:
    models = {item.__name__: item for kind in KINDS.values() for item in crds._reachable(kind)}
    for name in [*RULES, *EXTRA, *LENGTHS]:
        model, _, field = name.partition(".")
        assert model in models, name
        outside = {info.alias for info in models[model].model_fields.values()}
        assert not field or field.removesuffix("[]") in outside, name
    assert set(FROZEN) <= set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_columns_lead_to_fields_and_not_through_maps(kind: str) -> None:
    root = _schema(kind)
    for column in crds.COLUMNS[kind]:
        if column["jsonPath"].startswith(".metadata"):
            continue
        node = root
        for part in re.findall(r"\w+|\[0\]", column["jsonPath"]):
            node = node["items"] if part == "[0]" else node["properties"][part]
        assert node["type"] == column["type"]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_examples_fit_the_schemas(path: Path) -> None:
    load_file(path)
    for document in yaml.safe_load_all(path.read_text(encoding="utf-8")):
        if document is not None:
            body = {key: item for key, item in document.items() if key != "metadata"}
            schema = _schema(document["kind"])
            assert list(_problems(schema, _filled(schema, body))) == []


def test_a_server_fills_in_what_the_model_does() -> None:
    spec = {
        "algorithmRef": {"name": "a"},
        "datasetRef": {"name": "d"},
        "input": {"lidar": {"rings": 8}, "rate": None},
    }
    schema = _schema("MappingRun")["properties"]["spec"]
    assert _filled(schema, spec) == MappingRunSpec.model_validate(spec).as_json()


def test_a_template_gets_no_defaults() -> None:
    template = _schema("Sweep")["properties"]["spec"]["properties"]["template"]["properties"]["spec"]
    assert "required" not in template
    assert [path for path, node in _nodes(template) if path and "default" in node] == []


def test_the_command_writes_files(tmp_path: Path) -> None:
    assert crds.main([str(tmp_path / "new")]) == 0
    assert len(list((tmp_path / "new").iterdir())) == len(KINDS)
    assert crds.main([]) == 2
