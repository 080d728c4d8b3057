# SPDX-License-Identifier: Apache-2.0
"""Tests of what an algorithm, of the same user as the monitor, can see and change of it, and lock away."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import slamhive
from slamhive.monitor import SidecarSpec, SupervisorSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PACKAGES = str(Path(slamhive.__file__).parents[1])
# Root is kept from nothing: as in a pod, nobody in particular, without any capability.
USER: dict[str, Any] = {"user": 65532, "group": 65532, "extra_groups": []} if os.getuid() == 0 else {}
ENVIRONMENT = {"PATH": "/usr/bin:/bin", "PYTHONPATH": PACKAGES, "PYTHONDONTWRITEBYTECODE": "1"}
ATTACK = """
for name in root/ cwd/ fd/; do ls /proc/$1/$name >/dev/null 2>&1 && echo "$name is open"; done
for name in mem environ; do ( : < /proc/$1/$name ) 2>/dev/null && echo "$name is open"; done
( : >> /proc/$1/mem ) 2>/dev/null && echo "mem can be written"
echo attacked
"""


@pytest.fixture(scope="module")
def python() -> str:
    for path in (sys.executable, "/usr/bin/python3"):
        probe = [path, "-c", "import slamhive.monitor.sidecar"]
        try:
            subprocess.run(probe, env=ENVIRONMENT, check=True, capture_output=True, cwd="/", **USER)
        except (OSError, subprocess.CalledProcessError):
            continue
        return path
    pytest.skip(f"no Python that user 65532 may run finds slamhive in {PACKAGES}")


@pytest.fixture
def folder() -> Iterator[Path]:
    # Not below pytest's own folders, which are closed to other users.
    path = Path(tempfile.mkdtemp(prefix="slamhive-inspection-"))
    (path / "output").mkdir()
    for place in (path, path / "output"):
        os.chown(place, USER.get("user", -1), USER.get("group", -1))
    yield path
    shutil.rmtree(path)


def attack(pid: int) -> str:
    command = ["sh", "-c", ATTACK, "sh", str(pid)]
    return subprocess.run(command, env=ENVIRONMENT, check=True, capture_output=True, text=True, **USER).stdout


def test_any_other_process_of_the_user_is_open() -> None:
    """Else the tests below would tell nothing."""
    with subprocess.Popen(["sleep", "60"], env=ENVIRONMENT, **USER) as other:
        found = attack(other.pid)
        other.kill()
    assert {"root/ is open", "environ is open"} <= set(found.splitlines())


def test_an_algorithm_sees_nothing_of_its_supervisor(python: str, folder: Path) -> None:
    code = (
        ATTACK.replace("$1", "$PPID") + "\ncat /proc/self/oom_score_adj\n( : < /proc/$$/environ ) && echo me"
    )
    spec = SupervisorSpec(
        argv=("/bin/sh", "-c", code),
        cwd=str(folder / "output"),
        env=ENVIRONMENT,
        log_path=str(folder / "log.txt"),
        usage_path=str(folder / "usage.csv"),
        summary_path=str(folder / "summary.json"),
        process_path=str(folder / "process.json"),
        output_directory=str(folder / "output"),
    )
    (folder / "spec.json").write_text(spec.to_json())
    command = [python, "-P", "-m", "slamhive.monitor", "--spec", str(folder / "spec.json")]
    subprocess.run(command, env=ENVIRONMENT, check=True, cwd="/", **USER)
    assert json.loads((folder / "summary.json").read_text())["exitCode"] == 0
    # The algorithm is no worse off: it is killed first when memory is short, and is its own to read.
    assert (folder / "log.txt").read_text().splitlines() == ["attacked", "800", "me"]


def test_an_algorithm_sees_nothing_of_the_sidecar(
    python: str, folder: Path, wait_for: Callable[..., Any]
) -> None:
    spec = SidecarSpec(
        container="algorithm", run_directory=str(folder), termination_message=str(folder / "termination-log")
    )
    environment = ENVIRONMENT | {"SLAMHIVE_SIDECAR": spec.to_json(), "SLAMHIVE_CONTAINER": "monitor"}
    command = [python, "-P", "-m", "slamhive.monitor.sidecar"]
    with subprocess.Popen(command, env=environment, cwd="/", **USER) as sidecar:
        try:
            # Who may not be inspected has files in /proc that are root's.
            wait_for(lambda: os.stat(f"/proc/{sidecar.pid}/environ").st_uid == 0)  # noqa: PTH116
            assert attack(sidecar.pid) == "attacked\n"
        finally:
            sidecar.terminate()
    assert (folder / "summary.json").is_file()


LOCKED = """
import os
from slamhive.monitor.programs.output import OutputMeter
os.makedirs("output/locked/inner")
with open("output/locked/inner/map.bin", "wb") as file:
    file.truncate(3 << 20)
for folder in ("output/locked/inner", "output/locked"):
    os.chmod(folder, 0)
for limit in (4 << 20, 2 << 20):
    stop = OutputMeter("output", limit, 100).problem(1.0, [])
    print(stop and stop.message)
"""


def test_what_lies_in_locked_folders_is_counted(python: str, folder: Path) -> None:
    command = [python, "-P", "-c", LOCKED]
    told = subprocess.run(command, env=ENVIRONMENT, check=True, capture_output=True, cwd=folder, **USER)
    assert told.stdout.decode().splitlines() == ["None", "its output grew beyond the limit of 2 MiB"]
