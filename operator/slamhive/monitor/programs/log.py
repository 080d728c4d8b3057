# SPDX-License-Identifier: Apache-2.0
"""The log of an algorithm: what it prints, bounded, so that no program fills the disk by printing."""

from __future__ import annotations

import os
import re
from collections import deque

TAIL_LINES = 20
TAIL_BYTES = 4096
_ESCAPE = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)?|.)")
# Control characters, and those that turn the direction of text around or break lines unseen.
_CONTROL = dict.fromkeys(
    [*range(9), *range(10, 32), *range(127, 160), *range(0x2028, 0x202F), *range(0x2066, 0x206A)]
)


class BoundedLog:
    """Keeps the beginning and the end of a stream in a file, each up to half the limit."""

    def __init__(self, path: str, limit: int) -> None:
        """Begin a log.

        Args:
            path: The file, overwritten.
            limit: Bytes to keep.

        Raises:
            OSError: The file can't be written.
        """
        self.error: OSError | None = None
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        self._half = limit // 2
        self._written = 0
        self._end: deque[bytes] = deque()
        self._end_bytes = 0
        self._dropped = 0
        self._recent = b""

    def write(self, data: bytes) -> None:
        """Take what was printed."""
        self._recent = (self._recent + data)[-4 * TAIL_BYTES :]
        head = data[: self._half - self._written]
        if head:
            self._put(head)
            self._written += len(head)
            data = data[len(head) :]
        if data:
            self._end.append(data)
            self._end_bytes += len(data)
        while self._end and self._end_bytes - len(self._end[0]) >= self._half:
            dropped = len(self._end.popleft())
            self._end_bytes -= dropped
            self._dropped += dropped

    def tail(self) -> str:
        """Return the last lines for a message: at most 20 and 4 KiB, without control characters."""
        return clean_tail(self._recent)

    def close(self) -> None:
        """Write the end behind the beginning."""
        end = b"".join(self._end)
        surplus = max(len(end) - self._half, 0)
        if self._dropped or surplus:
            left_out = self._dropped + surplus
            self._put(f"\n[... {left_out} bytes left out ...]\n".encode())
        self._put(end[surplus:])
        os.close(self._file)

    def _put(self, data: bytes) -> None:
        try:
            while data and self.error is None:
                data = data[os.write(self._file, data) :]
        except OSError as error:  # a full disk must not end the supervision
            self.error = error


def clean_tail(data: bytes) -> str:
    """Return the last lines of what a program printed, fit to be shown anywhere.

    Terminal sequences and control characters go; of a line that was overwritten by carriage returns, as
    progress bars do, the last state stays.
    """
    text = _ESCAPE.sub("", data.decode("utf-8", "replace"))
    lines = [line.rstrip("\r").rpartition("\r")[2].translate(_CONTROL).rstrip() for line in text.split("\n")]
    kept = "\n".join([line for line in lines if line][-TAIL_LINES:])
    return kept.encode()[-TAIL_BYTES:].decode("utf-8", "ignore")
