# SPDX-License-Identifier: Apache-2.0
"""Checks of an algorithm that behaves as a test wants, on the small recording."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.conformance.checking import CheckRequest, check_algorithm
from slamhive.conformance.workstation import OnWorkstation, bench_for_checks
from slamhive.local.home.catalog import load_workshop
from slamhive.local.running import attempt
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.conformance.findings import Finding
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home

HERE = Path(__file__).parent
NAME = "behaving"


class Notes:
    """A watcher that remembers what it was told."""

    def __init__(self) -> None:
        self.steps = 0
        self.done: list[str] = []

    def begin(self, steps: int) -> None:
        self.steps = steps

    def step(self, what: str) -> None:
        self.done.append(what)

    def found(self, finding: Finding) -> None:
        pass


def behaving(home: Home, breaks: set[str], **spec: Any) -> None:
    """Put an algorithm that does these things wrong into a home."""
    folder = home.path / "algorithms" / NAME
    folder.mkdir(exist_ok=True)
    text = (HERE / "behaving.py").read_text().replace("set()  # what it does wrong", repr(breaks or set()))
    (folder / "adapter.py").write_text(text)
    (folder / "requirements.txt").write_text("")
    shutil.copyfile(home.path / "algorithms" / "actor" / "truth.txt", folder / "truth.txt")
    body: dict[str, Any] = {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Algorithm",
        "metadata": {"name": NAME},
        "spec": {
            "local": {"adapter": "adapter.py", "requirements": "requirements.txt"},
            "modes": [{"name": "lidar"}],
            "assets": [{"name": "truth.txt", "path": "truth.txt"}],
            "parameters": {"size": {"type": "Integer", "default": 1}},
            "files": [{"path": "settings.txt", "template": "size: 1\n"}],
            "output": {"frame": "body", "stamp": "ScanStart"},
            "deterministic": "Yes",
            **spec,
        },
    }
    body["spec"] = {name: value for name, value in body["spec"].items() if value is not None}
    (folder / "algorithm.yaml").write_text(yaml.safe_dump(body))


@pytest.fixture
def workshop_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[Home], Workshop]:
    """The catalog of a home with the small recording; what is deaf is killed soon."""
    short = partial(attempt.SupervisorSpec, kill_grace_seconds=0.3)
    monkeypatch.setattr(attempt, "SupervisorSpec", short)

    def load(home: Home) -> Workshop:
        workshop = load_workshop(home)
        workshop.add(load_file(home.path / "tiny.yaml"), home.path)
        return workshop

    return load


@pytest.fixture
def check(home: Home, workshop_of: Callable[[Home], Workshop]) -> Callable[..., dict[str, Finding]]:
    """Checks the algorithm, and returns what was found by what was looked at."""

    def run(breaks: set[str], notes: Notes | None = None, **spec: Any) -> dict[str, Finding]:
        behaving(home, breaks, **spec)
        with bench_for_checks(home, workshop_of(home)) as bench:
            executors = [OnWorkstation(bench, NAME, "tiny")]
            found = check_algorithm(bench, executors, CheckRequest(NAME, "tiny", 60.0), notes or Notes())
        assert len({finding.check for finding in found}) == len(found)
        return {finding.check: finding for finding in found}

    return run
