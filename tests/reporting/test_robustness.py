# SPDX-License-Identifier: Apache-2.0
"""Robustness card: from searches and grids alike, as figure, table and file, and what it refuses."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis.searches.seen import runs_seen
from slamhive.archive import Archive, SweepRecord
from slamhive.model.results import Outcome, Phase, Provenance, Reason, Result, RunRecord
from slamhive.model.search import Search

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Slamhive = Callable[..., tuple[int, str, str]]

DROP, NOISE = "input.perturb.lidar.dropPoints", "input.perturb.lidar.rangeNoise"
BREAKS = {("kiss-icp", DROP): 0.8, ("genz-icp", DROP): 0.55, ("mad-icp", DROP): 2.0, ("ct-icp", DROP): -1.0}
BREAKS |= {("kiss-icp", NOISE): 0.3, ("genz-icp", NOISE): 0.6}
ISLAND = ("mad-icp", NOISE)


def of_run(sweep: str, algorithm: str, axis: str, value: float, repetition: int) -> RunRecord:
    """Return a run that lost track where its value is too large for it."""
    lost = value > BREAKS.get((algorithm, axis), 9.0) or ((algorithm, axis) == ISLAND and 0.3 < value < 0.7)
    lost = lost or (algorithm == "genz-icp" and value > 0.45 and repetition == 0)
    name = f"{sweep}-{algorithm}-{value:g}-{repetition}"
    result = Result(
        evaluation="se3",
        outcome=Outcome.LOST if lost else Outcome.TRACKED,
        coverage=0.9,
        values={"ate": {"rmse": 0.1 + value}},
    )
    options = {axis.rpartition(".")[2]: value}
    return RunRecord.model_validate(
        {
            "uid": name,
            "name": name,
            "sweep": sweep,
            "sweepUid": sweep,
            "spec": {
                "algorithmRef": {"name": algorithm},
                "datasetRef": {"name": "hall"},
                "sensors": "lidar",
                "input": {"pace": "Lockstep", "perturb": {"lidar": options}},
                "repetition": repetition,
                "seed": repetition + 1,
            },
            "phase": Phase.SUCCEEDED,
            "results": [result],
        }
    )


def sweep_record(name: str, axis: str) -> SweepRecord:
    spec = {
        "matrix": [{"path": "algorithm", "values": ["kiss-icp"]}, {"path": axis, "values": [0, 1]}],
        "search": {"method": "Threshold", "axis": axis},
    }
    return SweepRecord(uid=name, name=name, spec=spec)


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """Return a home with a search for a threshold, and a grid of another axis."""
    tenths = [round(0.1 * step, 1) for step in range(10)]
    runs = [
        of_run("points", algorithm, DROP, value, repetition)
        for algorithm in ("kiss-icp", "genz-icp", "mad-icp", "ct-icp")
        for value in tenths
        for repetition in range(3)
    ]
    runs += [
        of_run("noise", algorithm, NOISE, value, repetition)
        for algorithm in ("kiss-icp", "genz-icp", "mad-icp")
        for value in tenths[::2]
        for repetition in range(3)
    ]
    broken = of_run("points", "ct-icp", DROP, 0.95, 0)
    runs.append(broken.model_copy(update={"phase": Phase.FAILED, "reason": Reason.NODE_LOST, "results": []}))
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        archive.put_sweep(sweep_record("points", DROP))
        archive.put_runs(runs)
    return tmp_path


def card(slamhive: Slamhive, home: Path, *words: Any) -> dict[tuple[str, str], dict[str, Any]]:
    code, text, complaint = slamhive(home, "results", "robustness", "--format", "json", *words)
    assert code == 0, complaint
    return {(row["algorithm"], row["axis"]): row for row in json.loads(text)}


def test_a_card_says_where_each_system_breaks(home: Path, slamhive: Slamhive) -> None:
    rows = card(slamhive, home, "-x", f"{DROP},{NOISE}")
    told = {key: (row["status"], row["passes"], row["fails"]) for key, row in rows.items()}
    assert told == {
        ("kiss-icp", DROP): ("found", 0.8, 0.9),
        ("genz-icp", DROP): ("found", 0.5, 0.6),
        ("mad-icp", DROP): ("never fails", 0.9, None),
        ("ct-icp", DROP): ("always fails", None, 0),
        ("kiss-icp", NOISE): ("found", 0.2, 0.4),
        ("genz-icp", NOISE): ("found", 0.6, 0.8),
        ("mad-icp", NOISE): ("not monotone", 0.2, 0.4),
    }
    assert rows["genz-icp", DROP]["counts"].split(", ")[4:7] == ["0.4: 0/3", "0.5: 1/3", "0.6: 3/3"]
    assert rows["ct-icp", DROP]["runs"] == 30  # the node was lost: nothing is known of that run


def test_the_axis_and_the_rule_are_those_that_were_sought(home: Path, slamhive: Slamhive) -> None:
    assert {axis for _, axis in card(slamhive, home)} == {DROP}
    assert {axis for _, axis in card(slamhive, home, "--sweep", "noise")} == {NOISE}
    rows = card(slamhive, home, "--failing", "ate.rmse > 0.5")
    assert rows["mad-icp", DROP]["passes"] == 0.4
    rows = card(slamhive, home, "--quantile", "0.3")
    assert rows["genz-icp", DROP]["passes"] == 0.4


def test_two_namespaces_with_a_sweep_of_one_name_are_told_apart(slamhive: Slamhive, tmp_path: Path) -> None:
    failing = {"metric": "ate.rmse", "above": 0.5}
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        for namespace, axis, rule in (("one", DROP, {}), ("two", NOISE, {"failing": failing})):
            uid = f"uid-{namespace}"
            record = sweep_record("sought", axis)
            spec = record.spec | {"search": record.spec["search"] | rule}
            archive.put_sweep(record.replace(uid=uid, namespace=namespace, spec=spec))
            runs = [of_run(namespace, "kiss-icp", axis, value, 0) for value in (0.0, 0.2, 0.4, 0.6, 0.9)]
            change = {"sweep": "sought", "sweep_uid": uid, "namespace": namespace}
            archive.put_runs(run.model_copy(update=change) for run in runs)
    rows = card(slamhive, tmp_path)
    assert {axis: (row["passes"], row["fails"]) for (_, axis), row in rows.items()} == {
        DROP: (0.6, 0.9),
        NOISE: (0.2, 0.4),  # where it is lost, though its error exceeds 0.5 m beyond 0.4 alone
    }


def test_searches_that_share_their_runs_keep_their_rules(slamhive: Slamhive, tmp_path: Path) -> None:
    values = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9)
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        for name, rule in (("tracks", {}), ("near", {"failing": {"metric": "ate.rmse", "above": 0.35}})):
            record = sweep_record(name, DROP)
            archive.put_sweep(record.replace(spec=record.spec | {"search": record.spec["search"] | rule}))
            runs = {value: of_run(name, "kiss-icp", DROP, value, 1) for value in values}
            archive.put_runs(
                run.model_copy(update={"provenance": Provenance(content_hash=f"content-{value}")})
                for value, run in runs.items()
            )
    code, text, _ = slamhive(tmp_path, "results", "robustness", "--format", "csv")
    assert code == 0
    told = {row["failing"]: (row["passes"], row["fails"]) for row in csv.DictReader(io.StringIO(text))}
    assert told == {"not Tracked": ("0.8", "0.9"), "ate.rmse > 0.35": ("0.2", "0.4")}
    code, text, said = slamhive(tmp_path, "results", "robustness")
    assert said.splitlines()[0] == "n = 6 runs on hall, lidar"
    one = slamhive(tmp_path, "results", "robustness", "--failing", "ate.rmse > 0.35", "--format", "json")[1]
    assert [(row["passes"], row["runs"]) for row in json.loads(one)] == [(0.2, 6)]


def test_a_run_of_two_axes_counts_once(slamhive: Slamhive, tmp_path: Path) -> None:
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        for value in (0.0, 0.2, 0.4):
            run = of_run("grid", "kiss-icp", DROP, value, 0)
            both = {"pace": "Lockstep", "perturb": {"lidar": {"dropPoints": value, "rangeNoise": value}}}
            archive.put_run(run.model_copy(update={"spec": dict(run.spec) | {"input": both}}))
    code, _, said = slamhive(tmp_path, "results", "robustness", "-x", f"{DROP},{NOISE}")
    assert (code, said.splitlines()[0]) == (0, "n = 3 runs on hall, lidar")


@pytest.mark.parametrize(
    ("outcome", "fails"), [(Outcome.DIVERGED, True), (Outcome.LOST, True), (Outcome.PARTIAL, False)]
)
def test_a_small_error_of_a_run_that_left_its_way_does_not_pass(
    slamhive: Slamhive, tmp_path: Path, outcome: Outcome, fails: bool
) -> None:
    record = sweep_record("noise", NOISE)
    search = record.spec["search"] | {"failing": {"metric": "ate.rmse", "above": 50}}
    run = of_run("noise", "kiss-icp", NOISE, 0.2, 0)
    run = run.model_copy(update={"results": [run.results[0].replace(outcome=outcome)]})
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        archive.put_sweep(record.replace(spec=record.spec | {"search": search}))
        archive.put_runs([of_run("noise", "kiss-icp", NOISE, 0.0, 0), run])
    (row,) = card(slamhive, tmp_path).values()
    assert row["counts"] == f"0: 0/1, 0.2: {int(fails)}/1"
    assert runs_seen({1: run}, Search.model_validate(search))[1].has_failed is fails


@pytest.mark.parametrize(("errors", "status"), [((0.1, 0.2), "no effect seen"), ((0.1, 0.9), "never fails")])
def test_what_changes_nothing_is_not_what_is_borne(
    slamhive: Slamhive, tmp_path: Path, errors: tuple[float, float], status: str
) -> None:
    """Repetitions differ by 0.15 m: an axis that moves the error by 0.1 m may have no effect."""
    with Archive.open(f"sqlite:///{tmp_path / 'archive.sqlite'}") as archive:
        archive.put_sweep(sweep_record("points", DROP))
        for value, error in zip((0.0, 0.5), errors, strict=True):
            for repetition in range(3):
                run = of_run("points", "mad-icp", DROP, value, repetition)
                results = [run.results[0].replace(values={"ate": {"rmse": error + 0.075 * repetition}})]
                archive.put_run(run.model_copy(update={"results": results}))
    (row,) = card(slamhive, tmp_path).values()
    assert (row["status"], row["passes"]) == (status, 0.5)


def test_csv_and_figure_hold_the_same_numbers(home: Path, slamhive: Slamhive, tmp_path: Path) -> None:
    code, text, _ = slamhive(home, "results", "robustness", "--format", "csv")
    assert code == 0
    pytest.importorskip("matplotlib")
    path = tmp_path / "card.svg"
    assert slamhive(home, "figure", "robustness", "-o", path)[0] == 0
    assert (tmp_path / "card.data.csv").read_text() == text
    assert len(list(csv.DictReader(io.StringIO(text)))) == 4
    again = path.read_bytes()
    assert slamhive(home, "figure", "robustness", "-o", path)[0] == 0
    assert path.read_bytes() == again


def test_names_of_systems_stand_whole_in_two_lines_and_apart_where_that_is_too_little() -> None:
    pytest.importorskip("matplotlib")
    from slamhive.figures.drawing import Drawing
    from slamhive.figures.pictures import Panel, Picture, PictureAxis, Reach
    from slamhive.figures.widths import WIDTHS

    names = ["kiss-icp, lidar, evaluation final", "genz-icp", *(f"{'a' * 80}-{last}" for last in "xy")]
    marks = tuple(Reach(row, 0.0, 1.0, text="never") for row in range(4))
    x = PictureAxis("drop", robust=False, ends=(0.0, 1.0))
    picture = Picture(
        x, PictureAxis("", categories=tuple(names)), (Panel("", marks, x),), (), (), columns={}, runs=4
    )
    axes = Drawing(picture, WIDTHS["ieee-column"]).draw().axes[0]
    shown = [text.get_text() for text in axes.get_yticklabels()]
    assert [text.replace("\n", " ") for text in shown[:2]] == names[:2]
    assert all(text.count("\n") <= 1 for text in shown)
    assert len(set(shown)) == 4


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["-x", "algorithm"], "--x: algorithm: a column of numbers is needed, this one holds none"),
        (["-x", "dropPonits"], "dropPonits"),
        (["--failing", "ate.rsme > 1"], "ate.rsme"),
        (["--where", f"{NOISE} == 0.2"], "--x: no number was varied in these runs"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(
    home: Path, slamhive: Slamhive, words: list[str], complaint: str
) -> None:
    code, _, errors = slamhive(home, "results", "robustness", *words)
    assert code == 2
    assert complaint in " ".join(errors.split())
