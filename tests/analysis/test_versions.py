# SPDX-License-Identifier: Apache-2.0
"""Before and after a change: on runs whose truth is known."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import with_derived
from slamhive.analysis.frame import Frame
from slamhive.analysis.grouping import Outcomes
from slamhive.analysis.versions import PERMUTATIONS, SIGN_FLIPS, Change, before_and_after, permutation_test

OLD, NEW = "old", "new"
DAY = 86_400.0


def make_row(version: str, error: float | None, number: int, **more: Any) -> dict[str, Any]:
    """Return a run of a version; None is one that ran out of memory."""
    failed = error is None
    row = {
        "id": number,
        "algorithm": "orb",
        "sensors": "stereo",
        "dataset": "hall",
        "provenance.algorithmHash": version,
        "created": (NEW, OLD).index(version) * -DAY + number if version in {NEW, OLD} else number,
        "phase": "Failed" if failed else "Succeeded",
        "reason": "OutOfMemory" if failed else None,
        "outcome": None if failed else "Tracked",
        "evaluation": "se3",
        "alignment": "se3",
        "ate.rmse": error,
        "usage.cpu.seconds": 60.0,
    }
    return row | more


def frame_of(rows: list[dict[str, Any]]) -> Frame:
    names = dict.fromkeys(name for row in rows for name in row)
    return with_derived({name: Column.of([row.get(name) for row in rows]) for name in names}, len(rows))


def study(
    factor: float, *, settings: int, repetitions: int, seed: int = 1, spread: float = 0.1
) -> list[dict[str, Any]]:
    """Return runs whose errors after are some times those before, in settings of very different sizes."""
    chance = random.Random(seed)
    return [
        make_row(
            version,
            10.0 ** (setting % 3) * scale * chance.lognormvariate(0, spread),
            setting * 100 + k,
            **{"parameters.nFeatures": 500 * (setting + 1)},
        )
        for version, scale in ((OLD, 1.0), (NEW, factor))
        for setting in range(settings)
        for k in range(repetitions)
    ]


def only(
    rows: list[dict[str, Any]], metric: str = "ate.rmse", outcomes: Outcomes = Outcomes.TRACKED
) -> Change:
    (change,) = before_and_after(frame_of(rows), metric, outcomes)[0]
    return change


def test_a_change_for_the_worse_in_many_settings_is_more_than_chance() -> None:
    change = only(study(1.8, settings=12, repetitions=1))
    assert change.ratio == pytest.approx(1.8, rel=0.1)
    assert (change.wins, change.test) == ((0, 12, 0), SIGN_FLIPS)
    assert change.p == 2 / 2**12
    assert "times worse, in 12 of 12 settings: more than chance (p = 0.000488)" in change.sentence


def test_one_setting_with_five_repetitions_is_tested_by_permuting_them() -> None:
    change = only(study(0.5, settings=1, repetitions=5))
    assert (change.test, change.p) == (PERMUTATIONS, 2 / math.comb(10, 5))
    assert change.sentence.startswith("after is ")
    assert "times better, in 1 of 1 setting: more than chance" in change.sentence


def test_one_run_before_and_after_is_too_little() -> None:
    change = only(study(0.5, settings=1, repetitions=1))
    assert change.p == change.least_p == 1.0
    assert "too few to tell" in change.sentence


def test_few_settings_with_few_repetitions_are_tested_together() -> None:
    change = only(study(2.0, settings=3, repetitions=3))
    assert change.p == pytest.approx(2 / math.comb(6, 3) ** 3)
    assert "more than chance" in change.sentence


@pytest.mark.slow
@pytest.mark.parametrize(("settings", "repetitions"), [(1, 5), (3, 3), (5, 6), (8, 1), (8, 4)])
def test_without_an_effect_p_is_small_as_seldom_as_it_says(
    settings: int, repetitions: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.analysis.versions._MOST_EXACT", 2_000)  # enough to tell 0.05, and quick
    found = [only(study(1.0, settings=settings, repetitions=repetitions, seed=seed)).p for seed in range(120)]
    # Of 120 draws 6 are expected below 0.05, with a standard deviation of 2.4.
    assert sum(p <= 0.05 for p in found) <= 14
    assert float(np.mean(found)) > 0.4


def test_drawn_arrangements_agree_with_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    chance = np.random.default_rng(3)
    pairs = [(chance.normal(size=5), chance.normal(0.8, size=6)) for _ in range(2)]
    monkeypatch.setattr("slamhive.analysis.versions._MOST_EXACT", 10**6)
    exact, _ = permutation_test(pairs)
    monkeypatch.setattr("slamhive.analysis.versions._MOST_EXACT", 20_000)
    drawn, _ = permutation_test(pairs)
    assert drawn == pytest.approx(exact, abs=4 * math.sqrt(exact / 20_000))
    assert drawn != exact


def test_runs_that_failed_are_worse_than_any_that_did_not() -> None:
    before = [make_row(OLD, 0.1 + k / 100, k) for k in range(5)]
    after = [make_row(NEW, None if k < 4 else 0.01, 10 + k) for k in range(5)]
    change = only(before + after)
    (setting,) = change.settings
    assert (setting.before.n, setting.after.n, setting.after.failures) == (5, 1, {"OutOfMemory": 4})
    assert math.isinf(setting.after.median)
    assert math.isnan(change.ratio)
    assert "worse in 1 and better in 0 of 1 setting, some of which failed" in change.sentence


def test_runs_that_the_machine_ended_say_nothing() -> None:
    lost = make_row(NEW, None, 99, reason="NodeLost", **{"parameters.nFeatures": 500})
    rows = study(1.0, settings=1, repetitions=3)
    (change,), notes = before_and_after(frame_of([*rows, lost]))
    assert change.settings[0].after.failures == {"NodeLost": 1}
    assert change.p == only(rows).p
    assert any("NodeLost" in note for note in notes)


def deterministic(version: str, error: float, number: int) -> list[dict[str, Any]]:
    more = {"trajectory.sha256": f"{version}{error}"}
    return [make_row(version, error, number + k, **more) for k in range(5)]


def test_a_deterministic_system_is_not_tested() -> None:
    change = only(deterministic(OLD, 0.1, 0) + deterministic(NEW, 0.18, 10))
    assert (change.test, change.p) == (None, 1.0)
    assert change.sentence.startswith("deterministic: after is 1.8 times worse, in 1 of 1 setting")


def test_equal_runs_are_one_result_beside_those_that_vary() -> None:
    after = [make_row(NEW, 0.2 + k / 100, 10 + k, **{"trajectory.sha256": f"{k}"}) for k in range(5)]
    change = only(deterministic(OLD, 0.1, 0) + after)
    assert change.least_p == 2 / 6
    assert "too few to tell" in change.sentence


def test_the_latest_earlier_version_comes_first_and_the_latest_of_all_is_after() -> None:
    rows = [make_row(version, 0.1, 10 * k) for k, version in enumerate(("a", "b", "c"))]
    found, _ = before_and_after(frame_of(rows))
    versions = dict(zip("abc", frame_of(rows).column("algorithm.version").tolist(), strict=True))
    assert [(one.before.version, one.after.version) for one in found] == [
        (versions["b"], versions["c"]),
        (versions["a"], versions["c"]),
    ]
    assert all(one.current for one in found)


def test_only_equal_settings_are_paired() -> None:
    rows = study(1.5, settings=3, repetitions=2)
    rows = [row for row in rows if not (row["provenance.algorithmHash"] == OLD and row["id"] >= 200)]
    rows += [make_row(NEW, 9.0, 900, dataset="yard", **{"parameters.nFeatures": 500})]
    change = only(rows)
    assert [one.keys for one in change.settings] == [
        {"dataset": "hall", "parameters.nFeatures": 500},
        {"dataset": "hall", "parameters.nFeatures": 1000},
    ]
    assert change.unpaired == 2


def test_evaluations_are_never_mixed() -> None:
    rows = study(1.0, settings=1, repetitions=2)
    rows += [row | {"evaluation": "sim3", "alignment": "sim3", "ate.rmse": 0.5} for row in rows]
    found, _ = before_and_after(frame_of(rows))
    assert sorted(one.keys["evaluation"] for one in found) == ["se3", "sim3"]
    assert all(len(one.settings) == 1 for one in found)


def test_what_changed_with_the_version_is_no_setting_and_is_told() -> None:
    rows = study(1.0, settings=1, repetitions=2)
    for row in rows:
        row["parameters.threads"] = 4 if row["provenance.algorithmHash"] == NEW else 2
    change = only(rows)
    assert len(change.settings) == 1
    told = {one.column: (one.before, one.after) for one in change.differences}
    assert told["parameters.threads"] == ([2], [4])
    assert "parameters.nFeatures" not in told


def test_versions_of_a_dataset_are_compared_for_each_algorithm_on_it() -> None:
    rows = [
        make_row(NEW, 0.1 * factor, 10 * k + number, algorithm=name, **{"provenance.datasetSha256": data})
        for number, name in enumerate(("orb", "vins"))
        for k, (data, factor) in enumerate((("x", 1.0), ("y", 2.0)))
    ]
    found, _ = before_and_after(frame_of(rows))
    assert [(one.changed, one.keys["algorithm"], one.keys["dataset"]) for one in found] == [
        ("dataset", "orb", "hall"),
        ("dataset", "vins", "hall"),
    ]
    assert [one.ratio for one in found] == pytest.approx([2.0, 2.0])


def test_a_dataset_that_changed_too_is_not_paired_with_what_it_was() -> None:
    rows = [make_row(OLD, 0.1, 0, **{"provenance.datasetSha256": "x"})]
    rows += [make_row(NEW, 0.2, 10, **{"provenance.datasetSha256": "y"})]
    found, _ = before_and_after(frame_of(rows))
    assert found[0].settings == []
    assert "no setting has results of both versions" in found[0].sentence


def test_load_is_compared_the_same_way() -> None:
    rows = study(1.0, settings=6, repetitions=1)
    for row in rows:
        row["usage.cpu.seconds"] = 90.0 if row["provenance.algorithmHash"] == NEW else 60.0
    change = only(rows, "usage.cpu.seconds")
    assert change.ratio == pytest.approx(1.5)
    assert "after is 1.5 times higher, in 6 of 6 settings: more than chance" in change.sentence


def test_nothing_is_said_where_nothing_changed() -> None:
    rows = [row for row in study(1.0, settings=3, repetitions=2) if row["provenance.algorithmHash"] == NEW]
    assert before_and_after(frame_of(rows)) == ([], [])
    assert before_and_after(Frame({}, 0)) == ([], [])


def test_several_earlier_versions_are_corrected_for() -> None:
    rows = [
        make_row(version, 0.1 * (k + 1) + repetition / 1000, 10 * k + repetition)
        for k, version in enumerate(("a", "b", "c"))
        for repetition in range(5)
    ]
    found, _ = before_and_after(frame_of(rows))
    assert [one.p for one in found] == [2 / 252, 2 / 252]
    assert [one.p_holm for one in found] == [4 / 252, 4 / 252]
    assert "after correction" in found[0].sentence


def test_versions_that_share_no_runs_of_a_known_version_say_how_many_are_left_out() -> None:
    unknown = make_row("x", 0.1, 900)
    unknown["provenance.algorithmHash"] = None
    _, notes = before_and_after(frame_of([*study(1.0, settings=1, repetitions=1), unknown]))
    assert notes == ["1 row is of no known algorithm.version: left out"]
