# SPDX-License-Identifier: Apache-2.0
"""Answers behind single pictures, over HTTP: failed runs are among those that a share is of."""

from __future__ import annotations

import base64
import csv
import io
import json
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.frame import Frame
from slamhive.archive import Archive
from slamhive.dashboard.answers.paths import apart
from slamhive.dashboard.answers.timeline import timeline
from slamhive.dashboard.sources.archived import Snapshot, Workstation
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.model.results import Outcome, Phase, Reason, Result

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord

TRACKED, PARTIAL = Outcome.TRACKED, Outcome.PARTIAL


def measured(error: float, outcome: Outcome = TRACKED) -> list[Result]:
    values = {"alignment": "se3", "ate": {"rmse": error}}
    return [Result(evaluation="se3", outcome=outcome, coverage=0.95, values=values)]


def spec(algorithm: str, dataset: str = "hall") -> dict[str, Any]:
    return {"algorithmRef": {"name": algorithm}, "datasetRef": {"name": dataset}, "repetition": 0}


BROKEN = {
    "phase": Phase.FAILED,
    "results": [],
    "trajectory": None,
    "evaluations": [{"evaluation": "se3", "alignment": "se3"}],
}


@pytest.fixture
async def judged(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> AsyncIterator[Any]:
    """An API over four runs of a and three of b: of each, some failed, in several ways."""
    runs = [
        make_run(0, spec=spec("a"), results=measured(0.1)),
        make_run(1, spec=spec("a"), results=measured(0.3)),
        make_run(2, spec=spec("a"), results=measured(0.01, PARTIAL)),
        make_run(3, spec=spec("a"), reason=Reason.OUT_OF_MEMORY, **BROKEN),
        make_run(4, spec=spec("b"), results=measured(0.2)),
        make_run(5, spec=spec("b"), reason=Reason.NODE_LOST, **BROKEN),
        make_run(6, spec=spec("b", "yard"), results=measured(0.4)),
    ]
    with Archive.open(url) as archive:
        archive.put_runs(runs)
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_a_share_is_of_all_runs_failed_ones_among_them(judged: Any) -> None:
    answer = await judged.get("/analysis/ecdf?dataset=hall")
    a, b = answer["curves"]
    assert (a["keys"], a["x"], a["share"]) == ({"algorithm": "a"}, [0.1, 0.3], [0.25, 0.5])
    assert (a["total"], a["n"], a["failures"]) == (4, 2, {"OutOfMemory": 1, "Partial": 1})
    assert a["median"] is None  # the second best of four is known, the third failed
    # The machine lost it: it says nothing of the algorithm.
    assert (b["share"], b["total"], b["leftOut"]) == ([1.0], 1, {"NodeLost": 1})
    assert any("NodeLost: no rank" in note for note in answer["notes"])


async def test_where_large_is_good_the_best_come_first_and_failed_runs_below_all(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> None:
    def found(share: float) -> list[Result]:
        values = {"alignment": "se3", "points": {"share": share}}
        return [Result(evaluation="se3", outcome=TRACKED, coverage=share, values=values)]

    runs = [make_run(k, spec=spec("a"), results=found(share)) for k, share in enumerate((0.5, 1.0, 0.75))]
    runs += [make_run(3, spec=spec("a"), reason=Reason.OUT_OF_MEMORY, **BROKEN)]
    runs += [make_run(4 + k, spec=spec("b"), results=found(0.25)) for k in range(3)]
    with Archive.open(url) as archive:
        archive.put_runs(runs)
    async with open_app(Workstation(url, tmp_path)) as api:
        answer = await api.get("/analysis/ecdf?metric=points.share")
        assert answer["metric"]["better"] == "higher"
        a, _ = answer["curves"]
        assert (a["x"], a["share"], a["median"]) == ([1.0, 0.75, 0.5], [0.25, 0.5, 0.75], 0.625)
        (board,) = (await api.get("/analysis/leaderboard?metric=points.share"))["boards"]
        entries = [(entry["keys"]["algorithm"], entry["ratio"]) for entry in board["entries"]]
        assert entries == [("a", 1.0), ("b", 2.5)]
        (pair,) = (await api.get("/analysis/compare?metric=points.share"))["boards"][0]["pairs"]
        assert (pair["wins"], pair["ratio"]) == ({"a": 1, "b": 0, "ties": 0}, pytest.approx(0.4))
        (cells,) = (await api.get("/analysis/surface?x=algorithm&y=dataset&metric=points.share"))["boards"]
        assert [(one["best"], one["low"], one["high"]) for one in cells["cells"]] == [
            (1.0, None, 0.8125),
            (0.25, 0.25, 0.25),
        ]
        (front,) = (await api.get("/analysis/pareto?x=usage.cpu.seconds&y=points.share"))["fronts"]
        assert [(spot["keys"]["algorithm"], spot["front"]) for spot in front["points"]] == [
            ("a", True),
            ("b", False),
        ]


async def test_what_counts_for_all_evaluated_runs(judged: Any) -> None:
    answer = await judged.get("/analysis/ecdf?dataset=hall&outcomes=all&algorithm=a")
    [curve] = answer["curves"]
    assert (curve["x"], curve["share"]) == ([0.01, 0.1, 0.3], [0.25, 0.5, 0.75])


async def test_datasets_are_in_one_curve_only_where_that_is_asked_for(judged: Any) -> None:
    apart = await judged.get("/analysis/ecdf")
    assert [curve["keys"] for curve in apart["curves"]] == [
        {"dataset": "hall", "algorithm": "a"},
        {"dataset": "hall", "algorithm": "b"},
        {"dataset": "yard", "algorithm": "b"},
    ]
    together = await judged.get("/analysis/ecdf?over=dataset")
    assert [curve["x"] for curve in together["curves"]] == [[0.1, 0.3], [0.2, 0.4]]
    assert any("not the same: curves of other runs can't be compared" in note for note in together["notes"])


async def test_a_table_of_shares_has_all_steps(judged: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.distributions.MOST_STEPS", 2)
    thinned = await judged.get("/analysis/ecdf?outcomes=all&algorithm=a")
    assert thinned["curves"][0]["share"] == [0.25, 0.75]
    table = await judged.raw.get("/api/v1/analysis/ecdf?outcomes=all&algorithm=a&format=csv")
    rows = list(csv.DictReader(io.StringIO(table.text)))
    assert [(row["value"], row["share"]) for row in rows] == [
        ("0.01", "0.25"),
        ("0.1", "0.5"),
        ("0.3", "0.75"),
    ]


async def test_curves_beyond_number_are_refused(judged: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.distributions.MOST_CURVES", 2)
    monkeypatch.setattr("slamhive.dashboard.answers.distributions.MOST_RANKED", 13)
    answer = await judged.get("/analysis/ecdf?by=uid", 413)
    assert "7 curves are asked for" in answer["error"]


async def test_of_many_competitors_the_best_are_drawn_and_others_when_asked_for(
    judged: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = await judged.get("/analysis/ecdf")
    assert (whole["competitors"], whole["shown"]) == (2, 2)
    # On hall b is better: every second run of a failed. It has a curve on yard, too.
    best = await judged.get("/analysis/ecdf?most=1")
    assert [curve["keys"] for curve in best["curves"]] == [
        {"dataset": "hall", "algorithm": "b"},
        {"dataset": "yard", "algorithm": "b"},
    ]
    assert (best["competitors"], best["shown"]) == (2, 1)
    assert best["notes"][0].startswith("of 2 competitors the 1 best by mean rank are shown")
    (other,) = (await judged.get("/analysis/ecdf?most=1&first=2"))["curves"]
    assert other == whole["curves"][0]
    beyond = await judged.get("/analysis/ecdf?first=3")
    assert (beyond["curves"], beyond["shown"]) == ([], 0)
    assert "none has place 3" in beyond["notes"][0]
    monkeypatch.setattr("slamhive.dashboard.answers.distributions.MOST_CURVES", 2)
    part = await judged.get("/analysis/ecdf?first=1")
    assert part["curves"] == whole["curves"][:2]
    assert "of 2 pictures the first 1 are shown: filter the runs for others" in part["notes"]


PICTURES = ("ecdf", "paths", "timeline", "slices", "surface?x=parameters.nFeatures&y=seed")


@pytest.mark.parametrize("picture", PICTURES)
async def test_every_picture_is_json_and_a_table_of_whatever_there_is(api: Any, picture: str) -> None:
    sign = "&" if "?" in picture else "?"
    for where in ("", "seed < 0", "seed == 24", "seed == 3", "outcome is null"):
        answer = await api.get(f"/analysis/{picture}{sign}where={where}")
        assert answer["revision"]
        assert "NaN" not in json.dumps(answer)
        table = await api.raw.get(f"/api/v1/analysis/{picture}{sign}where={where}&format=csv")
        assert table.status_code == 200
        cells = {cell for row in csv.reader(io.StringIO(table.text)) for cell in row}
        assert not {"nan", "inf"} & cells


@pytest.mark.parametrize(
    ("query", "field", "part"),
    [
        ("ecdf?metric=name", "metric", "numbers"),
        ("ecdf?by=algoritm", "by", "did you mean"),
        ("ecdf?over=datset", "over", "did you mean"),
        ("ecdf?outcomes=some", "outcomes", "known: all, tracked"),
        ("surface?x=seed", "y", "required"),
        ("surface?x=seed&y=seed", "y", "along x already"),
        ("surface?x=seed&y=sed", "y", "did you mean"),
        ("slices?metric=name", "metric", "numbers"),
        ("timeline?from=20&to=10", "to", "after that of from"),
        ("timeline?from=yesterday", "from", "valid number"),
    ],
)
async def test_mistakes_say_where_they_are(api: Any, query: str, field: str, part: str) -> None:
    answer = await api.get(f"/analysis/{query}", 400)
    assert answer["field"] == field
    assert part in answer["error"]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("", 30),
        ("uid-025", 1),
        ("ALGORITHM-0 dataset-2 1000", 4),
        ("algorithm-0 nfeatures=500", 5),
        ("nfeatures=5", 0),
        ("memory", 1),  # OutOfMemory
        ("loop=true algorithm-1", 0),
        ("nothing of the kind", 0),
        ("script>", 1),
    ],
)
async def test_runs_are_found_by_words(api: Any, words: str, found: int) -> None:
    answer = await api.get("/search", params={"words": words, "limit": 3})
    assert answer["total"] == found
    assert len(answer["items"]) == min(found, 3)


async def test_what_was_found_says_in_what_it_differs(api: Any) -> None:
    answer = await api.get("/search", params={"words": "algorithm-0 dataset-2"})
    assert {"parameters.nFeatures", "repetition"} <= answer["items"][0]["keys"].keys()
    assert "input.pace" not in answer["items"][0]["keys"]  # the same in all of them
    assert answer["items"][0]["uid"] > answer["items"][1]["uid"]


async def test_more_words_than_can_be_looked_for(api: Any) -> None:
    answer = await api.get("/search", 400, params={"words": "a " * 11})
    assert (answer["field"], "10 at most" in answer["error"]) == ("words", True)


def write_path(home: Path, run: RunRecord, shift: float) -> RunRecord:
    """Write a run's path of four poses along x, and return the run with its folder."""
    output = home / "runs" / "study" / run.name / "run" / "output"
    output.mkdir(parents=True)
    lines = [f"{t} {t + shift} 0 0 0 0 0 1" for t in range(4)]
    (output / "trajectory.txt").write_text("\n".join(lines) + "\n")
    return run.replace(folder=f"runs/study/{run.name}")


@pytest.fixture
async def repeated(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> AsyncIterator[Any]:
    """An API over three repetitions of a setting, one of them without a path, and one run of another."""

    def made(number: int, repetition: int, parameters: dict[str, Any], **changes: Any) -> RunRecord:
        given = spec("a") | {"repetition": repetition}
        return make_run(number, spec=given, parameters=parameters, **changes)

    transform = {"alignment": "se3", "transform": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
    aligned = [Result(evaluation="se3", outcome=TRACKED, coverage=1.0, values=transform)]
    runs = [
        write_path(tmp_path, made(0, 0, {"n": 500}, results=aligned), 0.0),
        write_path(tmp_path, made(1, 1, {"n": 500}, results=aligned), 0.5),
        made(2, 2, {"n": 500}, reason=Reason.OUT_OF_MEMORY, **BROKEN),
        write_path(tmp_path, made(3, 0, {"n": 900}, results=aligned), 9.0),
    ]
    with Archive.open(url) as archive:
        archive.put_runs(runs)
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_paths_of_all_repetitions_of_a_run(repeated: Any) -> None:
    answer = await repeated.get("/analysis/paths?of=uid-001")
    runs = [run for group in answer["groups"] for run in group["runs"]]
    assert answer["by"] == ["repetition"]
    assert {run["uid"]: run["track"] and run["track"]["x"] for run in runs} == {
        "uid-000": [5.0, 6.0, 7.0, 8.0],  # aligned
        "uid-001": [5.5, 6.5, 7.5, 8.5],
        "uid-002": None,
    }
    [problem] = [run["problem"] for run in runs if run["problem"]]
    assert "no files" in problem


async def test_paths_of_what_filters_leave_say_in_what_they_differ(repeated: Any) -> None:
    answer = await repeated.get("/analysis/paths?where=repetition == 0&points=3")
    [group] = answer["groups"]
    assert [run["keys"] for run in group["runs"]] == [
        {"parameters.n": 500, "repetition": 0},
        {"parameters.n": 900, "repetition": 0},
    ]
    assert group["runs"][0]["track"]["t"] == [0.0, 3.0]
    assert group["reference"] is None
    assert "the ground truth of this dataset is not at hand here" in group["notes"]


@pytest.mark.parametrize(("off", "told"), [(0.0, False), (-0.3, True)])
def test_the_truth_of_another_frame_is_told_from_that_drawn(off: float, told: bool) -> None:
    whole = {"t": np.arange(3.0)} | {axis: np.zeros(3) for axis in "xyz"}
    part = {"t": np.arange(1.0, 3.0), "x": np.zeros(2), "y": np.zeros(2), "z": np.full(2, off)}
    assert apart(whole, part) is told


async def test_of_many_paths_the_first_are_drawn(repeated: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.paths.MOST_PATHS", 2)
    answer = await repeated.get("/analysis/paths")
    assert (answer["rows"], answer["notes"]) == (2, ["of 4 runs the first 2 are drawn: choose fewer"])


async def test_repetitions_of_a_run_that_is_not_there(repeated: Any) -> None:
    assert (await repeated.get("/analysis/paths?of=uid-9", 404))["field"] == "of"


NOON = datetime(2026, 1, 2, 12, tzinfo=UTC)


def at(seconds: float) -> str:
    return (NOON + timedelta(seconds=seconds)).isoformat()


@pytest.fixture
async def timed(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> AsyncIterator[Any]:
    """An API over runs on two nodes: one knows the cores of its runs, on the other two overlap."""

    def made(number: int, begin: float, start: float | None, end: float, **more: Any) -> RunRecord:
        times = {"created": at(begin), "started": start and at(start), "finished": at(end)}
        node = {"provenance": {"node": more.pop("node")} | more.pop("provenance", {})}
        return make_run(number, **times, **node, **more)

    runs = [
        made(0, 0, 10, 50, node="b"),
        made(1, 0, None, 20, node="b", reason=Reason.DATASET_MISSING, **BROKEN),
        made(2, 20, 30, 60, node="b"),
        made(3, 60, 70, 100, node="a", reason=Reason.OUT_OF_MEMORY, **BROKEN),
        made(4, 0, 10, 50, node="b", provenance={"reusedFrom": "run-000"}),
    ]
    with Archive.open(url) as archive:
        archive.put_runs(runs)
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_a_timeline_has_a_lane_for_what_goes_on_at_a_time(timed: Any) -> None:
    answer = await timed.get("/analysis/timeline")
    bars = answer["bars"]
    assert answer["lanes"] == ["a", "b, place 1", "b, place 2"]
    assert dict(zip(bars["uid"], bars["lane"], strict=True)) == {
        "uid-000": 1,
        "uid-001": 2,
        "uid-002": 2,
        "uid-003": 0,
    }
    noon = NOON.timestamp()
    assert [value and value - noon for value in bars["start"]] == [10, None, 30, 70]
    assert [value - noon for value in answer["extent"]] == [0, 100]
    assert (bars["failed"], answer["failed"]) == ([False, True, False, True], 2)
    # What was taken over was not done again.
    assert any("1 run that took over" in note for note in answer["notes"])


async def test_a_part_of_the_time(timed: Any) -> None:
    noon = NOON.timestamp()
    answer = await timed.get(f"/analysis/timeline?from={noon + 55}&to={noon + 65}")
    assert answer["bars"]["uid"] == ["uid-002", "uid-003"]
    assert [value - noon for value in answer["whole"] + answer["extent"]] == [0, 100, 55, 65]


async def test_many_runs_are_summed_up(timed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.timeline.MOST_BARS", 2)
    monkeypatch.setattr("slamhive.dashboard.answers.timeline.BINS", 4)
    answer = await timed.get("/analysis/timeline")
    assert answer["bars"] is None
    bins = answer["bins"]
    # By hand, over quarters of 100 s: one ran from 10 to 50, one from 30 to 60, prepared from 20 on.
    assert bins["running"] == [[0, 0, 0.2, 1], [0.6, 1, 0, 0], [0, 0.8, 0.4, 0]]
    assert bins["preparing"] == [[0, 0, 0.4, 0], [0.4, 0, 0, 0], [1, 0.2, 0, 0]]
    assert bins["ended"] == [[0, 0, 0, 1], [0, 0, 1, 0], [1, 0, 1, 0]]
    assert bins["failed"] == [[0, 0, 0, 1], [0, 0, 0, 0], [1, 0, 0, 0]]
    table = await timed.raw.get("/api/v1/analysis/timeline?format=csv")
    assert len(table.text.splitlines()) == 5  # each run, whatever is drawn


def test_runs_that_go_on_last_until_now() -> None:
    noon = NOON.timestamp()
    columns = {
        "id": [1, 2],
        "uid": ["x", "y"],
        "phase": ["Running", "Pending"],
        "created": [noon, noon + 5],
        "started": [noon + 1, None],
        "provenance.node": ["a", "a"],
        "usage.processors": ["0-1", None],
    }
    frame = Frame({name: Column.of(values) for name, values in columns.items()}, 2)
    answer = timeline(Snapshot(frame), [], (None, None), lambda: noon + 60).content
    assert answer["live"] == 2
    assert answer["lanes"] == ["a, cores 0-1", "a, place 1"]
    assert answer["bars"]["end"].tolist() == [noon + 60, noon + 60]


def test_superseded_runs_are_no_lost_time() -> None:
    noon = NOON.timestamp()
    columns = {
        "id": [1, 2],
        "uid": ["x@0a1b2c3d", "x"],
        "phase": ["Succeeded", "Succeeded"],
        "created": [noon, noon + 50],
        "started": [noon, noon + 50],
        "finished": [noon + 50, noon + 100],
        "superseded": ["algorithm changed", None],
    }
    frame = Frame({name: Column.of(values) for name, values in columns.items()}, 2)
    answer = timeline(Snapshot(frame), [("superseded", "0")], (None, None)).content
    assert answer["bars"]["uid"] == ["x@0a1b2c3d", "x"]
    assert answer["notes"] == ["1 run of an earlier version is among them: it took time too"]


@pytest.fixture
async def varied(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> AsyncIterator[Any]:
    """An API over runs of two settings: of the dearer ones most failed."""

    def made(number: int, n: int, k: int, error: float | None) -> RunRecord:
        more = BROKEN | {"reason": Reason.OUT_OF_MEMORY} if error is None else {"results": measured(error)}
        given = spec("a") | {"repetition": number}
        return make_run(number, spec=given, parameters={"n": n, "k": k}, attributes={}, **more)

    rows = [(1, 1, 0.1), (1, 1, 0.3), (1, 2, 0.5), (2, 1, 0.7), (2, 2, None), (2, 2, None), (2, 2, 0.2)]
    with Archive.open(url) as archive:
        archive.put_runs(made(number, *row) for number, row in enumerate(rows))
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_a_surface_has_medians_with_failed_runs_last(varied: Any) -> None:
    answer = await varied.get("/analysis/surface?x=parameters.n&y=parameters.k")
    [board] = answer["boards"]
    found = {tuple(cell["at"]): (cell["median"], cell["n"], cell["total"]) for cell in board["cells"]}
    assert found == {(1, 1): (0.2, 2, 2), (1, 2): (0.5, 1, 1), (2, 1): (0.7, 1, 1), (2, 2): (None, 1, 3)}


async def test_slices_are_over_all_values_of_the_other_settings(varied: Any) -> None:
    answer = await varied.get("/analysis/slices")
    assert "each chart is over all values of the other settings" in answer["notes"]
    [board] = answer["boards"]
    one, two = board["slices"]["parameters.n"]
    assert (one["best"], one["low"], one["median"], one["high"]) == (0.1, 0.2, 0.3, 0.4)
    assert (two["best"], two["median"], two["n"], two["total"]) == (0.2, None, 2, 4)
    assert two["failures"] == {"OutOfMemory": 2}


async def test_many_values_of_a_setting_are_taken_together(
    varied: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.distributions.MOST_PLACES", 2)
    answer = await varied.get("/analysis/surface?x=ate.rmse&y=parameters.k")
    assert any("the 5 values of ate.rmse are taken together in 2 stretches" in n for n in answer["notes"])
    places = {cell["at"][0] for cell in answer["boards"][0]["cells"]} - {None}
    assert sorted(places) == pytest.approx([0.15, 0.5])


async def test_more_pictures_than_can_be_looked_at(varied: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.distributions.MOST_BOARDS", 0)
    assert "pictures are asked for" in (await varied.get("/analysis/slices", 413))["error"]


@pytest.fixture
async def filmed(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> AsyncIterator[Any]:
    """An API over a run that was given a recording of two images, and one whose link leads elsewhere."""
    variant = tmp_path / "variants" / ("0" * 32)
    variant.mkdir(parents=True)
    with BagWriter(variant / "recording.bag") as bag:
        for second, brightness in ((100, 10), (103, 250)):
            pixels = np.full((6, 8), brightness, dtype=np.uint8)
            bag.image("/camera", second * 10**9, "camera", "mono8", pixels)
    (variant / "variant.json").write_text(json.dumps({"format": "Rosbag1", "recording": "recording.bag"}))
    runs = []
    for number, target in enumerate((variant, tmp_path / "secrets")):
        folder = tmp_path / "runs" / "study" / f"run-00{number}" / "run"
        folder.mkdir(parents=True)
        (folder / "dataset").symlink_to(target)
        runs.append(make_run(number, folder=f"runs/study/run-00{number}"))
    with Archive.open(url) as archive:
        archive.put_runs([*runs, make_run(2)])
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_what_a_camera_saw_at_a_moment(filmed: Any) -> None:
    for moment, stamp, brightness in ((100.4, 100.0, 10), (102.9, 103.0, 250)):
        answer = await filmed.get(f"/runs/uid-000/images?t={moment}")
        [image] = answer["images"]
        assert (image["topic"], image["stamp"]) == ("/camera", stamp)
        pixels = cv2.imdecode(np.frombuffer(base64.b64decode(image["data"]), np.uint8), cv2.IMREAD_UNCHANGED)
        assert pixels.shape[:2] == (6, 8)
        assert abs(int(pixels.mean()) - brightness) < 3


@pytest.mark.parametrize(
    ("question", "part"),
    [
        ("uid-000/images?t=101.5", "no image within a second"),
        (
            "uid-001/images?t=100",
            "does not say which recording",
        ),  # a link that leads elsewhere is not followed
        ("uid-002/images?t=100", "not at hand here"),
        ("uid-9/images?t=100", "there is no run"),
    ],
)
async def test_why_there_is_no_image(filmed: Any, question: str, part: str) -> None:
    assert part in (await filmed.get(f"/runs/{question}", 404))["error"]
