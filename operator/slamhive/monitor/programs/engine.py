# SPDX-License-Identifier: Apache-2.0
"""Commands of a container engine (podman, docker), and its own words about what it doesn't do."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

from slamhive.contract.lines import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

COMMAND_SECONDS = 120.0
"""Longest time for one command, on a busy machine too."""
_LINE_LIMIT = 400


class EngineError(Exception):
    """An engine's own word about what it doesn't do."""


def run_engine(command: Sequence[str], seconds: float = COMMAND_SECONDS, given: str = "") -> str:
    """Have an engine do something with what it is given to read, and return what it printed.

    Raises:
        EngineError: It doesn't; the message is the last line that it printed.
    """
    try:
        done = subprocess.run(
            command,
            input=given,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=seconds,
            start_new_session=True,
        )
    except subprocess.TimeoutExpired:
        raise EngineError(f"no answer within {seconds:.0f} s") from None
    except OSError as error:
        raise EngineError(error.strerror or str(error)) from None
    if done.returncode != 0:
        raise EngineError(last_line(done.stderr or done.stdout))
    return done.stdout


def last_line(text: str) -> str:
    """Return the last line that says something, without what an engine puts before all its errors."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    last = lines[-1] if lines else "no message"
    for words in ("Error: ", "Error response from daemon: ", "ERROR: "):
        last = last.removeprefix(words)
    return printable(last)[:_LINE_LIMIT]
