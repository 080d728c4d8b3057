# SPDX-License-Identifier: Apache-2.0
"""The table of runs: figures over groups, and that nothing is lost, mixed or counted twice on the way."""

from __future__ import annotations

import math
import statistics
from typing import Any

import numpy as np
import pytest

from slamhive.analysis.boards import prepare
from slamhive.analysis.columns import Column
from slamhive.analysis.derived import SweepVersion, with_derived
from slamhive.analysis.frame import Frame
from slamhive.analysis.grouping import Outcomes, aggregate, varying
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.selection import Selection, choose, order_by
from slamhive.analysis.statistics import Numbers
from slamhive.model.errors import InputError


def row(rmse: float | None = 1.0, outcome: str | None = "Tracked", **changes: Any) -> dict[str, Any]:
    """Return the row of a run that was measured, or of one that failed and was meant to be."""
    base = {
        "algorithm": "a",
        "sensors": "lidar",
        "dataset": "d",
        "evaluation": "default",
        "alignment": "se3",
        "phase": "Succeeded" if outcome else "Failed",
        "outcome": outcome,
        "coverage": 0.9 if outcome else None,
        "ate.rmse": rmse,
    }
    return base | changes


def frame_of(rows: list[dict[str, Any]], sweeps: tuple[SweepVersion, ...] = ()) -> Frame:
    """Return rows as a table, each of a run of its own unless it says which."""
    rows = [{"id": number, **one} for number, one in enumerate(rows)]
    names = dict.fromkeys(name for one in rows for name in one)
    return with_derived({n: Column.of([one.get(n) for one in rows]) for n in names}, len(rows), sweeps)


def mean_of(values: list[float]) -> Any:
    return Numbers(np.array(values), np.zeros(len(values), dtype=np.intp), 1).summaries()[0]


def test_mean_and_sample_deviation_of_tracked_runs() -> None:
    rows = [
        row(1.0),
        row(2.0),
        row(4.0),
        row(100.0, "Lost", coverage=0.3),
        row(None, None, reason="OutOfMemory"),
        row(None, None, reason="NodeLost"),
    ]
    (cell,) = aggregate(frame_of(rows), ["ate.rmse"]).cells
    ate = cell.figures["ate.rmse"].summary
    assert ate is not None
    assert (ate.n, ate.mean, ate.std) == (3, 7 / 3, pytest.approx(statistics.stdev([1, 2, 4])))
    assert (ate.median, ate.min, ate.max) == (2.0, 1.0, 4.0)
    assert (cell.runs, cell.n, cell.failures) == (6, 3, {"Lost": 1, "NodeLost": 1, "OutOfMemory": 1})


def test_coverage_counts_what_the_algorithm_lost_and_not_what_the_machine_did() -> None:
    rows = [
        row(1.0, coverage=1.0),
        row(None, None, reason="AlgorithmFailed"),
        row(None, None, reason="NodeLost"),
        row(None, None, phase="Cancelled"),
        row(None, None, phase="Succeeded"),
    ]
    (cell,) = aggregate(frame_of(rows), ["ate.rmse"]).cells
    assert cell.coverage == mean_of([1.0, 0.0])


def test_a_disturbed_run_says_nothing_of_load_but_all_else_counts() -> None:
    load = {"usage.wallSeconds": 10.0, "usage.cpu.meanCores": 0.9, "usage.cpu.seconds": 9.0}
    rows = [
        row(1.0, **load, **{"usage.contendedSeconds": 0.5}),
        row(1.0, **load | {"usage.cpu.meanCores": 0.3}, **{"usage.contendedSeconds": 6.0}),
        row(1.0, **load | {"usage.cpu.meanCores": 0.4}, **{"usage.throttledSeconds": 2.0}),
    ]
    found = aggregate(frame_of(rows), ["usage.cpu.meanCores", "usage.cpu.seconds", "ate.rmse"])
    (cell,) = found.cells
    assert cell.figures["usage.cpu.meanCores"].summary == mean_of([0.9])
    assert cell.figures["usage.cpu.seconds"].summary == mean_of([9.0] * 3)
    assert cell.figures["ate.rmse"].summary == mean_of([1.0] * 3)
    assert "2 runs shared cores" in found.notes[-1]


@pytest.mark.parametrize(("metric", "said"), [("usage.memory.peakBytes", True), ("ate.rmse", False)])
def test_of_programs_that_fell_behind_memory_is_told_to_hold_what_waited(metric: str, said: bool) -> None:
    late = "metrics.latencySeconds.max"
    rows = [row(1.0, **{late: seconds, "usage.memory.peakBytes": 9.0}) for seconds in (0.2, 12.0, 31.4)]
    notes = aggregate(frame_of(rows), [metric]).notes
    told = "2 runs fell up to 31 s behind in real time: their memory holds what waited"
    assert (told in notes) is said


