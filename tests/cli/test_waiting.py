# SPDX-License-Identifier: Apache-2.0
"""Tests of what commands that take long say meanwhile."""

from __future__ import annotations

import io
import threading

import pytest
from rich.console import Console

from slamhive.cli.parts.waiting import Work


class Watch:
    """A clock that is set by hand, and what is said by it."""

    def __init__(self, *, terminal: bool = False) -> None:
        self.now = 0.0
        self.written = io.StringIO()
        console = Console(file=self.written, force_terminal=terminal, width=100, highlight=False)
        # No beats but those that a test asks for.
        self.work = Work("making it", to=console, clock=lambda: self.now, wait=lambda _: True)

    def says(self, *moments: float) -> list[str]:
        """Let moments come, and return the lines that they bring."""
        before = len(self.written.getvalue())
        for moment in moments:
            self.now = moment
            self.work.beat()
        return self.written.getvalue()[before:].splitlines()


def test_what_is_done_at_once_says_nothing() -> None:
    for terminal in (False, True):
        watch = Watch(terminal=terminal)
        with watch.work:
            assert watch.says(0.1, 0.3) == []
        assert watch.written.getvalue() == ""


def test_without_a_terminal_there_is_a_line_every_few_seconds() -> None:
    watch = Watch()
    with watch.work:
        assert watch.says(*range(13)) == ["making it: 5 s", "making it: 10 s"]


def test_the_lines_of_hours_are_few() -> None:
    watch = Watch()
    with watch.work:
        lines = watch.says(*range(4 * 3600))
    assert lines[-1].endswith(" min")
    assert len(lines) < 100


def test_a_line_says_how_far_it_is_and_how_long_it_still_takes() -> None:
    watch = Watch()
    with watch.work:
        watch.work.share(0.25)
        assert watch.says(6) == ["making it: 25 %, 6 s, about 18 s left"]
        watch.work.at("another")
        watch.now = 7
        watch.work.count(3, 4, "2 MiB")
        assert watch.says(11) == ["another: 3 of 4, 2 MiB, 11 s, about 2 s left"]


def test_each_step_has_a_share_and_a_time_of_its_own() -> None:
    watch = Watch()
    with watch.work:
        watch.work.part("step 1 of 2, reading", 0.0)
        watch.now = 8
        watch.work.part("step 1 of 2, reading", 0.5)
        assert watch.says(8) == ["making it: step 1 of 2, reading, 50 %, 8 s, about 8 s of this step left"]
        watch.now = 20
        watch.work.part("step 2 of 2, looking", 0.0)
        assert watch.says(21) == ["making it: step 2 of 2, looking, 0 %, 21 s"]


def test_what_has_to_be_made_first_is_shown_while_it_is_made() -> None:
    watch, making = Watch(), {}
    watch.work.follow(making)
    with watch.work:
        watch.work.share(0.5)
        making["making its input"] = 0.1
        assert watch.says(5) == ["making its input: 10 %, 5 s"]
        watch.now = 9
        del making["making its input"]
        assert watch.says(10) == ["making it: 50 %, 10 s, about 5 s left"]


def test_what_came_before_the_first_of_many_foretells_nothing() -> None:
    watch = Watch()
    with watch.work:
        assert watch.says(60) == ["making it: 1 min 0 s"]
        watch.work.count(0, 6)
        watch.now = 70
        watch.work.count(1, 6)
        assert watch.says(70) == ["making it: 1 of 6, 1 min 10 s, about 50 s left"]


def test_on_a_terminal_there_is_a_bar_and_it_goes() -> None:
    watch = Watch(terminal=True)
    with watch.work:
        watch.work.share(0.5)
        watch.says(1)
        watch.now = 4
    drawn = watch.written.getvalue()
    assert "making it" in drawn
    assert "50 %, 4 s, about 4 s left" in drawn
    assert drawn.endswith("\x1b[2K")  # the line is empty again


def test_words_of_others_are_no_markup() -> None:
    watch = Watch()
    with watch.work:
        watch.work.at("fetching [bold]x")
        assert watch.says(5) == ["fetching [bold]x: 5 s"]


def test_beats_come_by_themselves_and_end_with_the_work() -> None:
    written, said = io.StringIO(), threading.Event()

    def clock() -> float:
        return 0.0 if not said.is_set() else 60.0

    work = Work(
        "making it", to=Console(file=written), clock=clock, wait=lambda _: said.wait(30) and over.wait(0.01)
    )
    over = threading.Event()
    with work:
        said.set()
        while "1 min" not in written.getvalue():
            over.wait(0.001)
        over.set()
    assert "making it: 1 min 0 s" in written.getvalue()


def test_a_reader_that_went_away_is_no_trouble() -> None:
    closed = io.StringIO()
    closed.close()
    beats = iter([False, False, True])
    with Work(
        "making it",
        to=Console(file=closed),
        clock=iter(range(0, 600, 10)).__next__,
        wait=lambda _: next(beats),
    ):
        pass


@pytest.mark.parametrize(("total", "text"), [(0, "making it: 5 s"), (None, "making it: 5 s")])
def test_nothing_of_nothing_is_no_share(total: int | None, text: str) -> None:
    watch = Watch()
    with watch.work:
        watch.work.count(0, total)
        assert watch.says(5) == [text]
