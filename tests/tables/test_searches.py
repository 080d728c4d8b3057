# SPDX-License-Identifier: Apache-2.0
"""Story of a search: what it tried, where each setting stands, what was best when, and what matters."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from searched import ERROR, fill_search, searched, sweep_of
from slamhive.analysis.grouping import aggregate, without_chosen
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.searches.seen import records_frame
from slamhive.archive import Archive, CatalogEntry, SweepRecord
from slamhive.cli.main import main
from slamhive.figures.asking import FigureKind, Wish
from slamhive.figures.searches import search
from slamhive.model.errors import InputError
from slamhive.model.search import choosing_method
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, Plan
from slamhive.tables.reading import read_table
from slamhive.tables.searches import LEAST_TRIALS, plan_of, story_of, tell

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.tables.searches import SearchStory


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home with a finished search of one objective, one of two, and one under way."""
    folder = tmp_path_factory.mktemp("searched")
    with Archive.open(f"sqlite:///{folder / 'archive.sqlite'}") as archive:
        fill_search(archive, sweep_of("tune"), known=3)
        fill_search(archive, sweep_of("front", 2, 24))
        fill_search(archive, sweep_of("live"), most_runs=20)
    return folder


@pytest.fixture(scope="module")
def told(home: Path) -> Callable[[str], SearchStory]:
    url = f"sqlite:///{home / 'archive.sqlite'}"
    frame = read_table(url).frame
    with Archive.open(url, read_only=True) as archive:
        records = {one.name: one for one in archive.sweeps()}
    return lambda name: story_of(records[name], frame)


def run(
    capsys: pytest.CaptureFixture[str], home: Path, monkeypatch: Any, *words: str
) -> tuple[int, str, str]:
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    monkeypatch.setattr("sys.argv", ["slamhive", *words])
    try:
        main()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    out = capsys.readouterr()
    return code, out.out, out.err


def test_the_best_is_the_least_of_those_with_all_runs(told: Any) -> None:
    story = told("tune")
    complete = [trial for trial in story.trials if trial.is_complete and not trial.failed]
    (best,) = story.best
    assert story.trials[best].figures == min(trial.figures for trial in complete)
    assert story.trials[best].values["parameters.voxelSize"] == pytest.approx(0.5, rel=0.3)
    assert (story.is_over, story.to_come, story.spared, story.ended - story.computed) == (True, 0, 3, 3)
    assert story.averaged == "the mean over 2 values of dataset, of each the mean of 2 runs"


def test_the_curve_never_rises_and_ends_at_the_best(told: Any) -> None:
    story = told("tune")
    heights = [story.trials[step.best[0]].figures[0] for step in story.history]
    assert heights == sorted(heights, reverse=True)
    runs = [step.runs for step in story.history]
    assert runs == sorted(set(runs))
    assert runs[-1] <= story.computed


def test_of_a_front_none_is_better_in_both(told: Any) -> None:
    story = told("front")
    front = [story.trials[number].figures for number in story.best]
    assert len(front) > 1
    assert front == sorted(front)
    assert [cost for _, cost in front] == sorted((cost for _, cost in front), reverse=True)


def test_what_matters_is_found_and_what_does_not_is_little(told: Any) -> None:
    story = told("tune")
    shares = {one.label: one.shares[0] for one in story.influences}
    assert next(iter(shares)) == "parameters.voxelSize"
    assert shares["parameters.voxelSize"] > 0.5
    assert shares["parameters.deskew"] < 0.2
    few = told("live")
    assert few.compared < LEAST_TRIALS
    assert few.influences == ()


def test_of_a_search_under_way_is_said_what_is_to_come(told: Any) -> None:
    story = told("live")
    assert not story.is_over
    assert story.wanted <= story.expected <= story.to_come
    assert story.seconds_left is not None
    assert re.match(r"\d+ of 30 settings are tried so far: ", story.message)


def test_every_failed_setting_says_so(told: Any) -> None:
    failed = [one for one in told("tune").trials if one.values["parameters.voxelSize"] > 1.7]
    assert failed
    for one in failed:
        assert (one.figures, one.failed, one.dropped) == ((None,), 1, "its one run failed")


def test_a_grid_is_no_search(home: Path) -> None:
    with Archive.open(f"sqlite:///{home / 'archive.sqlite'}", read_only=True) as archive:
        record = archive.sweeps()[0]
    spec = {name: value for name, value in record.spec.items() if name != "search"}
    for other in (spec, {}):  # trajectories of others have no spec
        with pytest.raises(InputError, match="is no search"):
            plan_of(record.replace(spec=other))


