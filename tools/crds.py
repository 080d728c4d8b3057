# SPDX-License-Identifier: Apache-2.0
"""CustomResourceDefinitions, generated from the models.

``python tools/crds.py crds`` writes them; a test compares the committed files with the models.
The schemas are structural as Kubernetes asks: every node has one type, references and unions are resolved,
and values of any type are marked to be kept as they are.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, get_args

import yaml
from crd_columns import COLUMNS, Schema
from crd_rules import (
    EXTRA,
    LENGTHS,
    LIST_LENGTH,
    MAP_LENGTH,
    PATTERN_LENGTH,
    RULES,
    TEXT_LENGTH,
)
from pydantic import BaseModel

from slamhive.model.base import GROUP, NAME_LIMIT, QUANTITY_PATTERN, VERSION, meaning
from slamhive.model.loading import FROZEN, GROWING, KINDS
from slamhive.model.run import MappingRunSpec
from slamhive.model.status import KEEP, STATUSES

_SHORT = {"Algorithm": "algo", "Dataset": "dset", "Evaluation": "eval", "MappingRun": "mrun", "Sweep": "sw"}
"""Short names of the kinds, for `kubectl get`."""
_COPIED = (
    *("description", "enum", "pattern", "format"),
    *("minLength", "maxLength", "minItems", "maxItems", "minProperties", "maxProperties"),
)
_MARK = "x-kubernetes-"
_NAME_LIMIT = NAME_LIMIT
_TEXTS = {"apiVersion": "Version of the language.", "kind": "What the object is."}


class _Converter:
    """Turns the JSON schema of a model into a structural one."""

    def __init__(self, model: type[BaseModel]) -> None:
        self._model = model
        schema = model.model_json_schema(by_alias=True)
        self._definitions: dict[str, Schema] = schema.pop("$defs", {})
        self._schema = schema
        self._models = {item.__name__: item for item in _reachable(model)}

    def convert(self) -> Schema:
        """Return the schema of the model itself."""
        return self._node(self._schema | {"title": self._model.__name__}, self._model.__name__)

    def _node(self, schema: Schema, where: str) -> Schema:
        if "$ref" in schema:
            target = self._definitions[schema["$ref"].rsplit("/", 1)[-1]]
            schema = target | {key: value for key, value in schema.items() if key != "$ref"}
            schema["title"] = target["title"]
        options = [item for item in schema.get("anyOf", []) if item.get("type") != "null"]
        if len(options) == 1:
            outer = {key: value for key, value in schema.items() if key not in {"anyOf", "title"}}
            return self._node(options[0] | outer, where)
        result = {key: schema[key] for key in schema if key in _COPIED or key.startswith(_MARK)}
        if schema.get("default") is not None:
            result["default"] = schema["default"]
        if len(options) > 1 or not (schema.keys() & {"type", "const", "enum"}):
            return result | {KEEP: True, "nullable": True} | EXTRA.get(where, {})
        if "const" in schema:
            result["enum"] = [schema["const"]]
        return self._typed(schema, result, where)

    def _typed(self, schema: Schema, result: Schema, where: str) -> Schema:
        kind = schema.get("type", "string")
        result["type"] = kind
        match kind:
            case "object" if "properties" in schema:
                self._record(schema, result)
            case "object" if KEEP not in result:
                self._map(schema, result, where)
            case "array":
                result["items"] = self._node(schema.get("items", {}), f"{where}[]")
                result.setdefault("maxItems", LENGTHS.get(where, LIST_LENGTH))
            case "string" if result.get("pattern") == QUANTITY_PATTERN:
                del result["type"]
                result |= {"x-kubernetes-int-or-string": True, "maxLength": _NAME_LIMIT}
                result["anyOf"] = [{"type": "integer"}, {"type": "string"}]
                _explain_pattern(result, "type(self) == int || ")
            case "string" if "enum" not in result and "format" not in result:
                usual = PATTERN_LENGTH if "pattern" in result else TEXT_LENGTH
                result.setdefault("maxLength", LENGTHS.get(where, usual))
                _explain_pattern(result)
            case "integer":
                result["format"] = "int64"
        _bounds(schema, result)
        return result | EXTRA.get(where, {})

    def _map(self, schema: Schema, result: Schema, where: str) -> None:
        values = (
            self._node(schema["additionalProperties"], f"{where}[]") if _values_of(schema) else {KEEP: True}
        )
        if KEEP in values and "type" not in values:
            result[KEEP] = True
        else:
            result["additionalProperties"] = values
        result.setdefault("maxProperties", LENGTHS.get(where, MAP_LENGTH))

    def _record(self, schema: Schema, result: Schema) -> None:
        name = schema["title"]
        fields = {f.alias or key: f for key, f in self._models[name].model_fields.items()}
        properties: Schema = {}
        for key, item in schema["properties"].items():
            node = _special(name, key) or self._node(item, f"{name}.{key}")
            if fields[key].default_factory is not None:
                node["default"] = _default(fields[key].get_default(call_default_factory=True))
            properties[key] = node
        result["properties"] = properties
        if schema.get("required"):
            result["required"] = list(schema["required"])
        result |= EXTRA.get(name, {})
        rules = [_rule(rule, message, properties) for rule, message in RULES.get(name, ())]
        if rules:
            result["x-kubernetes-validations"] = rules


def _explain_pattern(schema: Schema, unless: str = "") -> None:
    """Say in words what a pattern asks; the pattern itself stays for other tools."""
    sentence = meaning(schema.get("pattern", ""))
    if sentence is not None:
        pattern = schema["pattern"].replace("\\", "\\\\")
        schema["x-kubernetes-validations"] = [
            {"rule": f"{unless}self.matches('{pattern}')", "message": sentence}
        ]


def _rule(rule: str, message: str, properties: Schema) -> Schema:
    """Return a rule whose error stands at the field that its message names."""
    way, _, text = message.partition(": ")
    result = {"rule": rule, "message": message}
    if way.split(".")[0] in properties:
        result["fieldPath"] = f".{way}"
    if text.startswith("needed"):
        result["reason"] = "FieldValueRequired"
    return result


def _values_of(schema: Schema) -> bool:
    return isinstance(schema.get("additionalProperties"), dict)


def _bounds(schema: Schema, result: Schema) -> None:
    for name, exclusive in (("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum")):
        if name in schema:
            result[name] = schema[name]
        elif exclusive in schema:
            result |= {name: schema[exclusive], exclusive: True}


def _default(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True, exclude_none=True)
    if isinstance(value, list | tuple):
        return [_default(item) for item in value]
    return value if not hasattr(value, "value") else str(value)


def _special(model: str, field: str) -> Schema | None:
    """Return the schema of fields that the models leave open and an API server needn't."""
    if (model, field) != ("RunTemplate", "spec"):
        return None
    spec = without_defaults(convert(MappingRunSpec))
    spec.pop("required", None)
    return spec | {"description": "Fields of a MappingRun's spec; axes set or replace them.", "default": {}}


