# SPDX-License-Identifier: Apache-2.0
"""The command itself, in a process of its own on a home of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.archive import Archive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from slamhive.local.home.folder import Home
    from slamhive.model.results import RunRecord

sys.path.append(str(Path(__file__).parents[1] / "faults"))

from forking import Fork, Forks

IMPORTED = (
    "slamhive.cli.main",
    "slamhive.cli.running",
    "slamhive.cli.results",
    "slamhive.archive.upgrading",
    "slamhive.data.making.transfer",
    "slamhive.local.running.workbench",
    "slamhive.local.home.catalog:load_workshop",
)
COMMAND = Path(sys.executable).with_name("slamhive")
DEADLINE_SECONDS = 120.0
HEADER = {"apiVersion": "slamhive.io/v1alpha1"}


def wait_until(condition: Callable[[], Any], what: str, seconds: float = DEADLINE_SECONDS) -> Any:
    """Return the value of a condition as soon as it holds."""
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > deadline:
            pytest.fail(f"{what}: not within {seconds:g} s")
        time.sleep(0.03)
    return found


def environment() -> dict[str, str]:
    """Return ours, in which nothing leads to another slamhive than the installed one."""
    return {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}


class System:
    """A home, the command on it, and what can be seen of it from outside."""

    def __init__(self, home: Home, folder: Path, forks: Forks) -> None:
        self.home = home
        self.folder = folder
        self._forks = forks
        self._started: list[subprocess.Popen[str] | Fork] = []

    def start(self, *arguments: str | Path) -> subprocess.Popen[str]:
        """Start the command; its output goes to files, so that it never waits for a reader."""
        number = len(self._started)
        with (
            (self.folder / f"{number}.out").open("w") as out,
            (self.folder / f"{number}.err").open("w") as err,
        ):
            process = subprocess.Popen(
                [COMMAND, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                text=True,
                cwd=self.folder,
                env=self._environment(),
            )
        self._started.append(process)
        return process

    def fork(self, *arguments: str | Path) -> Fork:
        """Start the command in a fork: it does the same, and has imported what it needs."""
        number = len(self._started)
        for name in (f"{number}.out", f"{number}.err"):
            (self.folder / name).touch()  # the fork opens them when it comes to it
        process = self._forks.start(**self._order(f"{number}.out", f"{number}.err", *arguments))
        self._started.append(process)
        return process

    def __call__(self, *arguments: str | Path) -> tuple[int, str, str]:
        """Run the command to its end, in a fork; return exit code, standard output and standard error."""
        code = self._forks.call(**self._order("out", "err", *arguments))
        return code, (self.folder / "out").read_text(), (self.folder / "err").read_text()

    def _order(self, out: str, err: str, *arguments: str | Path) -> dict[str, Any]:
        """Return the order to a fork."""
        return {
            "module": "slamhive.cli.main",
            "function": "main",
            "arguments": (),
            "words": [str(one) for one in arguments],
            "env": self._environment(),
            "cwd": str(self.folder),
            "out": str(self.folder / out),
            "err": str(self.folder / err),
        }

    def _environment(self) -> dict[str, str]:
        return environment() | {"SLAMHIVE_HOME": str(self.home.path), "COLUMNS": "200"}

    def printed(self, process: subprocess.Popen[str] | Fork) -> tuple[str, str]:
        """Return the output of a command so far, to standard output and standard error."""
        number = self._started.index(process)
        return (self.folder / f"{number}.out").read_text(), (self.folder / f"{number}.err").read_text()

    def sweep(self, name: str = "s", /, template: dict[str, Any] | None = None, **spec: Any) -> Path:
        """Write a sweep of runs of the actor that note when they start and end."""
        base = {"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "tiny"}}
        base |= {"parameters": {"act": "noted"}} | (template or {})
        return self.manifest("Sweep", name, {"template": {"spec": base}} | spec)

    def manifest(self, kind: str, name: str, spec: dict[str, Any]) -> Path:
        """Write a manifest, whole or not at all."""
        path = self.folder / f"{name}.yaml"
        text = yaml.safe_dump({**HEADER, "kind": kind, "metadata": {"name": name}, "spec": spec})
        path.with_suffix(".new").write_text(text)
        path.with_suffix(".new").replace(path)
        return path

    def journal(self, event: str | None = None) -> list[dict[str, Any]]:
        """Return the entries that the actors noted, in order."""
        path = self.home.path / "journal"
        lines = path.read_text().splitlines() if path.exists() else []
        found = [json.loads(line) for line in lines]
        return [entry for entry in found if event in (None, entry["event"])]

    def records(self, sweep: str = "s") -> list[RunRecord]:
        """Return the archived runs of a sweep's current version."""
        with Archive.open(self.home.archive_url) as archive:
            found = archive.sweep(sweep)
            return list(archive.runs({"sweep_uid": found.uid})) if found else []

    def alive(self) -> list[int]:
        """Return all living processes of this home whose environment names it: all but forks."""
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit() and int(entry.name) != os.getpid():
                with suppress(OSError):
                    if str(self.home.path).encode() in (entry / "environ").read_bytes():
                        found.append(int(entry.name))
        return found

    def supervisors(self) -> list[int]:
        """Return the living supervisors of this home, by what started them: they are closed to inspection."""
        found, alive = [], {*self.alive(), *(process.pid for process in self._started)}
        for entry in Path("/proc").iterdir():
            with suppress(OSError):
                if entry.name.isdigit() and b"slamhive.monitor" in (entry / "cmdline").read_bytes():
                    pid, parent = int(entry.name), (entry / "stat").read_text().rpartition(")")[2].split()[1]
                    if {pid, int(parent)} & alive:
                        found.append(pid)
        return found

    def end(self) -> None:
        """Leave nothing behind."""
        for process in self._started:
            process.kill()
            process.wait()
        deadline = time.monotonic() + 50
        while (left := self.alive()) and time.monotonic() < deadline:
            for pid in left:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            time.sleep(0.03)


@pytest.fixture(scope="session")
def forks() -> Iterator[Forks]:
    """Process that forks commands that are run to their end: importing takes longer than most of them."""
    found = Forks(IMPORTED, environment())
    yield found
    found.close()


@pytest.fixture
def system(home: Home, tmp_path: Path, forks: Forks) -> Iterator[System]:
    """A home with the actor, and the command on it."""
    found = System(home, tmp_path, forks)
    try:
        yield found
    finally:
        found.end()


@pytest.fixture(name="until")
def _until() -> Callable[..., Any]:
    """Waits for a condition, and fails when it doesn't come."""
    return wait_until
