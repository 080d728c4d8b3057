# SPDX-License-Identifier: Apache-2.0
"""Decisions of a gate: what is worse, no worse, better, and what nobody can tell."""

from __future__ import annotations

import importlib.util
import math
import sys
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest

from slamhive.analysis.gating.cells import GateCell, GateRuns
from slamhive.analysis.gating.deciding import Gate, GateAnswer
from slamhive.analysis.gating.figures import FAILURES, GateFigure, parse_figure
from slamhive.analysis.gating.ordering import next_runs
from slamhive.analysis.gating.spending import Spending
from slamhive.model.errors import InputError

BENCH = Path(__file__).parents[1] / "bench" / "bench_gate.py"
ATE = GateFigure("ate.rmse", 0.1)


def runs(*errors: float) -> GateRuns:
    return GateRuns([not math.isnan(one) for one in errors], {"ate.rmse": errors})


def cell(before: tuple[float, ...], now: tuple[float, ...], name: str = "a") -> GateCell:
    return GateCell(name, runs(*before), runs(*now))


def answer(*cells: GateCell, figure: GateFigure = ATE) -> Any:
    (found,) = Gate([figure]).look(cells)
    return found


NOISY = (1.00, 1.02, 0.98, 1.01, 0.99)


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        ((1.0, 1.01), GateAnswer.NO_WORSE),
        ((1.04, 1.05, 1.03), GateAnswer.NO_WORSE),
        ((1.2, 1.22, 1.19, 1.21), GateAnswer.WORSE),
        ((0.8, 0.81, 0.79), GateAnswer.BETTER),
        ((0.9, 1.3), GateAnswer.UNKNOWN),
    ],
)
def test_a_figure_is_held_against_its_margin(now: tuple[float, ...], expected: GateAnswer) -> None:
    assert answer(cell(NOISY, now)).answer is expected


@pytest.mark.parametrize(
    ("name", "beside", "now", "expected"),
    [
        ("usage.undisturbedSeconds", False, (0.85, 0.86, 0.84), GateAnswer.BETTER),
        ("usage.undisturbedSeconds", True, (0.85, 0.86, 0.84), GateAnswer.NO_WORSE),
        ("usage.undisturbedSeconds", True, (0.5, 0.51, 0.49), GateAnswer.BETTER),
        ("usage.memory.peakBytes", True, (0.85, 0.86, 0.84), GateAnswer.BETTER),
        ("ate.rmse", True, (0.85, 0.86, 0.84), GateAnswer.BETTER),
    ],
)
def test_a_quieter_hour_makes_nothing_better(
    *, name: str, beside: bool, now: tuple[float, ...], expected: GateAnswer
) -> None:
    before, after = (GateRuns([True] * len(of), {name: of}) for of in (NOISY, now))
    (found,) = Gate([GateFigure(name, 0.3)], is_beside_others=beside).look([GateCell("a", before, after)])
    assert found.answer is expected
    assert ("a quieter hour" in found.why) == (expected is GateAnswer.NO_WORSE)


def test_what_varies_in_nothing_needs_a_second_run_where_it_changed_and_none_where_it_did_not() -> None:
    still = (1.0, 1.0, 1.0)
    assert answer(cell(still, (1.0,))).answer is GateAnswer.NO_WORSE
    assert answer(cell(still, (1.5,))).answer is GateAnswer.UNKNOWN
    found = answer(cell(still, (1.5, 1.5)))
    assert (found.answer, round(found.low, 6)) == (GateAnswer.WORSE, round(math.log(1.5), 6))


def test_one_dataset_that_got_much_worse_is_no_average_over_the_others() -> None:
    others = [cell((1.0, 1.0), (1.0, 1.0)) for _ in range(19)]
    found = answer(*others, cell((1.0, 1.0), (2.0, 2.0), "lost"))
    assert found.shift < ATE.bound
    assert (found.answer, found.cells) == (GateAnswer.WORSE, (19,))


def test_one_run_a_side_tells_no_spread() -> None:
    found = answer(cell((1.0,), (1.0,)), cell((1.0,), (1.1,)))
    assert (found.answer, found.why) == (
        GateAnswer.UNKNOWN,
        "one run of a setting says nothing of its spread",
    )