def test_the_search_of_somebody_else_is_read(home: Path) -> None:
    record = _record(home, "tune")
    assert len(plan_of(record.replace(name="tune @lab"))) == len(plan_of(record))


def test_the_yaml_of_the_best_is_the_run_that_was_made(
    home: Path, told: Any, monkeypatch: Any, capsys: Any
) -> None:
    story = told("tune")
    code, out, _ = run(capsys, home, monkeypatch, "search", "best", "tune")
    assert code == 0
    single = yaml.safe_load(out)
    assert (single["kind"], single["metadata"]["name"]) == ("MappingRun", "tune-best")
    plan = plan_of(_record(home, "tune"))
    point = plan.point(story.best[0] * story.block)
    assert {name: single["spec"][name] for name in ("parameters", "seed", "repetition")} == {
        name: point.spec[name] for name in ("parameters", "seed", "repetition")
    }
    code, out, _ = run(capsys, home, monkeypatch, "search", "best", "tune", "--sweep")
    repeated = Sweep.model_validate(yaml.safe_load(out))
    assert repeated.name == "tune-best-sweep"  # of the run's name, each would supersede the other
    again = Plan(repeated, FixedCatalog(), strict=False)
    first = story.best[0] * story.block
    assert {one.spec_hash for one in again} == {plan.point(first + at).spec_hash for at in range(story.block)}


def test_the_yaml_of_the_best_brings_a_generated_dataset_that_came_with_the_sweep(
    home: Path, told: Any, monkeypatch: Any, capsys: Any, tmp_path: Path
) -> None:
    told("tune")
    made = {"recording": {"synthetic": {"seed": 3, "sensors": ["Lidar"], "durationSeconds": 20}}}
    copied = tmp_path / "home"
    shutil.copytree(home, copied)
    with Archive.open(f"sqlite:///{copied / 'archive.sqlite'}") as archive:
        archive.put_catalog(CatalogEntry(kind="Dataset", name="hall", spec=made))
    code, out, err = run(capsys, copied, monkeypatch, "search", "best", "tune", "--sweep")
    hall, again = yaml.safe_load_all(out)
    assert (code, hall["metadata"]["name"], hall["spec"]) == (0, "hall", made)
    assert again["kind"] == "Sweep"
    assert "dataset yard: it lies beside its manifest" in err


@pytest.mark.parametrize(
    ("own", "options", "is_said"),
    [({"alignment": "None"}, (), True), ({"alignment": "None"}, ("--sweep",), False), ({}, (), False)],
)
def test_a_run_that_is_measured_otherwise_than_the_search_was_says_so(
    *, home: Path, monkeypatch: Any, capsys: Any, tmp_path: Path, own: Any, options: Any, is_said: bool
) -> None:
    copied = tmp_path / "home"
    shutil.copytree(home, copied)
    record = _record(copied, "tune")
    with Archive.open(f"sqlite:///{copied / 'archive.sqlite'}") as archive:
        archive.put_sweep(record.replace(spec={**record.spec, "evaluation": own}))
    code, _, err = run(capsys, copied, monkeypatch, "search", "best", "tune", *options)
    assert (code, "a MappingRun is measured by the default evaluation" in " ".join(err.split())) == (
        0,
        is_said,
    )


def _record(home: Path, name: str) -> Any:
    with Archive.open(f"sqlite:///{home / 'archive.sqlite'}", read_only=True) as archive:
        return next(one for one in archive.sweeps() if one.name == name)


def test_of_a_front_one_must_be_chosen(home: Path, told: Any, monkeypatch: Any, capsys: Any) -> None:
    code, out, err = run(capsys, home, monkeypatch, "search", "best", "front")
    assert (code, out) == (2, "")
    assert [int(number) for number in re.findall(r"--number (\d+):", err)] == list(told("front").best)
    number = str(told("front").best[0])
    code, out, _ = run(capsys, home, monkeypatch, "search", "best", "front", "--number", number)
    assert (code, yaml.safe_load(out)["metadata"]["name"]) == (0, f"front-{number}")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("best", "tunes"), "unknown sweep 'tunes'; did you mean 'tune'?"),
        (("best", "tune", "--number", "99"), "--number: 99 is no setting of tune"),
        (("best", "tune", "--repetitions", "3"), "--repetitions: means nothing without --sweep"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    home: Path, monkeypatch: Any, capsys: Any, words: tuple[str, ...], sentence: str
) -> None:
    code, _, err = run(capsys, home, monkeypatch, "search", *words)
    assert code == 2
    assert sentence in err


