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
from slamhive.analysis.grouping import Outcomes, aggregate, unranked_notes, varying
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.metrics import Metric
from slamhive.analysis.selection import Selection, choose, order_rows
from slamhive.analysis.statistics import Numbers
from slamhive.model.errors import InputError
from slamhive.tables.text import table_columns
from slamhive.tables.words import meanings


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
    return Numbers(np.array(values), np.zeros(len(values), dtype=np.intp), 1).summaries().of(0)


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
    # A run that was measured in two ways is one run all the same.
    ended = row(None, None, reason="NodeLost")
    both = [
        one | {"id": n, "evaluation": way} for n, one in enumerate([*rows, ended]) for way in ("se3", "sim3")
    ]
    notes = aggregate(frame_of(both), ["usage.cpu.meanCores"]).notes
    assert any(note.startswith("2 runs shared cores") for note in notes)
    assert unranked_notes(frame_of(both), Outcomes.TRACKED)[0].startswith("1 NodeLost:")


@pytest.mark.parametrize(
    ("wall", "busy", "waited", "alone"),
    [
        (10.0, 4.0, None, 10.0),
        (35.0, 4.0, 30.0, 5.0),
        (10.0, 10.0, 10.0, 5.0),  # two threads, each of which waited half of the time
        (20.0, None, 5.0, 15.0),
        (None, None, None, math.nan),
    ],
)
def test_undisturbed_is_the_wall_time_without_the_wait_for_others(
    wall: float | None, busy: float | None, waited: float | None, alone: float
) -> None:
    given = {"wallSeconds": wall, "cpu.seconds": busy, "contendedSeconds": waited}
    rows = [row(1.0, **{f"usage.{name}": value for name, value in given.items() if value is not None})]
    assert frame_of(rows).column("usage.undisturbedSeconds").floats() == pytest.approx([alone], nan_ok=True)


@pytest.mark.parametrize(
    ("metric", "changes", "told"),
    [
        ("usage.memory.peakBytes", {}, "31 s late in 2 runs"),
        ("usage.memory.peakBytes", {"prepared.frameRate": 10.0}, "31 s late in 2 runs"),
        ("usage.memory.peakBytes", {"prepared.frameRate": 30.0}, "31 s late in 3 runs"),  # 6 frames
        ("usage.memory.peakBytes", {"prepared.frameRate": 10.0, "input.rate": 3.0}, "31 s late in 3 runs"),
        ("usage.memory.peakBytes", {"input.pace": "Stepped"}, None),  # the clock waited, no frame did
        ("ate.rmse", {}, None),
    ],
)
def test_of_nodes_whose_poses_came_late_memory_is_told_to_hold_what_waited(
    metric: str, changes: dict[str, Any], told: str | None
) -> None:
    late = "metrics.latencySeconds.max"
    rows = [
        row(1.0, **{late: seconds, "usage.memory.peakBytes": 9.0, "input.pace": "Realtime"} | changes)
        for seconds in (0.2, 12.0, 31.4)
    ]
    found = aggregate(frame_of(rows), [metric])
    sentence = f"§ poses came up to {told}: memory says how far it fell behind, not what it needs"
    assert [note for note in found.notes if "§" in note] == ([sentence] if told else [])
    if metric.startswith("usage.memory."):
        assert found.cells[0].late is (told is not None)


PACES = ("Lockstep", "Realtime", "Stepped")


@pytest.mark.parametrize("asked", [None, ("algorithm",), ("dataset",), ()])
def test_runs_of_three_paces_are_never_averaged(asked: tuple[str, ...] | None) -> None:
    rows = [row(error, **{"input.pace": pace}) for pace, error in zip(PACES, (1.0, 2.0, 4.0), strict=True)]
    found = aggregate(frame_of(rows), ["ate.rmse"], asked)
    assert {cell.keys["input.pace"]: cell.figures["ate.rmse"].summary for cell in found.cells} == {
        pace: mean_of([error]) for pace, error in zip(PACES, (1.0, 2.0, 4.0), strict=True)
    }


