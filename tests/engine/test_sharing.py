# SPDX-License-Identifier: Apache-2.0
"""Slots that Sweeps share: by weight, whole, none lost, and everybody's turn comes."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamhive.engine import Contender, NamespaceRule, SlotTurns, SlotWork, divide, foresee

SPACES = ["a", "b", "c"]


@st.composite
def crowds(draw: st.DrawFn) -> list[Contender]:
    count = draw(st.integers(1, 8))
    return [
        Contender(
            f"sweep-{number}",
            draw(st.sampled_from(SPACES)),
            held=0,
            asks=draw(st.integers(0, 40)),
            weight=draw(st.integers(1, 1000)),
            priority=draw(st.integers(-1, 1)),
        )
        for number in range(count)
    ]


rules = st.dictionaries(
    st.sampled_from(SPACES),
    st.builds(NamespaceRule, weight=st.none() | st.integers(1, 1000), slots=st.none() | st.integers(0, 30)),
)


def served(capacity: int | None, crowd: list[Contender], told: dict[str, NamespaceRule]) -> dict[str, int]:
    """Return the slots that each gets where all are free."""
    order = SlotTurns().next(capacity, crowd, divide(capacity, crowd, told), told)
    return {one.name: order.count(one.name) for one in crowd}


@given(st.integers(0, 100), crowds(), rules)
def test_no_slot_is_lost_and_none_given_twice(
    capacity: int, crowd: list[Contender], told: dict[str, NamespaceRule]
) -> None:
    slots = served(capacity, crowd, told)
    assert all(0 <= slots[one.name] <= one.asks for one in crowd)
    wanted = {space: sum(one.asks for one in crowd if one.namespace == space) for space in SPACES}
    most = {space: told[space].slots for space in told}
    possible = sum(
        min(wanted[space], wanted[space] if (m := most.get(space)) is None else m) for space in SPACES
    )
    assert sum(slots.values()) == min(capacity, possible)


@given(st.integers(0, 100), crowds(), rules)
def test_each_has_its_fair_number_within_one_slot(
    capacity: int, crowd: list[Contender], told: dict[str, NamespaceRule]
) -> None:
    slots, fair = served(capacity, crowd, told), divide(capacity, crowd, told)
    for one in crowd:
        assert abs(slots[one.name] - fair.sweeps[one.name]) < 2  # whole for its namespace, then for itself
    for group, part in fair.groups.items():
        inside = sum(slots[one.name] for one in crowd if one.group == group)
        assert math.floor(part + 1e-9) <= inside <= math.ceil(part - 1e-9)


@given(st.integers(1, 100), crowds())
def test_who_does_not_get_all_it_asks_for_gets_by_weight(capacity: int, crowd: list[Contender]) -> None:
    fair = divide(capacity, crowd).sweeps
    for one in crowd:
        for other in crowd:
            if one.group == other.group and fair[one.name] < one.asks - 1e-6:
                assert fair[other.name] / other.weight <= fair[one.name] / one.weight + 1e-6


@given(st.integers(0, 100), crowds(), rules)
def test_nobody_of_a_lower_priority_gets_what_a_higher_one_could_have(
    capacity: int, crowd: list[Contender], told: dict[str, NamespaceRule]
) -> None:
    slots = served(capacity, crowd, told)
    for one in crowd:
        above = [other for other in crowd if other.priority >= one.priority]
        alone = served(capacity, above, told)
        assert {other.name: slots[other.name] for other in above} == alone


def test_a_limit_of_a_namespace_holds_over_all_its_priorities() -> None:
    crowd = [
        Contender("urgent", "a", held=0, asks=3, priority=1000),
        Contender("usual", "a", held=0, asks=50),
        Contender("other", "b", held=0, asks=50),
    ]
    few = {"a": NamespaceRule(slots=5)}
    turns = SlotTurns()
    turns.pass_by(1.0, crowd, divide(12, [replace(one, priority=0) for one in crowd], few))
    assert turns.next(1, crowd, divide(1, crowd, few), few) == ["urgent"]  # though it had another before
    assert divide(12, crowd, few).sweeps == {"urgent": 3, "usual": 2, "other": 7}
    assert served(12, crowd, few) == {"urgent": 3, "usual": 2, "other": 7}
    assert divide(2, crowd).sweeps == {"urgent": 2, "usual": 0, "other": 0}
    later = foresee(2, crowd, {"urgent": SlotWork(10, 1), "usual": SlotWork(10, 1)})
    assert (later["urgent"].end, later["usual"].start) == (5, 5)


def test_a_second_sweep_does_not_double_a_labs_share() -> None:
    crowd = [Contender("a1", "a", 0, 100), Contender("a2", "a", 0, 100), Contender("b1", "b", 0, 100)]
    assert divide(60, crowd).sweeps == {"a1": 15, "a2": 15, "b1": 30}
    assert divide(60, crowd, {"a": NamespaceRule(weight=5)}).sweeps == {"a1": 25, "a2": 25, "b1": 10}
    assert divide(60, crowd, {"b": NamespaceRule(slots=10)}).sweeps == {"a1": 25, "a2": 25, "b1": 10}


def test_a_slot_that_is_free_goes_to_who_is_behind_and_no_run_is_broken_off() -> None:
    crowd = [Contender("first", "a", held=9, asks=50), Contender("second", "b", held=0, asks=50)]
    assert SlotTurns().next(10, crowd, divide(10, crowd)) == ["second"]
    full = [replace(crowd[0], held=10), crowd[1]]
    assert SlotTurns().next(10, full, divide(10, full)) == []


def test_without_a_capacity_each_has_what_it_asks_for() -> None:
    crowd = [Contender("first", "a", held=2, asks=3), Contender("second", "b", held=0, asks=1, weight=9)]
    fair = divide(None, crowd)
    assert fair.sweeps == {"first": 5, "second": 1}
    assert sorted(SlotTurns().next(None, crowd, fair)) == ["first", "first", "first", "second"]


@given(
    st.integers(1, 3),
    st.lists(
        st.tuples(st.integers(1, 1000), st.integers(1, 20), st.sampled_from(SPACES)), min_size=4, max_size=6
    ),
)
def test_with_fewer_slots_than_sweeps_all_have_their_turn(
    capacity: int, given_sweeps: list[tuple[int, int, str]]
) -> None:
    # Weights and lengths of runs as unequal as they may be: everybody starts again and again.
    crowd = [
        Contender(f"sweep-{number}", space, 0, 5, weight=min(weight, 20))
        for number, (weight, _, space) in enumerate(given_sweeps)
    ]
    lengths = {one.name: given_sweeps[number][1] for number, one in enumerate(crowd)}
    turns, ends, started = SlotTurns(), [], dict.fromkeys(lengths, 0)
    for now in range(20_000):
        ends = [(name, end) for name, end in ends if end > now]
        held = [sum(name == one.name for name, _ in ends) for one in crowd]
        there = [replace(one, held=count) for one, count in zip(crowd, held, strict=True)]
        division = divide(capacity, there)
        for name in turns.next(capacity, there, division):
            started[name] += 1
            ends.append((name, now + lengths[name]))
        held = [sum(name == one.name for name, _ in ends) for one in crowd]
        there = [replace(one, held=count) for one, count in zip(crowd, held, strict=True)]
        turns.pass_by(1, there, division)
        assert len(ends) == capacity
        if min(started.values()) >= 2:
            return
    pytest.fail(f"somebody starved: {started}")


def test_turns_are_by_weight() -> None:
    crowd = [Contender("three", "a", 0, 5, weight=3), Contender("one", "b", 0, 5, weight=1)]
    turns, had = SlotTurns(), []
    for _ in range(40):
        division = divide(1, crowd)
        [name] = turns.next(1, crowd, division)
        had.append(name)
        turns.pass_by(10, [replace(one, held=int(one.name == name)) for one in crowd], division)
    assert had.count("three") == 30


def test_what_is_to_come_is_foreseen() -> None:
    crowd = [Contender("small", "a", 5, 5), Contender("large", "b", 5, 5), Contender("idle", "c", 0, 0)]
    works = {"small": SlotWork(50.0, 5.0), "large": SlotWork(150.0, 5.0)}
    outlooks = foresee(10, crowd, works)
    # 5 slots each for 10 s, then 10 for the one that is left: 100 slot-seconds more.
    assert (outlooks["small"].end, outlooks["large"].end) == (10, 20)
    assert outlooks["idle"].end is None
    # The rest of one that asks for all of its namespace's slots.
    ruled = foresee(10, crowd[:2], works, {"b": NamespaceRule(slots=0)})
    assert (ruled["small"].end, ruled["large"].start) == (5, None)
    unknown = foresee(10, crowd[:2], {"large": SlotWork(150.0, 5.0)})
    assert (unknown["small"].end, unknown["large"].end) == (None, 30)
