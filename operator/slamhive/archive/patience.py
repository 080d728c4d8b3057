# SPDX-License-Identifier: Apache-2.0
"""Patience with a database that is away: what it is asked is asked again until it is back.

A server is restarted within seconds, and a night's runs must not end by that. What a transaction had begun is
begun anew: each method of an archive is one, and writes the same however often it is called.
"""

from __future__ import annotations

import threading
import time
from functools import wraps
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, Protocol, TypeVar

from slamhive.archive.connection import DatabaseAway

if TYPE_CHECKING:
    from collections.abc import Callable

MOST_SECONDS = 600.0
"""Time for which a database is waited for."""
PAUSE_SECONDS = 1.0

Given = ParamSpec("Given")
Answer = TypeVar("Answer")


class Patience:
    """Wait for a database, as long as it is worth it.

    Args:
        tell: told in a sentence that it is waited for, and that it is back.
        gives_up: tells that nobody waits any more.
        clock: monotonic time, s.
    """

    def __init__(
        self,
        tell: Callable[[str], None],
        gives_up: Callable[[], bool] = lambda: False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tell = tell
        self._gives_up = gives_up
        self._clock = clock
        self._since: float | None = None
        self._lock = threading.Lock()

    def wait(self, error: DatabaseAway) -> None:
        """Wait a moment before another try.

        Raises:
            DatabaseAway: it has been away for too long, or nobody waits.
        """
        with self._lock:
            first = self._since is None
            since = self._since = self._clock() if self._since is None else self._since
        if self._gives_up():
            raise error
        if self._clock() - since >= MOST_SECONDS:
            raise DatabaseAway(
                f"{error}; it was waited for {MOST_SECONDS / 60:.0f} minutes. What has run is in the runs' "
                "folders: the same command goes on from there"
            ) from error
        if first:
            self._tell(
                f"{error}: it is waited for, {MOST_SECONDS / 60:.0f} minutes at most; runs go on meanwhile"
            )
        time.sleep(PAUSE_SECONDS)

    def met(self) -> None:
        """Note that the database answers."""
        if self._since is not None:
            with self._lock:
                was, self._since = self._since, None
            if was is not None:
                self._tell("the archive answers again")


class HasPatience(Protocol):
    """An archive, whoever waits for it."""

    patience: Patience | None


def patient(method: Callable[Concatenate[Any, Given], Answer]) -> Callable[Concatenate[Any, Given], Answer]:
    """Have a method of an archive tried again while its patience lasts."""

    @wraps(method)
    def call(archive: HasPatience, /, *given: Given.args, **options: Given.kwargs) -> Answer:
        while True:
            try:
                found = method(archive, *given, **options)
            except DatabaseAway as error:
                if archive.patience is None:
                    raise
                archive.patience.wait(error)
            else:
                if archive.patience is not None:
                    archive.patience.met()
                return found

    return call