def played(**changes: Any) -> dict[str, Any]:
    """Return a row of a run to which a player played, and which published all its poses but once."""
    return row(0.5, **{"input.pace": "Realtime", "metrics.posesPublished": 90, "coverage": 0.9} | changes)


@pytest.mark.parametrize(
    ("changes", "causal"),
    [
        ({}, 0.5),
        ({"input.pace": "Stepped"}, 0.5),
        ({"beside.online.ate.rmse": 0.8, "beside.online.outcome": "Tracked"}, 0.8),
        ({"beside.online.outcome": "Lost"}, None),  # measured, without an error
        ({"beside.online.message": "line 3: found 3 of 8 values"}, None),
        ({"input.pace": "Lockstep"}, None),  # nobody heard when the program knew what
        ({"metrics.posesPublished": 0}, None),
        ({"metrics.posesPublished": None}, None),
        ({"outcome": None, "ate.rmse": None, "reason": "AlgorithmFailed"}, None),
    ],
)
def test_who_changed_no_pose_later_has_the_final_figures_as_causal_ones(
    changes: dict[str, Any], causal: float | None
) -> None:
    other = row(2.0, **{"beside.online.ate.rmse": 3.0, "beside.online.outcome": "Tracked"})
    frame = frame_of([played(**changes), other])
    assert frame.column("beside.online.ate.rmse").tolist() == [causal, 3.0]
    if causal == 0.5:
        assert frame.column("beside.online.outcome").tolist()[0] == "Tracked"
        assert frame.column("beside.online.coverage").tolist()[0] == 0.9
    again = with_derived({name: frame.column(name) for name in frame.stored}, len(frame))
    assert again.records(frame.names) == frame.records(frame.names)


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


@pytest.mark.parametrize(
    ("name", "values"),
    [("governor", ["performance", "powersave"]), *((name, [True, False]) for name in ("smt", "turbo"))],
)
def test_loads_on_machines_of_different_settings_are_kept_apart(name: str, values: list[Any]) -> None:
    column, load = f"provenance.machine.{name}", {"usage.cpu.seconds": 5.0, "provenance.cpuModel": "x"}
    rows = [row(1.0, **load, **{column: value}) for value in values]
    assert len(aggregate(frame_of(rows), ["ate.rmse"]).cells) == 1
    found = aggregate(frame_of(rows), ["usage.cpu.seconds"])
    assert sorted(str(cell.keys[column]) for cell in found.cells) == sorted(map(str, values))
    # What earlier versions did not record keeps nothing apart.
    assert len(aggregate(frame_of([*rows[:1], row(1.0, **load)]), ["usage.cpu.seconds"]).cells) == 1


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
    assert not list(aggregate(Frame({}, 0), ["ate.rmse"]).cells)


def test_equal_trajectories_are_one_result_whose_load_still_varies() -> None:
    rows = [row(0.05, **{"trajectory.sha256": "t", "usage.cpu.seconds": load}) for load in (1.0, 2.0, 3.0)]
    found = aggregate(frame_of(rows), ["ate.rmse", "usage.cpu.seconds"])
    (cell,) = found.cells
    error, load = (cell.figures[name].summary for name in ("ate.rmse", "usage.cpu.seconds"))
    assert cell.deterministic
    assert error is not None
    assert load is not None
    assert (error.n, error.mean, error.std) == (1, 0.05, None)
    assert (load.n, load.std) == (3, 1.0)
    assert (cell.runs, cell.n, cell.copies) == (3, 1, 2)
    assert "2 runs repeat another's trajectory; loads are of all runs" in found.notes[-1]
    (loads,) = aggregate(frame_of(rows), ["usage.cpu.seconds"]).cells
    assert (loads.n, loads.copies) == (3, 0)  # a sample of loads is of runs
    rows[0]["trajectory.sha256"] = "u"
    assert not aggregate(frame_of(rows), ["ate.rmse"]).cells[0].deterministic


def repeated(ends: dict[Any, float | None], times: int = 3, **more: Any) -> list[dict[str, Any]]:
    """Return runs of a deterministic program: by setting an error, or none where it fails."""
    return [
        row(error, error and "Tracked", reason=None if error else "AlgorithmFailed", **more)
        | {"parameters.n": n, "repetition": k, "trajectory.sha256": error and f"t{n}"}
        for n, error in ends.items()
        for k in range(times)
    ]


