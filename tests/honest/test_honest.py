# SPDX-License-Identifier: Apache-2.0
"""Every number that a user sees is the one of the definition, over made-up archives and the paper's runs."""

from __future__ import annotations

import json
from collections import Counter
from random import Random
from typing import TYPE_CHECKING

import archives
import pytest
import reckoning
from breaking import BREAKS, Break, broken
from check import check, reckoned
from comparing import VIEWS, problems
from hypothesis import HealthCheck, given, settings
from reckoning import Question
from views import Views, chosen

from thinning import thinned

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from archives import Tables

ARCHIVES = 10
TABLES = ["results table json"]


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Views]:
    with Views(tmp_path_factory.mktemp("honest")) as found:
        yield found


@pytest.mark.parametrize("seed", range(ARCHIVES))
def test_all_views_show_what_the_definition_says(views: Views, seed: int) -> None:
    """More: ``python tests/honest/check.py --archives 5000``."""
    names = [name for place, name in enumerate(VIEWS) if place % 5 == seed % 5]
    assert not list(check(views, archives.made_up(Random(seed)), Random(seed), names))


@pytest.mark.parametrize("one", thinned(BREAKS), ids=lambda one: one.what)
def test_a_broken_line_is_noticed(views: Views, one: Break) -> None:
    with broken(one):
        found = (check(views, archives.made_up(Random(seed)), Random(seed), TABLES) for seed in range(40))
        assert any(list(problems_of) for problems_of in found)
    # The same archives are shown rightly as soon as the line is right again.
    assert not list(check(views, archives.made_up(Random(0)), Random(0), TABLES))


@pytest.mark.slow
@given(tables=archives.archives())
@settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_the_smallest_archive_that_is_shown_wrongly(views: Views, tables: Tables) -> None:
    views.write(tables)
    rows = reckoned(views.home)
    for question in (Question(), Question(superseded=True, outcomes="all")):
        assert not problems(views, question, rows, ["api aggregate json", "results table json"])


def test_the_program_prints_what_the_command_does(views: Views) -> None:
    views.write(archives.made_up(Random(3)))
    question = Question(superseded=True, metrics=("ate.rmse", "usage.cpu.meanCores"))
    words = ("results", "table", *chosen(question), "--format", "json")
    assert views.shell(*words) == views.command(*words)


def test_no_row_is_lost_or_counted_twice() -> None:
    """Of the definition itself: what its sentences promise of sums."""
    seen: Counter[str] = Counter()
    for seed in range(60):
        tables = archives.made_up(Random(seed))
        rows = _rows_of(tables)
        for question in (Question(), Question(superseded=True), Question(outcomes="all", by=("algorithm",))):
            chosen_rows = reckoning.choose(rows, question).rows
            groups = reckoning.groups(chosen_rows, question)
            assert sum(group.runs for group in groups) == len(chosen_rows)
            assert all(
                group.n + group.copies + sum(group.failures.values()) == group.runs for group in groups
            )
            assert all(len({row.get("evaluation") for row in group.rows}) == 1 for group in groups)
            places = [
                one for board in reckoning.boards(chosen_rows, question) for one in board.standings.values()
            ]
            assert sum(place.group.runs for place in places) == len(chosen_rows)
            seen["deterministic"] += sum(group.deterministic for group in groups)
            seen["copies"] += sum(group.copies for group in groups)
            kept = [reckoning.distinct(group.rows, question.outcomes) for group in groups]
            assert all(
                group.copies
                == sum(reckoning.counts(row, question.outcomes) for row in group.rows)
                - sum(reckoning.counts(row, question.outcomes) for row in once)
                for group, once in zip(groups, kept, strict=True)
            )
            seen["equal failures"] += sum(
                len(group.rows) - len(once) - group.copies for group, once in zip(groups, kept, strict=True)
            )
            seen["failed"] += sum(place.median == float("inf") for place in places)
            seen["unranked"] += sum(place.median is None for place in places)
        seen.update(str(row["superseded"]) for row in rows)
        seen["reused"] += len(reckoning.choose(rows, Question()).reused)
    # Archives in which little goes wrong would show nothing.
    assert min(seen.values()) > 10, seen
    assert set(seen) >= {"algorithm changed", "dataset changed", "sweep edited", "None"}


def _rows_of(tables: Tables) -> list[reckoning.Row]:
    runs = [archives.with_times(run) for run in tables["runs"]]
    sweeps = [archives.with_times(sweep) for sweep in tables["sweeps"]]
    return reckoning.all_rows({"runs": runs, "sweeps": sweeps, "results": tables["results"]})


@pytest.fixture(scope="module")
def published(paper_home: Callable[..., Path]) -> Iterator[Views]:
    with Views(paper_home("sim3", "se3")) as found:
        yield found


LOADS = ("ate.rmse", "rpe[0].rmse", "usage.cpu.meanCores", "usage.memory.peakBytes")


@pytest.mark.parametrize(
    "question",
    [
        pytest.param(Question(), id="all"),
        pytest.param(
            Question(
                outcomes="all", metrics=LOADS, evaluation="sim3", by=("sensors", "algorithm", "dataset")
            ),
            id="table III",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            Question(
                metrics=LOADS, superseded=True, condition=("dataset", "==", "rgbd-dataset-freiburg2-desk")
            ),
            id="table IV",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_runs_of_the_paper(published: Views, question: Question) -> None:
    rows = reckoned(published.home)
    assert len(rows) == 162
    assert not problems(published, question, rows, VIEWS)


def test_an_archive_is_its_number() -> None:
    """So that one that was shown wrongly can be had again."""
    assert archives.made_up(Random(5)) == archives.made_up(Random(5))
    assert json.loads(json.dumps(archives.made_up(Random(5)))) == archives.made_up(Random(5))
