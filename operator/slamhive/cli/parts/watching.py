# SPDX-License-Identifier: Apache-2.0
"""Files that ``slamhive run --watch`` looks at: manifests, and what the algorithms in them are made of."""

from __future__ import annotations

import ast
import hashlib
import subprocess
import sys
import time
import warnings
from typing import TYPE_CHECKING

from slamhive.data.store.datasets import MANIFEST
from slamhive.local.programs.environments import source_files
from slamhive.local.programs.interpreters import interpreter
from slamhive.local.programs.unavailable import Unavailable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from slamhive.local.home.catalog import AlgorithmEntry, Workshop

    Stamp = tuple[int, int] | None

LOOK_SECONDS = 0.2
_PARSE = """
import ast, sys
for path in sys.argv[1:]:
    try:
        with open(path, "rb") as file:
            ast.parse(file.read(), path)
    except (SyntaxError, ValueError) as error:
        print(path, getattr(error, "lineno", None) or 1, getattr(error, "msg", error), sep="\\t")
"""


class Watched:
    """The files of a command, and what was last seen of them.

    Args:
        files: the manifests that it was given.
    """

    def __init__(self, files: Iterable[Path]) -> None:
        self._manifests = list(files)
        self._entries: list[AlgorithmEntry] = []
        self._others: list[Path] = []
        self._stamps: dict[Path, Stamp] = {}
        self._sums: dict[Path, str | None] = {}
        self.changed()

    def follow(self, workshop: Workshop, algorithms: Iterable[str], datasets: Iterable[str]) -> None:
        """Look at what some algorithms and datasets are made of as well, from now on."""
        self._entries = [workshop.algorithm(name) for name in algorithms]
        self._others = [workshop.dataset(name).folder / MANIFEST for name in datasets]
        for path in self._files():
            if path not in self._stamps:
                self._stamps[path], self._sums[path] = _stamp(path), _sum(path)

    def changed(self) -> bool:
        """Tell whether any file has other content than when this was last asked."""
        changed = False
        for path in dict.fromkeys((*self._files(), *self._stamps)):
            stamp = _stamp(path)
            if path in self._stamps and stamp == self._stamps[path]:
                continue
            found = _sum(path)
            changed |= found != self._sums.get(path)
            self._stamps[path], self._sums[path] = stamp, found
        return changed

    def wait(self, sleep: Callable[[float], None] = time.sleep) -> None:
        """Wait until a file is saved with other content, and as long as files go on changing."""
        while not self.changed():
            sleep(LOOK_SECONDS)
        while self.changed():
            sleep(LOOK_SECONDS)

    def _files(self) -> list[Path]:
        found = [*self._manifests, *self._others]
        for entry in self._entries:
            found.append(entry.folder / "algorithm.yaml")
            try:
                found += source_files(entry)
            except Unavailable:
                continue
        return found


def half_saved(entry: AlgorithmEntry) -> list[str]:
    """Return the files of an algorithm's Python that can't be run: an editor is not done with them."""
    program = entry.algorithm.spec.local
    if program is None or program.command is not None:
        return []
    own = sorted(entry.folder.glob("*.py"))
    adapter = entry.folder / program.adapter
    if not adapter.is_file():
        return [f"{adapter} is not there"]
    problems = [f"{adapter} is empty"] if adapter.stat().st_size == 0 else []
    try:
        python = interpreter(entry)
    except Unavailable:
        return problems
    if python.version == sys.version_info[:2]:
        return problems + [problem for path in own if (problem := _problem(path))]
    argv = [python.path, "-I", "-c", _PARSE, *map(str, own)]
    told = subprocess.run(argv, capture_output=True, text=True, check=False, timeout=30).stdout
    found = [line.split("\t") for line in told.splitlines()]
    return problems + [_sentence(*parts) for parts in found if len(parts) == 3]


def _problem(path: Path) -> str | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ast.parse(path.read_bytes(), str(path))
    except (SyntaxError, ValueError) as error:
        return _sentence(
            str(path), str(getattr(error, "lineno", None) or 1), getattr(error, "msg", str(error))
        )
    except OSError as error:
        return f"{path}: {error.strerror}"
    return None


def _sentence(path: str, line: str, message: str) -> str:
    return f"{path}, line {line}: {message}"


def _stamp(path: Path) -> Stamp:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def _sum(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