def test_all_evaluated_runs_on_request() -> None:
    rows = [row(1.0), row(3.0, "Partial"), row(None, None)]
    (cell,) = aggregate(frame_of(rows), ["ate.rmse"], outcomes=Outcomes.ALL).cells
    assert cell.figures["ate.rmse"].summary == mean_of([1.0, 3.0])
    assert (cell.runs, cell.n, cell.failures, cell.untracked) == (3, 2, {"Failed": 1}, {"Partial": 1})


def test_a_group_without_tracked_runs_stays() -> None:
    (cell,) = aggregate(frame_of([row(5.0, "Diverged")]), ["ate.rmse"]).cells
    assert (cell.n, cell.figures["ate.rmse"].summary, cell.failures) == (0, None, {"Diverged": 1})


@pytest.mark.parametrize(
    "facet",
    [
        *("algorithm", "dataset", "sensors", "alignment", "settings", "input.pace"),
        "provenance.algorithmHash",
    ],
)
def test_what_must_not_be_mixed_becomes_a_key(facet: str) -> None:
    rows = [row(1.0, **{facet: "x"}), row(2.0, **{facet: "y"})]
    found = aggregate(frame_of(rows), ["ate.rmse"], ["parameters.p"])
    assert [cell.runs for cell in found.cells] == [1, 1]
    assert len({str(cell.keys) for cell in found.cells}) == 2


def test_loads_of_processors_are_kept_apart_and_errors_are_not() -> None:
    load = {"usage.cpu.seconds": 5.0}
    rows = [row(1.0, **load, **{"provenance.cpuModel": name}) for name in ("x", "y")]
    assert len(aggregate(frame_of(rows), ["ate.rmse"]).cells) == 1
    assert [
        c.keys["provenance.cpuModel"] for c in aggregate(frame_of(rows), ["usage.cpu.seconds"]).cells
    ] == [
        "x",
        "y",
    ]


def test_a_failed_run_counts_once_in_the_evaluation_that_it_would_have_had() -> None:
    rows = [
        row(1.0, sensors="stereo", evaluation="se3"),
        row(2.0, sensors="mono", evaluation="sim3", alignment="sim3"),
        row(None, None, sensors="stereo", evaluation="se3", reason="NoTrajectory"),
    ]
    found = aggregate(frame_of(rows), ["ate.rmse"])
    assert [(c.keys["sensors"], c.n, c.failures) for c in found.cells] == [
        ("stereo", 1, {"NoTrajectory": 1}),
        ("mono", 1, {}),
    ]
    boards = leaderboard(frame_of(rows)).boards
    assert sorted(len(board.entries) for board in boards) == [1, 1]


def test_a_run_of_no_known_evaluation_is_nobodys_failure() -> None:
    rows = [row(1.0), row(None, None, evaluation=None, alignment=None, reason="NoTrajectory")]
    found = aggregate(frame_of(rows), ["ate.rmse"])
    assert [(c.keys["evaluation"], c.runs, c.n) for c in found.cells] == [("default", 1, 1), (None, 1, 0)]


@pytest.mark.parametrize("name", ["usage.includesReader", "provenance.cpuModel", "alignment", "settings"])
def test_rows_do_not_split_by_what_is_unknown(name: str) -> None:
    more = {"usage.cpu.seconds": 1.0}
    known = [
        row(1.0, algorithm="a", **more, **{name: "x"}),
        row(1.0, algorithm="b", **more, **{name: "y"}),
    ]
    failed = row(None, None, algorithm="a", reason="OutOfMemory", **{name: None})
    found = aggregate(frame_of([*known, failed]), ["ate.rmse", "usage.cpu.seconds"], ["algorithm"])
    assert [(c.keys["algorithm"], c.runs) for c in found.cells] == [("a", 2), ("b", 1)]
    # Where others like it differ, nobody knows whose it is.
    both = [*known, row(1.0, algorithm="a", **more, **{name: "y"}), failed]
    found = aggregate(frame_of(both), ["ate.rmse", "usage.cpu.seconds"], ["algorithm"])
    assert sorted(c.runs for c in found.cells) == [1, 1, 1, 1]


