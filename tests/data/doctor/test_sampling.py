# SPDX-License-Identifier: Apache-2.0
"""The quick look: what some messages of each sensor tell, and what they don't."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import found_in, spoil

from slamhive.data.doctor.findings import Finding, Severity
from slamhive.data.doctor.sampling import SAMPLED, of_sample
from slamhive.data.inspecting.quick import glance, require_usable

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.recordings.entries import DatasetEntry

DEPTH = "/camera/depth/image_raw"
TAI = 37


def in_tai(topic: str, message: Any) -> Any:
    if topic != "/points":
        return message
    stamp = message.header.stamp
    return replace(message, header=replace(message.header, stamp=replace(stamp, sec=stamp.sec + TAI)))


def in_metres(topic: str, message: Any) -> Any:
    if topic != DEPTH:
        return message
    pixels = message.data.view("<u2") // 50
    return replace(message, data=np.ascontiguousarray(pixels).view(np.uint8))


@pytest.mark.parametrize("fixture", ["lidar_entry", "camera_entries"])
def test_a_clean_recording_has_nothing(request: pytest.FixtureRequest, fixture: str) -> None:
    given = request.getfixturevalue(fixture)
    entry = given[0.5] if isinstance(given, dict) else given
    report = glance(entry)
    assert (report.errors, report.warnings, report.findings) == ([], [], [])
    declared = entry.dataset.spec.sensors
    assert {one.name: one.rate for one in report.sensors} == {
        name: pytest.approx(sensor.rate, rel=0.05) for name, sensor in declared.items()
    }


@pytest.mark.parametrize(
    ("fixture", "change", "code"),
    [("lidar_entry", in_tai, "clock.epoch"), ("camera_entries", in_metres, "depth.unit")],
)
def test_what_all_messages_have_is_found_in_some(
    request: pytest.FixtureRequest, tmp_path: Path, fixture: str, change: Any, code: str
) -> None:
    given = request.getfixturevalue(fixture)
    entry = spoil(given[0.5] if isinstance(given, dict) else given, tmp_path / "spoiled", change)
    whole, quick = found_in(entry)[code], {one.code: one for one in glance(entry).findings}[code]
    assert (quick.severity, quick.repair) == (whole.severity, whole.repair)
    added, _ = require_usable(entry.dataset, entry.root)
    assert code in {one.code for one in added}


@pytest.fixture
def long(frames_of: Any, tmp_path: Path) -> DatasetEntry:
    """A camera whose images are each of one grey: all 400 of them."""
    made: DatasetEntry = frames_of(tmp_path / "long.bag", rate=20.0, count=400)
    return made


def test_a_sample_is_bounded_and_reaches_to_the_end(long: DatasetEntry) -> None:
    report = glance(long)
    (sensor,) = report.sensors
    assert (sensor.messages, report.sampled) == (400, SAMPLED)
    assert sensor.rate == pytest.approx(20.0, rel=0.01)
    late = spoil(long, long.root / "late", lambda _, message: message)
    (found,) = (one for one in glance(late).findings if one.code == "images.constant")
    assert found.count == SAMPLED


def test_no_repair_counts_the_messages_of_a_sample(long: DatasetEntry, tmp_path: Path) -> None:
    numbers = iter(range(10_000))

    def seen_from_the_hundredth(topic: str, message: Any) -> Any:
        if not topic.endswith("image_raw") or next(numbers) < 100:
            return message
        return replace(message, data=np.arange(message.data.size, dtype=np.uint8))

    entry = spoil(long, tmp_path / "late", seen_from_the_hundredth)
    assert found_in(entry)["images.constant"].repair == {
        "repair": {"sensors": {"camera": {"dropLeading": 100}}}
    }
    quick = {one.code: one for one in glance(entry).findings}
    assert quick["images.constant"].repair == {}
    assert quick["images.constant"].count < SAMPLED
    assert "files.count" not in quick


def test_what_only_all_messages_tell_is_left_to_them() -> None:
    found = [
        Finding(code, Severity.WARNING, "") for code in ("stamps.gap", "points.no-return", "clock.drift")
    ]
    assert [one.code for one in of_sample(found)] == ["points.no-return"]
