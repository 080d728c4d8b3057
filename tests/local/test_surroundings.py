# SPDX-License-Identifier: Apache-2.0
"""Whatever machine, container and working folder slamhive is started in."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml

from slamhive.local import cores
from slamhive.local.environments import Unavailable, _explained
from slamhive.local.home import lock
from slamhive.model.errors import SystemFault
from slamhive.model.results import Phase, Reason
from slamhive.monitor.hierarchy import Hierarchy

if TYPE_CHECKING:
    from collections.abc import Callable

DEADLINE_SECONDS = 20


def test_modules_in_the_working_folder_are_not_ours(
    run_acts: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("json", "select", "resource", "venv", "logging"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('not mine')\n")
    monkeypatch.chdir(tmp_path)
    _, notes = run_acts(["good"], template={"retries": 0})
    assert notes.records[0].phase is Phase.SUCCEEDED, notes.records[0].message


_KILLED = """
import sys
from pathlib import Path
from slamhive.local.environments import _command
from slamhive.local.home import lock
folder = Path(sys.argv[1])
with lock(folder / "lock") as held:
    _command(["sh", "-c", "echo $$ > new && mv new pid && exec sleep 600"], "it", folder, held)
"""


def test_what_a_killed_slamhive_left_installing_holds_its_lock(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", _KILLED, str(tmp_path)])
    until = time.monotonic() + DEADLINE_SECONDS
    while not (tmp_path / "pid").exists() and time.monotonic() < until:
        time.sleep(0.01)
    process.kill()
    process.wait()
    with lock(tmp_path / "lock", wait=False) as held:
        assert held is None
    os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)
    with lock(tmp_path / "lock") as held:
        assert held is not None


def test_packages_that_do_not_exist_are_asked_for_once(run_acts: Callable, home, bench) -> None:  # noqa: ANN001
    requirements = home.path / "algorithms/actor/requirements.txt"
    requirements.write_text("--no-index\nno-such-package==1\n")
    told: list[str] = []
    bench.environments._notify = told.append
    _, notes = run_acts(["good", "slow"])
    for record in notes.records:
        assert (record.phase, record.reason) == (Phase.FAILED, Reason.ALGORITHM_UNAVAILABLE)
        assert record.message == (
            "packages of actor can't be installed: No matching distribution found for no-such-package==1"
        )
    assert len(told) == 1


@pytest.mark.parametrize(
    ("told", "kind", "why"),
    [
        (
            "ERROR: Invalid requirement: './x' (from line 1 of r.txt)\nHint: no",
            Unavailable,
            "Invalid requirement",
        ),
        ("ERROR: No matching distribution found for pyOpenSSL==99", Unavailable, "pyOpenSSL==99"),
        (
            "WARNING: Retrying after connection broken by 'NewConnectionError()': /x/\nERROR: No matching x",
            SystemFault,
            "the package index can't be reached (NewConnectionError)",
        ),
        (
            "ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device",
            SystemFault,
            "No space left",
        ),
        ("Error: Command 'python -m ensurepip' returned non-zero exit status 1.", SystemFault, "ensurepip"),
    ],
)
def test_only_what_another_try_may_mend_is_a_fault_of_the_machine(
    told: str, kind: type[Exception], why: str
) -> None:
    error = _explained("packages of x", told, by_itself=True)
    assert type(error) is kind
    assert why in str(error)


@pytest.mark.parametrize(
    ("limit", "expected"),
    [(None, 4), (8.0, 4), (4.0, 2), (3.9, 1), (0.5, 1)],
)
def test_no_more_cores_than_a_quota_can_keep_busy(limit: float | None, expected: int) -> None:
    assert len(cores.within([(0, 4), (1, 5), (2, 6), (3, 7)], limit)) == expected


def test_the_tightest_quota_above_us_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own, old = tmp_path / "v2/pod/own", tmp_path / "v1/own"
    own.mkdir(parents=True)
    old.mkdir(parents=True)
    trees = [
        Hierarchy(2, frozenset(), str(tmp_path / "v2"), str(own)),
        Hierarchy(1, frozenset({"cpu"}), str(tmp_path / "v1"), str(old)),
    ]
    monkeypatch.setattr(cores, "own_hierarchies", lambda: trees)
    assert cores.quota() is None
    (own / "cpu.max").write_text("max 100000\n")
    (own.parent / "cpu.max").write_text("250000 100000\n")
    assert cores.quota() == 2.5
    (old / "cpu.cfs_quota_us").write_text("150000\n")
    (old / "cpu.cfs_period_us").write_text("100000\n")
    assert cores.quota() == 1.5
    (old / "cpu.cfs_quota_us").write_text("-1\n")
    assert cores.quota() == 2.5


@pytest.mark.skipif(len(cores.whole_cores()) < 2, reason="needs two cores")
def test_a_run_gets_no_less_than_it_asks_for(run_acts: Callable) -> None:
    _, notes = run_acts(["good"], template={"resources": {"cpu": "1200m"}})
    configuration = yaml.safe_load((Path(notes.records[0].folder) / "run/config.yaml").read_text())
    assert configuration["cores"] == sum(map(len, cores.whole_cores()[:2]))
