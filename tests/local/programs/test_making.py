# SPDX-License-Identifier: Apache-2.0
"""Environments of algorithms by uv and by pip: whole, of copies, compiled, whatever was there before."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING

import pytest

from slamhive.local.programs.environments import is_whole
from slamhive.local.programs.interpreters import Interpreter
from slamhive.local.programs.making import Making
from slamhive.local.programs.pipcommands import run_command
from slamhive.local.programs.unavailable import GivenUp
from wheels import wheel

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.timeout(300)

OWN = Interpreter(sys.executable, sys.version_info[:2])


@pytest.fixture
def requirements(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of requirements of one package, which lies beside it."""
    monkeypatch.setenv("UV_CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "requirements.txt"
    path.write_text(f"--no-index\n--find-links {tmp_path}\n{wheel(tmp_path, 'shown')}")
    return path


def make(path: Path, requirements: Path, given_up: Callable[[], bool] = lambda: False) -> None:
    with Making("x", OWN, requirements, {}, given_up=given_up) as made:
        made.make(path)


def said(path: Path) -> str:
    """Return the words of the program of an environment's package."""
    return subprocess.run([path / "bin" / "shown"], capture_output=True, text=True, check=True).stdout


def test_programs_of_the_environment_run_and_its_files_are_its_own(
    requirements: Path, tmp_path: Path
) -> None:
    path = tmp_path / "environment"
    make(path, requirements)
    assert said(path) == "this is shown\n"
    assert is_whole(path)
    module = next(path.glob("lib/python*/site-packages/shown.py"))
    assert module.stat().st_nlink == 1
    # Programs keep nothing of what they compile: each would compile it anew, and that would be measured.
    assert list(module.parent.glob("__pycache__/shown.*.pyc"))


@pytest.mark.parametrize("uv", [True, False], ids=["uv", "pip"])
def test_a_file_with_hashes_names_all_that_is_installed(
    uv: bool, requirements: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not uv:
        monkeypatch.setattr("slamhive.local.programs.making.find_uv", lambda _: None)
    # As wheels of ROS ask for a package that builds messages alone, and has no wheel.
    requirements.write_text(f"--no-index\n--find-links {tmp_path}\n{wheel(tmp_path, 'shown', 'absent')}")
    make(tmp_path / "environment", requirements)
    assert said(tmp_path / "environment") == "this is shown\n"


def test_half_an_environment_is_made_anew(requirements: Path, tmp_path: Path) -> None:
    path = tmp_path / "environment"
    for left in (path, tmp_path / "environment.making"):
        (left / "bin").mkdir(parents=True)
        (left / "bin" / "python").write_text("half")
    make(path, requirements)
    assert said(path) == "this is shown\n"
    assert not (tmp_path / "environment.making").exists()


class _Index(SimpleHTTPRequestHandler):
    """An index of what lies in a folder."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def test_what_uv_had_before_is_installed_without_a_network(requirements: Path, tmp_path: Path) -> None:
    page = tmp_path / "index/simple/shown/index.html"
    page.parent.mkdir(parents=True)
    package = wheel(page.parent, "shown")
    name = next(page.parent.glob("*.whl")).name
    page.write_text(f'<a href="{name}">{name}</a>')
    handler = functools.partial(_Index, directory=tmp_path / "index")
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        requirements.write_text(f"--index-url http://127.0.0.1:{server.server_port}/simple\n{package}")
        make(tmp_path / "one", requirements)
        server.shutdown()
    make(tmp_path / "two", requirements)
    assert said(tmp_path / "two") == "this is shown\n"


def test_what_is_given_up_ends_and_leaves_nothing(requirements: Path, tmp_path: Path) -> None:
    with pytest.raises(GivenUp):
        make(tmp_path / "environment", requirements, given_up=lambda: True)
    assert not list(tmp_path.glob("environment*"))


def test_what_is_given_up_is_killed_with_all_that_it_started(tmp_path: Path) -> None:
    # The grandchild holds the pipe as long as it lives: its end is read when it has been killed too.
    reading, writing = os.pipe()
    wanted = iter((False, True))
    with pytest.raises(GivenUp):
        run_command(
            ["sh", "-c", "sleep 600 & echo begun; wait"],
            "it",
            tmp_path,
            writing,
            given_up=lambda: next(wanted),
        )
    os.close(writing)
    assert os.read(reading, 1) == b""
    os.close(reading)
