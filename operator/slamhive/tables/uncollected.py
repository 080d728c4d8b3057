# SPDX-License-Identifier: Apache-2.0
"""Memory while a large table is made: no search for garbage in what stays, and nothing kept of what goes."""

from __future__ import annotations

import ctypes
import gc
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def uncollected() -> Iterator[None]:
    """Let no collection begin: it would look at millions of values, none of which is garbage."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def return_memory() -> None:
    """Give the system back what was let go of: glibc keeps holes between small values, a third of a load."""
    with suppress(AttributeError, OSError):  # another library of C
        ctypes.CDLL(None).malloc_trim(0)
