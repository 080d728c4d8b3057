# SPDX-License-Identifier: Apache-2.0
"""Statuses as they are read, whoever wrote them, and as they are written."""

from __future__ import annotations

from typing import Any

import pytest

from slamhive.model.results import Phase, Usage
from slamhive.model.status import STATUSES, DatasetStatus, MappingRunStatus, SweepStatus, VariantPhase

TIME = "2026-01-02T03:04:05Z"


@pytest.mark.parametrize("kind", STATUSES)
@pytest.mark.parametrize("body", [{}, {"status": None}, {"status": {}}, {"status": {"later": {"x": 1}}}])
def test_an_object_without_a_status_of_ours_can_be_read(kind: str, body: dict[str, Any]) -> None:
    status = STATUSES[kind].of(body)
    assert status.conditions == []
    assert status.as_patch() == {}


def test_what_another_version_wrote_costs_that_field_alone() -> None:
    status = MappingRunStatus.of(
        {
            "status": {
                "phase": "Levitating",
                "attempts": 2,
                "frames": {"offered": "many", "processed": 5},
                "trajectory": {"poses": 3},
                "results": [{"evaluation": "a"}, {"evaluation": "b", "outcome": "Tracked"}],
                "usage": {"cpu": {"seconds": 1.5}, "later": True},
            }
        }
    )
    assert (status.phase, status.attempts) == (None, 2)
    assert status.frames is not None
    assert (status.frames.offered, status.frames.processed) == (None, 5)
    assert status.trajectory is None
    assert [result.evaluation for result in status.results] == ["b"]
    assert status.usage is not None
    assert status.usage.cpu.seconds == 1.5


def test_a_list_where_a_text_is_expected_costs_that_value_alone() -> None:
    """The place of such an error ends in a member of the union that was tried, not in a key."""
    asked = {"topics": ["/a"], "frameRate": 10}
    status = MappingRunStatus.of({"status": {"attempts": 2, "provenance": {"asked": asked}}})
    assert status.attempts == 2
    assert status.provenance is not None
    assert status.provenance.asked == {"frameRate": 10}


def test_all_that_cannot_be_read_is_found_in_one_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand variants with a word of a later version are not read a thousand times."""
    entries = [{"name": f"v{number}", "phase": "Odd" if number % 2 else "Ready"} for number in range(1000)]
    validate, looks = DatasetStatus.model_validate, []

    def counting(value: Any) -> DatasetStatus:
        looks.append(value)
        return validate(value)

    monkeypatch.setattr(DatasetStatus, "model_validate", counting)
    found = DatasetStatus.of({"status": {"variants": entries}}).variants
    assert [entry.name for entry in found] == [entry["name"] for entry in entries]
    assert [entry.phase for entry in found] == [VariantPhase.READY, None] * 500
    assert len(looks) <= 4


def test_reading_leaves_the_object_as_it_is() -> None:
    body = {"status": {"variants": [{"phase": "Ready"}, {"name": "b", "phase": "Odd"}]}}
    assert [entry.name for entry in DatasetStatus.of(body).variants] == ["b"]
    assert body == {"status": {"variants": [{"phase": "Ready"}, {"name": "b", "phase": "Odd"}]}}


def test_fields_of_a_later_version_stay_in_lists() -> None:
    entry = {"name": "a", "phase": "Ready", "sizeBytes": 7, "later": {"x": [1, None]}}
    status = DatasetStatus.of({"status": {"variants": [entry]}})
    again = status.variants[0].replace(phase=VariantPhase.PENDING)
    assert DatasetStatus(variants=[again]).as_patch() == {"variants": [entry | {"phase": "Pending"}]}


def test_a_patch_has_the_given_fields_and_removes_those_that_are_none() -> None:
    status = MappingRunStatus(phase=Phase.RUNNING, reason=None, start_time=TIME, usage=Usage(samples=3))
    assert status.as_patch() == {
        "phase": "Running",
        "reason": None,
        "startTime": TIME,
        "usage": {"cpu": {}, "memory": {}, "samples": 3},
    }


def test_a_sweep_says_what_is_best() -> None:
    best = [{"name": "r", "index": 3, "ate": 0.5}]
    assert SweepStatus.of({"status": {"best": best}}).as_patch() == {"best": best}
