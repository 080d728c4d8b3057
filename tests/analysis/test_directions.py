# SPDX-License-Identifier: Apache-2.0
"""Metrics where large is good, where small is, and those of which nobody has said: who is called better."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis import measures
from slamhive.analysis.columns import Column
from slamhive.analysis.comparing import compare
from slamhive.analysis.derived import with_derived
from slamhive.analysis.edits import edits
from slamhive.analysis.grouping import Groups, Outcomes, aggregate
from slamhive.analysis.leaderboard import leaderboard
from slamhive.analysis.measures import Better, Measure
from slamhive.analysis.pareto import pareto
from slamhive.analysis.ranking import Ranking
from slamhive.analysis.statistics import log_ratios
from slamhive.analysis.versions import before_and_after

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.analysis.frame import Frame

SPEED, LOAD = "framesPerSecond", "usage.cpu.seconds"
UNKNOWN = "metrics.loops"
"""A figure that an algorithm wrote by itself: nobody has said which way is good."""


@pytest.fixture(autouse=True)
def accuracy(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A metric where large is good, as a row of the table makes one, and a rate of the same kind."""
    within = Measure("within", "share of the poses within 5 cm", better=Better.HIGHER, is_error=True)
    for measure in (within, Measure(SPEED, better=Better.HIGHER)):
        monkeypatch.setitem(measures._BY_NAME, measure.name, measure)
    measures.measure_of.cache_clear()
    yield within.name
    measures.measure_of.cache_clear()


def make_row(algorithm: str, dataset: str, error: float | None, number: int, **more: Any) -> dict[str, Any]:
    """Return a run; None failed. Its accuracy is one over its error, so that both rank alike."""
    failed = error is None
    row = {
        "id": number,
        "algorithm": algorithm,
        "sensors": "stereo",
        "dataset": dataset,
        "phase": "Failed" if failed else "Succeeded",
        "reason": "OutOfMemory" if failed else None,
        "outcome": None if failed else "Tracked",
        "evaluation": "se3",
        "alignment": "se3",
        "ate.rmse": error,
        "within": None if error is None else 1 / error,
        UNKNOWN: error,
        "coverage": None if failed else 1.0,
    }
    return row | more


def frame_of(rows: list[dict[str, Any]]) -> Frame:
    names = dict.fromkeys(name for row in rows for name in row)
    return with_derived({name: Column.of([row.get(name) for row in rows]) for name in names}, len(rows))


@pytest.fixture
def study() -> Frame:
    """Three repetitions of three algorithms on seven datasets; most runs of one fail on two of them."""
    chance = random.Random(3)
    factors = {"good": 1.0, "middle": 2.0, "gambler": 0.5}
    return frame_of(
        [
            make_row(
                name,
                f"dataset-{place}",
                None
                if name == "gambler" and place < 2 and k
                else 10.0**place * factor * chance.lognormvariate(0, 0.1),
                place * 100 + k,
            )
            for name, factor in factors.items()
            for place in range(7)
            for k in range(3)
        ]
    )


def test_a_leaderboard_by_an_accuracy_is_that_by_its_error(study: Frame, accuracy: str) -> None:
    boards = [leaderboard(study, metric, draws=200).boards[0] for metric in ("ate.rmse", accuracy)]
    by_error, by_accuracy = (board.entries for board in boards)
    for error, share in zip(by_error, by_accuracy, strict=True):
        assert error.keys == share.keys
        assert (error.rank, error.score) == (share.rank, share.score)
        assert error.rank_interval == share.rank_interval
        assert error.ratio == pytest.approx(share.ratio)
        for one, other in zip(error.standings, share.standings, strict=True):
            assert (one.rank, one.failures) == (other.rank, other.failures)
            assert one.median == pytest.approx(1 / other.median if math.isfinite(other.median) else math.inf)


