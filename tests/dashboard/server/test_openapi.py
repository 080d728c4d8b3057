# SPDX-License-Identifier: Apache-2.0
"""The API's description: kept whole, so that no address changes unnoticed, and readable without a network.

``SLAMHIVE_UPDATE=1 pytest tests/dashboard -k openapi`` writes it anew.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.sources.archived import Workstation

GOLDEN = Path(__file__).with_name("openapi.json")


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return create_app(Workstation("sqlite:///none.sqlite")).openapi()


def test_openapi_is_what_it_was(document: dict[str, Any]) -> None:
    text = json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    if os.environ.get("SLAMHIVE_UPDATE"):
        GOLDEN.write_text(text, encoding="utf-8")
    kept = json.loads(GOLDEN.read_text(encoding="utf-8"))
    assert document == kept, "openapi.json is out of date; if meant: SLAMHIVE_UPDATE=1 pytest tests/dashboard"


def test_openapi_has_reading_methods_alone_each_described(document: dict[str, Any]) -> None:
    assert document["openapi"].startswith("3.")
    for path, methods in document["paths"].items():
        assert path.startswith("/api/v1")
        assert {*methods} == {"get"}, path
        assert methods["get"]["summary"], path
        assert methods["get"]["description"], path
    identifiers = [methods["get"]["operationId"] for methods in document["paths"].values()]
    assert len({*identifiers}) == len(identifiers)
