# SPDX-License-Identifier: Apache-2.0
"""Kept answers of the API, by which tests/javascript checks its types and draws its charts.

``SLAMHIVE_UPDATE=1 pytest tests/dashboard_pages -k answers`` writes them anew.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import httpx
import pytest

KEPT = Path(__file__).parents[1] / "javascript" / "answers.json"
ADDRESSES = json.loads(KEPT.read_text(encoding="utf-8"))
LONGEST_LIST = 6
LONGEST_TEXT = 60


def shortened(value: Any) -> Any:
    """Return an answer with its lists and texts cut."""
    if isinstance(value, dict):
        return {name: "1" if name == "revision" else shortened(one) for name, one in value.items()}
    if isinstance(value, list):
        return [shortened(one) for one in value[:LONGEST_LIST]]
    return value[:LONGEST_TEXT] if isinstance(value, str) else value


def shape(value: Any) -> Any:
    """Return the shape of an answer: names and kinds, not values."""
    if isinstance(value, dict):
        return {name: shape(one) for name, one in value.items()}
    if isinstance(value, list):
        return sorted({json.dumps(shape(one), sort_keys=True) for one in value})
    if isinstance(value, bool) or value is None:
        return str(value is None or "bool")
    return "number" if isinstance(value, int | float) else "text"


@pytest.mark.parametrize("address", ADDRESSES)
def test_answers_have_the_shape_that_the_pages_are_checked_with(site: str, address: str) -> None:
    today = shortened(httpx.get(site + address, timeout=60).raise_for_status().json())
    if os.environ.get("SLAMHIVE_UPDATE"):
        kept = json.loads(KEPT.read_text(encoding="utf-8")) | {address: today}
        KEPT.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    kept = json.loads(KEPT.read_text(encoding="utf-8"))[address]
    assert shape(today) == shape(kept), "if meant: SLAMHIVE_UPDATE=1 pytest tests/dashboard_pages -k answers"
