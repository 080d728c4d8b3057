# SPDX-License-Identifier: Apache-2.0
"""Predictions of costs: from the nearest runs, wider with distance, with what runs share in their sums."""

from __future__ import annotations

import math
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis.design import Known, Nearness, Quantity, Setting, design
from slamhive.analysis.predicting import CostInterval, predict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.predicting import Prediction

FRAMES = {"hall": 1000, "yard": 2000, "street": 4000, "park": 500}


def setting(algorithm: str = "icp", dataset: str = "hall", size: float = 1000, **fields: Any) -> Setting:
    return Setting(
        **{
            "algorithm": algorithm,
            "sensors": "lidar",
            "pace": "Lockstep",
            "dataset": dataset,
            "processor": "P",
            "frames": FRAMES[dataset],
            "changed": {"parameters.size": size},
            **fields,
        }
    )


def truth(one: Setting) -> float:
    """Return the cost of a run: 1 CPU s for 100 frames and the usual size, the root of another size."""
    factor = {"icp": 1.0, "slam": 6.0}[one.algorithm]
    return factor * (one.frames or 0) / 100 * (one.option("parameters.size") / 1000) ** 0.5


def runs(settings: Sequence[Setting], repetitions: int = 3, noise: float = 0.05) -> list[Known]:
    chance = Random(2)
    return [
        Known(one, {Quantity.CPU: truth(one) * math.exp(chance.gauss(0, noise))})
        for one in settings
        for _ in range(repetitions)
    ]


KNOWN = runs([setting(dataset=data, size=size) for data in ("hall", "yard") for size in (500, 1000, 2000)])


def predicted(known: Sequence[Known], *asked: Setting, quantity: Quantity = Quantity.CPU) -> Prediction:
    found = predict(quantity, known, asked, design(known, asked))
    assert found is not None
    return found


def width(span: CostInterval) -> float:
    return span.high / span.low


def test_what_ran_before_is_predicted_as_it_ran() -> None:
    asked = [setting(dataset=data, size=size) for data in ("hall", "yard") for size in (500, 1000, 2000)]
    found = predicted(KNOWN, *asked)
    assert set(found.design.nearness) == {Nearness.SETTING}
    total = CostInterval.of(found.total(np.full(len(asked), 3.0)))
    actual = sum(one.costs[Quantity.CPU] for one in KNOWN)
    assert total.middle == pytest.approx(actual, rel=0.03)
    assert total.low < actual < total.high


def test_another_value_follows_the_trend_of_those_that_are_known() -> None:
    asked = setting(size=4000)
    low, high = predicted(KNOWN, asked).each()
    assert low[0] < truth(asked) < high[0]
    assert predicted(KNOWN, asked).middles()[0] > truth(setting(size=2000))


def test_another_dataset_counts_by_its_frames() -> None:
    asked = setting(dataset="street")
    low, high = predicted(KNOWN, asked).each()
    assert low[0] < truth(asked) < high[0]


def test_the_farther_the_nearest_runs_are_the_wider_the_interval() -> None:
    both = [*KNOWN, *runs([setting("slam", "hall")])]
    asked = [
        setting(),
        setting(size=1500),
        setting(dataset="street", size=1500),
        setting(dataset="street", size=1500, pace="Realtime"),
        setting("slam", "street", size=1500, pace="Realtime"),
    ]
    found = predicted(both, *asked)
    assert found.design.nearness == [
        Nearness.SETTING,
        Nearness.PAIR,
        Nearness.ALGORITHM,
        Nearness.MODE,
        Nearness.MODE,
    ]
    scatter = found.scatter().tolist()
    assert scatter == sorted(scatter)


def test_an_algorithm_that_never_ran_is_told_apart() -> None:
    other = setting("unheard-of")
    assert design(KNOWN, [other]).nearness == [Nearness.NOTHING]


def test_another_processor_and_an_unknown_length_make_it_wider() -> None:
    asked = [
        setting(),
        setting(processor="Q"),
        setting(dataset="street"),
        setting(dataset="park", frames=None),
    ]
    scatter = predicted(KNOWN, *asked, setting(size=1001)).scatter()
    assert scatter[1] > 1.5 * scatter[4] > 1.5 * scatter[0]
    assert scatter[3] > 2 * scatter[2]


