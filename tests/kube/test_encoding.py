# SPDX-License-Identifier: Apache-2.0
"""JSON as the API server and the operator exchange it."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.kube.api.encoding import decode, encode
from slamhive.kube.api.kinds import Kind, Label

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@given(VALUES)
def test_values_come_back(value: Any) -> None:
    assert decode(encode(value)) == value
    assert json.loads(encode(value)) == value


def test_words_of_enumerations_are_texts() -> None:
    assert decode(encode({Label.SWEEP: Kind.SWEEP})) == {str(Label.SWEEP): str(Kind.SWEEP)}


@pytest.mark.parametrize(
    "value", ["\ud800", {"logTail": "end \udfff"}, [2**70]], ids=["text", "log", "number"]
)
def test_what_the_fast_encoder_refuses_is_written_all_the_same(value: Any) -> None:
    assert json.loads(encode(value)) == value
    assert decode(encode(value)) == pytest.approx(value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff", b"<html>"])
def test_no_json_is_a_value_error(content: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - json's and orjson's own
        decode(content)
