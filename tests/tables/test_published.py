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
from slamhive.tables.published import BUNDLED, check_names, load_published, published_on, read_published
from slamhive.tables.verdicts import Agreement, plain_name

if TYPE_CHECKING:
    from collections.abc import Callable

PAPER = Path(__file__).parents[3] / "shared" / "data" / "icra2023" / "paper_tables.json"
ROW = {"system": "slam", "dataset": "Hall_01", "values": {"ate.rmse": 12.0}}
TABLE = {"place": "Table 1", "alignment": "Sim3", "units": {"ate.rmse": "cm"}, "rows": [ROW]}
NUMBERS = {"source": {"title": "A paper"}, "families": {"halls": ["Hall_01"]}, "tables": [TABLE]}
MINE = {
    "dataset": "hall-01",
    "algorithm": "slam",
    "sensors": "stereo",
    "alignment": "sim3",
    "keyframes": False,
    "outcome": "Tracked",
    "phase": "Succeeded",
    "status": "Tracked",
    "coverage": 0.99,
    "pathLength": 80.2,
    "ate.rmse": 0.125,
}
"""A run that is comparable with the row: within 10 %."""


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
    known = read_published(BUNDLED / "icra2023.yaml")
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


def verdict_on(written: Any, mine: list[dict[str, Any]], table: Any = None, **file: Any) -> tuple[str, str]:
    """Return the verdict on own runs beside the row, and its sentence."""
    content = {**NUMBERS, "lengths": {"Hall_01": 80.0}, "tables": [{**TABLE, **(table or {})}], **file}
    rows = [MINE | one for one in mine]
    frame = runs(**{name: [row[name] for row in rows] for name in rows[0]})
    (item,) = published_on(frame, [read_published(written(content))])
    judged = item.verdicts["ate.rmse"]
    assert item.flat()["published.ate.rmse.verdict"] == judged.sentence
    return judged.verdict, judged.sentence


def of_numbers(*numbers: float) -> list[dict[str, Any]]:
    return [{"ate.rmse": number} for number in numbers]


@pytest.mark.parametrize(
    ("mine", "row", "verdict", "words"),
    [
        (of_numbers(0.125), {}, Agreement.WITHIN, "within 10% (+4.2%)"),
        (of_numbers(0.1), {}, Agreement.BETTER, "better (-17%)"),
        (of_numbers(0.15), {}, Agreement.WORSE, "worse (+25%)"),
        (of_numbers(0.1, 0.15, 0.21), {}, Agreement.WITHIN, "within the range of 3 of own runs (+28%)"),
        (of_numbers(*[0.15] * 9, 0.11), {}, Agreement.WORSE, "worse (+22%)"),
        (of_numbers(*[0.115, 0.2] * 5), {}, Agreement.WORSE, "worse (+31%)"),
        (of_numbers(*[0.1, 0.18] * 5), {}, Agreement.WITHIN, "within the 95% interval of own runs (+17%)"),
        (of_numbers(0.15, 0.15), {}, Agreement.WORSE, "worse (+25%)"),
        (
            of_numbers(0.15),
            {"spreads": {"ate.rmse": 2.0}},
            Agreement.WITHIN,
            "within 2 of the paper's standard deviations",
        ),
        (of_numbers(0.125), {"spreads": {"ate.rmse": 0.2}}, Agreement.WORSE, "worse (+4.2%)"),
    ],
)
def test_an_own_result_is_equal_better_or_worse(
    written: Any, mine: Any, row: Any, verdict: Agreement, words: str
) -> None:
    found = verdict_on(written, mine, {"rows": [{**ROW, **row}]})
    assert found[0] == verdict
    assert words in found[1]


