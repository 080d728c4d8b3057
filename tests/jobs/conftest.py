# SPDX-License-Identifier: Apache-2.0
"""Programs of Jobs as processes on folders like the volumes of their pods."""

from __future__ import annotations

import http.server
import json
import os
import shutil
import ssl
import subprocess
import sys
import threading
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

sys.path += [str(Path(__file__).parents[1] / "faults"), str(Path(__file__).parents[1] / "storage")]

from buckets import place, s3
from forking import Forks

__all__ = ["place", "s3"]

PROGRAMS = tuple(
    f"slamhive.jobs.{name}"
    for name in ("collect", "evaluate", "offload", "prepare", "read", "render", "report", "restore")
)
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


@dataclass
class Ended:
    """Exit code, output and termination message of a Job's program."""

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

    def __init__(self, root: Path, forks: Forks) -> None:
        self.root = root
        self._forks = forks
        for folder in ("data/datasets", "results/runs", "output", "request", "groundtruth"):
            (root / folder).mkdir(parents=True)

    def ask(self, request: Any) -> None:
        (self.root / "request" / "request.json").write_text(json.dumps(request))

    def start(self, program: str, *options: str, log: str = "termination-log", **popen: Any) -> Any:
        """Start a program as its pod does."""
        environment = self._environment(log)
        command = [sys.executable, "-P", "-m", f"slamhive.jobs.{program}", "--root", str(self.root), *options]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(command, env=environment, cwd=self.root, **pipes, **popen)

    def _environment(self, log: str) -> dict[str, str]:
        return os.environ | {"SLAMHIVE_TERMINATION_LOG": str(self.root / log)}

    def end(self, process: Any, log: str = "termination-log") -> Ended:
        stdout, stderr = process.communicate(timeout=120)
        return Ended(process.returncode, stdout, stderr, (self.root / log).read_text())

    def run(self, program: str, *options: str, request: Any = None, **popen: Any) -> Ended:
        """Run a program to its end, in a fork unless something of its process is asked for."""
        if request is not None:
            self.ask(request)
        if popen:
            return self.end(self.start(program, *options, **popen))
        out, err = self.root.with_name("out"), self.root.with_name("err")
        code = self._forks.call(
            module=f"slamhive.jobs.{program}",
            function="main",
            arguments=(),
            words=("--root", str(self.root), *options),
            env=self._environment("termination-log"),
            cwd=str(self.root),
            out=str(out),
            err=str(err),
        )
        return Ended(code, out.read_text(), err.read_text(), (self.root / "termination-log").read_text())


@pytest.fixture(scope="session")
def forks() -> Iterator[Forks]:
    """Process that forks programs: importing what they need takes a second of CPU."""
    found = Forks(PROGRAMS, dict(os.environ))
    yield found
    found.close()


@pytest.fixture
def pod(tmp_path: Path, forks: Forks) -> Pod:
    return Pod(tmp_path / "slamhive", forks)


@pytest.fixture(scope="session")
def shared() -> Path:
    if not SHARED.is_dir():
        pytest.skip(f"needs the data in {SHARED}")
    return SHARED


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


class Https:
    """An https server with a certificate of its own, which started programs trust."""

    def __init__(self, folder: Path, certificate: Path, key: Path) -> None:
        self.folder = folder
        self._server = http.server.ThreadingHTTPServer(
            ("127.0.0.1", 0), partial(_Quiet, directory=str(folder))
        )
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate, key)
        self._server.socket = context.wrap_socket(self._server.socket, server_side=True)
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()
        self.url = f"https://localhost:{self._server.server_port}"

    def close(self) -> None:
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
            self._server.server_close()


@pytest.fixture
def https(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Https]:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate: apt-get install openssl")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "1"]
    files = ["-keyout", str(key), "-out", str(certificate)]
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", *names, *files]
    subprocess.run(command, check=True, capture_output=True)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    for name in ("https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    folder = tmp_path / "served"
    folder.mkdir()
    server = Https(folder, certificate, key)
    yield server
    server.close()