def without_defaults(schema: Schema) -> Schema:
    """Return a schema in which nothing is filled in."""
    result: Schema = {}
    for key, value in schema.items():
        if key == "properties":
            result[key] = {name: without_defaults(item) for name, item in value.items()}
        elif key in {"items", "additionalProperties"}:
            result[key] = without_defaults(value)
        elif key == "x-kubernetes-validations":
            result[key] = [_tolerant(rule) for rule in value]
        elif key != "default":
            result[key] = value
    return result


def _tolerant(rule: Schema) -> Schema:
    """Return a rule that allows the field to be absent which its message names."""
    field = f"self.{rule['message'].split(':')[0]}"
    if field not in rule["rule"] or f"has({field})" in rule["rule"]:
        return rule
    return rule | {"rule": f"!has({field}) || {rule['rule']}"}


def _reachable(model: Any) -> set[type[BaseModel]]:
    found: set[type[BaseModel]] = set()
    waiting = [model]
    while waiting:
        item = waiting.pop()
        if isinstance(item, type) and issubclass(item, BaseModel):
            if item not in found:
                found.add(item)
                waiting.extend(field.annotation for field in item.model_fields.values())
        else:
            waiting.extend(get_args(item))
    return found


def convert(model: type[BaseModel]) -> Schema:
    """Return the structural schema of a model."""
    return _Converter(model).convert()