@pytest.mark.parametrize(
    ("mine", "table", "file", "words"),
    [
        ({"pathLength": 5.8}, {}, {}, "the ground truth here is 5.8 m long, that of Hall_01 80 m"),
        ({}, {}, {"lengths": {}}, "how long Hall_01 is isn't known"),
        ({"pathLength": None}, {}, {}, "how long the recording here is isn't known"),
        ({"alignment": "se3"}, {}, {}, "aligned by Sim3, own runs by SE3"),
        ({}, {"alignment": "SE3"}, {}, "aligned by SE3, own runs by Sim3"),
        ({}, {"alignment": None}, {}, "the alignment isn't said"),
        ({}, {"poses": "keyframes"}, {}, "measured are keyframes, here all poses"),
        ({"keyframes": True}, {"poses": "all frames"}, {}, "measured are all frames, here keyframes alone"),
        ({}, {"frame": "left camera"}, {}, "poses of the left camera are measured"),
        ({}, {"statistic": "Best", "runs": 5}, {}, "the best of 5 runs"),
        ({}, {"units": {"ate.rmse": "m"}}, {}, "more than 10 times apart; is the unit the same?"),
        ({"input.perturb.lidar.rain": 3.0}, {}, {}, "own runs had their frames changed on purpose"),
        ({"input.preparedBy": "masks"}, {}, {}, "own runs had their frames changed on purpose"),
        ({}, {"poses": "Key-frames"}, {}, "measured are Key-frames, here all poses"),
        ({}, {"poses": "only keyframes"}, {}, "measured are only keyframes, here all poses"),
        (
            {"ate.rmse": 0.5},
            {"rows": [{**ROW, "spreads": {"ate.rmse": 20.0}}]},
            {},
            "standard deviation 0.2 is larger than its 0.12; is the unit the same?",
        ),
    ],
)
def test_what_was_measured_differently_is_never_reproduced(
    written: Any, mine: Any, table: Any, file: Any, words: str
) -> None:
    """The own result is the paper's number to the digit: only what is known of both keeps them apart."""
    verdict, sentence = verdict_on(written, [{"ate.rmse": 0.12} | mine], table, **file)
    assert verdict == Agreement.NOT_COMPARABLE
    assert sentence.startswith("not comparable: ")
    assert words in sentence


@pytest.mark.parametrize(
    ("published", "own", "is_same"),
    [("5", 5.0, True), (5, "5.0", True), ("on", "On", True), (True, 1, False), ("true", True, True)],
)
def test_a_setting_is_known_however_it_is_written(
    written: Any, published: Any, own: Any, is_same: bool
) -> None:
    row = {**ROW, "parameters": {"k": published}}
    verdict, _ = verdict_on(written, [{"parameters.k": own}], {"rows": [row]})
    assert verdict == (Agreement.WITHIN if is_same else Agreement.NOT_RUN)


def test_another_system_has_no_verdict(written: Any) -> None:
    found = verdict_on(written, [{"algorithm": "slamhive"}])
    assert found == (Agreement.NOT_RUN, "no own run of slam")
    assert verdict_on(written, [{"algorithm": "slam-program"}])[0] == Agreement.WITHIN


def test_own_runs_that_failed_are_no_worse_number(written: Any) -> None:
    found = verdict_on(written, [{"outcome": "Lost", "status": "Lost"}])
    assert found == (Agreement.NOT_TRACKED, "no own run of it was tracked")
    crashed = {
        "outcome": None,
        "status": "OutOfMemory",
        "phase": "Failed",
        "pathLength": None,
        "ate.rmse": None,
    }
    assert verdict_on(written, [crashed, {"algorithm": "other"}])[0] == Agreement.NOT_TRACKED
    elsewhere = {"algorithm": "other", "pathLength": 5.8}
    assert verdict_on(written, [crashed, elsewhere])[0] == Agreement.NOT_COMPARABLE


@pytest.mark.parametrize(
    ("errors", "verdict", "sentence"),
    [
        ((0.05, 0.12, 0.19), Agreement.DIFFERS, "3 settings: 1 better, 1 within, 1 worse"),
        ((0.15, 0.2), Agreement.WORSE, "worse, all of 2 settings"),
        ((0.15, 0.15), Agreement.WORSE, "worse (+25%)"),
        ((2.0, 3.0), Agreement.NOT_COMPARABLE, "not comparable: 0.12 and 2 are more than 10 times apart"),
    ],
)
def test_settings_are_not_averaged_for_a_verdict(
    written: Any, errors: tuple[float, ...], verdict: Agreement, sentence: str
) -> None:
    found = verdict_on(written, [{"ate.rmse": one, "parameters.k": k} for k, one in enumerate(errors)])
    assert found[0] == verdict
    assert found[1].startswith(sentence)