def test_a_failed_run_is_below_every_accuracy(study: Frame, accuracy: str) -> None:
    (board,) = leaderboard(study, accuracy, draws=1).boards
    gambler = next(entry for entry in board.entries if entry.keys["algorithm"] == "gambler")
    assert [(one.median, one.rank) for one in gambler.standings[:2]] == [(-math.inf, 3.0)] * 2
    assert gambler.ratio == math.inf
    cells = aggregate(study, [accuracy, "ate.rmse"], ["algorithm", "dataset"]).cells
    figures = next(cell.figures for cell in cells if list(cell.keys.values()) == ["gambler", "dataset-0"])
    assert (figures[accuracy].middle, figures["ate.rmse"].middle) == (-math.inf, math.inf)
    assert figures[accuracy].censored == figures["ate.rmse"].censored == 2


def test_an_interval_of_an_accuracy_reaches_down_to_the_failed_runs(accuracy: str) -> None:
    rows = [make_row("a", "hall", None if k < 4 else 1 + k / 10, k) for k in range(12)]
    (cell,) = aggregate(frame_of(rows), [accuracy], ["algorithm"]).cells
    interval = cell.figures[accuracy].median_interval
    assert interval is not None
    assert interval.low == -math.inf
    assert 0.45 < interval.high < 1


def test_equal_trajectories_are_one_accuracy(accuracy: str) -> None:
    rows = [make_row("a", "hall", 2.0, k, **{"trajectory.sha256": "same"}) for k in range(3)]
    (cell,) = aggregate(frame_of(rows), [accuracy], ["algorithm"]).cells
    summary = cell.figures[accuracy].summary
    assert summary is not None
    assert (cell.deterministic, summary.std) == (True, None)


def test_pairs_by_an_accuracy_are_those_by_its_error(study: Frame, accuracy: str) -> None:
    ((by_error,), _), ((by_accuracy,), _) = (compare(study, metric) for metric in ("ate.rmse", accuracy))
    for error, share in zip(by_error.pairs, by_accuracy.pairs, strict=True):
        assert (error.a, error.wins, error.p_holm) == (share.a, share.wins, share.p_holm)
        assert error.effect == pytest.approx(share.effect)
        assert error.sentence == share.sentence
        # What is told is b over a, whichever way is good.
        assert share.ratio == pytest.approx(1 / error.ratio, nan_ok=True)
        assert share.ratio_interval.low == pytest.approx(1 / error.ratio_interval.high, nan_ok=True)


def test_a_front_is_of_the_better_of_both(accuracy: str) -> None:
    spots = {
        "cheap": (1.0, 3.0),
        "good": (3.0, 1.0),
        "both": (2.0, 2.0),
        "beaten": (2.5, 2.5),
        "lost": (0.1, None),
    }
    rows = [
        make_row(name, "x", error, k, **{LOAD: cost, SPEED: 1 / cost})
        for k, (name, (cost, error)) in enumerate(spots.items())
    ]
    for x in (LOAD, SPEED):
        for y in ("ate.rmse", accuracy):
            (front,), notes = pareto(frame_of(rows), x, y)
            order = [(spot.keys["algorithm"], spot.front) for spot in front.spots]
            assert order[:4] == [("cheap", True), ("both", True), ("beaten", False), ("good", True)]
            assert order[4] == ("lost", False)
            assert front.spots[4].y == (math.inf if y == "ate.rmse" else -math.inf)
            assert not [note for note in notes if "isn't known" in note]


