# SPDX-License-Identifier: Apache-2.0
"""Header stamps that go back, are equal, leave gaps or wander, in recordings whose record times are right."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.repairing import open_recording
from slamhive.model.dataset import Dataset

START = 1_600_000_000 * 10**9
COUNT, PERIOD = 1200, 5_000_000
CLEAN = START + np.arange(COUNT) * PERIOD
MS = 10**6


def noise(seed: int, scale: float) -> Any:
    return np.abs(np.random.default_rng(seed).normal(0, scale, COUNT)).astype(np.int64)


@pytest.fixture
def stamped(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> Any:
    """Make a dataset of an IMU of 200 Hz with other stamps than those at which it is recorded."""

    def make(stamps: Any, recorded: Any = CLEAN, *beside: str) -> Any:
        rng = np.random.default_rng(1)
        (tmp_path / "walk.bag").unlink(missing_ok=True)
        with bag_writer(tmp_path / "walk.bag") as bag:
            for stamp, time in sorted(
                zip(stamps.tolist(), recorded.tolist(), strict=True), key=lambda k: k[1]
            ):
                bag.recorded_at = time
                rate, force = rng.normal(0, 0.01, 3), np.array([0.0, 0.0, 9.81]) + rng.normal(0, 0.05, 3)
                bag.imu("/imu", stamp, "imu", rate, force)
                for name in beside:
                    bag.imu(f"/{name}", time, name, rate, force)
        sensors = {name: ("Imu", f"/{name}") for name in ("imu", *beside)}
        return bag_entry(tmp_path / "walk.bag", sensors)

    return make


def found(entry: Any) -> dict[str, Any]:
    return {one.code: one for one in inspect(entry).findings}


def repaired(entry: Any, finding: Any) -> Any:
    """Return a dataset under the repair that a finding proposes."""
    values = entry.dataset.as_json()
    values["spec"] |= finding.repair
    return type(entry)(Dataset.model_validate(values), entry.root)


def stamps_of(entry: Any, topic: str = "/imu") -> Any:
    with open_recording(entry.dataset, entry.root) as recording:
        return recording.scan([topic])[topic].stamps


def second_back_then_ahead() -> Any:
    stamps = CLEAN.copy()
    stamps[700:800] -= 10**9
    stamps[800:] += 10**9
    return stamps


def test_a_second_that_stamps_fall_back_by_is_named_and_repaired_by_the_times_of_recording(
    stamped: Any,
) -> None:
    entry = stamped(second_back_then_ahead())
    report = inspect(entry)
    (finding,) = report.findings
    assert (finding.code, finding.count) == ("stamps.back", 1)
    assert finding.value == pytest.approx(1.0)
    assert finding.first == pytest.approx(CLEAN[699] / 1e9)
    assert "message 701 of 1200" in finding.message
    assert "back by 1 s" in finding.message
    assert report.errors == [finding.message]
    mended = repaired(entry, finding)
    np.testing.assert_array_equal(stamps_of(mended), CLEAN)
    assert found(mended) == {}


def test_stamps_out_of_order_are_dropped_where_the_times_of_recording_are_worse(stamped: Any) -> None:
    stamps = CLEAN.copy()
    stamps[[300, 700]] -= 300 * MS
    entry = stamped(stamps, CLEAN + np.sort(noise(2, 40 * MS)))
    finding = found(entry)["stamps.back"]
    assert finding.repair["repair"]["sensors"]["imu"] == {"stamps": "Drop"}
    assert finding.count == 2
    assert finding.value == pytest.approx(0.3)
    np.testing.assert_array_equal(stamps_of(repaired(entry, finding)), np.delete(CLEAN, [300, 700]))
    steady = found(stamped(stamps))["stamps.back"]
    assert steady.repair["repair"]["sensors"]["imu"] == {"stamps": "Recorded"}


def test_a_clock_that_leaps_for_good_is_repaired_by_times_of_recording_that_jitter(stamped: Any) -> None:
    finding = found(stamped(second_back_then_ahead(), CLEAN + noise(2, MS)))["stamps.back"]
    assert finding.repair["repair"]["sensors"]["imu"] == {"stamps": "Recorded"}


def test_messages_without_a_stamp_are_left_out(stamped: Any) -> None:
    stamps = CLEAN.copy()
    stamps[[0, 5]] = 0
    entry = stamped(stamps)
    finding = found(entry)["stamps.zero"]
    np.testing.assert_array_equal(stamps_of(repaired(entry, finding)), np.delete(CLEAN, [0, 5]))
    assert found(stamped(np.zeros(COUNT, dtype=np.int64)))["stamps.zero"].repair == {}


@pytest.mark.parametrize(("at", "stamp"), [(0, 0), (-1, START + 3 * 10**16)], ids=["none", "of another year"])
def test_a_stamp_of_another_time_stretches_no_recording(stamped: Any, at: int, stamp: int) -> None:
    stamps = CLEAN.copy()
    stamps[at] = stamp
    report = inspect(stamped(stamps, CLEAN, "imu2"))
    assert report.duration_seconds == pytest.approx((COUNT - 1) * PERIOD / 1e9)
    assert [warning for warning in report.warnings if "covers" in warning] == []


@pytest.mark.parametrize("burst", [2, 5])
def test_equal_stamps_are_counted_with_the_right_rate(stamped: Any, burst: int) -> None:
    entry = stamped(np.repeat(CLEAN[::burst], burst))
    report = inspect(entry)
    (finding,) = report.findings
    count = COUNT - COUNT // burst
    assert (finding.code, finding.severity, finding.count) == ("stamps.equal", "warning", count)
    assert report.sensors[0].rate == pytest.approx(200, rel=0.01)
    np.testing.assert_allclose(stamps_of(repaired(entry, finding)), CLEAN, atol=burst / 2 * PERIOD)
    # Bursts of ten leave no gaps between them.
    bursts = np.repeat(CLEAN[::10], 10)
    (alike,) = inspect(stamped(bursts, bursts + np.tile(np.arange(10), COUNT // 10))).findings
    assert (alike.code, alike.repair) == ("stamps.equal", {})


def test_scans_that_were_recorded_twice_are_left_out(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> None:
    points = np.ones(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    times = np.sort(np.concatenate((CLEAN[::20], CLEAN[::200])))
    with bag_writer(tmp_path / "walk.bag") as bag:
        for k, time in enumerate(times.tolist()):
            bag.recorded_at = time + k % 7
            bag.points("/points", time, "lidar", points)
    entry = bag_entry(tmp_path / "walk.bag", {"lidar": ("Lidar", "/points")})
    once = repaired(entry, found(entry)["stamps.equal"])
    np.testing.assert_array_equal(stamps_of(once, "/points"), CLEAN[::20])


def test_one_stamp_twice_is_a_note(stamped: Any) -> None:
    stamps = CLEAN.copy()
    stamps[7] = stamps[6]
    assert {code: one.severity for code, one in found(stamped(stamps)).items()} == {"stamps.equal": "note"}


@pytest.mark.parametrize(("wander", "severity"), [(0.1, None), (0.3, "note"), (0.5, "warning")])
def test_stamps_that_wander_are_named_with_their_spread(
    stamped: Any, wander: float, severity: str | None
) -> None:
    stamps = np.sort(CLEAN + noise(3, wander * PERIOD))
    findings = found(stamped(stamps))
    assert {code: one.severity for code, one in findings.items()} == (
        {"stamps.jitter": severity} if severity else {}
    )
    if severity:
        assert "look like times of arrival" in findings["stamps.jitter"].message


def test_a_rate_that_varies_is_no_fault(stamped: Any) -> None:
    steps = PERIOD * (1 + 0.6 * np.sin(np.arange(COUNT) / 60))
    stamps = START + np.cumsum(steps).astype(np.int64)
    (finding,) = inspect(stamped(stamps, stamps)).findings
    assert (finding.code, finding.severity) == ("stamps.jitter", "note")
    assert "a rate that varies is no fault" in finding.message


def test_a_clean_stream_and_its_gap(stamped: Any) -> None:
    assert found(stamped(CLEAN)) == {}
    late = CLEAN.copy()
    late[500:] += 10**9
    (finding,) = inspect(stamped(late, late)).findings
    assert (finding.code, finding.count) == ("stamps.gap", 1)
    assert finding.value == pytest.approx(1.005)