def test_a_recording_of_another_length_is_drawn_nowhere(written: Any) -> None:
    content = {**NUMBERS, "families": {"euroc": ["MH_01_easy"]}}
    content["tables"] = [{**TABLE, "rows": [{**ROW, "dataset": "MH_01_easy"}]}]
    frame = runs(dataset=["mh-01-easy"], pathLength=[5.8])
    (item,) = published_on(frame, [read_published(written(content))])
    assert item.other == "the ground truth here is 5.8 m long, that of MH_01_easy 80.6 m"
    assert not item.is_drawn


def test_charts_show_what_was_added_and_the_rest_of_systems_that_were_run(written: Any) -> None:
    frame = runs(
        dataset=["mh-01-easy"], algorithm=["orb-slam3"], sensors=["stereo"], pathLength=[80.5], coverage=[1.0]
    )
    added = {**NUMBERS, "families": {}, "tables": [{**TABLE, "rows": [{**ROW, "dataset": "MH_01_easy"}]}]}
    found = published_on(frame, [*load_published(None), read_published(written(added))])
    drawn = {item.system for item in found if item.is_drawn}
    assert drawn == {"orb-slam3 stereo", "slam"}
    assert len(found) > 20
    assert [item.is_unrun for item in found] == sorted(item.is_unrun for item in found)


def test_the_tables_that_come_along_name_sequences_of_the_catalogue() -> None:
    for path in sorted(BUNDLED.glob("*.yaml")):
        numbers = read_published(path)
        assert check_names(numbers, path) == []
        assert path.name == "icra2023.yaml" or numbers.source.read
    rows = [(row, table) for one in load_published(None) for table in one.tables for row in table.rows]
    found = {
        (row.system, str(row.sensors)): row.values["ate.rmse"]
        for row, table in rows
        if row.dataset == "V2_02_medium" and table.statistic == "Median"
    }
    modes = {"mono": 0.029, "stereo": 0.028, "mono-inertial": 0.021, "stereo-inertial": 0.014}
    assert found == {("orb-slam3", mode): number for mode, number in modes.items()}
    assert {row.system for row, _ in rows} >= {"vins-fusion", "droid-slam", "kiss-icp", "ct-icp", "fast-lio2"}


LINES = {"column": "ate.rmse", "sequences": ["a", "b"], "lines": [{"system": "s", "numbers": [1.0, None]}]}


