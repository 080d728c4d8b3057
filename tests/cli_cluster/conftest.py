# SPDX-License-Identifier: Apache-2.0
"""The command on a real control plane, with an operator in the test and nodes that are played."""

from __future__ import annotations

import asyncio
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parents[1] / "cluster"))

from testcluster.fixtures import *  # noqa: F403
from testcluster.labs import *  # noqa: F403

from slamhive.archive import Archive
from slamhive.cli import main
from slamhive.cli.parts.console import speak_json
from slamhive.local.home.folder import Home

if TYPE_CHECKING:
    from testcluster.access import Cluster


@dataclass
class Said:
    """Exit code and output of a command that a test ran.

    Attributes:
        code: its exit code.
        out: its standard output.
        err: its standard error.
    """

    code: int
    out: str
    err: str

    @property
    def text(self) -> str:
        """All that it said, white space made one."""
        return " ".join(f"{self.out} {self.err}".split())


class Desk:
    """A user's folder and home, and the command as that user types it."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self._capsys = capsys

    @property
    def archive(self) -> Archive:
        """The archive of the home."""
        return Archive.open(Home.at(self.folder / "home").archive_url)

    def write(self, *objects: dict[str, Any], name: str = "study.yaml") -> str:
        """Write objects into a file and return its path."""
        path = self.folder / name
        path.write_text("---\n".join(yaml.safe_dump(item, sort_keys=False) for item in objects))
        return str(path)

    def type(self, *words: str) -> Said:
        """Run the command in this process."""
        self._capsys.readouterr()
        speak_json(wanted=False)  # as a new process would, whatever the command before was asked for
        code = 0
        sys.argv[:] = ["slamhive", *words]
        try:
            main.main()
        except SystemExit as end:
            code = int(end.code or 0)
        return Said(code, *self._capsys.readouterr())

    async def types(self, *words: str) -> Said:
        """Run the command beside an operator of the test."""
        return await asyncio.to_thread(self.type, *words)


@pytest.fixture
def bare_desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Desk:
    """A desk that knows no cluster."""
    (tmp_path / "home").mkdir()
    monkeypatch.setattr("sys.argv", ["slamhive"])
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("KUBECONFIG", str(tmp_path / "kubeconfig"))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    monkeypatch.setattr("slamhive.cli.cluster.status.LOOK_SECONDS", 0.2)
    monkeypatch.setattr("slamhive.cli.cluster.run.LOOK_SECONDS", 0.2)
    monkeypatch.chdir(tmp_path)
    return Desk(tmp_path, capsys)


@pytest.fixture
def desk(bare_desk: Desk, crds: Cluster, namespace: str) -> Desk:
    """A desk whose kubeconfig leads to the test's namespace, with its own catalog there and here."""
    config = yaml.safe_load(crds.kubeconfig.read_text())
    for context in config["contexts"]:
        context["context"]["namespace"] = namespace
    (bare_desk.folder / "kubeconfig").write_text(yaml.safe_dump(config))
    return bare_desk
