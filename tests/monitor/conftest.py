# SPDX-License-Identifier: Apache-2.0
"""Real processes under a real supervisor, by cgroup and by /proc."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.monitor import SupervisorSpec, end_orphans, identify, make_run_cgroup

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


def wait_for(condition: Callable[[], Any], seconds: float = 20.0) -> Any:
    """Poll until a condition holds and return its value."""
    deadline = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, "the condition never held"
        time.sleep(0.01)
    return value


def _cgroup_name() -> str | None:
    owner = identify(os.getpid())
    group = make_run_cgroup(owner) if owner else None
    if group is None:
        return None
    name = group.source.name
    group.remove()
    return name


class Run:
    """A run folder and its supervisor."""

    def __init__(self, folder: Path, cgroup: str) -> None:
        self.folder = folder
        self.cgroup = cgroup
        self.output = folder / "output"
        self.output.mkdir(parents=True, exist_ok=True)
        self.process_json = folder / "process.json"

    def spec(self, *argv: str, **options: Any) -> SupervisorSpec:
        return SupervisorSpec(
            argv=argv,
            cwd=str(self.output),
            env={"PATH": os.environ["PATH"], "SLAMHIVE_RUN": str(self.folder)},
            log_path=str(self.folder / "log.txt"),
            usage_path=str(self.folder / "usage.csv"),
            summary_path=str(self.folder / "summary.json"),
            process_path=str(self.process_json),
            output_directory=str(self.output),
            **{"cgroup": self.cgroup, "kill_grace_seconds": 5.0, **options},
        )

    def command(self, *argv: str, **options: Any) -> list[str]:
        path = self.folder / "spec.json"
        path.write_text(self.spec(*argv, **options).to_json())
        return [sys.executable, "-m", "slamhive.monitor", "--spec", str(path)]

    def start(self, *argv: str, **options: Any) -> subprocess.Popen[bytes]:
        return subprocess.Popen(self.command(*argv, **options))

    def __call__(self, *argv: str, **options: Any) -> dict[str, Any]:
        """Run to the end and return the summary."""
        assert subprocess.run(self.command(*argv, **options), check=False, timeout=120).returncode == 0
        return self.summary()

    def python(self, code: str, **options: Any) -> dict[str, Any]:
        return self(sys.executable, "-c", code, **options)

    def summary(self) -> dict[str, Any]:
        return json.loads((self.folder / "summary.json").read_text())

    def pid(self, name: str) -> int:
        """Wait for the pid that a program of the run writes into a file of its output."""
        path = self.output / name
        return int(wait_for(lambda: path.exists() and path.read_text().strip()))

    def cgroups(self) -> list[str]:
        return json.loads(self.process_json.read_text())["cgroups"]


@pytest.fixture(params=["cgroup", "proc"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Run]:
    if request.param == "cgroup" and _cgroup_name() is None:
        pytest.skip("no cgroup with CPU and memory can be made here")
    made = Run(tmp_path, "auto" if request.param == "cgroup" else "none")
    yield made
    if made.process_json.exists():
        left_behind = [path for path in made.cgroups() if os.path.exists(path)]  # noqa: PTH110
        assert end_orphans(made.process_json) == []
        assert left_behind == []


@pytest.fixture
def killed() -> Callable[[subprocess.Popen[bytes]], None]:
    """Kill -9 a process of ours and wait for it."""

    def kill(process: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)
        process.wait(20)

    return kill


@pytest.fixture(name="wait_for")
def wait_for_fixture() -> Callable[..., Any]:
    return wait_for
