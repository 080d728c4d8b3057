# SPDX-License-Identifier: Apache-2.0
"""Signs of life of commands that take long: a bar on a terminal, a line every few seconds elsewhere.

What is done within a moment shows nothing. ``slamhive run`` has a display of its own (`progress`).
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from slamhive.cli.parts import console

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rich.console import Console

BAR_AFTER_SECONDS = 0.5
LINE_AFTER_SECONDS = 5.0
_LINES_APART = 0.1
"""Share of the time passed after which another line comes: the log of an hour stays short."""
_BAR_WIDTH = 20
_FORETELLS = (0.05, 3.0)
"""Share done and seconds passed before which nothing is said of the time that is left."""


@dataclass
class _WorkStep:
    """Step of a piece of work whose progress is shown: its description, start and share done.

    Attributes:
        what: in words.
        since: when it began, later by the time in which something else was made for it.
        share: how much of it is done; None where it isn't known.
        note: what else is to be said of it.
        part: which part of it; empty where it has none.
    """

    what: str
    since: float
    share: float | None = None
    note: str = ""
    part: str = ""


class Work:
    """Shows what is being done and how far it is; a context manager.

    Args:
        what: what is being done, such as "generating hall".
        to: where it is shown; default: standard error.
        clock: monotonic time, s.
        wait: waits so many seconds and tells whether the work has ended meanwhile.
    """

    def __init__(
        self,
        what: str,
        *,
        to: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], bool] | None = None,
    ) -> None:
        self._console = console.err if to is None else to
        self._clock = clock
        self._began = self._said = clock()
        self._main = _WorkStep(what, self._began)
        self._made: _WorkStep | None = None
        self._making: Mapping[str, float] = {}
        self._ended = threading.Event()
        self._wait = self._ended.wait if wait is None else wait
        self._thread = threading.Thread(target=self._beats, name="signs of life", daemon=True)
        self._bar: Live | None = None

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        if self._bar is not None:
            self._bar.stop()

    def at(self, what: str) -> None:
        """Say what is being done from now on."""
        self._main = _WorkStep(what, self._clock())

    def share(self, share: float) -> None:
        """Say how much of it is done, 0 to 1."""
        self._main.share = share

    def part(self, what: str, share: float | None) -> None:
        """Say how much is done, 0 to 1 or None, of a part of the work: it begins where it is first named."""
        if self._main.part != what:
            self._main = _WorkStep(self._main.what, self._clock(), part=what)
        self._main.share = share

    def count(self, done: int, total: int | None, note: str = "", what: str | None = None) -> None:
        """Say how many of how many are done, and anything else in a few words."""
        step = self._main
        step.what = what or step.what
        if step.share is None and not done:  # what came before the first foretells nothing of the others
            step.since = self._clock()
        step.share = done / total if total else None
        counted = f"{done:,} of {total:,}" if total else ""
        step.note = ", ".join(filter(None, (counted, note)))

    def follow(self, making: Mapping[str, float]) -> None:
        """Show what is being made instead, by the share of it that is done, whenever something is."""
        self._making = making

    def beat(self) -> None:
        """Show the work if it has taken long enough by now to be worth it."""
        now = self._clock()
        if self._console.is_terminal:
            if self._bar is None and now - self._began >= BAR_AFTER_SECONDS:
                self._bar = Live(
                    console=self._console, get_renderable=self._rendered, refresh_per_second=4, transient=True
                )
                self._bar.start()
        elif now - self._said >= max(LINE_AFTER_SECONDS, _LINES_APART * (now - self._began)):
            self._said = now
            self._console.print(f"[dim]{escape(f'{self._step.what}: {self.told()}')}[/]", soft_wrap=True)

    def told(self) -> str:
        """Return the progress in words: step, share, time so far, and about the time it still takes."""
        now, step = self._clock(), self._step
        share, taken = step.share, now - step.since
        parts = [step.part, step.note]
        if share is not None and not step.note:
            parts.append(f"{100 * min(share, 1.0):.0f} %")
        parts.append(time_text(now - self._began))
        least, seconds = _FORETELLS
        if share is not None and least <= share < 1 and taken >= seconds:
            left = taken * (1 - share) / share
            of_it = " of this step" if step.part else ""
            parts.append(f"about {f'{left / 60:.0f} min' if left >= 90 else time_text(left)}{of_it} left")
        return ", ".join(filter(None, parts))

    @property
    def _step(self) -> _WorkStep:
        for what, share in list(self._making.items())[:1]:
            if self._made is None or what != self._made.what:
                self._end_making()
                self._made = _WorkStep(what, self._clock())
            self._made.share = share
            return self._made
        self._end_making()
        return self._main

    def _end_making(self) -> None:
        """Take the time in which something else was made out of that of the work itself."""
        if self._made is not None:
            self._main.since += self._clock() - max(self._made.since, self._main.since)
            self._made = None

    def _beats(self) -> None:
        pause = BAR_AFTER_SECONDS if self._console.is_terminal else LINE_AFTER_SECONDS / 5
        while self._bar is None and not self._wait(pause):  # a bar draws itself anew
            with suppress(OSError, ValueError):  # whoever read the lines may be gone
                self.beat()

    def _rendered(self) -> Table:
        step, told = self._step, self.told()
        bar = ProgressBar(1.0, min(step.share or 0.0, 1.0), width=_BAR_WIDTH, pulse=step.share is None)
        what = Text(step.what)
        what.truncate(max(_BAR_WIDTH, self._console.width - _BAR_WIDTH - len(told) - 2), overflow="ellipsis")
        row = Table.grid(padding=(0, 1))
        row.add_row(what, bar, Text(told))
        return row


def time_text(seconds: float) -> str:
    """Return a duration as people say it.

    >>> time_text(9.6), time_text(83), time_text(7384)
    ('10 s', '1 min 23 s', '2 h 3 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
