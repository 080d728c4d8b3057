# SPDX-License-Identifier: Apache-2.0
"""The table of behaviours on a workstation; tests/e2e/test_contract.py holds a cluster to the same."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import pytest
from executors import algorithm, table
from executors.executor import Row, differences, outcomes
from executors.process import Process

from slamhive.data.files.erasing import erase
from slamhive.monitor import identify, make_run_cgroup

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NOT_MEASURED = ("frames.", "metrics.", "reused")


def has_cgroups() -> bool:
    """Tell whether runs have a control group of their own on this machine."""
    owner = identify(os.getpid())
    group = make_run_cgroup(owner) if owner else None
    return group is not None and group.remove()


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory, environments: Path, tiny: Path) -> Iterator[Process]:
    """A workstation."""
    made = Process.at(tmp_path_factory.mktemp("workstation") / "home", environments, tiny)
    yield made
    erase(made.home.path / "runs")  # pytest can't remove folders that are as deep


@pytest.fixture(scope="module")
def behaved(process: Process) -> dict[str, Row]:
    """Outcomes of all behaviours; ``SLAMHIVE_UPDATE=1`` keeps figures of some as the expected ones."""
    found = table.carry_out(process)
    if os.environ.get("SLAMHIVE_UPDATE"):
        kept = {key: value for key, value in found["well"].items() if not key.startswith(NOT_MEASURED)}
        table.MEASURED.write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n")
        others = {name: _beside(found[name]) for name in table.BEHAVIOURS if table.BEHAVIOURS[name].beside}
        table.BESIDE.write_text(json.dumps(others, indent=1, sort_keys=True) + "\n")
    return found


def _beside(row: Row) -> Row:
    return {name: value for name, value in row.items() if name.startswith("beside.")}


def test_the_table_has_all_behaviours() -> None:
    assert table.BEHAVIOURS.keys() == algorithm.ACTS.keys()


@pytest.mark.parametrize("name", table.STANDING_FOR)
def test_a_behaviour_stands_for_others_that_are_read_as_it_is(name: str) -> None:
    read = table.LEAVING | table.WRITING
    assert {name, *table.STANDING_FOR[name]} <= read.keys()


@pytest.mark.parametrize("name", table.expected("process"))
def test_a_workstation_makes_of_it_what_the_table_says(name: str, behaved: dict[str, Row]) -> None:
    if name == "forks" and not has_cgroups():
        pytest.skip("without a control group, which takes root, 400 processes meet any limit first")
    assert differences(behaved[name], table.expected("process")[name]) == []


@pytest.mark.slow
def test_what_it_left_is_in_nobodys_way(process: Process, behaved: dict[str, Row]) -> None:
    """Whatever stands in its run folder: the same comes of the same run a second time."""
    made, _, _ = table.study(process)
    archive = process.run(made, table.sweep("hostile", table.HOSTILE), rerun=True)
    found = outcomes(archive, "hostile")
    assert found.keys() == table.HOSTILE.keys()
    changed = {name: differences(found[name], behaved[name]) for name in found}
    assert {name: lines for name, lines in changed.items() if lines} == {}
