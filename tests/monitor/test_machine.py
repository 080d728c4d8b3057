# SPDX-License-Identifier: Apache-2.0
"""Facts on a run's machine: read from files as kernels write them, and absent where they don't."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from slamhive.model.results import Machine
from slamhive.monitor.measuring.hierarchy import cpuset, own_cpuset_directory
from slamhive.monitor.measuring.machine import machine_report, processors_of
from slamhive.monitor.pod.sidecarstate import SidecarState
from slamhive.monitor.pod.watching import Watch


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"{text}\n")
    return folder


SIBLINGS = {f"cpu{n}/topology/thread_siblings_list": text for n, text in enumerate(["0,2", "1,3"] * 2)}
GOVERNORS = {f"cpu{n}/cpufreq/scaling_governor": "performance" for n in range(4)}


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({}, {}),
        (SIBLINGS | {"smt/active": "1"}, {"cores": 2, "smt": True}),
        (GOVERNORS | {"smt/active": "odd"}, {"governor": "performance"}),
        (
            GOVERNORS | {"cpu1/cpufreq/scaling_governor": "powersave"},
            {"governor": "performance, powersave"},
        ),
        ({"intel_pstate/no_turbo": "1", "cpufreq/boost": "1"}, {"turbo": False}),
        ({"cpufreq/boost": "1"}, {"turbo": True}),
        ({"cpufreq/scaling_governor": "no processor's", "cpufreq/boost": ""}, {}),
    ],
)
def test_what_can_be_read_is_told_and_nothing_else(
    tmp_path: Path, files: dict[str, str], told: dict[str, Any]
) -> None:
    found = machine_report(exclusive=None, folder=str(written(tmp_path, files)))
    assert found == told
    assert Machine.model_validate(found).as_json() == told


def test_of_this_machine_a_report_is_a_record() -> None:
    assert Machine.model_validate(machine_report(exclusive=True)).exclusive_cores is True


@pytest.mark.parametrize(
    ("text", "processors"),
    [
        ("0", {0}),
        ("0-2,8", {0, 1, 2, 8}),
        *((text, None) for text in ("", "a", "1-", "-1", "3-1", "1,,2", "0-99999999999", "²")),
    ],
)
def test_lists_of_processors(text: str, processors: set[int] | None) -> None:
    assert processors_of(text) == processors


def test_this_process_has_processors() -> None:
    directory = own_cpuset_directory()
    assert directory is None or cpuset(directory)


@pytest.mark.parametrize("name", ["cpuset.cpus.effective", "cpuset.effective_cpus"])
@pytest.mark.parametrize(
    ("theirs", "ours", "exclusive", "known"),
    [
        ("1", "0", True, {1}),
        ("1-2", "0,3", True, {1, 2}),
        ("0-1", "0-1", False, {0, 1}),
        ("1", "0-1", False, {1}),  # of itself, where nobody keeps us off
        ("", "0", None, None),
        ("1", "", None, None),
    ],
)
def test_cores_are_exclusive_where_we_may_not_use_them(  # noqa: PLR0917
    tmp_path: Path, name: str, theirs: str, ours: str, exclusive: bool | None, known: set[int] | None
) -> None:
    state = SidecarState()
    written(tmp_path, {f"theirs/{name}": theirs, f"ours/{name}": ours})
    container = SimpleNamespace(cpuset=lambda: cpuset(f"{tmp_path}/theirs"))
    watch: Any = SimpleNamespace(_container=container, _own_cpuset=f"{tmp_path}/ours", _state=state)
    Watch._look_at_processors(watch)
    assert (state.exclusive, state.cpuset) == (exclusive, known)


def test_cores_that_were_shared_at_any_time_are_not_exclusive(tmp_path: Path) -> None:
    state = SidecarState(exclusive=False)
    written(tmp_path, {"cpuset.effective_cpus": "0"})
    container = SimpleNamespace(cpuset=lambda: {1})
    Watch._look_at_processors(SimpleNamespace(_container=container, _own_cpuset=str(tmp_path), _state=state))  # type: ignore[arg-type]
    assert state.exclusive is False
