# SPDX-License-Identifier: Apache-2.0
"""Tests of settings files on a workstation: what the program finds, what is kept, what fails and how."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.conformance.checking import parameters as parameter_findings
from slamhive.conformance.findings import CheckAnswer
from slamhive.local.home.catalog import AlgorithmEntry
from slamhive.local.home.parameters import parameter_uses
from slamhive.local.running.configuring import rendered_for
from slamhive.model.algorithm import Algorithm
from slamhive.model.errors import InputError
from slamhive.model.results import Phase, Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import RunRecord

TEMPLATE = """number: {{ 100 // parameters.number }}
topic: {{ sensors.lidar.topic|quoted }}
recording: {{ paths.recording|quoted }}
here: {{ paths.files|quoted }}
seed: {{ seed }}
mode: {{ mode }}
"""


def reader(workshop: Workshop, template: str = TEMPLATE, path: str = "config/reader.yaml") -> None:
    """Put an actor with a settings file into the catalog."""
    actor = workshop.algorithm("actor")
    body = actor.algorithm.as_json()
    body["metadata"]["name"] = "reader"
    body["spec"] |= {"files": [{"path": path, "template": template}]}
    workshop.algorithm_entries["reader"] = AlgorithmEntry(Algorithm.model_validate(body), actor.folder)


@pytest.fixture
def run_reader(workshop: Workshop, run_acts: Callable[..., Any]) -> Callable[..., RunRecord]:
    """Runs an act of an actor that has a settings file, and returns its record."""

    def run(
        act: str = "settings", template: str = TEMPLATE, name: str = "acts", **parameters: Any
    ) -> RunRecord:
        reader(workshop, template)
        fields = {"algorithmRef": {"name": "reader"}, "parameters": parameters}
        _, notes = run_acts([act], template=fields, name=name)
        (record,) = notes.records
        assert isinstance(record.phase, Phase)
        return record  # type: ignore[no-any-return]

    return run


def test_the_program_finds_its_settings_and_they_stay_with_the_run(
    run_reader: Callable[..., RunRecord],
) -> None:
    record = run_reader(number=4)
    assert record.phase is Phase.SUCCEEDED, record.log_tail
    run = Path(record.folder or "") / "run"
    seen = run / "output" / "seen" / "config" / "reader.yaml"
    kept = run / "files" / "config" / "reader.yaml"
    assert kept.read_text() == seen.read_text()
    assert kept.stat().st_mode & 0o222 == 0
    assert yaml.safe_load(kept.read_text()) == {
        "number": 25,
        "topic": "/points",
        "recording": str(run / "dataset" / "recording.bag"),
        "here": str(run / "files"),
        "seed": 1,
        "mode": "lidar",
    }


def test_settings_that_can_not_be_rendered_fail_the_run_with_field_and_line(
    run_reader: Callable[..., RunRecord],
) -> None:
    record = run_reader(number=0)
    assert (record.phase, record.reason) == (Phase.FAILED, Reason.INVALID_PARAMETERS)
    assert record.message == (
        "algorithm 'reader': files.0.template (config/reader.yaml): line 1: division by zero"
    )
    assert record.attempts == 1


def test_another_template_is_another_experiment(run_reader: Callable[..., RunRecord]) -> None:
    first = run_reader(number=4, name="first")
    same = run_reader(number=4, name="same")
    other = run_reader(number=4, name="other", template=TEMPLATE + "more: 1\n")
    assert same.provenance.reused_from == first.name
    assert other.provenance.reused_from is None
    assert other.provenance.content_hash != first.provenance.content_hash


def test_what_is_rendered_for_people_is_what_a_run_reads(
    bench: Workbench, workshop: Workshop, run_reader: Callable[..., RunRecord]
) -> None:
    record = run_reader(number=4)
    (file,) = rendered_for(bench, "reader", "tiny", {"number": 4}, None)
    run = Path(record.folder or "") / "run"
    kept = (run / "files" / file.path).read_text()
    assert file.text == kept.replace(str(run), "/slamhive")


@pytest.mark.parametrize(
    ("name", "dataset", "parameters", "words"),
    [
        ("reader", "tinny", {}, "unknown dataset 'tinny'; did you mean 'tiny'?"),
        ("actor", "tiny", {}, "algorithm 'actor' has no settings files"),
        ("reader", "tiny", {"numbr": 1}, "parameters.numbr"),
        ("reader", "tiny", {"number": -1}, "parameters.number: -1 is below the minimum"),
        ("reader", "tiny", {"number": 0}, "line 1: division by zero"),
    ],
)
def test_what_can_not_be_rendered_for_people_is_a_sentence(
    name: str, dataset: str, parameters: dict[str, Any], words: str, bench: Workbench
) -> None:
    reader(bench.workshop)
    with pytest.raises(InputError) as error:
        rendered_for(bench, name, dataset, parameters, None)
    assert words in str(error.value)


def entry(folder: Path, adapter: str | None, template: str = "") -> AlgorithmEntry:
    """Return an algorithm with two parameters, and an adapter or an image alone."""
    program: dict[str, Any] = {"image": "example.org/x:1"} if adapter is None else {"local": {}}
    if adapter is not None:
        (folder / "adapter.py").write_text(adapter)
    parameters = {name: {"type": "Number", "default": 1} for name in ("size", "range.max")}
    spec = {"modes": [{"name": "lidar"}], "output": {"frame": "lidar"}, "parameters": parameters, **program}
    if template:
        spec["files"] = [{"path": "a.yaml", "template": template}]
    body = {"metadata": {"name": "x"}, "spec": spec}
    return AlgorithmEntry(Algorithm.model_validate(body), folder)


@pytest.mark.parametrize(
    ("adapter", "template", "unused", "answer"),
    [
        ("", "", ["range.max", "size"], CheckAnswer.FAIL),
        ("x = p['size']\ny = p['range.max']", "", [], CheckAnswer.PASS),
        ("x = p['sizes']; y = p['rangeXmax']", "", ["range.max", "size"], CheckAnswer.FAIL),
        ("x = p['size']", "{{ parameters['range.max'] }}", [], CheckAnswer.PASS),
        ("", "{{ parameters.size }}", ["range.max"], CheckAnswer.FAIL),
        ("", "{% for k, v in parameters.items() %}{{ k }}: {{ v }}{% endfor %}", [], CheckAnswer.PASS),
        ("f(**config['parameters'])", "", ["range.max", "size"], CheckAnswer.WARNING),
        ("for k in config['parameters'].items(): pass", "", ["range.max", "size"], CheckAnswer.WARNING),
        (None, "{{ parameters.size }}", ["range.max"], CheckAnswer.WARNING),
        (None, "{{ parameters.size }}{{ parameters['range.max'] }}", [], CheckAnswer.PASS),
    ],
)
def test_a_parameter_that_nothing_reads_is_found(
    adapter: str | None, template: str, unused: list[str], answer: CheckAnswer, tmp_path: Path
) -> None:
    item = entry(tmp_path, adapter, template)
    assert parameter_uses(item).unused == unused
    (finding,) = parameter_findings(item)
    assert finding.answer is answer
    assert all(name in finding.found for name in unused)


def test_programs_beside_the_adapter_and_broken_files_are_looked_at(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "more.py").write_text("parameter('size'), parameter('range.max')")
    (tmp_path / "broken.py").write_bytes(b"\xff\xfe")
    (tmp_path / "pipe.py").symlink_to("/dev/zero")
    assert parameter_uses(entry(tmp_path, "import more")).unused == []


def test_the_bundled_algorithms_use_what_they_declare(bench: Workbench) -> None:
    from slamhive.local.home.catalog import load_workshop

    found = {name: parameter_uses(item) for name, item in load_workshop().algorithm_entries.items()}
    assert json.dumps({name: uses.unused for name, uses in found.items() if uses.unused}) == "{}"
    assert len(found) >= 8
