# SPDX-License-Identifier: Apache-2.0
"""`slamhive results list` for people: what tells the runs apart is shown, what they share is said once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Slamhive = Callable[..., tuple[int, str, str]]
    Fill = Callable[..., Path]


def test_settings_that_vary_are_columns_and_what_is_the_same_is_said_once(
    records: Any, fill: Fill, slamhive: Slamhive
) -> None:
    home = fill([records.run(number, parameters={"nFeatures": 500 + number, "k": 1}) for number in (0, 6)])
    code, out, _ = slamhive(home, "results", "list")
    said, *table = out.splitlines()
    assert code == 0
    assert said.startswith("sweep study, algorithm algorithm-0, sensors stereo, dataset dataset-0, phase")
    heads = " ".join(table[:3]).split()
    assert "nFeatures" in heads
    assert not {"k", "parameters.nFeatures", "algorithm", "dataset"} & set(heads)
    rows = [line.split() for line in table if line.startswith("run-")]
    assert sorted((row[0], row[3]) for row in rows) == [("run-000", "500"), ("run-006", "506")]


def test_the_latest_run_stands_first_with_its_date(records: Any, fill: Fill, slamhive: Slamhive) -> None:
    days = {"run-000": "2026-11-20", "run-006": "2026-11-27", "run-012": "2026-11-24"}
    runs = [
        records.run(number, finished=f"{day}T12:00:00Z")
        for number, day in zip((0, 6, 12), days.values(), strict=True)
    ]
    home = fill([*runs, records.run(18, finished=None)])  # of the last, when it ended isn't known
    _, *table = slamhive(home, "results", "list")[1].splitlines()
    assert next(line for line in table if line.startswith("run")).split()[:2] == ["run", "finished"]
    lines = [line.split()[:2] for line in table if line.startswith("run-")]
    assert lines[:3] == [[name, days[name]] for name in ("run-006", "run-012", "run-000")]
    assert lines[3] == ["run-018", "–"]
    csv = slamhive(home, "results", "list", "--format", "csv", "--sort", "run")[1].splitlines()
    assert [line.partition(",")[0] for line in csv[1:]] == ["run-000", "run-006", "run-012", "run-018"]


def test_a_run_that_failed_says_why_where_others_have_an_outcome(
    records: Any, fill: Fill, slamhive: Slamhive
) -> None:
    home = fill([records.run(0), records.failed(6)])
    _, *table = slamhive(home, "results", "list")[1].splitlines()
    heads = " ".join(table[:3]).split()
    assert "status" in heads
    assert not {"phase", "outcome"} & set(heads)
    lines = {line.split()[0]: line.split() for line in table if line.startswith("run-")}
    assert "Tracked" in lines["run-000"]
    assert "OutOfMemory" in lines["run-006"]


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("results table", ["--rows", "nFeatures"]),
        ("results list", ["--columns", "run,nFeatures"]),
        ("results export", ["--columns", "run,nFeatures"]),
        ("paper-table", ["--rows", "nFeatures", "--style", "csv"]),
    ],
)
def test_the_last_part_of_a_columns_name_is_enough(
    records: Any, fill: Fill, slamhive: Slamhive, command: str, options: list[str]
) -> None:
    home = fill([records.run(number, parameters={"nFeatures": 500 + number}) for number in (0, 6)])
    code, out, _ = slamhive(home, *command.split(), *options)
    assert code == 0
    assert "506" in out


@pytest.mark.parametrize("form", ["json", "markdown"])
def test_an_export_written_some_rows_at_a_time_is_the_same(
    records: Any, fill: Fill, slamhive: Slamhive, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    home = fill([records.run(number) for number in range(5)])
    _, whole, _ = slamhive(home, "results", "export", "--format", form)
    monkeypatch.setattr("slamhive.cli.results._BLOCK", 2)
    code, parts, _ = slamhive(home, "results", "export", "--format", form)
    assert code == 0
    assert "run-004" in parts
    assert parts == whole


def test_one_run_has_all_columns_and_so_has_what_programs_read(
    records: Any, fill: Fill, slamhive: Slamhive
) -> None:
    home = fill([records.run(0)])
    assert "algorithm" in slamhive(home, "results", "list")[1].split()
    home = fill([records.run(0), records.run(6)])
    head = slamhive(home, "results", "list", "--format", "csv")[1].splitlines()[0]
    assert head.startswith("run,sweep,algorithm,sensors,dataset,repetition,phase,")


WILD = "a\x1b]0;title\x07 \u202eb\nc\x9bd\u2028e"


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("results list", []),
        ("results list", ["--format", "markdown"]),
        ("results list", ["--columns", f"run,parameters.{WILD},label.{WILD},dataset.attributes.{WILD}"]),
        ("results list", ["--columns", f"run,parameters.{WILD}", "--format", "csv"]),
        ("results table", ["--rows", f"parameters.{WILD}"]),
        ("results table", ["--rows", f"parameters.{WILD}", "--format", "csv"]),
        ("results table", ["--rows", f"parameters.{WILD}", "--format", "markdown"]),
        ("results export", ["--columns", f"run,label.{WILD},dataset.attributes.{WILD}"]),
        ("results export", ["--columns", f"run,label.{WILD}", "--format", "markdown"]),
        ("paper-table", ["--rows", f"parameters.{WILD}", "--style", "markdown"]),
        ("paper-table", ["--rows", f"parameters.{WILD}", "--style", "csv"]),
    ],
)
def test_names_of_columns_are_cleaned_as_cells_are(
    records: Any, fill: Fill, slamhive: Slamhive, command: str, options: list[str]
) -> None:
    def run(number: int) -> Any:
        wild = {WILD: number}
        return records.run(number, parameters=wild, labels={WILD: str(number)}, attributes=wild)

    home = fill([run(0), run(6)])
    code, out, err = slamhive(home, *command.split(), *options)
    assert code == 0, err
    assert "title" in out
    assert {sign for sign in out + err if not sign.isprintable()} == {"\n"}
    if "csv" in options:
        assert {line.count(",") for line in out.splitlines()} == {out.splitlines()[0].count(",")}


def test_settings_without_a_column_are_counted_and_a_wide_table_says_how_to_narrow_it(
    records: Any, fill: Fill, slamhive: Slamhive
) -> None:
    names = [f"knob{number:02}" for number in range(30)]
    home = fill([records.run(number, parameters=dict.fromkeys(names, 0.5 + number)) for number in (0, 6)])
    assert "24 more settings varied: --columns shows them" in slamhive(home, "results", "list")[2]
    code, out, err = slamhive(home, "results", "table")
    # One tells the rows apart: six are shown, as in the list.
    assert (code, [name for name in names if name in out]) == (0, names[:6])
    assert "24 settings left out, as rows are told apart without: --rows NAME,… shows some" in err
    assert "knob29" in slamhive(home, "results", "table", "--format", "csv")[1]
    assert (
        "columns: --rows NAME,… chooses" in slamhive(home, "results", "table", "--rows", ",".join(names))[2]
    )
    narrow = slamhive(home, "results", "table", "--rows", "algorithm,knob00")
    assert "chooses among them" not in narrow[2]
    assert " 6.5 " in narrow[1]


def test_a_spread_is_explained_where_one_stands(records: Any, fill: Fill, slamhive: Slamhive) -> None:
    home = fill([records.run(number, parameters={"knob": 0.5 + number}) for number in (0, 6)])
    for rows in ("algorithm", "algorithm,knob"):
        _, out, err = slamhive(home, "results", "table", "--rows", rows)
        assert ("±" in out) == ("a ± b: mean and standard deviation" in err) == (rows == "algorithm")


def test_settings_that_tell_rows_apart_all_have_a_column(
    records: Any, fill: Fill, slamhive: Slamhive
) -> None:
    names = [f"knob{number:02}" for number in range(9)]
    home = fill(
        [
            records.run(6 * place, parameters={name: int(name == one) for name in names})
            for place, one in enumerate(names)
        ]
    )
    _, out, err = slamhive(home, "results", "table")
    assert [name for name in names if name in out] == names[:8]  # who has none of eight has the ninth
    assert "1 setting left out, as rows are told apart without" in err


def test_whole_values_of_a_setting_stand_without_a_point(
    records: Any, fill: Fill, slamhive: Slamhive
) -> None:
    values = (0.1, 1.0, 1e9)
    home = fill([records.run(6 * place, parameters={"size": value}) for place, value in enumerate(values)])
    table = slamhive(home, "results", "table")[1].splitlines()
    assert {line.split()[0] for line in table} >= {"0.1", "1", "1000000000"}
