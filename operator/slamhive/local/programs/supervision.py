# SPDX-License-Identifier: Apache-2.0
"""A program under a supervisor of its own, as the runner sees it.

The program has our user and can write all files of its run folder, summary.json included. What counts is
therefore what the supervisor says itself, into a pipe that nobody else holds; and one that did not end by
itself says nothing.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from slamhive.local.programs.words import Words
from slamhive.monitor import end_orphans

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from slamhive.monitor import SupervisorSpec


class Supervised:
    """A program and its supervisor.

    Args:
        folder: where supervisor.json and process.json are.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._words: Words | None = None
        self._lock = threading.Lock()
        self._told: bytes | None = None
        self.asked_to_end = False

    @property
    def record(self) -> Path:
        """Path of the file in which the supervisor records which processes run."""
        return self._folder / "process.json"

    @property
    def started(self) -> bool:
        """True if a supervisor was started."""
        return self._process is not None

    @property
    def running(self) -> bool:
        """True if the supervisor is alive."""
        return self._process is not None and self._process.poll() is None

    def start(self, spec: SupervisorSpec, holding: Collection[int] = ()) -> None:
        """Start the supervisor, which starts the program.

        Args:
            spec: what it starts.
            holding: open files that it holds as long as it lives, and its program doesn't.

        Raises:
            OSError: it can't be started.
        """
        path = self._folder / "supervisor.json"
        path.write_text(spec.to_json())
        self._told, self.asked_to_end = None, False  # what was said and asked before was an earlier attempt's
        # Not a file: where the disk is full, that is what it has to say.
        self._words = Words()
        self._process = subprocess.Popen(
            # -P: a json.py in the user's working folder is none of ours.
            [sys.executable, "-P", "-m", "slamhive.monitor", "--spec", str(path)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._words.descriptor,
            start_new_session=True,
            pass_fds=tuple(holding),
        )

    def end(self) -> None:
        """Ask the supervisor to end the program; `wait` returns when it has."""
        self.asked_to_end = True
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)

    def wait(self) -> None:
        """Wait until the program and all its descendants are gone."""
        process = self._process
        if process is None:
            return
        with self._lock:
            if self._told is None:
                # Believed in place of summary.json: the algorithm can write every file of its user, but not
                # into this pipe.
                self._told = process.stdout.read() if process.stdout else b""
                if process.stdout:
                    process.stdout.close()
                if process.wait() != 0:  # nobody ended what the program left
                    with suppress(ValueError, OSError):  # spoilt by the program, the record names nobody
                        end_orphans(self.record)

    def summary(self) -> dict[str, Any] | None:
        """Return the supervisor's last word as it ended, None where it did not end by itself."""
        if self._process is None or self._process.returncode != 0:
            return None
        try:
            found = json.loads(self._told or b"")
        except ValueError:
            return None
        return found if isinstance(found, dict) else None

    def last_words(self, count: int = 1) -> str:
        """Return the last lines that the supervisor itself printed, in one line."""
        return self._words.last(count) if self._words else ""

    def fault(self) -> str | None:
        """Return the reason for a missing summary, None where nothing is to be said of it."""
        code = None if self._process is None else self._process.returncode
        if code is None or code >= 0:
            return self.last_words(3) or None
        return f"the supervisor was ended by signal {-code}"
