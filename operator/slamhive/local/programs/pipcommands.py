# SPDX-License-Identifier: Apache-2.0
"""Commands that make environments, `venv`, pip and uv: what they are given, and why one failed."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
from typing import IO, TYPE_CHECKING, cast

from slamhive.contract.environment import own_variables
from slamhive.local.programs.unavailable import GivenUp, Unavailable
from slamhive.local.programs.uv import uv_variables
from slamhive.local.programs.words import Words
from slamhive.model.errors import SlamHiveError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

_LOOK_SECONDS = 0.25
_NOT_THERE = ("ERROR: No matching distribution found", "ERROR: Could not find a version")
_PASSING = re.compile(
    r"Retrying|[Cc]onnection|[Tt]imed out|[Tt]imeout|[Tt]emporary failure|SSL|Proxy|HTTP error|unreachable"
    r"|No space left|quota|Read-only|OSError|Permission denied|Input/output|MemoryError|Killed"
    r"|ERROR: Exception"
)
"""Words of pip about what another try may mend; without any, another try ends as the first did."""
_BROKEN = re.compile(r"after connection broken by '(\w+)")
_NO_WHEEL = re.compile(r"No matching distribution found for ([\w.-]+).*")
_PASSED_ON = re.compile(
    r"PATH|HOME|USER|LOGNAME|LANG|LC_\w+|TZ|TMPDIR|LD_LIBRARY_PATH|XDG_(CONFIG|CACHE)_(HOME|DIRS)|PIP_\w+"
    r"|UV_(?!PUBLISH)\w+"
    r"|(HTTPS?|ALL|NO)_PROXY|(https?|all|no)_proxy|SSL_CERT_(FILE|DIR)|(REQUESTS|CURL)_CA_BUNDLE"
)


def run_command(
    argv: list[str],
    what: str,
    folder: Path,
    held: int | None = None,
    tell: Callable[[str], None] | None = None,
    *,
    together: bool = False,
    given_up: Callable[[], bool] = lambda: False,
) -> None:
    """Run a command in a folder.

    Args:
        argv: the command.
        what: what it makes, for the message.
        folder: where it runs.
        held: descriptor of a lock that it shall hold as long as it runs: it may outlive a slamhive that is
            killed, and another one must not begin to make the same meanwhile.
        tell: given each line of its standard output, which then says nothing of errors.
        together: whether it is given what comes on standard error too: uv prints nowhere else.
        given_up: tells whether what it makes is wanted no more.

    Raises:
        SlamHiveError: it failed.
        GivenUp: it was given up, and ended.
    """
    words = Words()
    printed: list[str] = []
    try:
        process = subprocess.Popen(
            argv,
            cwd=folder,
            env=_surroundings(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if together else words.descriptor,
            pass_fds=() if held is None else (held,),
            # Ctrl-C is ours to hear: it would take this for a failure, and try otherwise.
            process_group=0,
        )
    except OSError as error:
        raise SystemFault(f"{what}: {error}") from None
    with process:
        try:
            for line in _lines(process, what, given_up):
                (tell or printed.append)(line)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode != 0:
        told = "\n".join([words.text(), *printed])
        raise explained(what, told, by_itself=process.returncode > 0)


def _lines(process: subprocess.Popen[bytes], what: str, given_up: Callable[[], bool]) -> Iterator[str]:
    """Yield the lines that a process prints, and look up now and then."""
    pipe, pending = cast("IO[bytes]", process.stdout).fileno(), b""
    while True:
        if given_up():
            raise GivenUp(what)
        if select.select([pipe], [], [], _LOOK_SECONDS)[0]:
            if not (read := os.read(pipe, 1 << 16)):
                break
            *whole, pending = (pending + read).split(b"\n")
            yield from (line.decode(errors="replace").rstrip() for line in whole)
    if pending:
        yield pending.decode(errors="replace")


def explained(what: str, told: str, *, by_itself: bool) -> SlamHiveError:
    """Return the error of a failed command: `Unavailable` where pip says what no other try would change.

    Args:
        what: what it was to make.
        told: all that it printed.
        by_itself: whether it ended by itself.
    """
    lines = [line.strip() for line in told.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR: ")]
    passing = [line for line in lines if _PASSING.search(line) and not line.startswith(_NOT_THERE)]
    # An index that can't be reached ends in the same error as a package that doesn't exist: only what pip
    # says before it tells them apart.
    if by_itself and errors and not passing:
        why = errors[-1].removeprefix("ERROR: ")
        return Unavailable(f"{what} can't be installed: {why}{_of_source(why)}")
    last = (passing or errors or lines or ["no message"])[-1].removeprefix("ERROR: ")
    broken = _BROKEN.search(last)
    why = f"the package index can't be reached ({broken.group(1)})" if broken else last
    return SystemFault(f"{what} could not be made: {why}")


def _of_source(why: str) -> str:
    found = _NO_WHEEL.fullmatch(why)
    if found is None:
        return ""
    return (
        f" among the wheels; if there is only source, a line --no-binary {found.group(1)} among the "
        "requirements lets its own setup program run"
    )


def _surroundings() -> dict[str, str]:
    """Return the variables that programs and pip need: paths, package index, proxies, certificates.

    Packages may bring programs of their own for their setup: tokens and keys that are ours are not for them,
    nor what makes Python import what merely lies about.
    """
    passed = own_variables(filter(_PASSED_ON.fullmatch, os.environ))
    return passed | uv_variables(passed) | {"PYTHONSAFEPATH": "1"}
