# SPDX-License-Identifier: Apache-2.0
"""Commands that make environments, `venv` and pip: what they are given, and why one failed."""

from __future__ import annotations

import os
import re
import subprocess
from typing import TYPE_CHECKING

from slamhive.contract.environment import own_variables
from slamhive.local.programs.unavailable import Unavailable
from slamhive.local.programs.words import Words
from slamhive.model.errors import SlamHiveError, SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

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
    r"|(HTTPS?|ALL|NO)_PROXY|(https?|all|no)_proxy|SSL_CERT_(FILE|DIR)|(REQUESTS|CURL)_CA_BUNDLE"
)


def run_command(
    argv: list[str],
    what: str,
    folder: Path,
    held: int | None = None,
    tell: Callable[[str], None] | None = None,
) -> None:
    """Run a command in a folder.

    Args:
        argv: the command.
        what: what it makes, for the message.
        folder: where it runs.
        held: descriptor of a lock that it shall hold as long as it runs: it may outlive a slamhive that is
            killed, and another one must not begin to make the same meanwhile.
        tell: given each line of its standard output, which then says nothing of errors.
    """
    words, printed = Words(), []
    try:
        process = subprocess.Popen(
            argv,
            text=True,
            errors="replace",
            cwd=folder,
            env=_surroundings(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=words.descriptor,
            pass_fds=() if held is None else (held,),
        )
    except OSError as error:
        raise SystemFault(f"{what}: {error}") from None
    with process:
        try:
            for line in process.stdout or ():
                if tell is None:
                    printed.append(line)
                else:
                    tell(line.rstrip())
        except BaseException:
            process.kill()
            raise
    if process.returncode != 0:
        raise explained(what, words.text() + "".join(printed), by_itself=process.returncode > 0)


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
    return own_variables(filter(_PASSED_ON.fullmatch, os.environ)) | {"PYTHONSAFEPATH": "1"}