@pytest.mark.parametrize(("factor", "word"), [(2.0, "worse"), (0.5, "better")])
def test_before_and_after_says_better_where_an_accuracy_grows(
    accuracy: str, factor: float, word: str
) -> None:
    rows = [
        make_row(
            "orb",
            "hall",
            error * scale,
            k,
            **{"parameters.n": error, "provenance.algorithmHash": version, "created": k, SPEED: scale},
        )
        for version, scale in (("old", 1.0), ("new", factor))
        for k, error in enumerate((1.0, 2.0, 4.0, 8.0, 16.0, 32.0), 1 if version == "old" else 100)
    ]
    changes = {m: before_and_after(frame_of(rows), m)[0][0] for m in ("ate.rmse", accuracy, SPEED, UNKNOWN)}
    assert changes["ate.rmse"].sentence == changes[accuracy].sentence
    assert f"after is 2 times {word}, in 6 of 6 settings: more than chance" in changes[accuracy].sentence
    assert changes["ate.rmse"].wins == changes[accuracy].wins
    assert changes[accuracy].ratio == pytest.approx(1 / factor)
    assert changes[accuracy].settings[0].ratio == pytest.approx(1 / factor)
    # Of what is no error it is said which way it went, and a rate that grows is the better one.
    way = "higher" if factor > 1 else "lower"
    assert f"after is 2 times {way}, in 6 of 6" in changes[SPEED].sentence
    assert changes[SPEED].wins == ((6, 0, 0) if factor > 1 else (0, 6, 0))
    assert f"after is 2 times {way}, in 6 of 6" in changes[UNKNOWN].sentence
    before = changes[accuracy].before.version
    ((edit,), _) = edits(frame_of(rows), [accuracy], {("algorithm", "orb"): before})
    assert edit.lines[0].wins == changes[accuracy].wins


def test_a_setting_that_fails_now_is_worse_by_an_accuracy_too(accuracy: str) -> None:
    rows = [
        make_row("orb", "hall", error, k, **{"provenance.algorithmHash": version, "created": k})
        for k, (version, error) in enumerate((("old", 1.0), ("new", None)))
    ]
    (change,) = before_and_after(frame_of(rows), accuracy)[0]
    (setting,) = change.settings
    assert (change.wins, setting.ratio, setting.after.median) == ((0, 1, 0), 0.0, -math.inf)
    assert "after is worse in 1 and better in 0 of 1 setting, some of which failed" in change.sentence


def test_shares_of_runs_are_of_those_as_good_or_better(accuracy: str) -> None:
    rows = [make_row("a", "hall", error, k) for k, error in enumerate((1.0, 2.0, 4.0, None))]
    ranked = next(Ranking(frame_of(rows), accuracy, Outcomes.TRACKED).each(Groups(frame_of(rows), ())))
    assert ranked.values.tolist() == [1.0, 0.5, 0.25]
    assert ranked.shares.tolist() == [0.25, 0.5, 0.75]
    assert (ranked.median, ranked.quartiles) == (0.375, (-math.inf, 0.375, 0.625))
    assert ranked.failures == {"OutOfMemory": 1}


def test_nothing_calls_a_figure_better_of_which_nobody_has_said_so(study: Frame) -> None:
    told = f"{UNKNOWN}: whether small or large is good isn't known: ranked from small to large"
    assert told in leaderboard(study, UNKNOWN, draws=1).notes
    boards, notes = compare(study, UNKNOWN)
    assert told in notes
    assert all("lower" in pair.sentence and "better" not in pair.sentence for pair in boards[0].pairs)
    assert told not in leaderboard(study, draws=1).notes


def test_how_much_worse_an_accuracy_is() -> None:
    failed, nothing, half, all_of_it = (np.array([cost]) for cost in (math.inf, -0.0, -0.5, -1.0))
    assert log_ratios(all_of_it, half, -1) == pytest.approx(math.log(2))
    assert log_ratios(half, all_of_it, -1) == pytest.approx(-math.log(2))
    assert log_ratios(half, nothing, -1) == math.inf
    assert log_ratios(half, failed, -1) == math.inf
    # No pose within the limit is better than no trajectory.
    assert log_ratios(nothing, failed, -1) == math.inf
    assert log_ratios(failed, nothing, -1) == -math.inf
    assert log_ratios(failed, failed, -1) == 0
    assert np.isnan(log_ratios(np.array([math.nan]), half, -1))
