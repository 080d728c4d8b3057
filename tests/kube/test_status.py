# SPDX-License-Identifier: Apache-2.0
"""Statuses as the API holds them."""

from __future__ import annotations

import pytest

from slamhive.engine import RunState
from slamhive.kube import status as st
from slamhive.kube.reconciling.run_status import usage_suspect
from slamhive.model.results import CpuUsage, MemoryUsage, Outcome, Phase, Reason, Result, Usage
from slamhive.model.status import MappingRunStatus


def test_times_come_back() -> None:
    assert st.iso(1_600_000_000.25) == "2020-09-13T12:26:40.250000Z"
    assert st.moment("2020-09-13T12:26:40.25Z") == 1_600_000_000.25
    assert st.moment("yesterday") is st.moment(None) is None


def test_a_condition_keeps_its_time_while_its_status_stays() -> None:
    first = st.merged([], [st.condition("Ready", False, "Waiting")], 1, 10.0)
    same = st.merged(first, [st.condition("Ready", False, "StillWaiting", "for a node")], 2, 20.0)
    other = st.merged(same, [st.condition("Ready", True, "Done")], 2, 30.0)
    assert same[0]["lastTransitionTime"] == first[0]["lastTransitionTime"] == st.iso(10.0)
    assert (same[0]["reason"], same[0]["observedGeneration"]) == ("StillWaiting", 2)
    assert other[0]["lastTransitionTime"] == st.iso(30.0)


def test_other_conditions_stay() -> None:
    before = [{"type": "Queued", "status": "True", "reason": "Kueue", "message": ""}]
    after = st.merged(before, [st.condition("Ready", None, "Unknown")], 1, 10.0)
    assert [item["type"] for item in after] == ["Queued", "Ready"]
    assert st.holds({"conditions": after}, "Queued") is True
    assert st.holds({"conditions": after}, "Ready") is None
    assert st.holds({}, "Ready") is None


@pytest.mark.parametrize(
    "state",
    [
        RunState(),
        RunState(Phase.PENDING, Reason.NODE_LOST, "gone", attempts=2, faults=1, judged=2, not_before=12.5),
        RunState(Phase.FAILED, Reason.OUT_OF_MEMORY, "too much", attempts=1),
    ],
)
def test_what_the_engine_remembers_survives_in_a_status(state: RunState) -> None:
    kept = st.state_fields(state).as_json()
    assert st.run_state(MappingRunStatus.of({"status": kept})) == state


def test_a_result_survives_in_a_status() -> None:
    result = Result(
        evaluation="se3",
        outcome=Outcome.PARTIAL,
        coverage=0.6,
        values={"ate": {"rmse": 0.1}, "settings": "x"},
    )
    field = st.result_field(result)
    assert field["ate"] == {"rmse": 0.1}
    assert field["outcome"] == "Partial"
    assert st.result_of(field) == result


def test_figures_are_shown_as_people_read_them() -> None:
    usage = Usage(cpu=CpuUsage(mean_cores=0.6478), memory=MemoryUsage(peak_bytes=78_630_912))
    shown = st.display(usage, [{"ate": {"rmse": 0.0710095}}])
    assert shown is not None
    assert shown.as_json() == {"ate": "0.07101 m", "cpu": "0.65", "memory": "75Mi"}
    assert st.display(None, []) is None


def test_only_what_differs_is_written() -> None:
    assert st.changes({"a": 1, "b": 2}, {"a": 1, "b": 3, "c": None}) == {"b": 3}


def test_the_metrics_api_is_compared_with_the_working_set() -> None:
    memory = MemoryUsage(peak_bytes=60 << 20, working_set_peak_bytes=200 << 20)
    assert usage_suspect(Usage(memory=memory), None, 200 * 2.0**20) is None
    told = usage_suspect(Usage(memory=memory), None, 300 * 2.0**20)
    assert told == "the metrics API showed 300 MiB, the sidecar 200 MiB at most"
