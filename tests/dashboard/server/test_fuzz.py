# SPDX-License-Identifier: Apache-2.0
"""A few questions of each sort of ``tests/fuzz/api.py``, the same each time; ``make fuzz-api`` asks more."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.sources.archived import Workstation

sys.path.insert(0, str(Path(__file__).parents[2] / "fuzz"))


@pytest.fixture(scope="module")
def asking() -> Any:
    """The module that asks; it takes a second to import, which all workers would spend to collect tests."""
    pytest.importorskip("schemathesis", reason="the package schemathesis is not installed")
    return importlib.import_module("api")


@pytest.mark.slow
def test_no_question_is_a_fault(assorted_file: Path, asking: Any) -> None:
    app = create_app(Workstation(f"sqlite:///{assorted_file}"))
    with TestClient(app, base_url="http://127.0.0.1", raise_server_exceptions=False) as client:
        client.get("/api/v1")
        tally = asking.Fuzzer(app, client).run(0)
    assert tally.faults == []
    assert {200, 400, 404, 405} <= tally.statuses.keys()
    assert {*app.openapi()["paths"]} - {asking.UNENDING} <= tally.asked.keys()


class Answer:
    def __init__(self, status: int, text: str) -> None:
        self.status_code = status
        self.text = text
        self.headers: dict[str, str] = {}


@pytest.mark.parametrize(
    ("method", "status", "text", "told"),
    [
        ("GET", 200, "", ""),
        ("GET", 500, "{}", "was answered 500"),
        ("GET", 503, '{"error": "so"}', "was answered 503"),
        ("GET", 404, '{"error": "there is no such run"}', ""),
        ("GET", 404, "Not Found", "was answered 404 without a sentence"),
        ("HEAD", 404, "", ""),
        ("POST", 200, "", "was answered 200, and only GET and HEAD may be"),
        ("POST", 405, '{"error": "only GET and HEAD are answered"}', ""),
    ],
)
def test_faults_are_noticed(method: str, status: int, text: str, told: str, asking: Any) -> None:
    found: Any = Answer(status, text)
    assert asking.verdict(method, found) == told
