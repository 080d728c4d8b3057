# SPDX-License-Identifier: Apache-2.0
"""Environment of a checkout, ``.venv``: what ``make demo`` and ``make install`` see to before all else.

It is made under another name and renamed when it is complete, so one that is there is whole, and says what it
was made from. Where it is as it should be nothing is done, and no network asked. The standard library alone.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
import venv
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from telling import Teller, install

from slamhive.local.programs.installing import InstallStep, Steps
from slamhive.local.programs.uv import find_uv, settle, uv_commands, uv_variables

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"demo": "constraints-demo.txt", "all": "constraints.txt"}
"""Files of packages by what they are enough for: what ``make demo`` and the README show, or everything."""
STAMP = ".made-from"
_HASHED = ("--require-hashes", "--only-binary", ":all:", "--requirement")
_OURS = ("--no-index", "--no-deps", "--no-build-isolation", "--editable", ".", "--editable", "./evaluator")
_OF_UV = re.compile(r"^uv==.*\n(?: +.*\n)*", re.MULTILINE)
_FAULTS = {"place": "was made in", "checkout": "was made for", "Python": "is of Python"}


def origin(what: str, folder: Path) -> dict[str, str]:
    """Return all that an environment is made from.

    Args:
        what: a key of `PACKAGES`.
        folder: where it is.
    """
    digest = hashlib.sha256((ROOT / PACKAGES[what]).read_bytes() + (ROOT / "hatch_build.py").read_bytes())
    for project in (ROOT, ROOT / "evaluator"):
        stated = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))
        parts = stated["project"], stated["build-system"], stated["tool"]["hatch"]
        digest.update(json.dumps(parts, sort_keys=True).encode())
    return {
        "place": str(folder),
        "checkout": str(ROOT),
        "Python": f"{sys.version_info[0]}.{sys.version_info[1]} ({sys.base_prefix})",
        "packages": what,
        "digest": digest.hexdigest(),
    }


def made_from(folder: Path) -> dict[str, str]:
    """Return all that an environment was made from; nothing where it doesn't say."""
    try:
        found = json.loads((folder / STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def fault(folder: Path, wanted: dict[str, str]) -> str | None:
    """Return the reason why an environment must be made anew; None where it is as it should be."""
    made = made_from(folder)
    if not made:
        return "was not made to its end, or by an earlier version" if folder.exists() else "is not there"
    if not (folder / "bin" / "python").exists():
        return f"has lost its Python {made.get('Python')}"
    for name, words in _FAULTS.items():
        if made.get(name) != wanted[name]:
            return f"{words} {made.get(name)}"
    return None if made == wanted else "has not the packages that are wanted now"


def make_environment(folder: Path, what: str) -> None:
    """Make an environment unless it is as it should be; another one may begin to at the same time.

    Args:
        folder: where it will be.
        what: a key of `PACKAGES`.

    Raises:
        SystemExit: it can't be made.
    """
    with _alone(folder.parent) as held:
        # What is enough for everything is enough for the demo, and stays so.
        what = "all" if made_from(folder).get("packages") == "all" else what
        wanted = origin(what, folder)
        why = fault(folder, wanted)
        if why is None:
            return
        _say(f"{folder} {why}: it is made.")
        _Venv(folder, ROOT / PACKAGES[what], held).make(json.dumps(wanted, indent=1))


@dataclass(frozen=True)
class _Venv:
    """The making of an environment.

    Attributes:
        folder: where it will be.
        packages: file of its packages, with hashes.
        held: descriptor of the lock; what installs holds it too, and may outlive this process.
    """

    folder: Path
    packages: Path
    held: int
    teller: Teller = field(default_factory=lambda: Teller(sys.stdout))

    @property
    def aside(self) -> Path:
        """Return the folder in which it is made."""
        return self.folder.with_name(f"{self.folder.name}.making")

    @property
    def python(self) -> Path:
        """Return its interpreter."""
        return self.aside / "bin" / "python"

    def make(self, stamp: str) -> None:
        """Make it aside, and put it in its place.

        Raises:
            SystemExit: its packages can't be installed.
        """
        try:
            said = self._by_uv()
            if said:
                causes = [line for line in said if "cause:" in line] or said
                _say(f"uv can't install them ({causes[-1].strip()}): pip does, in a minute or three.")
                said = self._by_pip()
            if said:
                why = f"{self.folder} could not be made: pip failed, and says why above."
                sys.exit("\n".join([*said[-5:], why]))
            settle(self.aside, self.folder)
            (self.aside / STAMP).write_text(stamp, encoding="utf-8")
            old = self.folder.with_name(f"{self.folder.name}.old")
            shutil.rmtree(old, ignore_errors=True)
            if self.folder.exists():
                self.folder.rename(old)
            self.aside.rename(self.folder)
            shutil.rmtree(old, ignore_errors=True)
        finally:
            shutil.rmtree(self.aside, ignore_errors=True)

    def _by_uv(self) -> list[str]:
        """Make it by uv, and return what that said where it failed."""
        self._begin()
        said = ["there is none for this machine"]
        # The environment that is to be replaced may have one. What is fetched goes: uv installs itself too,
        # and then has all that it needs in its cache.
        with tempfile.TemporaryDirectory(dir=self.aside) as fetched:
            uv = find_uv([self.folder / "bin"])
            if uv is None:
                said = self._fetch(fetched) or said
                uv = find_uv([Path(fetched) / "bin"])
            return self._by(uv) if uv else said

    def _by(self, uv: str) -> list[str]:
        said: list[str] = []
        for arguments in ((*_HASHED, str(self.packages)), _OURS):
            for command in uv_commands(uv, self.python, arguments):
                said = self._run(command)
                if not said:
                    break
            if said:
                break
        return said

    def _fetch(self, folder: str) -> list[str]:
        """Put uv into a folder by pip, and return what that said where it failed."""
        self.teller.take(InstallStep("fetching uv", 0, 0))
        wanted = self.aside / "uv.txt"
        wanted.write_text("".join(_OF_UV.findall(self.packages.read_text(encoding="utf-8"))))
        target = ["--quiet", "--no-deps", "--target", folder, *_HASHED, str(wanted)]
        return self._run([*_pip(self.python), "install", *target])

    def _by_pip(self) -> list[str]:
        """Make it by pip, and return what that said where it failed."""
        self._begin()
        wanted = self.aside / "others.txt"
        wanted.write_text(_OF_UV.sub("", self.packages.read_text(encoding="utf-8")))
        command = [*_pip(self.python), "install", "--progress-bar", "off"]
        return self._run([*command, *_HASHED, str(wanted)]) or self._run([*command, *_OURS])

    def _begin(self) -> None:
        shutil.rmtree(self.aside, ignore_errors=True)
        venv.create(self.aside, symlinks=True, prompt=self.folder.name)

    def _run(self, command: list[str]) -> list[str]:
        variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        variables |= uv_variables(variables) | {"PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_INPUT": "1"}
        return install(command, Steps(self.packages), self.teller, variables, self.held)


def _pip(python: Path) -> list[str]:
    """Return the command of a pip that installs into an environment, which has none of its own.

    Raises:
        SystemExit: there is none.
    """
    if importlib.util.find_spec("pip"):
        return [sys.executable, "-m", "pip", "--python", str(python)]
    if not _wheels_of_pip() and os.geteuid() == 0 and shutil.which("apt-get"):
        subprocess.run(["apt-get", "install", "-y", "-q", "python3-venv"], check=False)
    if not (wheels := _wheels_of_pip()):
        sys.exit("Python has neither pip nor its venv module: sudo apt-get install python3-venv")
    # From the wheel: to install it takes longer than all that it is asked for here.
    return [str(python), f"{wheels[-1]}/pip"]


def _wheels_of_pip() -> list[str]:
    """Return the wheels from which Python would install pip into an environment."""
    folders = sysconfig.get_config_var("WHEEL_PKG_DIR"), Path(contextlib.__file__).with_name("ensurepip")
    return [str(path) for folder in folders if folder for path in sorted(Path(folder).rglob("pip-*.whl"))]


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[int]:
    """Hold the lock of a folder: the kernel lets go of it when all that hold it have ended."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            _say(f"Another make is at work in {folder}: this one waits for it.")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


def _say(sentence: str) -> None:
    sys.stdout.write(f"{sentence}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        make_environment(Path(sys.argv[1]).resolve(), sys.argv[2])
    except OSError as error:
        sys.exit(f"{error.filename or sys.argv[1]}: {error.strerror or error}")
    except KeyboardInterrupt:
        sys.exit(130)
