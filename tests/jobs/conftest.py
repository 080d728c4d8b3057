# SPDX-License-Identifier: Apache-2.0
"""Programs of Jobs as real processes on folders like the volumes of their pods."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


@dataclass
class Ended:
    """How a program ended."""

    code: int
    stdout: str
    stderr: str
    message: str

    @property
    def told(self) -> Any:
        return json.loads(self.message)

    @property
    def error(self) -> tuple[str, str]:
        error = self.told["error"]
        assert self.code == 1
        assert len(self.message.encode()) <= 4096
        assert "Traceback" not in error["message"]
        return error["reason"], error["message"]


class Pod:
    """A pod's volumes, and its program."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in ("data/datasets", "results/runs", "output", "request", "groundtruth"):
            (root / folder).mkdir(parents=True)

    def ask(self, request: Any) -> None:
        (self.root / "request" / "request.json").write_text(json.dumps(request))

    def start(self, program: str, *options: str, log: str = "termination-log", **popen: Any) -> Any:
        environment = os.environ | {"SLAMHIVE_TERMINATION_LOG": str(self.root / log)}
        command = [sys.executable, "-P", "-m", f"slamhive.jobs.{program}", "--root", str(self.root), *options]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(command, env=environment, cwd=self.root, **pipes, **popen)

    def end(self, process: Any, log: str = "termination-log") -> Ended:
        stdout, stderr = process.communicate(timeout=120)
        return Ended(process.returncode, stdout, stderr, (self.root / log).read_text())

    def run(self, program: str, *options: str, request: Any = None, **popen: Any) -> Ended:
        if request is not None:
            self.ask(request)
        return self.end(self.start(program, *options, **popen))


@pytest.fixture
def pod(tmp_path: Path) -> Pod:
    return Pod(tmp_path / "slamhive")


@pytest.fixture(scope="session")
def shared() -> Path:
    if not SHARED.is_dir():
        pytest.skip(f"needs the data in {SHARED}")
    return SHARED
