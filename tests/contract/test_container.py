# SPDX-License-Identifier: Apache-2.0
"""The table of behaviours in containers of a workstation; test_process.py holds processes to the same."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from executors import table
from executors.container import InContainers
from executors.executor import differences, outcomes

from slamhive.data.files.erasing import erase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from executors.executor import Row

    from slamhive.local.programs.engines import Engine


@pytest.fixture(scope="module")
def workstation(
    tmp_path_factory: pytest.TempPathFactory, environments: Path, tiny: Path, podman: Engine
) -> Iterator[InContainers]:
    """A workstation with podman."""
    made = InContainers.at(tmp_path_factory.mktemp("workstation") / "home", environments, tiny)
    yield made
    assert podman.labelled(f"io.slamhive.home={made.label()}") == []
    erase(made.home.path / "runs")  # pytest can't remove folders that are as deep


@pytest.fixture(scope="module")
def behaved(workstation: InContainers) -> dict[str, Row]:
    """Outcomes of a sample of the behaviours in containers, by behaviour."""
    return table.carry_out(workstation, table.SAMPLE)


def test_nothing_is_left_where_the_command_was_called(behaved: dict[str, Row]) -> None:
    assert behaved["memory"]["reason"] == "OutOfMemory"
    assert not Path("oom").exists()


@pytest.mark.parametrize("name", table.expected(InContainers.name, table.SAMPLE))
def test_a_container_makes_of_it_what_the_table_says(name: str, behaved: dict[str, Row]) -> None:
    assert differences(behaved[name], table.expected(InContainers.name)[name]) == []


def test_what_it_left_is_in_nobodys_way(workstation: InContainers, behaved: dict[str, Row]) -> None:
    """Whatever stands in its output: the same comes of the same run a second time."""
    made, _, _ = table.study(workstation)
    archive = workstation.run(made, table.sweep("hostile", table.HOSTILE), rerun=True)
    found = outcomes(archive, "hostile")
    assert found.keys() == table.HOSTILE.keys()
    changed = {name: differences(found[name], behaved[name]) for name in found}
    assert {name: lines for name, lines in changed.items() if lines} == {}
