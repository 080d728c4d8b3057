# SPDX-License-Identifier: Apache-2.0
"""Manifests are read as kubectl reads them, and mistakes name file, line and field."""

from __future__ import annotations

import contextlib
import json
import tracemalloc
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from slamhive.model.errors import InputError, ManifestError
from slamhive.model.loading import load_file, parse, to_object

if TYPE_CHECKING:
    from pathlib import Path

RUN = """
apiVersion: slamhive.io/v1alpha1
kind: MappingRun
metadata: {name: one}
spec:
  algorithmRef: {name: a}
  datasetRef: {name: d}
"""


def _value(text: str) -> Any:
    return parse(f"key: {text}", "file.yaml")[0].value["key"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("10.0", 10),
        ("1e-3", 0.001),
        ("1e3", 1000),
        (".5", 0.5),
        ("1.", 1),
        ("+3", 3),
        ("-0.0", 0),
        ("007", 7),
        ("0o12", 10),
        ("0x1F", 31),
        ("0b101", 5),
        ("1_000", 1000),
        ("08", 8),
        ("0x", "0x"),
        ("1.2.3", "1.2.3"),
        ("12:30", "12:30"),
        ("2020-01-01", "2020-01-01"),
        ("yes", True),
        ("n", False),
        ("Off", False),
        ("~", None),
        ("", None),
        ("null", None),
        ("'1'", "1"),
        ('"true"', "true"),
        ("1e400", None),
        ("!!str 12", "12"),
    ],
)
def test_values_are_those_that_kubectl_sends(text: str, expected: Any) -> None:
    if text == "1e400":
        with pytest.raises(InputError, match=r"file\.yaml:1: inf is not a finite number"):
            _value(text)
        return
    found = _value(text)
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", "f.yaml:3: the key 'a' stands twice"),
        ("a: 1\nb:\n  - c: 1\n    c: 2\n", "f.yaml:4: the key 'c' stands twice"),
        ("a: [1\n", "f.yaml:2: not YAML"),
        ("a: .nan\n", "f.yaml:1: .nan is not a finite number"),
        ("? [1, 2]\n: 3\n", "f.yaml:1: a key must be text"),
        ("a: &x [*x]\n", "f.yaml"),
        ("<<: 3\n", "f.yaml:1: << takes a mapping"),
        ("a: " + "[" * 2000, "f.yaml"),
        (
            "a: !!python/name:os.system x",
            "f.yaml:1: the tag tag:yaml.org,2002:python/name:os.system is not supported",
        ),
        ("a: !mine x", "f.yaml:1: the tag !mine is not supported"),
        ("a: \x1f", "f.yaml: not YAML"),
        ("a: \udce4", "f.yaml: not YAML"),  # Latin-1 on a terminal that says nothing of encodings
        ('a: "\\ud800"', "f.yaml:1: half a character"),
        ("a: 0123", "f.yaml:1: 0123 is octal and means 83: write 123, 0o123 if 83 is meant, or quotes"),
        ("a: " + "9" * 5000, "f.yaml:1: an integer of 5000 characters"),
    ],
)
def test_what_is_not_a_manifest(text: str, message: str) -> None:
    with pytest.raises(ManifestError) as error:
        parse(text, "f.yaml")
    assert message in str(error.value)


def test_anchors_and_merges_work() -> None:
    (document,) = parse("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}\n", "f.yaml")
    assert document.value["b"] == {"x": 1, "y": 3}


def test_aliases_take_no_more_memory_than_their_text() -> None:
    """A deep list of wide ones: 50,000 values, each a hundred levels down."""
    wide = "b: &b [" + ",".join(["x"] * 500) + "]"
    deep = "c: " + "[" * 100 + ",".join(["*b"] * 100) + "]" * 100
    tracemalloc.start()
    try:
        parse(f"{wide}\n{deep}\n", "f.yaml")
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()


def test_aliases_of_a_long_text_are_counted_each_time() -> None:
    text = f"a: &a '{'x' * 1_000_000}'\nb: [{','.join(['*a'] * 20)}]\n"
    with pytest.raises(ManifestError, match=r"f\.yaml: its values have more than 16777216 characters"):
        parse(text, "f.yaml")


def test_a_merged_key_is_named_where_it_stands() -> None:
    (document,) = parse("a: &a\n  x: 1\nb:\n  <<: [*a]\n  y: 2\n", "f.yaml")
    assert document.where(("b", "x", "z")) == "f.yaml:2"
    assert document.where(("b", "y")) == "f.yaml:5"


