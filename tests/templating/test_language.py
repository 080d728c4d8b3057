# SPDX-License-Identifier: Apache-2.0
"""Tests of templates in an Algorithm: what is refused when it is loaded, with its line, and its identity."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from slamhive.model.algorithm import AlgorithmSpec
from slamhive.model.errors import ManifestError
from slamhive.model.loading import parse, to_object
from slamhive.model.templates import (
    FILTERS,
    FUNCTIONS,
    TEMPLATE_LIMIT,
    TEMPLATES_LIMIT,
    TESTS,
    VALUES,
    TemplateMistake,
    read_template,
)
from slamhive.plan import algorithm_hash
from slamhive.templating.helpers import Helpers
from slamhive.templating.sandbox import Sandbox

MANIFEST = """apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: vins}
spec:
  image: example.org/vins:1
  modes: [{name: mono-inertial}]
  output: {frame: imu}
  parameters: {features: {type: Integer, default: 150}}
  files:
    - path: PATH
      template: |
        max_cnt: {{ parameters.features }}
        BODY
"""


def load(path: str = "config/vins.yaml", body: str = "") -> Any:
    return to_object(parse(MANIFEST.replace("PATH", path).replace("BODY", body), "vins.yaml")[0])


def test_a_template_is_kept_as_it_was_written() -> None:
    spec = load(body="{# n #}").spec
    assert spec.templates == [("config/vins.yaml", "max_cnt: {{ parameters.features }}\n{# n #}\n")]


@pytest.mark.parametrize(
    "path", ["/etc/passwd", "../vins.yaml", "a/../b", "a//b", "./a", ".hidden", "a b", "a/", "''"]
)
def test_a_path_that_leads_elsewhere_is_refused_with_its_line(path: str) -> None:
    with pytest.raises(ManifestError, match=r"vins.yaml:10: spec\.files\.0\.path: .*, found"):
        load(path)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("{{ parameters.feature }}", ["line 2", "unknown parameter 'feature'; did you mean 'features'?"]),
        ("{{ parameters['feature'] }}", ["line 2", "unknown parameter 'feature'"]),
        ("{{ sensor.imu }}", ["line 2", "unknown name 'sensor'; did you mean 'sensors'?"]),
        ("{{ sensors.left.topic }}", ["line 2", "unknown sensor 'left'", "camera, imu"]),
        ("{{ seed|randomly }}", ["line 2", "unknown filter 'randomly'"]),
        ("{{ seed is prime }}", ["line 2", "unknown test 'prime'"]),
        ("{{ lipsum() }}", ["line 2", "unknown name 'lipsum'"]),
        ("{% include 'x' %}", ["line 2", "'include' is not allowed: a template reads no other file"]),
        ("{% import 'x' as y %}", ["line 2", "'import' is not allowed"]),
        ("{% extends 'x' %}", ["line 2", "'extends' is not allowed"]),
        ("{{ 2 * -1e999 }}", ["line 2", "a number is too large: at most 1.797e308"]),
        ("{% set seed = 3 %}", ["line 2", "'seed' has a meaning already"]),
        ("{% macro camera() %}{% endmacro %}", ["line 2", "'camera' has a meaning already"]),
        ("{% for x in seed %}", ["line 2", "endfor"]),
        ("{{ seed", ["line 2", "unexpected end of template"]),
        ("{{ " + "(" * 3000 + "1" + ")" * 3000 + " }}", ["line 1", "nested too deeply"]),
        ("{{ " + "1" * 5000 + " }}", ["line 1", "integer"]),
    ],
)
def test_what_shows_without_a_run_is_refused_with_field_and_line(body: str, words: list[str]) -> None:
    with pytest.raises(ManifestError) as error:
        load(body=body)
    sentence = str(error.value)
    assert "files.0.template" in sentence
    assert "\n" not in sentence
    assert all(word in sentence for word in words), sentence


@pytest.mark.parametrize(
    "body",
    [
        "{% set n = namespace(x=1) %}{% set n.x = 2 %}{{ n.x }}",
        "{% for a, b in parameters.items() %}{{ loop.index }}{% endfor %}",
        "{% macro m(a) %}{{ caller() }}{{ varargs }}{% endmacro %}{% call m(1) %}x{% endcall %}",
        "{{ sensors.camera.topic }}{{ sensors['imu'].rate }}{{ transform('imu', 'camera') }}",
        "{% raw %}{{ nothing }}{% endraw %}",
    ],
)
def test_what_is_right_is_not_refused(body: str) -> None:
    load(body=body)


def spec(*files: tuple[str, str]) -> AlgorithmSpec:
    body = {"image": "x", "modes": [{"name": "lidar"}], "output": {"frame": "lidar"}}
    if files:
        body["files"] = [{"path": path, "template": text} for path, text in files]
    return AlgorithmSpec.model_validate(body)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ([("a", ""), ("a", "")], "files: each path may be used once"),
        ([("a", ""), ("a/b", "")], "'a' can't be a file and the folder of 'a/b'"),
        ([("a", "x" * (TEMPLATE_LIMIT + 1))], f"at most {TEMPLATE_LIMIT} characters"),
        ([(str(n), "é" * TEMPLATE_LIMIT) for n in range(2)], f"at most {TEMPLATES_LIMIT} are allowed"),
        ([(str(n), "") for n in range(17)], "at most 16 items"),
    ],
)
def test_files_are_few_and_small_and_apart(files: list[tuple[str, str]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        spec(*files)


def test_nothing_is_computed_when_a_template_is_read() -> None:
    # 10^10 characters: compiling it would make them.
    read_template("{{ 'a' * 10**10 }}{{ 'a'|indent(10**10) }}{{ 10**10**9 }}")


def test_the_names_that_are_checked_are_those_that_are_there(told: dict[str, Any]) -> None:
    helpers, sandbox = Helpers(told, "/r", "/r/files"), Sandbox()
    assert sorted(helpers.values()) == sorted(VALUES)
    assert sorted([*helpers.functions(), *sandbox.globals]) == sorted(FUNCTIONS)
    assert sorted(sandbox.filters) == sorted(FILTERS)
    assert sorted(sandbox.tests) == sorted(TESTS)


@pytest.mark.parametrize(
    ("template", "names", "takes_all"),
    [
        ("{{ parameters.a }}{{ parameters['b'] }}{{ seed.c }}", {"a", "b"}, False),
        ("{% for k, v in parameters.items() %}{% endfor %}", set(), True),
        ("{% set p = parameters %}{{ p.a }}", set(), True),
        ("{{ parameters[mode] }}", set(), True),
    ],
)
def test_the_parameters_that_a_template_takes_are_known(
    template: str, names: set[str], takes_all: bool
) -> None:
    found = read_template(template)
    assert (found.parameters, found.takes_all) == (names, takes_all)


def test_a_parameter_may_be_called_like_a_method() -> None:
    assert read_template("{{ parameters.items }}", {"items"}).parameters == {"items"}
    with pytest.raises(TemplateMistake, match="unknown parameter"):
        read_template("{{ parameters.pop }}", {"items"})


def test_templates_count_as_what_the_algorithm_is_and_no_files_change_nothing() -> None:
    plain = spec()
    assert "files" not in plain.as_json()
    assert (
        len({algorithm_hash(item) for item in (plain, spec(("a", "1")), spec(("a", "2")), spec(("b", "1")))})
        == 4
    )
    # As it was before there were settings files.
    assert algorithm_hash(plain) == "aa6352ae9a2985def6c0e29858e4f0d436e443a9a65a5cecd9d6f1b20b3f5745"


def test_jinja_is_loaded_where_there_are_templates_alone() -> None:
    """The evaluator's image has none, and commands begin sooner without."""
    code = "import sys; sys.modules['jinja2'] = None; import slamhive.jobs.evaluate, slamhive.model.loading"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_the_document_names_all_that_templates_have() -> None:
    document = (Path(__file__).parents[2] / "docs" / "settings-files.md").read_text(encoding="utf-8")
    assert [name for name in (*VALUES, *FUNCTIONS, "number", "quoted") if f"`{name}" not in document] == []