def test_accuracies_are_better_when_they_grow() -> None:
    figure = GateFigure("coverage", 0.1)
    grown = GateCell(
        "a",
        GateRuns([True] * 3, {"coverage": [0.5, 0.5, 0.5]}),
        GateRuns([True] * 2, {"coverage": [0.8, 0.8]}),
    )
    found = answer(grown, figure=figure)
    assert found.answer is GateAnswer.BETTER
    assert figure.change(found.shift) == pytest.approx(0.3)


def test_failures_are_told_from_chance_and_none_takes_a_dozen_runs() -> None:
    figure = GateFigure(FAILURES, 0.3)
    good, bad = (1.0,) * 5, (math.nan,) * 5
    assert answer(cell(good, good), figure=figure).answer is GateAnswer.UNKNOWN
    assert answer(*[cell(good, good) for _ in range(3)], figure=figure).answer is GateAnswer.NO_WORSE
    found = answer(*[cell(good, good) for _ in range(3)], cell(good * 2, bad, "lost"), figure=figure)
    assert (found.answer, found.cells) == (GateAnswer.WORSE, (3,))
    assert answer(*[cell(bad, bad) for _ in range(3)], figure=figure).answer is not GateAnswer.WORSE


def test_what_stands_out_is_repeated_first() -> None:
    cells = [cell(NOISY, (1.0,)), cell(NOISY, (1.9,)), cell((1.0, 1.3, 0.8), (1.1,))]
    gate = Gate([ATE])
    assert next_runs(cells, gate.findings, 5) == {}
    gate.look(cells)
    assert 1 in next_runs(cells, gate.findings, 5)
    assert next_runs(cells, gate.findings, 1) == {}


def test_looks_spend_no_more_than_is_allowed() -> None:
    shares = [1.0, 1.5, 2.0, 3.0, 5.0]
    spending = Spending(0.05)
    levels = [spending.level(share, last=share == shares[-1]) for share in shares]
    random = np.random.default_rng(1)
    steps = random.normal(size=(200_000, len(shares))) * np.sqrt(np.diff(shares, prepend=0.0))
    scores = steps.cumsum(axis=1) / np.sqrt(shares)
    bounds = [NormalDist().inv_cdf(1 - level) for level in levels]
    assert (scores > bounds).any(axis=1).mean() == pytest.approx(0.05, abs=0.003)


def test_with_the_spread_of_real_repetitions_few_are_called_worse_and_a_fifth_is_found() -> None:
    described = importlib.util.spec_from_file_location("bench_gate", BENCH)
    assert described is not None
    assert described.loader is not None
    bench = importlib.util.module_from_spec(described)
    sys.modules["bench_gate"] = bench
    described.loader.exec_module(bench)
    if not bench.PAPER.is_file():
        pytest.skip("the paper's runs are not there (../shared/data/icra2023)")
    lab = bench.Laboratory(5)
    none, much = bench.CHANGES[0], bench.CHANGES[3]
    same = [bench.decide(lab, none, fixed=False) for _ in range(40)]
    worse = [bench.decide(lab, much, fixed=False) for _ in range(20)]
    assert sum(gate.answer is GateAnswer.WORSE for gate, _ in same) <= 2
    assert sum(gate.answer is GateAnswer.NO_WORSE for gate, _ in same) >= 36
    assert all(gate.answer is GateAnswer.WORSE for gate, _ in worse)
    assert np.mean([count for _, count in [*same, *worse]]) <= bench.FIXED * len(lab.means) / 2


def test_figures_have_short_names_and_margins() -> None:
    assert parse_figure("cpu=15%", "--figure") == ("usage.cpu.secondsPerDataSecond", 0.15)
    assert parse_figure("rpe[0].max", "--figure") == ("rpe[0].max", None)
    for text in ("ate=0", "ate=x", "ate=nan", "coverage=200%", "input.frameRate=10%"):
        with pytest.raises(InputError, match="--margin"):
            parse_figure(text, "--margin")
    for text, close in (("cpuu=20%", "cpu"), ("ate.rms", "ate.rmse")):
        with pytest.raises(InputError, match=f"did you mean '{close}'"):
            parse_figure(text, "--figure")