def _freeze(kind: str, spec: Schema) -> None:
    if kind not in FROZEN:
        return
    fields = FROZEN[kind]
    rules = spec.setdefault("x-kubernetes-validations", [])
    text = f"cannot change once created; create another {kind} with a new name"
    if fields is None:
        rules.append({"rule": "self == oldSelf", "message": f"spec: {text}"})
        return
    growing = [way.partition(".") for way in GROWING.get(kind, ())]
    for name in fields:
        inside = {field for whole, _, field in growing if whole == name}
        if not inside:
            rules.append(_same(spec, name, text))
            continue
        # Each field of it alone, so that one of them may change.
        record = spec["properties"][name]
        record.setdefault("x-kubernetes-validations", []).extend(
            _same(record, field, "may only be raised once created", "self.{0} >= oldSelf.{0}")
            if field in inside
            else _same(record, field, text)
            for field in record["properties"]
        )


def _same(record: Schema, name: str, text: str, relation: str = "self.{0} == oldSelf.{0}") -> Schema:
    """Return the rule that a field of a record is as it was, or related to that."""
    rule = relation.format(name)
    if name not in record.get("required", []):
        rule = f"has(self.{name}) == has(oldSelf.{name}) && (!has(self.{name}) || {rule})"
    return {"rule": rule, "message": f"{name}: {text}", "fieldPath": f".{name}"}


def definition(kind: str) -> Schema:
    """Return the CustomResourceDefinition of a kind."""
    model, plural = KINDS[kind], f"{kind.lower()}s"
    spec = convert(model.model_fields["spec"].annotation)  # type: ignore[arg-type]
    _freeze(kind, spec)
    schema = {
        "type": "object",
        "description": (model.__doc__ or "").strip(),
        "required": ["spec"],
        "properties": {
            "apiVersion": {"type": "string", "description": _TEXTS["apiVersion"]},
            "kind": {"type": "string", "description": _TEXTS["kind"]},
            "metadata": {"type": "object"},
            "spec": spec,
            # One value to the server's account of who wrote which field, as the operator alone writes it:
            # field by field that account is longer than the status, and goes with each answer and event.
            "status": without_defaults(convert(STATUSES[kind])) | {"x-kubernetes-map-type": "atomic"},
        },
        "x-kubernetes-validations": [
            {
                "rule": f"size(self.metadata.name) <= {_NAME_LIMIT}",
                "message": f"metadata.name: at most {_NAME_LIMIT} characters, since it becomes a label",
            }
        ],
    }
    version = {
        "name": VERSION,
        "served": True,
        "storage": True,
        "schema": {"openAPIV3Schema": schema},
        "subresources": {"status": {}},
        "additionalPrinterColumns": COLUMNS[kind],
    }
    names = {
        "kind": kind,
        "listKind": f"{kind}List",
        "plural": plural,
        "singular": kind.lower(),
        "shortNames": [_SHORT[kind]],
        "categories": ["slamhive"],
    }
    return {
        "apiVersion": "apiextensions.k8s.io/v1",
        "kind": "CustomResourceDefinition",
        "metadata": {"name": f"{plural}.{GROUP}"},
        "spec": {"group": GROUP, "names": names, "scope": "Namespaced", "versions": [version]},
    }


class _Dumper(yaml.SafeDumper):
    """Writes without anchors, so that the files are plain."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - the base class' signature
        return True


def render(kind: str) -> str:
    """Return the CustomResourceDefinition of a kind as YAML."""
    body = yaml.dump(definition(kind), Dumper=_Dumper, sort_keys=False, width=100, allow_unicode=True)
    return "# Generated by make crds; do not edit.\n" + body


def files() -> dict[str, str]:
    """Return the content of each generated file by its name."""
    return {f"{GROUP}_{kind.lower()}s.yaml": render(kind) for kind in KINDS}


def main(arguments: list[str]) -> int:
    """Write the files to a folder."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python tools/crds.py FOLDER\n")
        return 2
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files().items():
        (folder / name).write_text(content, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
