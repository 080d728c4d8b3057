# SPDX-License-Identifier: Apache-2.0
"""Runs that ask a recording for more than it has: told truly, and done once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.local.home.catalog import DatasetPlace
from slamhive.model.dataset import Dataset
from slamhive.model.results import Phase
from slamhive.model.sweep import Sweep
from slamhive.plan import plan_problems

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import RunRecord


@pytest.fixture
def brisk(bench: Workbench) -> None:
    """A recording like tiny, at 20 Hz and 2 s longer."""
    place = bench.workshop.dataset_places["tiny"]
    spec = place.dataset.spec.as_json()
    spec["recording"]["synthetic"] |= {"durationSeconds": 12}
    spec["recording"]["synthetic"]["lidar"]["rate"] = 20
    dataset = Dataset.model_validate({"metadata": {"name": "brisk"}, "spec": spec})
    bench.workshop.dataset_places["brisk"] = DatasetPlace(dataset, place.folder)


@pytest.fixture
def bag(bench: Workbench) -> None:
    """The recording of tiny as a bag of which a manifest tells neither rate nor length."""
    entry = bench.dataset("tiny")
    sensors = {name: sensor.as_json() for name, sensor in entry.dataset.spec.sensors.items()}
    for sensor in sensors.values():
        sensor.pop("rate", None)
    spec = {
        "recording": {"files": [{"path": entry.dataset.spec.recording.files[0].path}]},
        "sensors": sensors,
    }
    dataset = Dataset.model_validate({"metadata": {"name": "bag"}, "spec": spec})
    bench.workshop.dataset_places["bag"] = DatasetPlace(dataset, entry.root)


@pytest.fixture
def run(run_sweep: Callable[..., Any]) -> Callable[..., list[RunRecord]]:
    """Runs a sweep over settings, and returns its records in their order."""

    def go(matrix: list[dict[str, Any]], template: dict[str, Any], **more: Any) -> list[RunRecord]:
        spec = {"algorithmRef": {"name": "actor"}} | template
        body = {"template": {"spec": spec}, "matrix": matrix} | more
        job, notes = run_sweep(Sweep.model_validate({"metadata": {"name": "rates"}, "spec": body}))
        assert plan_problems(job.points) == []
        return sorted(notes.records, key=lambda record: record.index or 0)

    return go


RATES = [
    {"path": "dataset", "values": ["tiny", "brisk"]},
    {"path": "input.frameRate", "values": [10, 15, 30]},
]


@pytest.mark.slow
@pytest.mark.usefixtures("brisk")
@pytest.mark.parametrize("how", [{}, {"cachePolicy": "Rerun"}])
def test_rates_over_two_recordings_are_told_as_they_took_effect(run: Callable[..., Any], how: Any) -> None:
    records = run(RATES, {}, **how)
    assert [record.phase for record in records] == [Phase.SUCCEEDED] * 6
    kept = [record.provenance for record in records]
    assert [record.spec["input"]["frameRate"] for record in records] == [10, 10, 10, 10, 15, 20]
    assert [known.prepared.frame_rate for known in kept] == pytest.approx([10, 10, 10, 10, 15, 20], rel=0.01)
    asked = [None, {"frameRate": 15}, {"frameRate": 30}, None, None, {"frameRate": 30}]
    assert [known.asked for known in kept] == asked
    assert [(known.effective or {}).get("frameRate") for known in kept] == [None, 10, 10, None, None, 20]
    # What comes out equal is done once, even where two runs go at a time and nothing else is reused.
    first = records[0].name
    assert [known.reused_from for known in kept] == [None, first, first, None, None, None]
    assert records[1].results == records[0].results


@pytest.mark.usefixtures("brisk")
def test_what_comes_out_equal_waits_although_there_is_room(run_sweep: Callable[..., Any]) -> None:
    spec = {"template": {"spec": {"algorithmRef": {"name": "actor"}}}, "matrix": RATES}
    sweep = Sweep.model_validate({"metadata": {"name": "rates"}, "spec": spec})
    _, notes = run_sweep(sweep, parallelism=6)
    assert {0, 3, 4, 5} in notes.active  # all that asks for something of its own
    assert not any(0 in active and active & {1, 2} for active in notes.active)


@pytest.mark.usefixtures("brisk")
def test_the_archive_keeps_what_was_asked(run: Callable[..., Any], bench: Workbench) -> None:
    records = run(RATES[:1], {"input": {"frameRate": 30, "duration": "1m"}})
    stored = [bench.archive.get(record.uid) for record in records]
    assert [record.provenance.asked for record in stored if record] == [
        {"frameRate": 30, "duration": "1m"}
    ] * 2
    assert [record.provenance.effective for record in stored if record] == [
        {"frameRate": 10, "duration": "10s"},
        {"frameRate": 20, "duration": "12s"},
    ]
    assert stored == records


@pytest.mark.usefixtures("bag")
def test_what_only_the_bag_itself_tells_is_told_after_it_was_read(run: Callable[..., Any]) -> None:
    asked = {"frameRate": 30, "start": "2s", "duration": "100s"}
    [record] = run([], {"datasetRef": {"name": "bag"}, "input": asked})
    assert record.phase is Phase.SUCCEEDED
    known = record.provenance
    assert known.asked == {"frameRate": 30, "duration": "100s"}
    assert known.effective == {"frameRate": 10, "duration": "7s900ms"}
    assert known.prepared.frame_rate == pytest.approx(10, rel=0.01)
    assert known.prepared.duration_seconds == pytest.approx(7.9, abs=0.11)
    assert record.spec["input"]["duration"] == "100s"  # what it is prepared and measured by
