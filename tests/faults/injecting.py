# SPDX-License-Identifier: Apache-2.0
"""Faults of the disk, injected at writes of a command and of all that it starts, by a preloaded library."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

from forking import Forks

if TYPE_CHECKING:
    from collections.abc import Mapping

HERE = Path(__file__).parent
IMPORTED = (
    "slamhive.cli.running",
    "slamhive.local.running.workbench",
    "slamhive.archive",
    "slamhive.data.making.transfer",
    "slamhive.jobs.prepare",
    "slamhive.jobs.evaluate",
    "rosbags.typesys.stores.ros1_noetic",
    "rosbags.typesys.stores.ros2_humble",
)
"""Modules that commands under faults need."""
KINDS = ("ENOSPC", "EIO", "EROFS", "EDQUOT", "short")
_ALLOWED = {
    "unlink": ("EIO", "EROFS"),
    "rmdir": ("EIO", "EROFS"),
    "chmod": ("EIO", "EROFS"),
    "utime": ("EIO", "EROFS"),
    "write": KINDS,
}
"""Errors that calls fail with; all others with anything but a short write."""


@dataclass(frozen=True)
class Fault:
    """A fault to be made.

    Attributes:
        number: which of the calls it is, from 1.
        how: an errno by its name, or ``short``.
        lasting: whether the disk stays like that.
        call, form: name of a call and form of a path (fnmatch): others are not counted.
    """

    number: int
    how: str
    lasting: bool = False
    call: str | None = None
    form: str | None = None

    def __str__(self) -> str:
        where = " ".join(filter(None, (self.call, self.form)))
        return f"{self.how}{' from then on' if self.lasting else ''} at {where or 'write'} {self.number}"


@dataclass(frozen=True)
class Call:
    """A call that was seen, or a fault that was made.

    Attributes:
        name: of the call.
        path: from the folder.
        what: of a fault its errno, of a call seen whether it could be half done.
    """

    name: str
    path: str
    what: str

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of failure that it can have."""
        found = _ALLOWED.get(self.name, KINDS[:-1])
        return found if self.what == "sized" else tuple(kind for kind in found if kind != "short")


@dataclass(frozen=True)
class Command:
    """A function that is called as a program.

    Attributes:
        words: what its command line is.
        env: variables beside ours.
        module, function, arguments: what is called.
    """

    words: tuple[str, ...]
    env: Mapping[str, str]
    module: str = "slamhive.cli.main"
    function: str = "main"
    arguments: tuple[object, ...] = ()


@dataclass(frozen=True)
class Done:
    """A command that ended under faults."""

    code: int
    out: str
    err: str
    calls: list[Call]


class Injector:
    """Runs commands with faults below a folder.

    Args:
        folder: for the library and its notes; not below where faults are made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.library = build_library(folder / "shim.so")

    @cached_property
    def _forks(self) -> Forks:
        return Forks(IMPORTED, os.environ | {"LD_PRELOAD": str(self.library)})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if "_forks" in vars(self):  # who only wants the variables has started none
            self._forks.close()

    def run(self, command: Command, root: Path, fault: Fault | None) -> Done:
        """Run a command with a fault, or with none: then all calls are told of."""
        given = self.variables(root, fault)
        out, err = self._folder / f"{root.name}.out", self._folder / f"{root.name}.err"
        order = asdict(command) | {"env": os.environ | {**command.env, **given}, "cwd": str(Path.cwd())}
        code = self._forks.call(**order, out=str(out), err=str(err))
        return Done(code, out.read_text(), err.read_text(), self.calls(root))

    def variables(self, root: Path, fault: Fault | None) -> dict[str, str]:
        """Return the variables by which a program has a fault below a folder, counted from now on."""
        count = self._folder / f"{root.name}.count"
        count.write_bytes(bytes(4096))
        self._log(root).write_text("")
        given = {"LD_PRELOAD": str(self.library), "FAULT_ROOT": str(root)}
        given |= {"FAULT_COUNT": str(count), "FAULT_LOG": str(self._log(root))}
        if fault is None:
            return given | {"FAULT_AT": "0", "FAULT_CALL": "", "FAULT_MATCH": ""}
        return given | {
            "FAULT_AT": str(fault.number),
            "FAULT_HOW": fault.how,
            "FAULT_LASTING": str(int(fault.lasting)),
            "FAULT_CALL": fault.call or "",
            "FAULT_MATCH": fault.form or "",
        }

    def calls(self, root: Path) -> list[Call]:
        """Return the calls seen below a folder, or the faults made there."""
        lines = [line.split("\t") for line in self._log(root).read_text(errors="replace").splitlines()]
        return [Call(*line[:3]) for line in lines if len(line) == 4]

    def _log(self, root: Path) -> Path:
        return self._folder / f"{root.name}.log"


def build_library(place: Path) -> Path:
    """Build the library that makes faults, at a path, and return that."""
    command = [str(compiler()), "-O2", "-shared", "-fPIC", "-o", str(place), str(HERE / "shim.c"), "-ldl"]
    subprocess.run(command, check=True)
    return place


def compiler() -> str | None:
    """Return the machine's C compiler, if it has one."""
    return shutil.which("cc") or shutil.which("gcc")
