# SPDX-License-Identifier: Apache-2.0
"""Words beneath tables: what a column means there, and errors that no run that tracked should have."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import with_derived
from slamhive.model.results import Outcome, Result
from slamhive.tables.words import disproportion, disproportion_notes, meanings

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame

RPE = {"rpe[0].delta": 1.0, "rpe[0].unit": "m", "rpe[0].pairs": "all"}


def frame_of(*rows: dict[str, Any]) -> Frame:
    usual = {"algorithm": "a", "dataset": "d", "alignment": "se3", "outcome": "Tracked", "phase": "Succeeded"}
    given = [{"id": number, **usual, **RPE, **row} for number, row in enumerate(rows)]
    names = dict.fromkeys(name for row in given for name in row)
    return with_derived({name: Column.of([row.get(name) for row in given]) for name in names}, len(given), ())


def test_a_line_says_what_the_shown_columns_mean_in_these_runs() -> None:
    cpu = {"usage.cpu.seconds": 9.0, "usage.readerCpuSeconds": 1.0}
    runs = frame_of({"usage.includesReader": False, **cpu})
    shown = ["ate.rmse", "rpe[0].rmse", "usage.cpu.secondsPerDataSecond", "coverage", "parameters.k"]
    (line,) = meanings(runs, shown)
    assert line.split("; ") == [
        "ATE: RMSE of position errors after SE(3) alignment",
        "RPE: RMSE of translation errors over 1 m of path, all pairs",
        "CPU: CPU seconds a second of recording, without the reader",
        "coverage: share of the true path that has poses",
    ]
    assert meanings(runs, ["parameters.k", "dataset"]) == []
    frames = {"rpe[0].delta": 10.0, "rpe[0].unit": "frames", "rpe[0].pairs": "consecutive"}
    others = frame_of({"alignment": "sim3", **frames}, {"alignment": "none", **frames})
    (line,) = meanings(others, ["ate.max", "rpe[0].rotationDeg.median"])
    assert line.split("; ") == [
        "ATE maximum: maximum of position errors after Sim(3) alignment or none",
        "RPE of rotation median: median of rotation errors over 10 frames, consecutive pairs",
    ]


def test_what_differs_between_the_runs_is_not_said_of_all_of_them() -> None:
    mixed = frame_of({"usage.includesReader": False}, {"usage.includesReader": True, "rpe[0].delta": 5.0})
    assert meanings(mixed, ["rpe[0].rmse", "usage.cpu.meanCores"]) == [
        "RPE: RMSE of translation errors; CPU: cores busy on average"
    ]


@pytest.mark.parametrize(
    ("ate", "rpe", "path", "told"),
    [
        (0.5, 0.68, 30.0, "RPE 0.68 m a metre (above 0.25; standing still has 1)"),
        (0.05, 1.06, 130.0, "more than positions of this ATE can make: orientations are off"),
        (1.6, 0.1, 30.0, "ATE 1.6 m on 30 m of path (above 5 %; above 10 % is Diverged)"),
        (0.05, 0.08, 30.0, None),
    ],
)
def test_an_error_out_of_proportion_is_named_though_the_run_tracked(
    ate: float, rpe: float, path: float, told: str | None
) -> None:
    values = {"ate": {"rmse": ate}, "rpe": [{"rmse": rpe, "delta": 1.0, "unit": "m"}], "pathLength": path}
    said = disproportion(Result(evaluation="se3", outcome=Outcome.TRACKED, coverage=1.0, values=values))
    row = {
        "ate.rmse": ate,
        "rpe[0].rmse": rpe,
        "pathLength": path,
        "algorithm": "kiss-icp",
        "dataset": "hall",
    }
    notes = disproportion_notes(frame_of({"ate.rmse": 0.01}, row))
    if told is None:
        assert (said, notes) == (None, [])
        return
    assert said is not None
    assert told in said
    (note,) = notes
    assert note.startswith("1 tracked run has an error out of proportion; the worst, kiss-icp on hall: ")
    assert told in note


def test_a_run_that_is_called_lost_needs_no_such_warning() -> None:
    values = {"rpe": [{"rmse": 0.9, "delta": 1.0, "unit": "m"}]}
    lost = Result(evaluation="se3", outcome=Outcome.LOST, coverage=0.2, values=values)
    assert disproportion(lost) is None
    assert disproportion_notes(frame_of({"rpe[0].rmse": 0.9, "outcome": "Lost"})) == []


def test_figures_of_an_own_evaluator_are_taken_as_they_come() -> None:
    odd_values: list[dict[str, Any]] = [{"ate": 3, "rpe": "none"}, {"ate": {"rmse": "1"}, "rpe": [1]}, {}]
    for values in odd_values:
        odd = Result(evaluation="mine", outcome=Outcome.TRACKED, coverage=1.0, values=values)
        assert disproportion(odd) is None
