# SPDX-License-Identifier: Apache-2.0
"""Conditions under which loads compare: what is known must be equal, what isn't known says nothing."""

import pytest

from slamhive.engine import LoadConditions
from slamhive.model.results import Machine, Provenance

FULL = LoadConditions("P", smt=True, governor="performance", turbo=False, exclusive_cores=True)


@pytest.mark.parametrize(
    ("other", "told"),
    [
        (FULL, []),
        (LoadConditions("P"), []),
        (LoadConditions(None), []),
        (LoadConditions("Q"), ["processor P and Q"]),
        (FULL._replace(governor="powersave"), ["governor performance and powersave"]),
        (FULL._replace(smt=False, turbo=True), ["SMT on and off", "turbo off and on"]),
        (FULL._replace(exclusive_cores=False), ["exclusive cores on and off"]),
    ],
)
def test_differences_are_of_what_both_know(other: LoadConditions, told: list[str]) -> None:
    assert FULL.differences(other) == told


@pytest.mark.parametrize(
    ("many", "common"),
    [
        ([], LoadConditions(None)),
        ([FULL, LoadConditions("P"), LoadConditions(None)], FULL),
        ([FULL, FULL._replace(smt=False)], None),
        ([LoadConditions("P"), LoadConditions("Q")], None),
    ],
)
def test_several_have_in_common_what_none_contradicts(
    many: list[LoadConditions], common: LoadConditions | None
) -> None:
    assert LoadConditions.common(many) == common


def test_a_record_without_a_machine_is_one_of_an_earlier_version() -> None:
    known = Provenance(cpu_model="P")
    assert LoadConditions.of(known) == LoadConditions("P")
    assert LoadConditions("P").machine is None
    assert LoadConditions.of(known.replace(machine=FULL.machine)) == FULL
    assert LoadConditions.of(known.replace(machine=Machine(cores=4))) == LoadConditions("P")
