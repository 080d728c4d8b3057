# SPDX-License-Identifier: Apache-2.0
"""Nodes beside others of their kind: who is slower is named, and chance alone names nobody."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.derived import with_derived
from slamhive.analysis.machines import nodes
from slamhive.analysis.machines.nodes import NodeVerdict, compare_nodes, kind_text

if TYPE_CHECKING:
    from slamhive.analysis.frame import Frame

SETTINGS, REPETITIONS = 6, 4


def frame_of(rows: list[dict[str, Any]]) -> Frame:
    names = dict.fromkeys(name for row in rows for name in row)
    return with_derived({name: Column.of([row.get(name) for row in rows]) for name in names}, len(rows))


def runs(
    ratios: dict[str, float], *, seed: int = 1, noise: float = 0.02, **more: Any
) -> list[dict[str, Any]]:
    """Return runs on nodes, each of which needs so much more CPU time; some settings take ten times that."""
    chance = np.random.default_rng(seed)
    return [
        {
            "algorithm": "a",
            "sensors": "s",
            "dataset": "d",
            "phase": "Succeeded",
            "parameters.k": setting,
            "provenance.node": node,
            "provenance.cpuModel": "P",
            "provenance.machine.governor": "performance",
            "usage.cpu.seconds": float(10 ** (1 + setting % 2) * ratio * np.exp(chance.normal(0, noise))),
        }
        | more
        for node, ratio in ratios.items()
        for setting in range(SETTINGS)
        for _ in range(REPETITIONS)
    ]


def compared(rows: list[dict[str, Any]]) -> nodes.NodeComparison:
    return compare_nodes(frame_of([{"id": number} | row for number, row in enumerate(rows)]))


def test_a_slower_node_is_named_first_with_its_interval_and_its_like_are_equal() -> None:
    found = compared(runs({"n1": 1.0, "n2": 1.12, "n3": 1.0, "n4": 1.0}))
    slow, *others = found.nodes
    assert (slow.node, slow.verdict, slow.others, slow.settings, slow.runs) == (
        *("n2", NodeVerdict.SLOWER, 3, SETTINGS),
        SETTINGS * REPETITIONS,
    )
    assert 1.05 < slow.low < 1.12 < slow.high < 1.2
    assert slow.ratio == pytest.approx(1.12, abs=0.02)
    assert "n2 is slower: 1" in slow.sentence
    assert "more CPU time than 3 others of its kind" in slow.sentence
    assert {one.verdict for one in others} == {NodeVerdict.EQUAL}
    assert (found.notes, slow.kind["provenance.cpuModel"]) == ([], "P")


@pytest.mark.parametrize("ratio", [1.0, 1.05])
def test_up_to_five_percent_nobody_is_named_but_by_rare_chance(ratio: float) -> None:
    ratios = {f"n{number}": 1.0 for number in range(5)} | {"odd": ratio}
    named = sum(
        any(one.verdict is NodeVerdict.SLOWER for one in compared(runs(ratios, seed=seed)).nodes)
        for seed in range(60)
    )
    assert named <= 3  # of 60: 5 %


def test_of_two_nodes_the_other_one_is_faster() -> None:
    slow, fast = compared(runs({"n1": 1.0, "n2": 1.2})).nodes
    assert (slow.verdict, fast.verdict) == (NodeVerdict.SLOWER, NodeVerdict.FASTER)
    assert "less CPU time than another of its kind" in fast.sentence


def test_a_few_runs_beside_other_work_name_nobody() -> None:
    rows = runs({"n1": 1.0, "n2": 1.0, "n3": 1.0})
    for row in rows[:4]:
        row["usage.cpu.seconds"] *= 5
    assert NodeVerdict.SLOWER not in {one.verdict for one in compared(rows).nodes}


def test_too_few_runs_are_no_verdict() -> None:
    rows = [one for one in runs({"n1": 1.0, "n2": 2.0}) if one["parameters.k"] == 0][::4]
    first, _ = compared(rows).nodes
    assert (first.verdict, first.as_json()["high"]) == (NodeVerdict.UNSURE, None)


@pytest.mark.parametrize(
    ("column", "values"),
    [
        ("provenance.cpuModel", ("P", "Q")),
        ("provenance.machine.governor", ("performance", "powersave")),
        ("provenance.algorithmHash", ("1", "2")),
        ("resources.cpu", ("1", "2")),
    ],
)
def test_runs_that_are_not_equal_are_not_compared(column: str, values: tuple[str, str]) -> None:
    rows = [*runs({"n1": 1.0}, **{column: values[0]}), *runs({"n2": 2.0}, **{column: values[1]})]
    found = compared(rows)
    assert (found.nodes, found.notes) == ([], ["no setting ran on several nodes of the same kind"])


@pytest.mark.parametrize(
    "change",
    [
        {"phase": "Failed"},
        {"provenance.reusedFrom": "another"},
        {"usage.suspect": "forged"},
        {"origin.kind": "Bundle"},
        {"usage.cpu.seconds": 0.0},
    ],
)
def test_what_was_not_measured_on_the_node_does_not_count(change: dict[str, Any]) -> None:
    rows = [*runs({"n1": 1.0}), *(one | change for one in runs({"n2": 2.0}))]
    found = compared(rows)
    assert (found.nodes, found.notes) == ([], ["all runs were on one node, n1: nothing to compare"])


def test_runs_of_an_archive_without_nodes_are_told_of() -> None:
    old = [{name: value for name, value in row.items() if name != "provenance.node"} for row in runs({"": 1})]
    assert compared(old).notes == ["of no run both node and CPU time are known"]
    both = [*old, *runs({"n1": 1.0, "n2": 1.0})]
    assert compared(both).notes == [f"left out: {len(old)} runs of which nobody noted the node"]
    assert not compared([]).nodes


def test_of_many_runs_the_newest_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nodes, "MOST_QUOTIENTS", 30)
    rows = runs({"n1": 1.0, "n2": 1.0}, noise=0.0)
    for number, row in enumerate(rows):
        row["finished"] = float(number)
        row["usage.cpu.seconds"] *= 1 if number % REPETITIONS == REPETITIONS - 1 else 9
    found = compared(rows)
    assert [one.ratio for one in found.nodes] == [1.0, 1.0]
    assert found.notes == ["of each setting the newest run on a node counts"]
    monkeypatch.setattr(nodes, "MOST_QUOTIENTS", 20)
    found = compared(rows)
    assert [one.settings for one in found.nodes] == [SETTINGS // 2] * 2
    assert found.notes == ["of 1 setting in 2 the newest run on a node counts"]


def test_a_kind_is_told_in_words() -> None:
    kind = {"provenance.cpuModel": "P", "provenance.machine.smt": False, "provenance.machine.governor": "x"}
    assert kind_text(kind) == "P, SMT off, governor x"