def test_many_runs_are_no_surer_than_what_they_share() -> None:
    few = predicted(KNOWN, setting(dataset="street"))
    one, many = (CostInterval.of(few.total(np.array([count]))) for count in (1.0, 1000.0))
    assert many.middle == pytest.approx(1000 * one.middle, rel=0.1)
    assert width(many) > 1.3
    same = predicted(KNOWN, setting())
    one, many = (CostInterval.of(same.total(np.array([count]))) for count in (1.0, 1000.0))
    assert width(many) < width(one)


def test_another_sweep_differs_as_sweeps_did() -> None:
    def known(*factors: float) -> list[Known]:
        return [
            Known(
                one.setting._replace(occasion=f"sweep {number}"),
                {Quantity.CPU: factor * one.costs[Quantity.CPU]},
            )
            for number, factor in enumerate(factors)
            for one in KNOWN
        ]

    def width_of(runs: list[Known], occasion: str) -> float:
        found = predicted(runs, setting(occasion=occasion))
        return width(CostInterval.of(found.total(np.array([1000.0]))))

    alike, different = known(1.0, 1.0, 1.0, 1.0), known(1.0, 2.0, 0.7, 1.5)
    assert width_of(alike, "now") > width_of(alike, "sweep 0")
    assert width_of(different, "now") > 1.3 * width_of(alike, "now")


def test_what_a_run_may_take_at_most_bounds_it() -> None:
    draws = predicted(KNOWN, setting(dataset="street")).total(np.array([10.0]), np.array([5.0]))
    assert CostInterval.of(draws).middle == pytest.approx(50.0, rel=0.05)


def test_the_largest_of_many_runs_is_larger_than_each() -> None:
    found = predicted(KNOWN, *(setting(size=size) for size in range(980, 1020)))
    assert CostInterval.of(found.largest()).middle > 1.1 * found.middles().max()


def test_nothing_is_said_of_a_cost_that_nobody_measured() -> None:
    assert predict(Quantity.DISK, KNOWN, [setting()], design(KNOWN, [setting()])) is None


def test_eight_of_ten_runs_lie_within_their_intervals() -> None:
    chance, held, count = Random(5), 0, 0
    for number in range(60):
        own = {size: math.exp(chance.gauss(0, 0.15)) for size in (500, 700, 1000, 1400, 2000)}
        whole = [
            Known(setting(size=size), {Quantity.CPU: factor * 10 * math.exp(chance.gauss(0, 0.1))})
            for size, factor in own.items()
            for _ in range(2)
        ]
        out = whole.pop(number % len(whole))
        low, high = predicted(whole, out.setting).each()
        held += low[0] <= out.costs[Quantity.CPU] <= high[0]
        count += 1
    assert 0.7 <= held / count <= 0.92


def test_values_beyond_number_are_put_into_groups() -> None:
    chance = Random(1)
    known = runs([setting(size=chance.uniform(500, 2000)) for _ in range(60)], repetitions=1)
    asked = setting(size=1234.5)
    found = predicted(known, asked)
    assert found.middles()[0] == pytest.approx(truth(asked), rel=0.1)
    assert len(found.effects) < 30


@pytest.mark.parametrize(("pace", "factor"), [("Realtime", 0.5), ("Stepped", 0.5), ("Lockstep", 1.0)])
def test_wall_time_of_what_is_played_follows_the_speed_of_playback(pace: str, factor: float) -> None:
    """In Stepped time stands besides: how much longer that takes is told by the runs that are known."""
    known = [Known(setting(pace=pace, seconds=100.0), {Quantity.WALL: 140.0 + number}) for number in range(5)]
    asked = [setting(pace=pace, seconds=100.0), setting(pace=pace, seconds=100.0, rate=2.0)]
    usual, fast = predicted(known, *asked, quantity=Quantity.WALL).middles()
    assert usual == pytest.approx(142.0, rel=0.02)
    assert fast == pytest.approx(factor * usual, rel=0.02)