def test_default_rows_are_what_varies() -> None:
    rows = [
        row(k, **{"parameters.n": n, "parameters.same": 1, "input.frameRate": 10})
        for n in (500, 1000)
        for k in (1.0, 3.0)
    ]
    rows += [row(9.0, algorithm="b", **{"parameters.other": 5})]
    found = aggregate(frame_of(rows), ["ate.rmse"])
    assert found.keys == ("algorithm", "sensors", "dataset", "parameters.n")
    means = [cell.figures["ate.rmse"].summary for cell in found.cells]
    assert [summary and summary.mean for summary in means] == [2.0, 2.0, 9.0]
    assert found.notes == ()


def test_pooling_over_parameters_is_said() -> None:
    rows = [row(1.0, **{"parameters.n": 1}), row(2.0, **{"parameters.n": 2})]
    found = aggregate(frame_of(rows), ["ate.rmse"], ["dataset"])
    assert len(found.cells) == 1
    assert found.notes == ("averaged over different values of parameters.n",)


def test_a_parameter_that_some_runs_lack_varies() -> None:
    assert varying(frame_of([row(**{"parameters.a": 1}), row()])) == ["parameters.a"]
    assert varying(frame_of([row(**{"parameters.a": 1}), row(algorithm="b")])) == []


def test_columns_lie_across() -> None:
    rows = [row(1.0), row(2.0, dataset="e")]
    found = aggregate(frame_of(rows), ["ate.rmse"], ["algorithm"], across=["dataset"])
    assert [cell.keys for cell in found.cells] == [
        {"algorithm": "a", "dataset": "d"},
        {"algorithm": "a", "dataset": "e"},
    ]


def test_groups_are_sorted_as_numbers() -> None:
    rows = [row(**{"parameters.n": n}) for n in (1000, 500, None, "auto", 250.5)]
    found = aggregate(frame_of(rows), [], ["parameters.n"])
    assert [c.keys["parameters.n"] for c in found.cells] == [250.5, 500, 1000, "auto", None]


def test_values_that_are_no_numbers_stay_out_of_means() -> None:
    rows = [row(value) for value in (1.0, math.nan, math.inf, None, True)] + [row("x")]  # type: ignore[arg-type]
    (cell,) = aggregate(frame_of(rows), ["ate.rmse"]).cells
    assert cell.figures["ate.rmse"].summary == mean_of([1.0])


def test_no_rows() -> None:
    assert aggregate(Frame({}, 0), ["ate.rmse"]).cells == []


def test_equal_trajectories_are_one_result_whose_load_still_varies() -> None:
    rows = [row(0.05, **{"trajectory.sha256": "t", "usage.cpu.seconds": load}) for load in (1.0, 2.0, 3.0)]
    found = aggregate(frame_of(rows), ["ate.rmse", "usage.cpu.seconds"])
    (cell,) = found.cells
    error, load = (cell.figures[name].summary for name in ("ate.rmse", "usage.cpu.seconds"))
    assert cell.deterministic
    assert error is not None
    assert load is not None
    assert (error.n, error.mean, error.std) == (3, 0.05, None)
    assert load.std == 1.0
    assert "deterministic: one result, n equal runs" in found.notes[-1]
    rows[0]["trajectory.sha256"] = "u"
    assert not aggregate(frame_of(rows), ["ate.rmse"]).cells[0].deterministic


def test_a_rank_is_lost_by_the_algorithms_own_failures_alone() -> None:
    rows = [
        row(1.0),
        row(None, None, reason="NodeLost"),
        row(None, None, reason="NodeLost"),
        row(2.0, algorithm="b"),
        row(None, None, algorithm="b", reason="AlgorithmFailed"),
        row(None, None, algorithm="b", reason="AlgorithmFailed"),
    ]
    found = prepare(frame_of(rows), ["ate.rmse"], ("algorithm",), Outcomes.TRACKED)
    (grid,) = found.grids
    assert grid.medians.tolist() == [[1.0], [math.inf]]
    assert any("2 NodeLost" in note for note in found.notes)


CHANGED = {"provenance.algorithmHash": "old", "provenance.contentHash": "c-old", "created": 1.0}
NOW = {"provenance.algorithmHash": "new", "provenance.contentHash": "c-new", "created": 2.0}


def test_an_edited_algorithm_supersedes_what_it_was() -> None:
    frame = frame_of([row(1.0, **CHANGED), row(3.0, **NOW), row(7.0, algorithm="other", created=1.0)])
    assert frame.column("superseded").tolist() == ["algorithm changed", None, None]
    chosen = choose(frame, Selection())
    assert chosen.frame.column("ate.rmse").tolist() == [3.0, 7.0]
    assert chosen.notes == ("1 run of earlier versions left out (algorithm changed)",)
    both = aggregate(choose(frame, Selection(superseded=True)).frame, ["ate.rmse"], ["algorithm"])
    assert "algorithm.version" in both.keys
    assert [cell.runs for cell in both.cells] == [1, 1, 1]


