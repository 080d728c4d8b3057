# SPDX-License-Identifier: Apache-2.0
"""Schemas for editors: as the models are, taking what slamhive takes, and found from every example."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import StringConstraints, TypeAdapter, ValidationError

from slamhive.model.base import explain
from slamhive.model.errors import UnknownNameError
from slamhive.model.loading import KINDS, parse
from slamhive.model.schemas import file_name, schema, schema_names, text

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").rglob("*.yaml"))
MANIFESTS = [*EXAMPLES, *sorted((ROOT / "images" / "algorithms").glob("*/algorithm.yaml"))]
SWEEP = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: s}
spec:
  template: {spec: {datasetRef: {name: hall}, resources: {cpu: 2}, input: {frameRate: 5}}}
  matrix: [{path: algorithm, values: [a]}]
"""


@cache
def validator(name: str) -> Any:
    """Return a validator by a schema; importing it takes seconds, which every worker would spend."""
    from jsonschema import Draft7Validator

    return Draft7Validator(schema(name))


def mistakes(name: str, manifest: str) -> list[str]:
    value: Any = parse(manifest, "f.yaml")[0].value
    return [error.message for error in validator(name).iter_errors(value)]


@pytest.mark.parametrize("name", schema_names())
def test_committed_schemas_are_those_of_the_models(name: str) -> None:
    validator(name).check_schema(schema(name))
    found = (ROOT / "schemas" / file_name(name)).read_text(encoding="utf-8")
    assert found == text(name), "schemas/ is out of date; if meant: make crds"


def test_nothing_else_is_published() -> None:
    assert {path.name for path in (ROOT / "schemas").iterdir()} == set(map(file_name, schema_names()))


def patterns(value: Any) -> set[str]:
    """All patterns of a schema."""
    if isinstance(value, list):
        return set().union(*map(patterns, value))
    if not isinstance(value, dict):
        return set()
    here = {value["pattern"]} if isinstance(value.get("pattern"), str) else set()
    return here.union(*map(patterns, value.values()))


@pytest.mark.parametrize("pattern", sorted(patterns(schema("slamhive"))))
def test_mistakes_are_told_without_regular_expressions(pattern: str) -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(Annotated[str, StringConstraints(pattern=pattern)]).validate_python("")
    assert explain(caught.value.errors()[0]).startswith("expected ")


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_slamhive_takes_is_right_by_its_schema(path: Path) -> None:
    for document in parse(path.read_text(encoding="utf-8"), path.name):
        for name in (document.value["kind"], "slamhive"):
            assert not [*validator(name).iter_errors(document.value)]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_example_leads_to_its_schema(path: Path) -> None:
    manifest = path.read_text(encoding="utf-8")
    found = re.findall(r"^# yaml-language-server: \$schema=(.+)$", manifest, re.MULTILINE)
    assert len(found) == 1
    kinds = {document.value["kind"] for document in parse(manifest, path.name)}
    made = json.loads((path.parent / found[0]).read_text(encoding="utf-8"))
    assert made["title"] in kinds or len(kinds) > 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("metadata:", "metadate:"), "'metadate' was unexpected"),
        (("frameRate: 5", "framerate: 5"), "'framerate' was unexpected"),
        (("frameRate: 5", "frameRate: fast"), "'fast'"),
        (("cpu: 2", "cpu: two"), "'two'"),
        (("kind: Sweep", "kind: Sweap"), "Sweep"),
        (("v1alpha1", "v1"), "v1alpha1"),
    ],
)
@pytest.mark.parametrize("name", ["Sweep", "slamhive"])
def test_mistakes_are_mistakes_by_the_schema(name: str, change: tuple[str, str], message: str) -> None:
    assert mistakes(name, SWEEP) == []
    assert any(message in found for found in mistakes(name, SWEEP.replace(*change))) or (
        (name, change[1]) == ("slamhive", "v1")
    )


def test_a_template_needs_nothing_and_a_run_does() -> None:
    run = SWEEP.replace("Sweep", "MappingRun").partition("spec:")[0] + "spec: {seed: 1}\n"
    assert len(mistakes("MappingRun", run)) == 2


def test_kinds_are_called_as_one_likes() -> None:
    assert [schema(kind.lower())["title"] for kind in KINDS] == [*KINDS]
    with pytest.raises(UnknownNameError, match="did you mean 'Sweep'"):
        schema("sweeps")
