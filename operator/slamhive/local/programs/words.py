# SPDX-License-Identifier: Apache-2.0
"""Memory file for a child's standard error: on a full disk its message would be lost in a file."""

from __future__ import annotations

import os
import weakref

_LIMIT = 64 << 10


class Words:
    """Standard error of a child process, kept in a file in memory."""

    def __init__(self) -> None:
        self.descriptor = os.memfd_create("words", os.MFD_CLOEXEC)
        """For the child to write to."""
        weakref.finalize(self, os.close, self.descriptor)

    def last(self, count: int = 1) -> str:
        """Return its last lines that say something, in one line; empty where it said nothing."""
        lines = [line.strip() for line in self.text().splitlines() if line.strip()]
        return " ".join(lines[-count:])

    def text(self) -> str:
        """Return all of it; of much the end."""
        size = os.fstat(self.descriptor).st_size
        return os.pread(self.descriptor, _LIMIT, max(0, size - _LIMIT)).decode("utf-8", "replace")
