# SPDX-License-Identifier: Apache-2.0
"""Messages that an algorithm may have forged: nothing in them raises, and all can be written to a status."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.kube.reports import (
    clean,
    last_line,
    read_description,
    read_failure,
    read_object,
    read_report,
    tail,
)
from slamhive.model.results import Reason
from slamhive.playback.outcome import Played

TRAJECTORY = {"poses": 3, "durationSeconds": 1.5, "sha256": "a" * 64, "path": "output/trajectory.txt"}


@pytest.mark.parametrize(
    "text",
    [
        None,
        5,
        "",
        "null",
        "[1]",
        '{"v": 2}',
        '{"v": 1, "a": NaN}',
        '{"v": 1, "a": 1e999}',
        '{"v": 1, "a": 123456789012345678901234567890}',
        '{"v": 1, "a": ' + "9" * 5000 + "}",
        '{"v": 1, "a": ' + "[" * 100_000,
        '{"v": 1, "a": ' + "[" * 50 + "]" * 50 + "}",
        '{"v": 1, "a": "' + "x" * 20_000 + '"}',
    ],
)
def test_what_is_no_report_is_none(text: Any) -> None:
    assert read_report(text) is None


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[31mred\x1b[0m\x00\x07!", "red!"),
        ("a\r\nb\tc", "a\nb\tc"),
        ("\u202egnirts", "gnirts"),
        ("\ud800x", "x"),
        ("\ufffdcut \x00both ends\ufffd", "cut both ends"),
        ("x" * 30, "x" * 19 + "…"),
    ],
)
def test_text_is_cleaned(text: str, shown: str) -> None:
    assert clean(text, 20) == shown


def test_a_log_is_known_by_its_end() -> None:
    assert tail("a" * 5000 + "\nend\n", 10) == "aaaaa\nend"
    assert tail("\n") is None
    assert last_line("one\ntwo\n\n") == "two"
    assert last_line(None) == ""
    killed = (
        "frame 7\nFatal Python error: Segmentation fault\n\nCurrent thread 0x1 (most recent call first):\n"
    )
    assert last_line(f'{killed}  File "slam.py", line 3 in track\n    return self._slam.track(') == (
        "Fatal Python error: Segmentation fault"
    )


@pytest.mark.parametrize(
    "told",
    [
        {},
        {"trajectory": TRAJECTORY | {"sha256": "x"}},
        {"trajectory": TRAJECTORY | {"poses": "many"}},
        {"trajectory": [1]},
    ],
)
def test_a_report_without_a_sound_trajectory_has_none(told: dict[str, Any]) -> None:
    report = read_report(json.dumps({"v": 1} | told))
    assert report is not None
    assert (report.trajectory, report.trajectory_missing) == (None, True)
    assert report.trajectory_problem == "the monitor told of no trajectory"


def test_what_is_wrong_in_a_report_leaves_the_rest() -> None:
    told = {"usage": {"cpu": "fast"}, "frames": [], "startedAt": "yesterday", "message": {"a": 1}}
    report = read_report(json.dumps({"v": 1, "trajectory": TRAJECTORY, "cpuModel": "x\x1b[0m"} | told))
    assert report is not None
    assert report.trajectory is not None
    assert (report.usage, report.frames, report.started_at, report.message) == (None, None, None, None)
    assert report.cpu_model == "x"


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)
_FIELDS = (
    "reason",
    "message",
    "startedAt",
    "usage",
    "trajectory",
    "frames",
    "cpuModel",
    "metrics",
    "error",
    "z",
)


@given(st.dictionaries(st.sampled_from(_FIELDS), _JSON), st.text())
def test_nothing_raises_and_everything_can_be_written(told: dict[str, Any], noise: str) -> None:
    for text in (noise, json.dumps(told | {"v": 1})):
        report = read_report(text)
        if report is not None:
            for value in (report.message, report.cpu_model, report.trajectory_problem, report.started_at):
                (value or "").encode()
        read_failure(text)
        read_description(text)
        json.dumps(read_object(text), allow_nan=False, ensure_ascii=False).encode()


@pytest.mark.parametrize(
    ("told", "played"),
    [
        ({"completed": True, "reason": None, "message": None}, Played(True)),
        (
            {"completed": False, "reason": "AlgorithmFailed", "message": "it did not subscribe"},
            Played(False, Reason.ALGORITHM_FAILED, "it did not subscribe"),
        ),
        ({"completed": "yes", "reason": "NodeLost"}, Played(False)),
        ("Ended", None),
    ],
)
def test_how_playing_ended_is_told(told: object, played: Played | None) -> None:
    report = read_report(json.dumps({"v": 1, "played": told}))
    assert report is not None
    assert report.played == played


@pytest.mark.parametrize(
    ("told", "kept"),
    [
        ({"a": [1], "b": None, "c": {"d": {"e": 1}, "f": 2}, "g": 1}, {"c": {"d": {"e": 1}, "f": 2}, "g": 1}),
        ([1], {}),
        ({str(number): number for number in range(100)}, {str(number): number for number in range(64)}),
        ({" a ": " b ", "c\u202e": 1}, {" a ": " b "}),
    ],
)
def test_of_metrics_that_an_algorithm_forged_no_more_is_taken(told: object, kept: dict[str, Any]) -> None:
    report = read_report(json.dumps({"v": 1, "metrics": told}))
    assert report is not None
    assert report.metrics == kept
