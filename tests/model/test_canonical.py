# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from typing import Any

import pytest
import rfc8785
from hypothesis import given
from hypothesis import strategies as st

from slamhive.model.base import quantity, seconds
from slamhive.model.canonical import digest, normalize
from slamhive.model.errors import InputError
from slamhive.plan.hashes import canonical_text


@pytest.mark.parametrize(
    ("value", "expected"),
    [(10.0, 10), (-0.0, 0), (0.1, 0.1), (True, True), ((1, 2.0), [1, 2]), (1e300, 1e300), (10**16, 1e16)],
)
def test_whole_numbers_become_integers(value: Any, expected: Any) -> None:
    found = normalize(value)
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize("value", [2**53 + 1, 10**400, float("nan"), float("inf"), b"x", {"a": {1}}])
def test_what_json_cannot_hold_is_refused(value: Any) -> None:
    with pytest.raises(InputError, match="spec"):
        normalize(value, "spec")


_text = st.text(st.characters(codec="utf-8"), max_size=10)
_scalars = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | _text
)


@given(st.dictionaries(_text, _scalars | st.dictionaries(_text, _scalars)))
def test_the_quick_text_is_rfc_8785(value: dict[str, Any]) -> None:
    try:
        plain = normalize(value)
    except InputError:
        return
    assert canonical_text(plain).encode() == rfc8785.dumps(plain)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_keeps_its_hash_on_its_way_through_json(value: float) -> None:
    there = rfc8785.dumps(normalize(value)).decode()
    assert digest(normalize(json.loads(there))) == digest(normalize(value))


@pytest.mark.parametrize(
    ("text", "length"), [("90s", 90), ("1h30m", 5400), ("250ms", 0.25), ("1m1ms", 60.001)]
)
def test_durations(text: str, length: float) -> None:
    assert seconds(text) == pytest.approx(length)


@pytest.mark.parametrize(("text", "size"), [("2", 2), ("500m", 0.5), ("4Gi", 2**32), ("1.5k", 1500)])
def test_quantities(text: str, size: float) -> None:
    assert quantity(text) == size
