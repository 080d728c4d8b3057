# SPDX-License-Identifier: Apache-2.0
"""The rule about which of an algorithm's values are kept, by itself."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from slamhive.contract.metrics import MOST_BYTES, MOST_VALUES, keep_values
from slamhive.monitor.pod.termination import termination_message

_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=8),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), _VALUES, max_size=10))
@example({f"{k}": {"é" * 90: "é" * 200, "b": -1.2345678901234567e-300} for k in range(40)})
def test_what_is_kept_fits_and_is_kept_again_as_it_is(values: dict[str, Any]) -> None:
    kept = keep_values(values).values
    text = json.dumps(kept, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    assert len(text.encode()) <= MOST_BYTES
    assert keep_values(json.loads(text)) == (kept, None)


@pytest.mark.parametrize(
    ("values", "note"),
    [
        ({"a": 1, "b": None, "c": {}}, None),
        ({"a": [1]}, "a (a list)"),
        ({"a": {"b": {"c": float("inf")}}}, "a.b.c (no finite number)"),
        ({"a": 2**53 + 1}, "a (beyond 2^53)"),
        ({"a": "b\nc"}, "a (a text must have one line of at most 200 printable characters)"),
        (
            {"a\n": 1, "": 2},
            "a  (a name must have 1 to 100 printable characters),  (a name must have 1 to 100",
        ),
        ({"x" * 101: 1}, "x" * 40 + "… (a name must have 1 to 100 printable characters)"),
        ({k: [] for k in "abcde"}, "a (a list), b (a list), c (a list) and 2 more"),
        ({f"n{k}": k for k in range(65)}, "n64 (more than 64 values)"),
        ({f"n{k}": "v" * 200 for k in range(10)}, "n9 (more than 2 KiB)"),
    ],
)
def test_what_is_left_out_is_said(values: dict[str, Any], note: str | None) -> None:
    told = keep_values(values).note
    assert told is None if note is None else (told or "").startswith(f"output/metrics.json: left out {note}")


def test_repetitions_have_the_same_columns_however_long_their_numbers_are() -> None:
    short = {f"name{k}": 1 for k in range(MOST_VALUES)}
    long = dict.fromkeys(short, -1.2345678901234567e-300)
    assert keep_values(short).values.keys() == keep_values(long).values.keys()


def test_the_monitors_last_words_have_all_that_is_kept() -> None:
    """Whatever else there is to say."""
    metrics = keep_values({f"name{k}": "é" * 100 for k in range(MOST_VALUES)}).values
    told = dict.fromkeys(("message", "trajectoryProblem", "metricsProblem", "cpuModel"), "é" * 5000)
    message = termination_message({**told, "metrics": metrics | {"x" * 60: "y" * 9000}})
    assert len(message) <= 4096
    assert json.loads(message)["metrics"] == metrics
