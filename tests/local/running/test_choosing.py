# SPDX-License-Identifier: Apache-2.0
"""Runs of a sweep are chosen by the conditions that tables are asked by."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.running.choosing import ask, first_of, twins_among
from slamhive.local.running.outlook import Outlook, RunStanding
from slamhive.model.errors import InputError
from slamhive.plan import Plan

from .sweeps import sweep_of

if TYPE_CHECKING:
    from slamhive.local.home.catalog import Workshop


def asked(workshop: Workshop, only: str | None = None, datasets: tuple[str, ...] = ()) -> Any:
    matrix = [
        {"path": "parameters.number", "values": [1, 2, 15]},
        {"path": "parameters.act", "values": ["good", "crash"]},
    ]
    sweep = sweep_of([], matrix=matrix, repetitions=2)
    return ask([(sweep, Plan(sweep, workshop))], workshop, only, datasets)[0]


@pytest.mark.parametrize(
    ("only", "indices"),
    [
        ("parameters.number == 15 and repetition = 0", {8, 10}),
        ("parameters.act = 'crash' and parameters.number < 2", {2, 3}),
        ("seed in (2) and not parameters.number in (2, 15)", {1, 3}),
        ("algorithm = 'actor' and dataset = 'tiny' and index >= 11", {11}),
        ("sensors = 'lidar' and input.frameRate is null and repetition = 1", {1, 3, 5, 7, 9, 11}),
    ],
)
def test_a_condition_is_on_settings_under_the_names_of_tables(
    workshop: Workshop, only: str, indices: set[int]
) -> None:
    assert asked(workshop, only) == indices


def test_no_condition_leaves_none_out(workshop: Workshop) -> None:
    assert asked(workshop) is None


@pytest.mark.parametrize(
    ("only", "datasets", "words"),
    [
        (
            "parameters.numbr == 1",
            (),
            "--only: condition, character 1: unknown column 'parameters.numbr'",
        ),
        ("ate.rmse > 1", (), "--only: condition, character 1: unknown column 'ate.rmse'"),
        ("parameters.number <", (), "--only: condition, character"),
        ("parameters.number > 99", (), "--only: no run meets it, of 12"),
        (None, ("tny",), "--dataset: the runs here: unknown dataset 'tny'; did you mean 'tiny'?"),
    ],
)
def test_what_can_not_be_meant_is_refused_in_a_sentence(
    workshop: Workshop, only: str | None, datasets: tuple[str, ...], words: str
) -> None:
    with pytest.raises(InputError) as error:
        asked(workshop, only, datasets)
    assert str(error.value).startswith(words)


def test_equal_results_cost_nothing_and_are_not_counted_among_the_first() -> None:
    outlook = Outlook(bytearray([RunStanding.NEW, RunStanding.EQUAL, RunStanding.STALE, RunStanding.NEW]))
    assert first_of([3, 2, 1, 0], outlook, {0, 1, 2, 3}, 2) == {1, 3, 2}
    assert first_of([3, 2, 1, 0], outlook, {0}, 2) == {0}


def test_a_run_waits_for_no_equal_one_that_is_left_out() -> None:
    twins = {4: 0, 5: 0, 6: 1, 7: 2}
    assert twins_among(twins, None, set()) == twins
    # 4 and 5 wait for 0 in vain: 4 runs itself and stands for it; 1 is done, 2 is chosen.
    assert twins_among(twins, {2, 4, 5, 6, 7}, {1}) == {5: 4, 6: 1, 7: 2}
