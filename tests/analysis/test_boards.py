# SPDX-License-Identifier: Apache-2.0
"""Tests of leaderboards, comparisons, importance and repetitions on studies whose truth is known."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.analysis.boards import Window
from slamhive.analysis.columns import Column
from slamhive.analysis.comparing import BoardComparison, CompetitorPair, compare
from slamhive.analysis.derived import SweepVersion, with_derived
from slamhive.analysis.grouping import aggregate
from slamhive.analysis.importance import importance
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.pareto import nondominated, pareto
from slamhive.analysis.repeating import repeatability, spread_within, suspects
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame

SCALES = {"dataset-0": 0.01, "dataset-1": 1.0, "dataset-2": 100.0}


def make_row(algorithm: str, dataset: str, error: float | None, **more: Any) -> dict[str, Any]:
    row = {
        "algorithm": algorithm,
        "sensors": "stereo",
        "dataset": dataset,
        "phase": "Succeeded" if error is not None else "Failed",
        "outcome": "Tracked" if error is not None else None,
        "reason": None if error is not None else "AlgorithmFailed",
        "evaluation": "se3",
        "alignment": "se3",
        "ate.rmse": error,
        "coverage": 1.0 if error is not None else None,
    }
    return row | more


def frame_of(rows: list[dict[str, Any]]) -> Frame:
    names = dict.fromkeys(name for row in rows for name in row)
    return with_derived({name: Column.of([row.get(name) for row in rows]) for name in names}, len(rows))


def study(
    factors: dict[str, float], repetitions: int = 5, datasets: int = 3, spread: float = 0.01
) -> list[dict[str, Any]]:
    chance = random.Random(1)
    names = [f"dataset-{number}" for number in range(datasets)]
    return [
        make_row(name, dataset, SCALES.get(dataset, 1.0) * factor * chance.lognormvariate(0, spread), uid=k)
        for name, factor in factors.items()
        for dataset in names
        for k in range(repetitions)
    ]


def test_ranks_do_not_depend_on_the_metres_of_a_dataset() -> None:
    (board,) = leaderboard(frame_of(study({"best": 1.0, "middle": 2.0, "last": 4.0}))).boards
    assert [entry.keys["algorithm"] for entry in board.entries] == ["best", "middle", "last"]
    assert [round(entry.ratio) for entry in board.entries] == [1, 2, 4]
    assert [(e.rank_interval.low, e.rank_interval.high) for e in board.entries] == [(1, 1), (2, 2), (3, 3)]


def test_a_single_result_has_no_interval_and_what_rows_are_over_is_said() -> None:
    rows = [make_row("one", "hall", 1.0)]
    rows += [make_row("two", "hall", error, **{"parameters.n": n}) for n, error in enumerate((2.0, 3.0))]
    found = leaderboard(frame_of(rows))
    one, two = found.boards[0].entries
    assert math.isnan(one.ratio_interval.low)
    assert math.isnan(one.rank_interval.low)
    assert (two.ratio_interval.low, two.ratio_interval.high) == pytest.approx((2, 3))
    told = (
        "Rows are over 2 values of parameters.n (two): by algorithm, sensors, parameters.n tells them apart."
    )
    assert (found.pooled, found.pooling) == ({"parameters.n": 2}, told)
    assert leaderboard(frame_of(rows), by=["algorithm", "parameters.n"]).pooling == ""


def test_settings_that_rows_are_over_are_named_of_every_competitor() -> None:
    swept = {"one": ("a", "b", "c"), "two": ("z",), "three": ()}
    rows = [
        make_row(name, "hall", 1.0 + k, **{f"parameters.{one}": k for one in own}, **{"input.frameRate": k})
        for name, own in swept.items()
        for k in (1, 2)
    ]
    rows.append(make_row("three", "hall", 1.0, **{"parameters.z": 3, "input.frameRate": 1}))
    rows = [row | {"parameters.z": 3} if row["algorithm"] == "three" else row for row in rows]
    found = leaderboard(frame_of(rows))
    order = ["input.frameRate", "parameters.a", "parameters.z", "parameters.b", "parameters.c"]
    assert list(found.pooled) == order
    assert found.pooled["parameters.z"] == 2
    told = ["input.frameRate", "parameters.a (one)", "parameters.z (two)"]
    words = ", ".join(f"2 values of {one}" for one in told)
    assert found.pooling.startswith(f"Rows are over {words}, 2 further settings: by algorithm, sensors, inp")


def test_a_setting_that_changes_no_trajectory_is_named_with_whom() -> None:
    told = "n changes nothing for idle: equal trajectories at all values"
    names: list[tuple[Any, int]] = [("idle", 0), ("moved", 1), (None, 0)]  # a damaged row says no name
    rows = [
        make_row(name, dataset, 1.0, **{"parameters.n": n, "trajectory.sha256": f"{dataset} {n * moved}"})
        for name, moved in names
        for dataset in ("hall", "yard")
        for n in (1, 2)
    ]
    assert told in leaderboard(frame_of(rows)).notes
    assert told in aggregate(frame_of(rows), ["ate.rmse"], ["algorithm"]).notes
    rows[0]["trajectory.sha256"] = "another"
    assert not [note for note in leaderboard(frame_of(rows)).notes if "changes nothing" in note]


def test_equals_share_a_rank_and_are_unsure_of_it() -> None:
    (board,) = leaderboard(frame_of(study({"a": 1.0, "b": 1.0}, spread=0.3))).boards
    assert all(entry.rank_interval.low == 1 and entry.rank_interval.high == 2 for entry in board.entries)


def test_keyframes_that_were_lost_are_ranked_last_though_their_run_was_tracked() -> None:
    metric, outcome = "beside.keyframes.ate.rmse", "beside.keyframes.outcome"
    lost, partial = {metric: None, outcome: "Lost"}, {metric: 1e-4, outcome: "Partial"}
    rows = [
        make_row(name, f"dataset-{d}", 1.0, **more)
        for d in range(3)
        for name, more in (
            ("steady", {metric: 2.0, outcome: "Tracked"}),
            ("lost", lost),
            ("partial", partial),
            ("without", {metric: None, outcome: None}),
        )
    ]
    (board,) = leaderboard(frame_of(rows), metric).boards
    ratios = {entry.keys["algorithm"]: entry.ratio for entry in board.entries}
    assert ratios == {
        "steady": 1.0,
        "lost": math.inf,
        "partial": math.inf,
        "without": pytest.approx(math.nan, nan_ok=True),
    }
    found = aggregate(frame_of(rows), [metric])
    medians = {cell.keys["algorithm"]: cell.figures[metric].censored_median for cell in found.cells}
    assert medians == {"steady": 2.0, "lost": math.inf, "partial": math.inf, "without": None}


def test_equal_final_trajectories_say_nothing_of_the_spread_of_those_beside_them() -> None:
    rows = [
        make_row("a", "d", 1.0, **{"trajectory.sha256": "same", "beside.online.ate.rmse": error})
        for error in (1.0, 3.0)
    ]
    (cell,) = aggregate(frame_of(rows), ["ate.rmse", "beside.online.ate.rmse"]).cells
    final, online = (cell.figures[name].summary for name in ("ate.rmse", "beside.online.ate.rmse"))
    assert final is not None
    assert final.std is None
    assert online is not None
    assert online.std == pytest.approx(math.sqrt(2))


def test_failed_runs_are_ranked_last_and_never_dropped() -> None:
    rows = study({"steady": 2.0}, 4)
    rows += [
        make_row("gambler", f"dataset-{d}", 1e-4 if k == 0 else None) for d in range(3) for k in range(4)
    ]
    (board,) = leaderboard(frame_of(rows)).boards
    steady, gambler = board.entries
    assert (steady.keys["algorithm"], gambler.n, gambler.runs) == ("steady", 3, 12)
    assert math.isinf(gambler.ratio)
    assert gambler.standings[0].failures == {"AlgorithmFailed": 3}


def test_who_never_succeeded_has_no_rank_and_comes_last_with_a_word_why() -> None:
    rows = study({"good": 1.0, "bad": 5.0}, 3)
    rows += [make_row("never", f"dataset-{d}", None) for d in range(3) for _ in range(3)]
    frame = frame_of(rows)
    (board,) = leaderboard(frame).boards
    *ranked, last = board.entries
    assert [(entry.rank, entry.score, entry.unranked) for entry in ranked] == [(1, 0, ""), (2, 1, "")]
    assert (last.keys["algorithm"], last.unranked, last.n, last.failed) == ("never", "never succeeded", 0, 9)
    assert all(map(math.isnan, (last.rank, last.score, last.rank_interval.low)))
    assert all(math.isnan(one.rank) and math.isinf(one.median) for one in last.standings)
    assert (ranked[1].rank_interval.low, ranked[1].rank_interval.high) == (2, 2)
    # It is nobody's rival in pairs either, and no reader takes it for one of the best.
    (pairs,), _ = compare(frame)
    assert [(pair.a["algorithm"], pair.b["algorithm"]) for pair in pairs.pairs] == [("bad", "good")]
    assert not any(spot.front for front in pareto(frame, "coverage")[0] for spot in front.spots[2:])


def test_where_all_failed_nobody_is_first() -> None:
    """A board of one system that failed three times said: rank 1, score 0, 1 times the best."""
    (board,) = leaderboard(
        frame_of([make_row("never", "depth", None, repetition=k) for k in range(3)])
    ).boards
    (entry,) = board.entries
    assert math.isnan(entry.rank)
    assert math.isinf(entry.ratio)
    # One that came through once in three has a rank, though its median run failed.
    rows = [make_row("once", "depth", error) for error in (1.0, None, None)]
    (board,) = leaderboard(frame_of(rows)).boards
    assert (board.entries[0].rank, board.entries[0].ratio) == (1.0, math.inf)


def test_competitors_without_a_common_dataset_are_not_compared() -> None:
    rows = [make_row("a", "x", 1.0), make_row("b", "y", 2.0)]
    assert [len(board.entries) for board in leaderboard(frame_of(rows)).boards] == [1, 1]


@pytest.mark.parametrize(
    ("column", "metric", "boards"),
    [
        ("alignment", "ate.rmse", 2),
        ("input.pace", "ate.rmse", 2),
        ("provenance.cpuModel", "ate.rmse", 1),
        ("provenance.cpuModel", "usage.wallSeconds", 2),
        ("provenance.machine.governor", "usage.wallSeconds", 2),
    ],
)
def test_facets_are_never_mixed_silently(column: str, metric: str, boards: int) -> None:
    rows = [
        row | {column: half, "usage.wallSeconds": 1.0}
        for half in ("p", "q")
        for row in study({"a": 1, "b": 2})
    ]
    found = leaderboard(frame_of(rows), metric)
    assert len(found.boards) == boards
    said = {"provenance.cpuModel": "of different processors", "provenance.machine.governor": "governor"}
    assert any(said.get(column, "") in note for note in found.notes) or column not in said


def test_the_sequence_is_the_unit_of_a_comparison() -> None:
    few, _ = compare(frame_of(study({"a": 1.0, "b": 2.0}, repetitions=50)))
    (pair,) = few[0].pairs
    assert (pair.p, pair.least_p, pair.wins) == (0.25, 0.25, (3, 0, 0))
    assert "too few to tell" in pair.sentence
    many, _ = compare(frame_of(study({"a": 1.0, "b": 2.0}, repetitions=2, datasets=8)))
    (pair,) = many[0].pairs
    assert pair.p == pytest.approx(2 / 2**8)
    assert pair.ratio == pytest.approx(2.0, rel=0.05)
    assert pair.effect == 1.0
    assert "more than chance" in pair.sentence


def test_pairs_are_corrected_for_their_number() -> None:
    boards, _ = compare(frame_of(study({"a": 1.0, "b": 2.0, "c": 4.0}, 2, datasets=7)))
    assert [pair.p_holm for pair in boards[0].pairs] == pytest.approx([3 * 2 / 2**7] * 3)


def test_of_many_competitors_the_best_are_shown_and_all_pairs_are_corrected_for() -> None:
    factors = {f"a{k:02d}": 1.0 + (50 - k) / 10 for k in range(50)}  # the last one is the best
    frame = frame_of(study(factors, 2, datasets=6))
    (board,), notes = compare(frame)
    names = {pair.a["algorithm"] for pair in board.pairs} | {pair.b["algorithm"] for pair in board.pairs}
    assert names == {f"a{k:02d}" for k in range(38, 50)}
    assert (board.competitors, board.shown, len(board.pairs)) == (50, 12, 66)
    assert any("of 50 competitors the 12 best by mean rank are shown" in note for note in notes)
    assert "p is corrected for all pairs, shown or not" in notes
    assert {pair.p for pair in board.pairs} == {2 / 2**6}
    assert {pair.p_holm for pair in board.pairs} == {1.0}
    (next_ones,), _ = compare(frame, window=Window(3, 13))
    assert [(pair.a["algorithm"], pair.b["algorithm"]) for pair in next_ones.pairs] == [
        ("a35", "a36"),
        ("a35", "a37"),
        ("a36", "a37"),
    ]
    assert not compare(frame, window=Window(3, 51))[0][0].pairs


def test_pairs_of_some_datasets_are_tested_like_those_of_all() -> None:
    rows = study({"a": 1.0, "b": 2.0, "c": 4.0, "d": 4.5}, 2, datasets=7)
    lacking = [row for row in rows if (row["algorithm"], row["dataset"]) != ("c", "dataset-2")]
    (whole,), (part,) = compare(frame_of(rows))[0], compare(frame_of(lacking))[0]

    def told(board: BoardComparison) -> dict[tuple[str, str], CompetitorPair]:
        return {(pair.a["algorithm"], pair.b["algorithm"]): pair for pair in board.pairs}

    for names, pair in told(part).items():
        assert "dataset-2" not in pair.datasets or "c" not in names
        assert pair.p == 2.0 ** (1 - (6 if "c" in names else 7))
        alike = told(whole)[names]
        assert (pair.effect, pair.wins[1:]) == (alike.effect, alike.wins[1:])
        assert pair.ratio == pytest.approx(alike.ratio, rel=0.05)
        assert pair.ratio_interval.low <= pair.ratio <= pair.ratio_interval.high


def test_more_competitors_than_can_be_tested_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.analysis.comparing.MOST_TESTED", 2)
    with pytest.raises(InputError, match=r"pairs by algorithm, sensors: 3 competitors .* at most 2"):
        compare(frame_of(study({"a": 1.0, "b": 2.0, "c": 4.0})))


def test_a_failure_outweighs_any_error() -> None:
    rows = [make_row("a", f"d{k}", 1.0 if k else None) for k in range(6)]
    rows += [make_row("b", f"d{k}", 1.1) for k in range(6)]
    boards, _ = compare(frame_of(rows))
    (pair,) = boards[0].pairs
    assert pair.wins == (5, 1, 0)
    assert math.isnan(pair.ratio)
    assert pair.p > 0.3


def test_those_without_a_cost_come_last_on_a_front_by_their_error() -> None:
    rows = [make_row(name, "x", error) for name, error in (("far", 3.0), ("near", 1.0), ("mid", 2.0))]
    rows.append(make_row("known", "x", 9.0, **{"usage.cpu.seconds": 1.0}))
    ((front,), _) = pareto(frame_of(rows), "usage.cpu.seconds")
    assert [spot.keys["algorithm"] for spot in front.spots] == ["known", "near", "mid", "far"]


def test_the_front_holds_those_nobody_beats_in_both() -> None:
    spots = {
        "cheap": (1.0, 3.0),
        "good": (3.0, 1.0),
        "both": (2.0, 2.0),
        "beaten": (2.5, 2.5),
        "lost": (0.1, None),
    }
    rows = [
        make_row(name, "x", error, **{"usage.cpu.seconds": cost}) for name, (cost, error) in spots.items()
    ]
    fronts, _ = pareto(frame_of(rows), "usage.cpu.seconds")
    assert [(spot.keys["algorithm"], spot.front) for spot in fronts[0].spots] == [
        ("cheap", True),
        ("both", True),
        ("beaten", False),
        ("good", True),
        ("lost", False),
    ]
    assert math.isinf(fronts[0].spots[-1].y)


def settings_study() -> list[dict[str, Any]]:
    chance = random.Random(2)
    rows = []
    for number in range(240):
        a, b, c = number % 3, number // 3 % 4, number // 12 % 2
        error = math.exp(1.0 * a + (0.8 if b in (0, 3) and c else 0.0) + chance.gauss(0, 0.1))
        more = {"parameters.a": a, "parameters.b": b, "parameters.c": c, "parameters.text": "xyz"[number % 3]}
        rows.append(make_row("alg", "x", error, **more, **{"sweep.uid": "s" if number < 200 else "t"}))
    return rows


def test_the_setting_that_matters_is_found() -> None:
    rows = frame_of(settings_study())
    searched = [SweepVersion("s", "s"), SweepVersion("t", "t", search="TPE")]
    frame = with_derived({name: rows.column(name) for name in rows.stored}, len(rows), searched)
    (subject,), notes = importance(frame, "ate.rmse")
    assert notes == ["40 runs that a search chose by results (TPE) are left out"]
    strongest = subject.influences[0]
    assert strongest.name in {"parameters.a", "parameters.text"}
    assert strongest.variance == pytest.approx(0.8, abs=0.1)
    by_name = {one.name: one for one in subject.influences}
    assert by_name["parameters.a"].rank_correlation == pytest.approx(0.9, abs=0.1)
    assert by_name["parameters.text"].rank_correlation is None
    assert {subject.interactions[0].a, subject.interactions[0].b} == {"parameters.b", "parameters.c"}


def test_equal_trajectories_count_once() -> None:
    hashes = ["same"] * 4 + ["other"]
    rows = [
        make_row("a", "x", 1.0 if name == "same" else 3.0, **{"trajectory.sha256": name}) for name in hashes
    ]
    (one,), _ = repeatability(frame_of(rows))
    assert (one.distinct, one.figures) == (2, (1.0, 3.0))
    assert one.relative_spread == pytest.approx(math.sqrt(2) / 2)
    (same,), _ = repeatability(frame_of(rows[:4]))
    assert same.verdict == "deterministic: one result, 4 equal runs"


def test_spread_is_of_repetitions_not_of_settings() -> None:
    settings = {1: (1.0, 1.2), 2: (9.0, 9.2, 9.4), 3: (5.0,)}
    rows = [
        make_row("a", "x", error, **{"parameters.n": number})
        for number, errors in settings.items()
        for error in errors
    ]
    found, _ = repeatability(frame_of(rows))
    # Of 1 and 2 degrees of freedom; a setting that ran once says nothing.
    pooled = math.sqrt((1 * 0.02 + 2 * 0.04) / 3)
    assert spread_within(found, ("algorithm", "dataset")) == {("a", "x"): pytest.approx(pooled)}


@pytest.mark.parametrize("again", [0, 2])
def test_a_single_run_says_nothing_of_repeatability(again: int) -> None:
    rows = [make_row("a", "x", 1.0), make_row("b", "x", 1.0), *[make_row("c", "x", 2.0)] * again]
    found, notes = repeatability(frame_of(rows))
    assert [one.cell.keys["algorithm"] for one in found] == ["c"] * bool(again)
    assert notes == ["2 configurations ran once: a single run says nothing of repeatability"]


@pytest.mark.parametrize(
    ("scales", "found"),
    [([0.957, 0.9571, 0.9569], 1), ([0.95, 1.02, 1.0], 0), ([1.001, 1.001, 1.001], 0), ([0.957, 0.957], 0)],
)
def test_a_scale_that_is_off_by_the_same_factor_is_suspect(scales: list[float], found: int) -> None:
    rows = [make_row("a", "x", 1.0, scale=scale, alignment="sim3") for scale in scales]
    assert len(suspects(frame_of(rows))) == found


@given(st.data())
def test_the_front_is_what_its_definition_says(data: st.DataObject) -> None:
    number = st.sampled_from([0.0, -0.0, 1.0, 2.0, 2.5, 3.0, math.inf, -math.inf, math.nan])
    points = data.draw(st.lists(st.tuples(number, number), max_size=12))
    x, y = np.array(points, dtype=float).reshape(-1, 2).T
    known = np.isfinite(x) & np.isfinite(y)
    as_good = (x[None] <= x[:, None]) & (y[None] <= y[:, None])
    better = (x[None] < x[:, None]) | (y[None] < y[:, None])
    expected = known & ~(as_good & better & known[None]).any(axis=1)
    assert nondominated(x, y).tolist() == expected.tolist()


def test_a_front_of_very_many_needs_no_table_of_pairs() -> None:
    # A table of all pairs would have 90 billion entries.
    x = np.arange(300_000.0)
    assert nondominated(x, -x).all()
    assert np.flatnonzero(nondominated(x, x)).tolist() == [0]


def test_a_board_of_too_many_is_refused_with_what_helps() -> None:
    rows = [make_row(f"a{k}", "dataset-0", 1.0) for k in range(501)]
    with pytest.raises(
        InputError, match=r"leaderboard by algorithm: 501 competitors .* at most 500 .* condition"
    ):
        leaderboard(frame_of(rows), by=["algorithm"])
    (board,) = leaderboard(frame_of(rows[:500]), by=["algorithm"], draws=2).boards
    assert len(board.entries) == 500
