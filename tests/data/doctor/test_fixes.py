# SPDX-License-Identifier: Apache-2.0
"""Findings of GNSS fixes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import found_in, spoil

from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset

if TYPE_CHECKING:
    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.entries import DatasetEntry

METRE = 1 / 111_200
CENTIMETRE = np.diag([1e-4, 1e-4, 1e-4]).reshape(-1)


@pytest.fixture(scope="session")
def fixes(tmp_path_factory: pytest.TempPathFactory) -> DatasetEntry:
    """A generated recording of 46 fixes, with noise of 0.3 m."""
    folder = tmp_path_factory.mktemp("fixes")
    synthetic = {"sensors": ["Gnss"], "durationSeconds": 9, "loops": 0.2}
    values = {"metadata": {"name": "fixes"}, "spec": {"recording": {"synthetic": synthetic}}}
    return materialise(Dataset.model_validate(values), folder, folder)


@pytest.fixture
def spoiled(fixes: DatasetEntry, tmp_path_factory: pytest.TempPathFactory) -> Any:
    def make(change: Any) -> DatasetEntry:
        numbers = iter(range(1000))

        def changed(topic: str, message: Any) -> Any:
            if topic == "/fix":
                change(next(numbers), message)
            return message

        return spoil(fixes, tmp_path_factory.mktemp("spoiled"), changed)

    return make


def north(message: Any, metres: float) -> None:
    message.latitude += metres * METRE


def of_gnss(entry: DatasetEntry) -> dict[str, Finding]:
    return {code: one for code, one in found_in(entry).items() if code.startswith("gnss.")}


@pytest.mark.parametrize(
    "change",
    [
        lambda _k, _fix: None,
        lambda k, fix: north(fix, 0.5 * 3.0 * (k / 5) ** 2),
        lambda k, fix: north(fix, 20.0 * max(0.0, k / 5 - 4.0)),
        lambda k, fix: north(fix, float(np.random.default_rng(k).normal(0, 4))),
    ],
    ids=["plain", "speeding", "starting", "noisy"],
)
def test_vehicles_and_noise_are_no_finding(spoiled: Any, change: Any) -> None:
    assert of_gnss(spoiled(change)) == {}


def test_a_vehicle_may_get_faster_while_there_is_no_fix(spoiled: Any) -> None:
    """It stands, has no fix for three seconds, and goes on at 30 m/s then."""

    def change(k: int, fix: Any) -> None:
        fix.latitude, fix.longitude = 49.0 + METRE * (45.0 + 6.0 * (k - 25)) * (k >= 25), 8.0
        fix.status.status = -1 if 10 <= k < 25 else 0
        fix.position_covariance_type = 0

    assert set(of_gnss(spoiled(change))) == {"gnss.status"}


def test_a_leap_that_the_covariance_denies_is_named_and_left_out(spoiled: Any) -> None:
    """Thirty metres in a fifth of a second are 150 m/s, but ten are no more than an aircraft's speed."""

    def change(k: int, fix: Any) -> None:
        fix.position_covariance, fix.position_covariance_type = CENTIMETRE, 2
        north(fix, 10.0 if k in {20, 21} else 0.0)

    finding = of_gnss(spoiled(change))["gnss.leap"]
    assert finding.value == pytest.approx(10, abs=2)
    assert finding.count == 2
    assert "standard deviation is 0.014 m" in finding.message
    assert finding.repair["repair"]["sensors"]["gnss"] == {"drop": [20, 21]}


def test_a_leap_that_stays_has_no_repair(spoiled: Any) -> None:
    finding = of_gnss(spoiled(lambda k, fix: north(fix, 10.0 * (k > 20))))["gnss.leap"]
    assert (finding.count, finding.repair) == (1, {})


def test_states_are_counted_by_kind(spoiled: Any) -> None:
    def change(k: int, fix: Any) -> None:
        fix.status.status = (-1, 0, 1, 2)[k % 4]

    finding = of_gnss(spoiled(change))["gnss.status"]
    assert str(finding.severity) == "warning"
    assert (
        "12 of 46 messages on /fix have no fix; the others are 12 of satellites alone (0), 11 with SBAS (1)"
        in (finding.message)
    )

    def kinds(k: int, fix: Any) -> None:
        fix.status.status = k % 2

    assert str(of_gnss(spoiled(kinds))["gnss.status"].severity) == "note"
