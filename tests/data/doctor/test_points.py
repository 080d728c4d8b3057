# SPDX-License-Identifier: Apache-2.0
"""Findings of LiDAR scans, each in a recording that is clean otherwise, and what their repairs make of it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import found_in, spoil

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.inspecting.quick import require_usable
from slamhive.data.inspecting.suggestion import suggest_dataset
from slamhive.data.recordings.clouds import cloud_points, point_times
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.repairing import open_recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SCANS = 80
CODES = {"float32": 7, "float64": 8, "uint32": 6}


def at(message: Any) -> float:
    return message.header.stamp.sec + message.header.stamp.nanosec / 1e9


def timed(message: Any, times: Any, letter: str = "f4") -> Any:
    """Return a scan with other times, at the end of its points."""
    points = cloud_points(message, "")
    values = np.asarray(times).astype(letter)
    rows = points.view(np.uint8).reshape(len(points), -1)
    data = np.hstack([rows, values.view(np.uint8).reshape(len(rows), -1)])
    where = {"offset": message.point_step, "datatype": CODES[values.dtype.name]}
    fields = [replace(one, **where) if one.name == "time" else one for one in message.fields]
    step = data.shape[1]
    return replace(
        message, fields=fields, point_step=step, row_step=step * message.width, data=data.reshape(-1)
    )


def chosen(points: Any, share: float) -> Any:
    """Return the mask of a share of points all over a scan."""
    return np.arange(len(points)) % round(1 / share) == 0


def seconds(message: Any) -> Any:
    return cloud_points(message, "")["time"].astype(float)


@pytest.fixture
def spoiled(lidar_entry: DatasetEntry, tmp_path: Path) -> Callable[..., DatasetEntry]:
    """Change the scans by their number."""

    def make(change: Callable[[int, Any], Any], spec: dict[str, Any] | None = None) -> DatasetEntry:
        count = itertools.count()
        return spoil(
            lidar_entry,
            tmp_path / "spoiled",
            lambda topic, message: change(next(count), message) if topic == "/points" else message,
            spec,
        )

    return make


def mended(entry: DatasetEntry, repair: Any) -> DatasetEntry:
    """Return a dataset with the repair of a finding, as if it were copied into the manifest."""
    values = entry.dataset.as_json()
    values["spec"] |= repair
    return DatasetEntry(type(entry.dataset).model_validate(values), entry.root)


def scans_of(entry: DatasetEntry) -> list[Any]:
    with open_recording(entry.dataset, entry.root) as recording:
        return [recording.decode(raw, one.msgtype) for one, _, raw in recording.messages({"/points"})]


def test_a_clean_recording_has_none(lidar_entry: DatasetEntry) -> None:
    assert found_in(lidar_entry) == {}


def test_a_scan_that_comes_again_under_the_next_stamp_is_left_out(spoiled: Any) -> None:
    before: list[Any] = []

    def again(k: int, message: Any) -> Any:
        before.append(message.data)
        return replace(message, data=before[k - 1]) if k in {41, 45} else message

    entry = spoiled(again)
    (finding,) = found_in(entry).values()
    assert (finding.code, finding.severity, finding.count) == ("points.duplicate", "warning", 2)
    assert finding.repair["repair"]["sensors"]["lidar"] == {"drop": [41, 45]}
    assert "points.duplicate" not in found_in(mended(entry, finding.repair))


def test_scans_that_stay_the_same_without_a_truth_are_a_simulator_at_rest(spoiled: Any) -> None:
    seen: list[Any] = []

    def held(k: int, message: Any) -> Any:
        seen.append(seen[-1] if 30 <= k < 38 or k == 40 else message.data)
        return replace(message, data=seen[k])

    finding = found_in(spoiled(held, {"groundTruth": None}))["points.duplicate"]
    assert (finding.count, finding.repair["repair"]["sensors"]["lidar"]) == (1, {"drop": [40]})


def test_scans_without_a_return_are_told_from_scans_that_come_again(spoiled: Any) -> None:
    def blank(k: int, message: Any) -> Any:
        points = cloud_points(message, "").copy()
        for axis in "xyz":
            points[axis] = np.nan if k in {41, 42} else 0 if k == 50 else points[axis]
        return replace(message, data=points.view(np.uint8))

    entry = spoiled(blank)
    findings = [one for one in inspect(entry).findings if one.code.startswith("points.")]
    assert {one.code for one in findings} == {"points.no-return"}
    blanks = findings[0]
    assert (blanks.count, blanks.value, blanks.repair["repair"]["sensors"]["lidar"]) == (
        3, 3, {"drop": [41, 42, 50]},
    )  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        lambda _, m: timed(m, seconds(m), "f8"),
        lambda _, m: timed(m, seconds(m) * 1e9, "u4"),
        lambda _, m: timed(m, seconds(m) + at(m), "f8"),
        lambda _, m: timed(m, 1e9 * (seconds(m) + at(m)), "f8"),
        # Every twentieth scan, as thinned recordings have them, and a first scan that is half a one.
        lambda k, m: m if k % 20 == 0 else None,
        lambda k, m: timed(m, seconds(m) / 2) if k == 0 else m,
    ],
    ids=["float64", "ns", "absolute s", "absolute ns", "thinned", "half"],
)
def test_times_as_drivers_write_them_are_no_finding(spoiled: Any, change: Any) -> None:
    assert found_in(spoiled(change)).keys() <= {"stamps.gap", "stamps.jitter"}


@pytest.mark.parametrize(
    ("change", "expected", "words"),
    [
        (lambda _, m: timed(m, seconds(m) * 1e6), ("error", "us"), "so that a scan lasts 9.89e+04 s"),
        (lambda _, m: timed(m, seconds(m) * 1e6, "u4"), ("warning", "us"), "they are microseconds"),
        (lambda _, m: timed(m, seconds(m) * 1e3), ("error", "ms"), "they are milliseconds"),
        (lambda _, m: timed(m, seconds(m) * 1e9), ("error", "ns"), "taken for seconds"),
        (lambda _, m: timed(m, 1e6 * (seconds(m) + at(m)), "f8"), ("error", "us"), "absolute ones in micro"),
        (lambda _, m: timed(m, seconds(m) + at(m)), ("error", "None"), "in steps of 128 s only"),
        (lambda k, m: timed(m, seconds(m) + 0.1 * k + 5, "f8"), ("error", "None"), "another clock"),
        (lambda k, m: timed(m, 1e6 * (seconds(m) + 0.1 * k + 5), "u4"), ("error", "None"), "another clock"),
    ],
    ids=["us", "us whole", "ms", "ns", "absolute us", "absolute float32", "since start", "us since start"],
)
def test_unit_of_times(
    spoiled: Any, lidar_entry: Any, change: Any, expected: tuple[str, str], words: str
) -> None:
    entry, (severity, unit) = spoiled(change), expected
    finding = found_in(entry)["points.times.unit"]
    assert (str(finding.severity), finding.count, finding.sensor) == (severity, SCANS, "lidar")
    assert words in finding.message
    assert finding.repair == {"repair": {"sensors": {"lidar": {"pointTimes": unit}}}}
    repaired = mended(entry, finding.repair)
    assert found_in(repaired) == {}
    if unit == "None":
        assert "time" not in [field.name for field in scans_of(repaired)[0].fields]
        return
    for scan, clean in zip(scans_of(repaired), scans_of(lidar_entry), strict=True):
        np.testing.assert_allclose(seconds(scan), seconds(clean), atol=1e-6)


def test_absolute_times_of_a_clock_that_counts_from_a_start(spoiled: Any, lidar_entry: DatasetEntry) -> None:
    def simulated(_: int, message: Any) -> Any:
        stamp = replace(message.header.stamp, sec=message.header.stamp.sec - 1_600_000_000 + 130)
        message = replace(message, header=replace(message.header, stamp=stamp))
        return timed(message, seconds(message) + at(message), "f8")

    entry = spoiled(simulated)
    finding = found_in(entry)["points.times.unit"]
    assert "absolute ones in seconds, which are taken for seconds since the stamp" in finding.message
    repaired = mended(entry, finding.repair)
    for scan, clean in zip(scans_of(repaired), scans_of(lidar_entry), strict=True):
        np.testing.assert_allclose(seconds(scan), seconds(clean), atol=1e-6)


def test_a_unit_is_told_where_the_manifest_names_no_field(spoiled: Any, lidar_entry: DatasetEntry) -> None:
    sensors = lidar_entry.dataset.as_json()["spec"]["sensors"]
    del sensors["lidar"]["lidar"]["timeField"]
    finding = found_in(spoiled(lambda _, m: timed(m, seconds(m) * 1e6), {"sensors": sensors}))[
        "points.times.unit"
    ]
    assert "state lidar.timeField: time, and pointTimes: us" in finding.message
    assert not finding.repair


def test_scans_of_one_time(spoiled: Any) -> None:
    finding = found_in(spoiled(lambda _, m: timed(m, 0 * seconds(m))))["points.times.constant"]
    assert (str(finding.severity), finding.count) == ("warning", SCANS)
    assert "run with deskew: false" in finding.message
    assert finding.repair["repair"]["sensors"]["lidar"] == {"pointTimes": "None"}


def test_some_scans_of_one_time(spoiled: Any) -> None:
    entry = spoiled(lambda k, m: timed(m, (0 if k in {5, 6} else 1) * seconds(m)))
    finding = found_in(entry)["points.times.constant"]
    assert (finding.count, finding.first) == (2, pytest.approx(1_600_000_000.5))
    assert "in 2 of" not in finding.message
    assert finding.repair["repair"]["sensors"]["lidar"] == {"drop": [5, 6]}
    assert found_in(mended(entry, finding.repair)).keys() <= {"stamps.gap"}


@pytest.mark.parametrize(("share", "severity"), [(0.001, "note"), (0.5, "warning")])
def test_points_without_a_time(spoiled: Any, share: float, severity: str) -> None:
    def change(k: int, message: Any) -> Any:
        times = seconds(message)
        times[chosen(times, share)] = np.nan
        return timed(message, times)

    entry = spoiled(change)
    finding = found_in(entry)["points.times.none"]
    assert (str(finding.severity), finding.count) == (severity, SCANS)
    repaired = mended(entry, finding.repair)
    assert found_in(repaired) == {}
    before, after = scans_of(entry)[0], scans_of(repaired)[0]
    assert after.width == before.width - chosen(seconds(before), share).sum()
    times, is_absolute = point_times(cloud_points(before, ""), "time", 0) or (np.empty(0), True)
    assert (len(times), is_absolute) == (after.width, False)


def odd_first(k: int, message: Any) -> Any:
    if k:
        return message
    points = cloud_points(message, "")[::4].copy()
    points["time"] *= 36
    return replace(
        message,
        width=len(points),
        row_step=len(points) * message.point_step,
        data=points.view(np.uint8).reshape(-1),
    )


def test_a_first_scan_unlike_the_rest(spoiled: Any) -> None:
    entry = spoiled(odd_first)
    report = inspect(entry)
    finding = next(one for one in report.findings if one.code == "points.times.span")
    assert (str(finding.severity), finding.count) == ("warning", 1)
    assert "span 3.56 s in the scan at 1600000000.000 s, and 0.0989 s typically" in finding.message
    assert finding.repair["repair"]["sensors"]["lidar"] == {"dropLeading": 1}
    widths = sorted(scan.width for scan in scans_of(entry))
    assert report.sensors[0].content.startswith(f"{widths[-1]} points")
    assert found_in(mended(entry, finding.repair)) == {}


def test_scans_unlike_the_rest_in_the_midst(spoiled: Any) -> None:
    entry = spoiled(lambda k, m: timed(m, (3 if k in {7, 40} else 1) * seconds(m)))
    finding = found_in(entry)["points.times.span"]
    assert finding.repair["repair"]["sensors"]["lidar"] == {"drop": [7, 40]}


@pytest.mark.parametrize(("share", "severity"), [(0.5, "warning"), (0.005, "note")])
def test_points_at_the_origin(spoiled: Any, share: float, severity: str) -> None:
    def change(k: int, message: Any) -> Any:
        points = cloud_points(message, "")
        for axis in "xyz":
            points[axis][chosen(points, share)] = 0
        return replace(message, data=points.view(np.uint8).reshape(-1))

    entry = spoiled(change)
    finding = found_in(entry)["points.no-return"]
    assert (str(finding.severity), finding.unit) == (severity, "%")
    assert finding.value == pytest.approx(100 * share, abs=0.1)
    assert found_in(mended(entry, finding.repair)) == {}


def test_points_of_nan_are_a_note_that_says_what_is_dense_states(spoiled: Any) -> None:
    def change(k: int, message: Any) -> Any:
        points = cloud_points(message, "")
        points["y"][:100] = np.nan
        return replace(message, data=points.view(np.uint8).reshape(-1))

    found = found_in(spoiled(change))
    assert found.keys() == {"points.no-return"}
    assert str(found["points.no-return"].severity) == "note"
    assert "is_dense says that there are none" in found["points.no-return"].message


def test_rows_of_0_bytes_are_read_alike_by_all(spoiled: Any, lidar_entry: DatasetEntry) -> None:
    entry = spoiled(lambda _, m: replace(m, row_step=0))
    found = found_in(entry)
    assert [str(one.severity) for one in found.values()] == ["note"]
    assert "rows of 0 bytes" in found["points.layout"].message
    findings, warnings = require_usable(entry.dataset, entry.root)
    assert ([one.code for one in findings], warnings) == (["points.layout"], [])
    bag = entry.root / entry.dataset.spec.recording.files[0].path
    assert any("rows of 0 bytes" in note for note in suggest_dataset([bag], "zero").missing)
    repaired = mended(entry, {"repair": {"sensors": {"lidar": {"noReturns": True}}}})
    for scan, clean in zip(scans_of(repaired), scans_of(lidar_entry), strict=True):
        assert scan.data.tobytes() == clean.data.tobytes()


def test_scans_that_break_off_are_left_out(spoiled: Any) -> None:
    entry = spoiled(lambda k, m: replace(m, data=m.data[:100]) if k in {3, 9} else m)
    finding = found_in(entry)["points.layout"]
    assert (str(finding.severity), finding.count) == ("error", 2)
    assert "2 of 80 scans can't be read" in finding.message
    assert finding.repair["repair"]["sensors"]["lidar"] == {"drop": [3, 9]}
    bag = entry.root / entry.dataset.spec.recording.files[0].path
    assert any("scans can't be read" in note for note in suggest_dataset([bag], "broken").missing)


def test_big_endian_scans_are_a_note(spoiled: Any) -> None:
    def change(k: int, message: Any) -> Any:
        points = cloud_points(message, "")
        swapped = points.astype(points.dtype.newbyteorder(">"))
        return replace(message, is_bigendian=True, data=swapped.view(np.uint8).reshape(-1))

    found = found_in(spoiled(change))
    assert [(code, str(one.severity)) for code, one in found.items()] == [("points.layout", "note")]


def test_a_new_recording_is_described_by_many_scans(spoiled: Any) -> None:
    """A scan stamped at its end tells so, though the first one is broken."""

    def change(k: int, message: Any) -> Any:
        return odd_first(k, timed(message, seconds(message) - 0.1) if k else message)

    entry = spoiled(change)
    bag = entry.root / entry.dataset.spec.recording.files[0].path
    suggestion = suggest_dataset([bag], "new")
    assert suggestion.manifest["spec"]["sensors"]["lidar"]["stamp"] == "ScanEnd"
    assert any("the scan at 1600000000.000 s" in note for note in suggestion.missing)
    assert any(
        "the scan at 1600000000.000 s" in one.message for one in require_usable(entry.dataset, entry.root)[0]
    )