def test_repetitions_of_a_deterministic_program_count_once_whatever_is_averaged_over() -> None:
    """Eight settings run three times each: 24 runs, of which 8 say something of the errors."""
    errors = {n: 0.01 * 2**n for n in range(8)}
    rows = [one | {"usage.cpu.seconds": 1.0 + k} for k, one in enumerate(repeated(errors))]
    found = aggregate(frame_of(rows), ["ate.rmse", "usage.cpu.seconds"], ["algorithm"])
    (cell,) = found.cells
    assert cell.figures["ate.rmse"].summary == mean_of(list(errors.values()))
    assert (cell.runs, cell.n, cell.copies, cell.deterministic) == (24, 8, 16, False)
    load = cell.figures["usage.cpu.seconds"].summary
    assert load is not None
    assert load.n == 24
    assert any("16 runs repeat" in note for note in found.notes)
    # Another program's equal trajectory is another result, and so is that on another dataset.
    rows += [one | {"dataset": "e"} for one in rows]
    assert [c.n for c in aggregate(frame_of(rows), ["ate.rmse"], ["algorithm", "dataset"]).cells] == [8, 8]


def test_a_setting_that_always_fails_weighs_as_much_as_one_that_is_always_tracked() -> None:
    """Else three equal failures would outweigh two results that came out three times each."""
    frame = frame_of(repeated({1: 0.1, 2: 0.2, 3: None}))
    (cell,) = aggregate(frame, ["ate.rmse"], ["algorithm"]).cells
    assert cell.figures["ate.rmse"].censored_median == 0.2
    assert (cell.n, cell.failures) == (2, {"AlgorithmFailed": 3})
    assert cell.coverage is not None
    assert (cell.coverage.n, cell.coverage.mean) == (3, pytest.approx(0.6))
    (grid,) = prepare(frame, ["ate.rmse"], ("algorithm",), Outcomes.TRACKED).grids
    assert grid.medians.tolist() == [[0.2]]


@pytest.mark.parametrize("version", [{}, {"evaluationVersion": 2}])
def test_failures_of_a_program_that_fails_now_and_then_count_each(version: dict[str, int]) -> None:
    rows = [one | version for one in repeated({1: 0.1, 2: 0.2})]
    rows += [
        row(None, None, reason="AlgorithmFailed") | {"parameters.n": 2, "repetition": k} for k in range(3)
    ]
    (cell,) = aggregate(frame_of(rows), ["ate.rmse"], ["algorithm"]).cells
    assert cell.figures["ate.rmse"].censored == 3
    assert cell.figures["ate.rmse"].censored_median == math.inf


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_one_value_only_has_no_spread_at_any_scale(scale: float) -> None:
    for times in (1, 12):
        (cell,) = aggregate(frame_of(repeated({1: scale}, times)), ["ate.rmse"]).cells
        figure = cell.figures["ate.rmse"]
        assert figure.summary == mean_of([scale])
        assert (figure.mean_interval, figure.median_interval) == (None, None)


