# SPDX-License-Identifier: Apache-2.0
"""Progress of pip, by what it prints: for environments of algorithms, and for ``make install``.

The standard library alone: ``make install`` runs this file before there is anything else.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_STEP = re.compile(r"\s*(?P<verb>Collecting|Downloading|Installing) (?:collected packages: )?(?P<rest>.+)")
_SIZE = re.compile(r" \([\d.]+ [kMG]?B\)")
_NAME_ENDS = {"collecting": re.compile(r"[\s=<>~!\[;]"), "downloading": re.compile(r"-\d|\s")}
_LINES = 12
"""Lines while packages come, where there is no terminal."""
_FIRST_WAIT = 10.0
"""Time without news after which a line comes, s; twice as long each time."""


class Step(NamedTuple):
    """Step of an installation by pip, with the number of packages fetched so far.

    Attributes:
        what: in words.
        done: packages that are fetched.
        total: packages in all, as far as that is known.
    """

    what: str
    done: int
    total: int

    @property
    def share(self) -> float:
        """Return the share that is done: all packages are fetched, then all are installed at once."""
        return self.done / (self.total + 1)


class PipSteps:
    """Follows what pip prints.

    Args:
        requirements: what it installs: a file that states each package on a line.
    """

    def __init__(self, requirements: Path) -> None:
        self._stated = sum(b"==" in line for line in requirements.read_bytes().splitlines())
        self._seen = 0

    def step(self, line: str) -> Step | None:
        """Return the step that a line of pip's is about; None where it is about none."""
        found = _STEP.match(line)
        if found is None:
            return None
        verb, rest = found["verb"].lower(), found["rest"]
        size = _SIZE.search(rest)
        done = max(0, self._seen - (verb == "downloading"))  # what is being fetched isn't yet
        if verb == "installing":
            what = f"{rest.count(',') + 1} packages"
        else:
            self._seen += verb == "collecting"
            what = _NAME_ENDS[verb].split(rest, maxsplit=1)[0] + (size[0] if size else "")
        return Step(f"{verb} {what}", done, max(self._stated, self._seen))


class Teller:
    """Says how far an installation is: by one line that changes on a terminal, by a few lines elsewhere.

    Args:
        to: where.
        clock: monotonic time, s.
    """

    def __init__(self, to: IO[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._to = to
        self._clock = clock
        self._began = self._said = clock()
        self._wait = _FIRST_WAIT
        self._lines = 0
        self._step = Step("beginning", 0, 0)
        self._lock = threading.Lock()

    def take(self, step: Step) -> None:
        """Take a step."""
        with self._lock:
            self._step = step
            # A log keeps every line: a few are enough, evenly over the packages.
            due = step.total and step.done * _LINES >= self._lines * step.total
            if self._to.isatty():
                self._redraw()
            elif due or step.what.startswith("installing"):
                self._print()

    def beat(self) -> None:
        """Say that it goes on, where nothing was said for a while."""
        with self._lock:
            if self._to.isatty():
                self._redraw()
            elif self._clock() - self._said >= self._wait:
                self._wait *= 2
                self._print()

    def end(self) -> None:
        """Take the line that changes away."""
        if self._to.isatty():
            self._to.write("\r\x1b[K")
            self._to.flush()

    def _text(self) -> str:
        step = self._step
        counted = f"{step.done} of {step.total} packages, " if step.total else ""
        return f"{counted}{self._clock() - self._began:.0f} s: {step.what}"

    def _print(self) -> None:
        self._said = self._clock()
        self._lines += 1
        self._to.write(f"{self._text()}\n")
        self._to.flush()

    def _redraw(self) -> None:
        width = shutil.get_terminal_size().columns - 1
        self._to.write(f"\r\x1b[K{self._text()[:width]}")
        self._to.flush()


def install(requirements: Path, command: Sequence[str], teller: Teller) -> int:
    """Run pip, tell how far it is, and return its exit code; its errors go to standard error as they come."""
    steps, ended = PipSteps(requirements), threading.Event()

    def beats() -> None:
        while not ended.wait(1.0):
            teller.beat()

    beating = threading.Thread(target=beats, daemon=True)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, errors="replace") as process:
        beating.start()
        try:
            for line in process.stdout or ():
                step = steps.step(line)
                if step is not None:
                    teller.take(step)
        except BaseException:
            process.kill()
            raise
        finally:
            ended.set()
            beating.join()
            teller.end()
    return process.returncode


if __name__ == "__main__":
    sys.exit(install(Path(sys.argv[1]), sys.argv[2:], Teller(sys.stdout)))