def test_the_table_shows_every_setting(home: Path, told: Any, monkeypatch: Any, capsys: Any) -> None:
    code, out, _ = run(capsys, home, monkeypatch, "search", "show", "tune")
    assert code == 0
    assert len(re.findall(r"^\d+ ", out, re.MULTILINE)) >= len(told("tune").trials)
    assert "what matters: voxelSize" in out


def test_results_that_a_search_chose_are_marked_and_left_out_of_boards(home: Path) -> None:
    frame = read_table(f"sqlite:///{home / 'archive.sqlite'}").frame
    assert set(frame.column("search").tolist()) == {"TPE", "NSGA-II"}
    found = aggregate(frame, [ERROR], ["dataset"])
    assert all(cell.chosen for cell in found.cells)
    assert any(note.startswith("¶ all runs were chosen by a search") for note in found.notes)
    kept, notes = without_chosen(frame)
    assert len(kept) == len(frame)
    assert "no fair sample" in notes[0]
    assert any("no fair sample" in note for note in leaderboard(frame).notes)


@pytest.mark.parametrize(
    ("search", "method"),
    [
        (None, None),
        ({"method": "Grid"}, None),
        ({"method": "Random", "objectives": [{"metric": ERROR}], "trials": 9, "keep": 1}, None),
        ({"method": "Random", "objectives": [{"metric": ERROR}], "trials": 9}, "Random"),
        ({"method": "TPE", "objectives": [{"metric": ERROR}], "trials": 9, "keep": 1}, "TPE"),
        ({"method": "Threshold", "axis": "x"}, "Threshold"),
        ({"method": "Oracle"}, "Oracle"),
    ],
)
def test_what_looks_at_no_results_is_a_fair_sample(search: Any, method: str | None) -> None:
    assert choosing_method({} if search is None else {"search": search}) == method


def test_the_list_of_runs_says_which_a_search_chose(home: Path, monkeypatch: Any, capsys: Any) -> None:
    code, text, _ = run(capsys, home, monkeypatch, "results", "list", "--format", "csv")
    rows = list(csv.DictReader(io.StringIO(text)))
    found = {(row["sweep"], row["search"]) for row in rows}
    assert (code, found) == (0, {("tune", "TPE"), ("front", "NSGA-II"), ("live", "TPE")})


def test_of_a_threshold_the_values_are_told_and_none_is_the_best() -> None:
    body = sweep_of("edge").model_dump(mode="json", by_alias=True, exclude_unset=True)
    body["spec"]["search"] = {"method": "Threshold", "axis": "parameters.voxelSize", "tolerance": 0.2}
    body["spec"]["matrix"] = body["spec"]["matrix"][:2]
    plan, records = searched(Sweep.model_validate(body))
    frame = records_frame(list(records.values()))
    story = tell(plan, None, frame)
    assert story.is_over
    assert (story.best, story.influences) == ((), ())
    assert [trial.values for trial in story.trials] == [
        dict(zip(("dataset", "parameters.voxelSize"), trial.values, strict=True)) for trial in plan.trials
    ]
    failing = {
        trial.values["parameters.voxelSize"] > 1.7 or trial.values["parameters.voxelSize"] < 0.12
        for trial in story.trials
        if trial.failed == 1
    }
    assert failing == {True}


def test_of_a_threshold_it_is_said_where_its_answer_is(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    body = sweep_of("edge").model_dump(mode="json", by_alias=True, exclude_unset=True)
    body["spec"]["search"] = {"method": "Threshold", "axis": "parameters.voxelSize", "tolerance": 0.2}
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        archive.put_sweep(SweepRecord(uid="edge", name="edge", spec=body["spec"]))
    for command, expected in (("show", 0), ("best", 2)):
        code, out, err = run(capsys, tmp_path, monkeypatch, "search", command, "edge")
        assert (code, "slamhive results robustness --sweep edge" in out + err) == (expected, True)


def test_a_figure_says_what_its_curve_averaged(told: Any) -> None:
    curve = search(told("tune"), Wish(FigureKind.SEARCH)).settled()
    assert "the mean over 2 values of dataset, of each the mean of 2 runs" in curve.notes[0]
    assert len(curve.columns["setting"]) == len(told("tune").trials)
    front = search(told("front"), Wish(FigureKind.SEARCH)).settled()
    assert front.y.label.startswith("CPU time")
    with pytest.raises(InputError, match="has its objectives along its axes"):
        search(told("tune"), Wish(FigureKind.SEARCH, x="ate.rmse"))


def test_figures_are_finite(told: Any) -> None:
    for trial in told("front").trials:
        assert all(value is None or math.isfinite(value) for value in trial.figures)