def test_cpu_of_an_adapter_that_reads_by_itself_and_tells_no_clock_is_marked_beside_others() -> None:
    told = {"usage.cpu.seconds": 1.0, "usage.includesReader": False}
    rows = [
        row(1.0, algorithm="kiss-icp", **told, **{"usage.readerCpuSeconds": 0.1}),
        row(1.0, algorithm="mine", **told, **{"usage.readerCpuSeconds": None}),  # as earlier versions said it
        row(1.0, algorithm="mine-too", **told | {"usage.includesReader": None}),
    ]
    frame = frame_of(rows)
    assert frame.column("usage.includesReader").tolist() == [False, None, None]
    metrics = [Metric(name, "", 1.0, "") for name in ("ate.rmse", "usage.cpu.seconds")]
    found = aggregate(frame, [one.column for one in metrics], ["algorithm"])
    lines = zip(*table_columns(found, (), metrics)[1], strict=True)
    assert [["‡" in cell for cell in line[1:3]] for line in lines] == [[False, False]] + [[False, True]] * 2
    assert any(note.startswith("‡ the CPU of mine, mine-too holds the reading") for note in found.notes)
    # Where no other's is without it there is nothing beside which it could be misread.
    assert not any("‡" in note for note in aggregate(frame_of(rows[1:]), ["usage.cpu.seconds"]).notes)
    assert not any("‡" in note for note in aggregate(frame, ["ate.rmse"]).notes)
    # Of records of others there can be the mean load alone.
    mean = {"usage.cpu.seconds": None, "usage.cpu.meanCores": 1.5, "usage.includesReader": True}
    frame = frame_of([rows[0], row(1.0, algorithm="theirs", **mean)])
    noted = aggregate(frame, ["usage.cpu.meanCores"], ["algorithm"]).notes
    assert any(note.startswith("‡ the CPU of theirs holds the reading") for note in noted)
    # A run that was ended before it could say so has no figure that is shown.
    ended = row(None, algorithm="kiss-icp", phase="Failed", **told | {"usage.includesReader": None})
    frame = frame_of([rows[0], ended])
    assert not any("‡" in note for note in aggregate(frame, ["usage.cpu.seconds"]).notes)
    assert meanings(frame, ["usage.cpu.seconds"]) == ["CPU time: CPU seconds of a run, without the reader"]


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


OLD = "measured by an earlier version of the evaluation: evaluationVersion tells them apart"


def test_versions_of_the_evaluation_are_never_averaged() -> None:
    """The first version named itself nowhere."""
    rows = [row(1.0), row(3.0), row(5.0, evaluationVersion=2), row(7.0, evaluationVersion=2)]
    chosen = choose(frame_of(rows), Selection())
    found = aggregate(chosen.frame, ["ate.rmse"])
    told = [(cell.keys["evaluationVersion"], cell.figures["ate.rmse"].summary.mean) for cell in found.cells]
    assert told == [(1, 2.0), (2, 6.0)]
    assert [note for note in chosen.notes if "2 runs were " + OLD in note]
    assert "slamhive results measure" in chosen.notes[0]
    ranked = prepare(chosen.frame, ["ate.rmse"], ("algorithm",), Outcomes.TRACKED)
    assert sorted(grid.facets["evaluationVersion"] for grid in ranked.grids) == [1, 2]


def test_one_version_of_the_evaluation_is_not_told() -> None:
    failed = row(None, None, reason="AlgorithmFailed")
    for rows in ([row(1.0), failed], [row(1.0, evaluationVersion=2), failed]):
        chosen = choose(frame_of(rows), Selection())
        assert chosen.notes == ()
        [cell] = aggregate(chosen.frame, ["ate.rmse"]).cells
        assert "evaluationVersion" not in cell.keys
        assert cell.failures == {"AlgorithmFailed": 1}
    # Another evaluation may have stayed as it was.
    both = [row(1.0, evaluation="mine"), row(2.0, evaluationVersion=2)]
    assert choose(frame_of(both), Selection()).notes == ()


def test_of_equal_content_what_the_later_version_measured_counts() -> None:
    content = {"provenance.contentHash": "c"}
    rows = [row(2.0, **content, created=1.0, evaluationVersion=2), row(1.0, **content, created=2.0)]
    assert choose(frame_of(rows), Selection()).frame.column("ate.rmse").tolist() == [2.0]


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
    frame = frame_of([row(1.0), row(None, None), row(3.0), row(2.0)])
    errors = frame.column("ate.rmse").tolist()
    cells = aggregate(frame, ["ate.rmse"], ["id"]).cells
    for sort, expected in (("ate.rmse", [1.0, 2.0, 3.0, None]), ("-ate.rmse", [3.0, 2.0, 1.0, None])):
        assert [errors[place] for place in order_rows(frame, [sort])] == expected
        summaries = [cell.figures["ate.rmse"].summary for cell in cells.sorted([sort])]
        assert [one.mean if one else None for one in summaries] == expected
