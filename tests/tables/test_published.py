# SPDX-License-Identifier: Apache-2.0
"""Tests of published numbers: what is printed, which dataset is meant, why own numbers may differ."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.analysis.columns import Column
from slamhive.analysis.frame import Frame
from slamhive.model.errors import InputError
from slamhive.tables.published import load_published, plain_name, published_on, read_published

if TYPE_CHECKING:
    from collections.abc import Callable

PAPER = Path(__file__).parents[3] / "shared" / "data" / "icra2023" / "paper_tables.json"
ROW = {"system": "slam", "dataset": "Hall_01", "values": {"ate.rmse": 12.0}}
TABLE = {"place": "Table 1", "alignment": "Sim3", "units": {"ate.rmse": "cm"}, "rows": [ROW]}
NUMBERS = {"source": {"title": "A paper"}, "families": {"halls": ["Hall_01"]}, "tables": [TABLE]}


def runs(**columns: list[Any]) -> Frame:
    count = len(next(iter(columns.values())))
    return Frame({name: Column.of(values) for name, values in columns.items()}, count)


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    def write(content: Any = NUMBERS) -> Path:
        path = tmp_path / "numbers.yaml"
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
        return path

    return write


def test_the_papers_tables_are_as_printed() -> None:
    if not PAPER.is_file():
        pytest.skip(f"needs {PAPER}")
    paper = json.loads(PAPER.read_text())
    (known,) = load_published(None)
    third, fourth = known.tables
    names = {
        "ate.rmse": "ate_rmse_m",
        "usage.cpu.meanCores": "cpu_mean_cores",
        "usage.cpu.maxCores": "cpu_max_cores",
        "usage.memory.peakBytes": "memory_max_mib",
    }
    assert [
        (row.sensors, row.system, row.dataset, {names[name]: value for name, value in row.values.items()})
        for row in third.rows
    ] == [
        (row["sensors"], row["algorithm"], row["dataset"], {name: row[name] for name in names.values()})
        for row in paper["table_III"]
    ]
    names |= {"ate.rmse": "ate_rmse_cm", "rpe[0].rmse": "rpe_rmse_cm_per_m"}
    assert [
        (row.parameters["nFeatures"], {names[name]: value for name, value in row.values.items()})
        for row in fourth.rows
    ] == [(row["nFeatures"], {name: row[name] for name in names.values()}) for row in paper["table_IV"]]
    misprints = [row for table in known.tables for row in table.rows if row.notes]
    assert len(misprints) == len(paper["known_misprints"]) == 2
    assert ["0.034" in str(misprints[0].notes), "1.14" in str(misprints[1].notes)] == [True, True]


@pytest.mark.parametrize("name", ["hall-01", "Hall.01", "halls-hall-01"])
def test_a_sequence_is_known_by_its_names(written: Any, name: str) -> None:
    found = published_on(runs(dataset=[name, "other"]), [read_published(written())])
    assert [(item.dataset, item.values) for item in found] == [(name, {"ate.rmse": 0.12})]


def test_a_sequence_is_known_by_an_attribute(written: Any) -> None:
    frame = runs(**{"dataset": ["mine"], "dataset.attributes.sequence": ["HALL 01"]})
    assert [item.dataset for item in published_on(frame, [read_published(written())])] == ["mine"]
    assert published_on(runs(dataset=["hall-010"]), [read_published(written())]) == []


@pytest.mark.parametrize(("alignment", "said"), [("SE3", True), ("Sim3", False)])
def test_another_alignment_is_named(written: Any, alignment: str, said: bool) -> None:
    frame = runs(dataset=["hall-01"], alignment=[alignment])
    (item,) = published_on(frame, [read_published(written())])
    assert any("aligned by Sim3, own runs by SE3" in one for one in item.differences) is said


def test_no_column_of_a_published_row_is_one_of_own_results(written: Any) -> None:
    (item,) = published_on(runs(dataset=["hall-01"]), [read_published(written())])
    assert {name for name in item.flat() if not name.startswith("published")} == {"dataset"}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a: [", "no YAML"),
        ({**NUMBERS, "tables": []}, "tables: "),
        ({**NUMBERS, "tables": [{**TABLE, "place": ""}]}, "tables.0.place"),
        ({**NUMBERS, "tables": [{**TABLE, "units": {"ate.rmse": "ft"}}]}, "'ft' is neither a unit"),
        ({**NUMBERS, "tables": [{**TABLE, "units": {"rpe[0].rmse": "m"}}]}, "no row has the column"),
        ({**NUMBERS, "tables": [{**TABLE, "rows": [{**ROW, "score": 1}]}]}, "score"),
    ],
)
def test_what_is_no_file_of_published_numbers(written: Any, content: Any, words: str) -> None:
    with pytest.raises(InputError, match=r"numbers\.yaml") as error:
        read_published(written(content))
    assert words in str(error.value)


def test_the_documents_example_is_one(written: Any) -> None:
    text = (Path(__file__).parents[2] / "docs" / "results.md").read_text(encoding="utf-8")
    example = next(block for block in text.split("```text\n") if block.startswith("source: "))
    (item,) = published_on(
        runs(dataset=["euroc-mh-01-easy"]), [read_published(written(example.partition("```")[0]))]
    )
    assert (item.where, item.values) == ("ICRA 2024, Table 2", {"ate.rmse": pytest.approx(0.035)})


def test_names_without_case_and_punctuation() -> None:
    assert plain_name("MH_01_easy") == "mh-01-easy"


def test_files_of_the_home_are_added_and_listed(
    written: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Any
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    assert run_command("published", "add", written())[0] == 0
    code, out, _ = run_command("published", "list")
    assert code == 0
    assert "Hall_01" in out
    written({**NUMBERS, "source": {"title": "Another"}})
    code, _, err = run_command("published", "add", tmp_path / "numbers.yaml")
    assert code == 2
    assert "differs" in err
