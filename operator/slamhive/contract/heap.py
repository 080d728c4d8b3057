# SPDX-License-Identifier: Apache-2.0
"""Heap of this process: what the C library keeps of memory that was let go of, and what it gives back.

Said by those who run for long (operator, dashboard) and by those who compute with large arrays for them.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of malloc.h


def keep_memory(kept_bytes: int, large_bytes: int) -> None:
    """Say what is kept for the next values; a C library other than glibc does as it likes.

    Without that, glibc puts ever larger values among the small ones, whose holes then stay.

    Args:
        kept_bytes: memory at the end of the heap, beyond which it is given back.
        large_bytes: size of values from which on each is given back at once.
    """
    with suppress(AttributeError, OSError):
        library = ctypes.CDLL(None)
        library.mallopt(_TRIM_THRESHOLD, kept_bytes)
        library.mallopt(_MMAP_THRESHOLD, large_bytes)


def return_memory() -> None:
    """Give the system back what was let go of: glibc keeps holes between small values, a third of a load."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
