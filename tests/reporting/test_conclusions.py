# SPDX-License-Identifier: Apache-2.0
"""The winner in words: the last lines of the demo, honest where nothing won."""

from __future__ import annotations

from typing import Any

import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import with_derived
from slamhive.analysis.grouping import aggregate
from slamhive.reporting.conclusions import conclusion

CPU = "usage.cpu.secondsPerDataSecond"
WON = "kiss-icp has the smallest error: ATE 0.02 m"
CHEAP = ", and no other takes less CPU."
NEAR = "As good, within 5 %:"
AMONG = "As good, with a best run no worse than the worst of a:"
NOBODY = "nothing won: no setting tracked in most of its runs."
ALONE = "That is one recording: on another the order may differ."


def told(*runs: tuple[Any, ...]) -> str:
    """Return the sentences on runs: algorithm, error (None where it failed), CPU, dataset if not hall."""
    rows = [
        {
            "id": number,
            "algorithm": run[0],
            "sensors": "lidar",
            "dataset": run[3] if len(run) > 3 else "hall",
            "evaluation": "se3",
            "phase": "Failed" if run[1] is None else "Succeeded",
            "reason": "AlgorithmFailed" if run[1] is None else None,
            "outcome": None if run[1] is None else "Tracked",
            "ate.rmse": run[1],
            "trajectory.sha256": run[1] and f"{run[0]} {run[1]} {number if run[0] != 'again' else ''}",
            CPU: run[2],
            "parameters.k": run[4] if len(run) > 4 else None,
        }
        for number, run in enumerate(runs)
    ]
    columns: dict[str, Any] = {name: Column.of([row[name] for row in rows]) for name in rows[0]}
    found = aggregate(with_derived(columns, len(rows), ()), ["ate.rmse", CPU])
    return " ".join(conclusion(found, "ate.rmse", CPU))


@pytest.mark.parametrize(
    ("runs", "words"),
    [
        (
            [("kiss-icp", 0.02, 0.7), ("rko-lio", 0.05, 0.1), ("genz-icp", 0.06, 0.3)],
            [f"{WON}, for 7 times the CPU of the cheapest, rko-lio (ATE 0.05 m)."],
        ),
        (
            [("kiss-icp", 0.02, 0.1), ("rko-lio", 0.05, 0.7)],
            [f"{WON}{CHEAP}"],
        ),
        # What can't be told apart is not ordered: 3 % on one recording, or ranges of runs that overlap.
        (
            [("a", 0.0200, 0.1), ("b", 0.0206, 0.1)],
            [f"a has the smallest error: ATE 0.02 m{CHEAP}", f"{NEAR} b (ATE 0.0206 m)."],
        ),
        (
            [("a", 0.02, 0.1), ("a", 0.04, 0.1), ("b", 0.03, 0.1), ("b", 0.05, 0.1)],
            [f"a has the smallest error: ATE 0.03 m{CHEAP}", f"{AMONG} b (ATE 0.04 m)."],
        ),
        (
            [
                *[("a", 0.02, 0.1), ("a", 0.04, 0.1)],
                *[("b", 0.03, 0.1), ("b", 0.05, 0.1)],
                *[("c", 0.0301, 0.1), ("d", 0.09, 0.1)],
            ],
            [
                f"a has the smallest error: ATE 0.03 m{CHEAP}",
                f"{NEAR} c (ATE 0.0301 m).",
                f"{AMONG} b (ATE 0.04 m).",
            ],
        ),
        (
            [("a", 0.02, None), ("b", 0.06, None), ("c", None, None)],
            [
                "a has the smallest error: ATE 0.02 m.",
                "Not ranked, for runs that did not track: c (AlgorithmFailed in its run).",
            ],
        ),
        # Equal results count once: a failure beside them is half of what counts, but not most of the runs.
        (
            [("a", 0.02, 0.1), ("again", 0.06, 0.1), ("again", 0.06, 0.1), ("again", None, 0.1)],
            [
                "a alone tracked: ATE 0.02 m.",
                "Not ranked, for runs that did not track: again (AlgorithmFailed in 1 of 3 runs).",
            ],
        ),
        ([("a", 0.02, 0.1)], ["a alone tracked: ATE 0.02 m."]),
        ([("a", None, None), ("b", None, None)], [NOBODY]),
        # Two of three runs failed: the one that didn't is no winner.
        ([("a", 0.02, 0.1), ("a", None, 0.1), ("a", None, 0.1)], [NOBODY]),
        ([("a", 0.0, 0.0), ("b", 0.1, 0.1)], ["a has the smallest error: ATE 0 m."]),
    ],
)
def test_the_winner_and_its_price_are_said_and_no_more_than_the_runs_say(
    runs: list[Any], words: list[str]
) -> None:
    alone = [] if words == [NOBODY] else [ALONE]
    assert told(*runs) == " ".join([f"On hall {words[0]}", *words[1:], *alone])


def test_each_of_some_recordings_has_its_own_winner_and_long_names_stay_whole() -> None:
    long = "x" * 63
    said = told((long, 0.1, 1.0), ("b", 0.2, 0.1), (long, 0.4, 1.0, "room"), ("b", 0.2, 0.1, "room"))
    assert f"On hall {long} has the smallest error: ATE 0.1 m" in said
    assert "On room b has the smallest error: ATE 0.2 m" in said
    assert ALONE not in said
    many = told(*(("a", 0.1, 1.0, f"d{number}") for number in range(9)))
    assert many.endswith("The table has 6 more datasets.")


def test_settings_that_an_algorithm_does_not_have_are_not_named() -> None:
    said = told(("a", 0.02, 0.7, "hall", 5), ("a", 0.04, 0.7, "hall", 6), ("b", 0.09, 0.1))
    assert said.startswith(
        "On hall a with k 5 has the smallest error: ATE 0.02 m, for 7 times the CPU of the"
    )
    assert "the cheapest, b (ATE 0.09 m)" in said