def test_an_algorithm_of_the_same_name_elsewhere_supersedes_nothing() -> None:
    frame = frame_of([row(1.0, **CHANGED, namespace="lab"), row(3.0, **NOW, namespace="students")])
    assert frame.column("superseded").is_empty


@pytest.mark.parametrize("name", ["provenance.datasetSha256", "provenance.preparation"])
def test_another_recording_supersedes_the_former_one(name: str) -> None:
    frame = frame_of([row(1.0, created=1.0, **{name: "x"}), row(1.0, created=2.0, **{name: "y"})])
    assert frame.column("superseded").tolist() == ["dataset changed", None]


def test_an_edited_sweep_supersedes_the_points_that_it_has_no_longer() -> None:
    versions = (SweepVersion("s1", "study", created=1.0), SweepVersion("s2", "study", created=2.0))
    rows = [row(1.0, sweep="study", **{"sweep.uid": uid}) for uid in ("s1", "s2")]
    assert frame_of(rows, versions).column("superseded").tolist() == ["sweep edited", None]
    # The edit taken back: the first version is asked for last.
    again = (versions[0]._replace(created=3.0), versions[1])
    assert frame_of(rows, again).column("superseded").tolist() == [None, "sweep edited"]


def test_a_selection_of_superseded_runs_alone_says_so() -> None:
    frame = frame_of([row(1.0, **CHANGED, sweep="before"), row(3.0, **NOW, sweep="after")])
    chosen = choose(frame, Selection(sweeps=("before",)))
    assert (len(chosen.frame), chosen.superseded) == (0, 1)
    assert "all 1 run selected is of earlier versions (algorithm changed)" in chosen.notes[0]


def test_equal_content_counts_once_as_the_run_that_computed_it() -> None:
    content = {"provenance.contentHash": "c"}
    rows = [
        row(1.0, **content, created=5.0, **{"provenance.reusedFrom": "x"}),
        row(1.0, **content, created=1.0, name="x"),
        row(None, None, **content, created=9.0, reason="NodeLost"),
        row(2.0, **{"provenance.contentHash": "d"}),
        row(3.0),
        row(3.0),
    ]
    chosen = choose(frame_of(rows), Selection())
    assert chosen.frame.column("id").tolist() == [1, 3, 4, 5]
    assert chosen.notes == ("2 runs repeat the content of others: equal content counts once",)
    assert len(choose(frame_of(rows), Selection(each=True)).frame) == 6


def test_equal_content_measured_in_two_ways_counts_in_both() -> None:
    rows = [row(1.0, evaluation=name, **{"provenance.contentHash": "c"}) for name in ("se3", "sim3")]
    assert len(choose(frame_of(rows), Selection()).frame) == 2


def test_an_evaluation_has_the_runs_that_it_was_meant_to_measure() -> None:
    rows = [row(1.0, evaluation="se3"), row(2.0, evaluation="sim3"), row(None, None, evaluation="se3")]
    assert choose(frame_of(rows), Selection(evaluation="se3")).frame.column("id").tolist() == [0, 2]
    with pytest.raises(InputError, match=r"^evaluation: unknown evaluation 'se4'"):
        choose(frame_of(rows), Selection(evaluation="se4"))


def test_sweeps_of_one_name_in_two_places_are_told_apart() -> None:
    rows = [row(1.0, sweep="first", namespace=place) for place in ("lab", "students", None)]
    frame = frame_of(rows)
    with pytest.raises(InputError, match="several sweeps are called 'first': write which of"):
        choose(frame, Selection(sweeps=("first",)))
    for name, place in (("lab/first", 0), ("students/first", 1), ("/first", 2)):
        assert choose(frame, Selection(sweeps=(name,))).frame.column("id").tolist() == [place]


def test_unfinished_runs_are_listed_and_not_counted() -> None:
    frame = frame_of([row(1.0), row(None, None, phase="Running")])
    chosen = choose(frame, Selection())
    assert (len(chosen.frame), chosen.notes) == (1, ("1 run not finished yet",))
    assert len(choose(frame, Selection(each=True)).frame) == 2


def test_missing_values_come_last_either_way() -> None:
    items = [{"a": 1}, {"a": None}, {"a": 3}, {"a": 2, "b": 1}]

    def get(item: dict[str, Any], name: str) -> Any:
        return item.get(name)

    assert [i["a"] for i in order_by(items, ["a"], get)] == [1, 2, 3, None]
    assert [i["a"] for i in order_by(items, ["-a"], get)] == [3, 2, 1, None]
    assert [i["a"] for i in order_by(items, ["b", "-a"], get)] == [2, 3, 1, None]
