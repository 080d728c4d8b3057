# SPDX-License-Identifier: Apache-2.0
"""Requests made up from the OpenAPI document: whatever is asked, the answer is no 5xx.

SLAMHIVE_FUZZ_EXAMPLES says how many requests an address gets; some thousands take minutes.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest
from starlette.testclient import TestClient

from slamhive.dashboard.app import create_app
from slamhive.dashboard.sources import Workstation

if TYPE_CHECKING:
    from pathlib import Path

schemathesis = pytest.importorskip("schemathesis", reason="the package schemathesis is not installed")

from hypothesis import HealthCheck, given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

EXAMPLES = int(os.environ.get("SLAMHIVE_FUZZ_EXAMPLES", "30"))
WORDS = (
    "ate.rmse",
    "algorithm",
    "-seed",
    "where",
    "coverage>=0.5",
    "algorithm == 'x'",
    "%00",
    "NaN",
    "1e999",
    "é",
)


@pytest.fixture(scope="module")
def client(assorted_file: Path) -> Any:
    with TestClient(
        create_app(Workstation(f"sqlite:///{assorted_file}")),
        base_url="http://127.0.0.1",
        raise_server_exceptions=False,
    ) as found:
        yield found


def operations() -> list[str]:
    document = create_app(Workstation("sqlite:///none.sqlite")).openapi()
    return [path for path in document["paths"] if path != "/api/v1/events"]


@pytest.mark.parametrize("path", operations())
def test_no_request_is_a_fault(path: str, client: TestClient) -> None:
    schema = schemathesis.openapi.from_dict(client.app.openapi())  # type: ignore[attr-defined]

    @settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(case=schema[path]["GET"].as_strategy())
    def ask(case: Any) -> None:
        given_path = case.formatted_path
        answer = client.get(given_path, params=case.query or {})
        assert answer.status_code < 500, (given_path, case.query, answer.text)

    ask()


@settings(max_examples=20 * EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    path=st.sampled_from(
        ["runs", "columns", "analysis/points", "analysis/aggregate", "analysis/leaderboard"]
    ),
    pairs=st.lists(
        st.tuples(
            st.one_of(
                st.sampled_from([*WORDS, "sort", "by", "x", "y", "metric", "limit", "after"]), st.text()
            ),
            st.one_of(st.sampled_from(WORDS), st.text(), st.floats().map(str)),
        ),
        max_size=5,
    ),
)
def test_no_query_is_a_fault(path: str, pairs: list[tuple[str, str]], client: TestClient) -> None:
    cleaned = [
        (a.encode("utf-8", "replace").decode(), b.encode("utf-8", "replace").decode()) for a, b in pairs
    ]
    answer = client.get(f"/api/v1/{path}", params=cleaned)
    assert answer.status_code < 500, (path, pairs, answer.text)
    assert answer.status_code < 400 or answer.json()["error"]
