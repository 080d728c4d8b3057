# SPDX-License-Identifier: Apache-2.0
"""Making of an algorithm's environment: by uv where it can be had, else by pip, and under another name.

It is renamed when it is complete. Its files are copies: uv's links would share them with its cache and all
other environments, and programs run in it. Where uv fails, for whatever reason, pip says what is wrong.
"""

from __future__ import annotations

import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from slamhive.local.programs.installing import InstallStep, Steps
from slamhive.local.programs.pipcommands import run_command
from slamhive.local.programs.uv import find_uv, settle, uv_commands
from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.programs.interpreters import Interpreter

MARKER = ".complete"
"""A file that is in an environment which was made to its end."""
# What some packages have for other versions of Python can't be compiled, and nobody imports their tests.
_COMPILE = """
import compileall, re
compileall.compile_dir(".", quiet=2, workers={workers}, rx=re.compile("/tests?/"))
"""
ASIDE = ".making"
"""End of the name of one that is being made."""


class Making:
    """The making of an environment, shown to those who wait for it; a context manager.

    Args:
        name: of the algorithm.
        python: its interpreter.
        requirements: its packages.
        shown: gets what is done, in words, and the share of it that is done.
        held: descriptor of its lock; what installs holds it too, and may outlive this process.
        given_up: tells whether it is wanted no more.
    """

    def __init__(
        self,
        name: str,
        python: Interpreter,
        requirements: Path,
        shown: dict[str, float],
        *,
        held: int | None = None,
        given_up: Callable[[], bool] = lambda: False,
    ) -> None:
        self._name = name
        self._what = self._said = f"making the environment of {name}"
        self._python = python
        self._requirements = requirements
        self._steps = Steps(requirements)
        self._shown = shown
        self._held = held
        self._given_up = given_up

    def __enter__(self) -> Self:
        self._shown[self._said] = 0.0
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.pop(self._said, None)

    def tell(self, line: str) -> None:
        """Take a line that pip or uv printed."""
        step = self._steps.step(line)
        if step is not None:
            self._show(step)

    def make(self, path: Path) -> None:
        """Make it.

        Raises:
            Unavailable: its packages can't be had.
            SystemFault: they can't be installed right now.
            GivenUp: it is wanted no more.
        """
        aside = path.with_name(f"{path.name}{ASIDE}")
        shutil.rmtree(path, ignore_errors=True)
        try:
            if not self._by_uv(aside):
                self._by_pip(aside)
            settle(aside, path)
            (aside / MARKER).touch()
            aside.rename(path)
        finally:
            shutil.rmtree(aside, ignore_errors=True)  # half of one is of no use, and may fill the disk

    def _by_uv(self, path: Path) -> bool:
        """Make it by uv or, where there is nothing to install, by neither; tell whether that went well."""
        if not _anything_in(self._requirements):
            self._begin(path, "--without-pip")
            return True
        # What a machine's ROS brings counts for pip alone.
        uv = None if self._python.beside else find_uv([Path(sys.prefix) / "bin"])
        if uv is None:
            return False
        self._begin(path, "--without-pip")
        how = ["--link-mode", "copy", *_how(self._requirements)]
        for command in uv_commands(uv, path / "bin" / "python", how):
            with suppress(SlamHiveError):
                self._run(command, together=True)
                self._compile(path)
                return True
        return False

    def _by_pip(self, path: Path) -> None:
        self._begin(path)
        pip = [str(path / "bin" / "python"), "-m", "pip", "--no-input", "--disable-pip-version-check"]
        self._run([*pip, "install", "--progress-bar", "off", *_how(self._requirements)])

    def _begin(self, path: Path, *how: str) -> None:
        shutil.rmtree(path, ignore_errors=True)
        seeing = ["--system-site-packages"] if self._python.beside else []
        make = [self._python.path, "-m", "venv", *seeing, *how, str(path)]
        self._run(make, f"environment of {self._name}", tell=None)

    def _compile(self, path: Path) -> None:
        """Compile all that is imported: programs keep nothing of what they compile, and would each time."""
        self._show(InstallStep("compiling", 9, 9))
        packages = next(path.glob("lib/python*/site-packages"))
        code = _COMPILE.format(workers=len(os.sched_getaffinity(0)))
        self._run([str(path / "bin" / "python"), "-I", "-c", code], "compiling", packages, tell=None)

    def _run(self, command: list[str], what: str = "", folder: Path | None = None, **how: Any) -> None:
        run_command(
            command,
            what or f"packages of {self._name}",
            folder or self._requirements.parent,
            self._held,
            given_up=self._given_up,
            **({"tell": self.tell} | how),
        )

    def _show(self, step: InstallStep) -> None:
        self._shown.pop(self._said, None)
        self._said = f"{self._what}: {step.what}"
        self._shown[self._said] = step.share


def _how(requirements: Path) -> list[str]:
    """Return the arguments with which uv and pip install a file of requirements."""
    # Wheels alone: a source package runs a program of its own to install itself.
    how = ["--only-binary", ":all:", "-r", str(requirements)]
    # With hashes it has to name all that is needed, and what it leaves out is left out on purpose.
    return ["--no-deps", *how] if b"--hash=" in requirements.read_bytes() else how


def _anything_in(requirements: Path) -> bool:
    """Tell whether a file of requirements has more than comments."""
    # As bytes: pip reads encodings that we need not know.
    lines = (line.strip() for line in requirements.read_bytes().splitlines())
    return any(line and not line.startswith(b"#") for line in lines)