def test_lines_of_numbers_are_rows(written: Any) -> None:
    table = {"place": "Table 1", **LINES}
    (read,) = read_published(written({"source": {"title": "A paper"}, "tables": [table]})).tables
    row = {"system": "s", "dataset": "a", "values": {"ate.rmse": 1.0}}
    assert [one.as_json() | row for one in read.rows] == [one.as_json() for one in read.rows]
    assert {"lines", "sequences", "column"}.isdisjoint(read.as_json())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"families": {"euroc": ["MH_01_eazy"]}}, "unknown sequence 'MH_01_eazy'; did you mean 'MH_01_easy'"),
        ({"families": {"halls": ["Hal_01"]}}, "dataset 'Hall_01' is in none of the families; did you mean"),
        ({"lengths": {"Hall_1": 80}}, "lengths: unknown sequence 'Hall_1'"),
        ({"tables": [{"place": "T", **LINES, "sequences": ["a"]}]}, "numbers of s: 2 for 1 sequences"),
        ({"tables": [{"place": "T", **LINES, "column": None}]}, "lines: column and sequences say"),
        ({"lengths": {"Hall_01": -1}}, "lengths.Hall_01"),
        (
            {"families": {"halls": ["Hall_01"], "euroc": ["MH_01_easy"]}, "lengths": {"MH_01_easy": 8}},
            "lengths: MH_01_easy of euroc is 80.6 m long, not 8",
        ),
        (
            {"tables": [{**TABLE, "rows": [{**ROW, "values": {"ate.rmse": 9, "ate.mean": 12}}]}]},
            "Hall_01: ate.mean 12 is larger than ate.rmse 9, which is never smaller; were columns or units",
        ),
        (
            {"tables": [{"place": "T", **LINES, "column": "ate.rms"}]},
            "T: unknown column 'ate.rms'; did you mean 'ate.rmse'?",
        ),
        (
            {"tables": [{"place": "T", **LINES, "lines": [{"system": "s", "numbers": [-1, None]}]}]},
            "T: s on a: ate.rmse: expected a number from 0 on, found -1",
        ),
    ],
)
def test_a_table_with_a_slip_of_the_pen_is_refused(
    written: Any, changes: Any, words: str, run_command: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written({**NUMBERS, **changes})
    home = file.parent / "home"
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    code, _, err = run_command("published", "add", file)
    assert code == 2
    assert words in " ".join(err.split())
    assert not (home / "published" / file.name).exists()


@pytest.mark.parametrize("column", ["rpe[11].rmse", "health.seconds", "beside.online.rpe[0].rmse"])
def test_a_column_that_is_like_another_is_none_of_its_misspellings(written: Any, column: str) -> None:
    table = {"place": "T", **LINES, "column": column}
    assert column in read_published(written({**NUMBERS, "tables": [table]})).tables[0].rows[0].values


def test_a_family_that_may_be_misspelt_is_remarked(
    written: Any, run_command: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    code, _, err = run_command("published", "add", written({**NUMBERS, "families": {"eurok": ["Hall_01"]}}))
    assert code == 0
    assert "did you mean 'euroc'?" in err


def test_a_length_that_is_another_sequences_is_remarked(
    written: Any, run_command: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    rows = [{**ROW, "dataset": "MH_01_easy"}]
    content = {**NUMBERS, "families": {}, "lengths": {"MH_01_easy": 5.8}, "tables": [{**TABLE, "rows": rows}]}
    code, _, err = run_command("published", "add", written(content))
    assert code == 0
    assert "MH_01_easy of euroc is 80.6 m long, not 5.8; is another sequence meant?" in err


AVERAGES = """
orbslam3, Table II: orb-slam3 mono 0.041, orb-slam3 stereo 0.084, orb-slam3 mono-inertial 0.043
orbslam3, Table II: orb-slam3 stereo-inertial 0.035, vins-mono mono-inertial 0.110
orbslam3, Table II: kimera stereo-inertial 0.119
orbslam3, Table II: vins-fusion stereo-inertial 0.138, vins-fusion stereo 0.424, orb-slam2 stereo 0.044
orbslam3, Table IV: orb-slam3 mono 0.039, orb-slam3 stereo 0.068, orb-slam3 mono-inertial 0.011
orbslam3, Table IV: orb-slam3 stereo-inertial 0.009
droid-slam, Table 3: droid-slam mono 0.022
droid-slam, Table 4: droid-slam mono 0.038
droid-slam, Table 5: droid-slam stereo 0.024
basalt, Table I: basalt stereo-inertial 0.072, vins-fusion stereo-inertial 0.18, okvis stereo-inertial 0.18
basalt, Table I: vins-fusion mono-inertial 0.14, okvis mono-inertial 0.28
kiss-icp, notebook: kiss-icp lidar 0.50
pin-slam, Table III: ct-icp lidar 0.50, kiss-icp lidar 0.50, mulls lidar 0.52, f-loam lidar 0.84
pin-slam, Table III: imls-slam lidar 0.52, pin-lo lidar 0.51
pin-slam, Table IV: pin-lo lidar 2.6, pin-slam lidar 1.2, mulls lidar 1.6, suma lidar 3.1
"""
"""Means over the sequences as the papers print them."""


@pytest.mark.parametrize("line", AVERAGES.strip().splitlines())
def test_lines_have_the_means_that_the_papers_print(line: str) -> None:
    """A digit that was typed wrongly changes the mean of its line."""
    place, _, means = line.partition(": ")
    name, _, place = place.partition(", ")
    tables = [one for one in read_published(BUNDLED / f"{name}.yaml").tables if place in one.place.split(",")]
    for system, sensors, mean in map(str.split, means.split(", ")):
        numbers = [
            number
            for table in tables
            for row in table.rows
            if (row.system, row.sensors) == (system, sensors)
            for column, number in row.values.items()
            if name != "kiss-icp" or column.startswith("kitti")
        ]
        rounded = 0.6 * 10.0 ** -len(mean.partition(".")[2])
        assert sum(numbers) / len(numbers) == pytest.approx(float(mean), abs=rounded)
