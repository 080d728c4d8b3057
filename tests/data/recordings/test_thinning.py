# SPDX-License-Identifier: Apache-2.0
from typing import Any

import numpy as np
import pytest

from slamhive.data.recordings.thinning import partners, rate_of, thin

MS = 10**6


def stream(rate: Any, count: Any, jitter_ms: Any = 0.0, seed: Any = 0) -> Any:
    noise = np.random.default_rng(seed).uniform(-jitter_ms, jitter_ms, count)
    return np.rint(1e9 * np.arange(count) / rate + noise * MS).astype(np.int64)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("recorded", "wanted"), [(20.0, 10.0), (19.97, 10.0), (20.03, 10.0), (30.0, 10.0), (10, 5)]
)
def test_spacing_stays_regular_under_jitter_and_drift(recorded: Any, wanted: Any, seed: Any) -> None:
    stamps = stream(recorded, 2000, jitter_ms=8, seed=seed)
    steps = np.diff(stamps[thin(stamps, wanted)]) / MS
    period = round(recorded / wanted) * 1000 / recorded
    assert np.abs(steps - period).max() <= 16.1
    assert steps.mean() == pytest.approx(period, rel=2e-3)


@pytest.mark.parametrize("wanted", [15.0, 12.0, 7.0, 1.3])
def test_other_rates_are_met_on_average(wanted: Any) -> None:
    stamps = stream(20.0, 2000, jitter_ms=3)
    kept = stamps[thin(stamps, wanted)]
    assert 1e9 / np.diff(kept).mean() == pytest.approx(wanted, rel=5e-3)
    assert np.diff(kept).max() <= 1e9 / wanted + 60 * MS


@pytest.mark.parametrize("wanted", [20.0, 25.0, 19.9, 100.0])
def test_a_rate_that_is_not_lower_keeps_everything(wanted: Any) -> None:
    assert thin(stream(20.0, 50, jitter_ms=5), wanted).all()


def test_thinning_goes_on_after_a_gap() -> None:
    stamps = stream(20.0, 100)
    stamps[50:] += 7 * 10**9 + 13 * MS
    kept = stamps[thin(stamps, 10.0)]
    steps = np.diff(kept) / MS
    assert np.count_nonzero(np.abs(steps - 100) > 1) == 1
    assert len(kept) == 50


def test_a_dropped_frame_is_replaced_by_its_neighbour() -> None:
    stamps = np.delete(stream(20.0, 100), 40)
    steps = np.diff(stamps[thin(stamps, 10.0)]) / MS
    assert set(np.rint(steps)) <= {50.0, 100.0, 150.0}
    assert np.count_nonzero(np.rint(steps) != 100) == 1


@pytest.mark.parametrize("count", [1, 2])
def test_short_streams(count: Any) -> None:
    assert thin(stream(20.0, count), 1.0)[0]


def test_rate_leaves_gaps_out_but_not_an_irregular_stream() -> None:
    stamps = stream(20.0, 200)
    stamps[100:] += 60 * 10**9
    assert rate_of(stamps) == pytest.approx(20.0)
    bursts = np.cumsum(np.tile([50, 50, 900], 100)) * MS
    assert rate_of(bursts) == pytest.approx(3.0, rel=0.01)
    assert rate_of(stamps[:1]) is None


def test_partners_are_unique_and_near() -> None:
    stamps, others = np.array([0, 100, 200, 300]), np.array([4, 110, 190, 290, 296])
    assert partners(stamps, others, 20).tolist() == [0, 1, 2, 4]
    assert partners(stamps, np.array([140]), 60).tolist() == [-1, 0, -1, -1]
    assert partners(stamps, np.array([], dtype=np.int64), 20).tolist() == [-1] * 4
