# SPDX-License-Identifier: Apache-2.0
"""Memory after many rows were read: nothing is kept of what goes."""

from __future__ import annotations

import ctypes
from contextlib import suppress


def return_memory() -> None:
    """Give the system back what was let go of: glibc keeps holes between small values, a third of a load."""
    with suppress(AttributeError, OSError):  # another library of C
        ctypes.CDLL(None).malloc_trim(0)
