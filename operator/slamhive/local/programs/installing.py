# SPDX-License-Identifier: Apache-2.0
"""Progress of pip and uv, by what they print: for environments of algorithms, and for ``make install``.

The standard library alone: ``make install`` uses this before there is anything else.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
import time
from typing import IO, TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

_STEP = re.compile(r"\s*(?P<verb>Collecting|Downloading|Installing) (?:collected packages: )?(?P<rest>.+)")
_STEP_OF_UV = re.compile(r" ?(?P<verb>Resolved|Downloaded|Prepared) (?P<rest>[\w.-]+)")
_SIZE = re.compile(r" \([\d.]+ ?[kKMG]?i?B\)")
_NAME_ENDS = {"collecting": re.compile(r"[\s=<>~!\[;]"), "downloading": re.compile(r"-\d|\s")}
_LINES = 12
"""Lines while packages come, where there is no terminal."""
_FIRST_WAIT = 10.0
"""Time without news after which a line comes, s; twice as long each time."""


class InstallStep(NamedTuple):
    """Step of an installation, with the number of packages fetched so far.

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


class Steps:
    """Follows what pip or uv prints.

    Args:
        requirements: what is installed: a file that states each package on a line.
    """

    def __init__(self, requirements: Path) -> None:
        self._stated = sum(b"==" in line for line in requirements.read_bytes().splitlines())
        self._seen = 0

    def step(self, line: str) -> InstallStep | None:
        """Return the step that a line of theirs is about; None where it is about none."""
        found = _STEP.match(line)
        if found is None:
            return self._of_uv(line)
        verb, rest = found["verb"].lower(), found["rest"]
        size = _SIZE.search(rest)
        # What pip is fetching isn't there yet; uv fetches many at a time, and says which have come.
        done = max(0, self._seen - (verb == "downloading" and ".whl" in rest))
        if verb == "installing":
            what = f"{rest.count(',') + 1} packages"
        else:
            self._seen += verb == "collecting"
            what = _NAME_ENDS[verb].split(rest, maxsplit=1)[0] + (size[0] if size else "")
        return InstallStep(f"{verb} {what}", done, max(self._stated, self._seen))

    def _of_uv(self, line: str) -> InstallStep | None:
        found = _STEP_OF_UV.match(line)
        if found is None:
            return None
        if found["verb"] == "Downloaded":
            self._seen += 1
            return InstallStep(f"fetched {found['rest']}", self._seen, self._stated)
        if found["verb"] == "Prepared":
            return InstallStep(f"installing {found['rest']} packages", self._stated, self._stated)
        self._stated = int(found["rest"])
        return InstallStep("fetching packages", 0, self._stated)


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
        self._step = InstallStep("beginning", 0, 0)
        self._lock = threading.Lock()

    def take(self, step: InstallStep) -> None:
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


def install(
    command: Sequence[str], steps: Steps, teller: Teller, variables: Mapping[str, str], held: int
) -> list[str]:
    """Run pip or uv, tell how far it is, and return what it said where it failed, nothing where it did not.

    Args:
        command: what is run.
        steps: follows it.
        teller: tells how far it is.
        variables: those that it is started with.
        held: descriptor of a lock that it holds as long as it runs.
    """
    ended, said = threading.Event(), []

    def beats() -> None:
        while not ended.wait(1.0):
            teller.beat()

    beating = threading.Thread(target=beats, daemon=True)
    with subprocess.Popen(
        command,
        env=variables,
        pass_fds=(held,),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ) as process:
        beating.start()
        try:
            for line in process.stdout or ():
                step = steps.step(line)
                if step is not None:
                    teller.take(step)
                elif line.strip():
                    said.append(line.rstrip())
        except BaseException:
            process.kill()
            raise
        finally:
            ended.set()
            beating.join()
            teller.end()
    return (said or [f"exit code {process.returncode}"]) if process.returncode else []