def test_a_bomb_of_anchors_is_refused() -> None:
    lines = ["a0: &a0 [1,1,1,1,1,1,1,1,1,1]"]
    lines += [f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9)]
    with pytest.raises(ManifestError, match="more than 500000 values"):
        parse("\n".join(lines), "f.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("slamhive.io/v1alpha1", "slamhive.io/v2"),
            "f.yaml:2: apiVersion: found 'slamhive.io/v2', expected",
        ),
        (("MappingRun", "MapingRun"), "f.yaml:3: kind: unknown kind 'MapingRun'; did you mean 'MappingRun'?"),
        (("  datasetRef: {name: d}\n", ""), "f.yaml:5: spec.datasetRef: needed, but missing"),
        (("datasetRef", "datsetRef"), "f.yaml:7: spec.datsetRef: unknown field 'datsetRef'; did you mean"),
        (("{name: d}", "{name: D}"), "f.yaml:7: spec.datasetRef.name: expected a name of lower-case letters"),
        (
            ("{name: d}", "{name: d}\n  seed: '1'"),
            "f.yaml:8: spec.seed: must be a whole number, found '1'",
        ),
        (
            ("{name: d}", "{name: d}\n  retries: yes"),
            "f.yaml:8: spec.retries: must be a whole number",
        ),
        (("{name: d}", "{name: d}\n  timeout: 90"), "f.yaml:8: spec.timeout: must be a text"),
        (
            ("{name: d}", "{name: d}\n  timeout: 1d"),
            "f.yaml:8: spec.timeout: expected a duration such as 90s",
        ),
        (("{name: d}", "{name: d}\n  sensors: radar"), "f.yaml:8: spec.sensors: must be 'mono'"),
        (
            ("{name: d}", "{name: d}\n  input: {frameRat: 5}"),
            "unknown field 'frameRat'; did you mean 'frameRate'?",
        ),
        (
            ("{name: d}", "{name: d}\n  parameters: {a: [1]}"),
            "f.yaml:8: spec.parameters.a: must be",
        ),
    ],
)
def test_mistakes_name_line_and_field(change: tuple[str, str], message: str) -> None:
    with pytest.raises(ManifestError) as error:
        to_object(parse(RUN.replace(*change), "f.yaml")[0])
    assert message in str(error.value)


def test_all_mistakes_of_an_object_are_told() -> None:
    text = RUN + "  seed: -1\n  retries: 99\n  speed: 3\n"
    with pytest.raises(ManifestError) as error:
        to_object(parse(text, "f.yaml")[0])
    assert [line.split(": ")[0] for line in str(error.value).splitlines()] == [
        "f.yaml:8",
        "f.yaml:9",
        "f.yaml:10",
    ]


def test_a_list_whose_only_item_is_wrong_is_told_of_once() -> None:
    text = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: d}
spec:
  recording:
    synthetic: {sensors: [Camera], durationSeconds: 8}
"""
    with pytest.raises(ManifestError) as error:
        to_object(parse(text, "f.yaml")[0])
    (line,) = str(error.value).splitlines()
    assert line.startswith("f.yaml:7: spec.recording.synthetic.sensors.0: must be 'Lidar'")


def test_a_whole_quantity_may_be_a_number() -> None:
    made = to_object(parse(RUN + "  resources: {cpu: 2}\n", "f.yaml")[0])
    assert made.spec.resources.cpu == "2"  # type: ignore[union-attr]


def test_status_is_not_read() -> None:
    assert to_object(parse(RUN + "status: {phase: Whatever}\n", "f.yaml")[0]).name == "one"


def test_several_documents_and_unreadable_files(tmp_path: Path) -> None:
    file = tmp_path / "many.yaml"
    file.write_text(f"{RUN}---\n---\n{RUN.replace('one', 'two')}", encoding="utf-8")
    assert [item.name for item in load_file(file)] == ["one", "two"]
    file.write_text("# nothing\n", encoding="utf-8")
    with pytest.raises(ManifestError, match="empty; expected an object"):
        load_file(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file in UTF-8"):
        load_file(file)
    with pytest.raises(InputError, match="No such file"):
        load_file(tmp_path / "absent.yaml")


_json = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53) + 1, 2**53 - 1) | st.text(st.characters(codec="utf-8")),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(st.characters(codec="utf-8")), inner),
    max_leaves=20,
)


@given(_json)
def test_json_is_read_as_it_is(value: Any) -> None:
    (document,) = parse(json.dumps({"value": value}), "f.json")
    assert document.value == {"value": value}


@given(st.text(max_size=60))
def test_no_text_makes_a_traceback(text: str) -> None:
    with contextlib.suppress(InputError):
        for document in parse(text, "f.yaml"):
            to_object(document)


@given(st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**53) + 1, 2**53 - 1))
def test_numbers_written_by_others_are_read(value: float) -> None:
    assert _value(json.dumps(value)) == value
    assert parse(yaml.safe_dump({"key": value}), "f.yaml")[0].value["key"] == value
