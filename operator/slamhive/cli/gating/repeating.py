# SPDX-License-Identifier: Apache-2.0
"""Time at which a gate began that does finished runs again, kept until it ends.

Who interrupts it and gives the same command goes on: runs that began since then are not done a third time.
"""

from __future__ import annotations

from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from slamhive.model.canonical import digest
from slamhive.model.errors import InputError
from slamhive.monitor.programs.orphans import write_atomically

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from slamhive.local.home.folder import Home

FOLDER = "gates"


@contextmanager
def begun(home: Home, command: Sequence[str]) -> Iterator[tuple[datetime, Callable[[], None]]]:
    """Yield the time at which a gate began, and a function that keeps it: else it goes when this ends.

    Args:
        home: the home.
        command: what tells this gate from others.

    Raises:
        InputError: it can't be noted.
    """
    path = home.folder(FOLDER) / digest(list(command))[:16]
    kept = False

    def keep() -> None:
        nonlocal kept
        kept = True

    try:
        time = datetime.fromisoformat(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        time = datetime.now(UTC)
        try:
            write_atomically(str(path), time.isoformat())
        except OSError as error:
            raise InputError(f"SLAMHIVE_HOME: {path}: {error.strerror}") from None
    try:
        yield time, keep
    except KeyboardInterrupt:
        keep()
        raise
    finally:
        if not kept:
            path.unlink(missing_ok=True)
