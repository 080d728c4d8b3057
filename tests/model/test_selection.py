# SPDX-License-Identifier: Apache-2.0
"""Selection of an Evaluation's runs, on a workstation and on a cluster."""

from __future__ import annotations

from typing import Any

import pytest

from slamhive.model.evaluation import RunSelector

LABELS = {"room": "hall", "speed": "slow"}


@pytest.mark.parametrize(
    ("selector", "selected"),
    [
        ({"names": ["other", "one"]}, True),
        ({"names": ["other"]}, False),
        ({"sweepRef": {"name": "study"}}, True),
        ({"sweepRef": {"name": "other"}}, False),
        ({"matchLabels": {"room": "hall", "speed": "slow"}}, True),
        ({"matchLabels": {"room": "hall", "speed": "fast"}}, False),
        ({"matchLabels": {"missing": "x"}}, False),
        ({"names": ["one"], "sweepRef": {"name": "study"}, "matchLabels": {"room": "hall"}}, True),
        ({"names": ["one"], "sweepRef": {"name": "other"}}, False),
        ({"names": ["one"], "matchLabels": {"room": "yard"}}, False),
    ],
)
def test_all_conditions_must_hold(selector: dict[str, Any], selected: bool) -> None:
    assert RunSelector.model_validate(selector).selects("one", "study", LABELS) is selected


def test_a_run_by_itself_is_of_no_sweep() -> None:
    assert not RunSelector.model_validate({"sweepRef": {"name": "study"}}).selects("one", None, LABELS)
