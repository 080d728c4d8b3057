# SPDX-License-Identifier: Apache-2.0
"""Lines of the table broken on purpose, one at a time: a checker that notices none of them checks nothing."""

from __future__ import annotations

import inspect
import textwrap
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.analysis import derived, grouping, selection, statistics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@dataclass(frozen=True)
class Break:
    """A mistake.

    Attributes:
        what: what it does, in words.
        function: where the line is.
        line: the line, or the part of it that is replaced.
        wrong: what stands there instead.
    """

    what: str
    function: Callable[..., Any]
    line: str
    wrong: str


BREAKS = (
    Break(
        "what the machine ended covers nothing",
        grouping.covered,
        "np.isnan(coverage) & failing(frame, Outcomes.ALL)",
        "np.isnan(coverage)",
    ),
    Break(
        "the standard deviation of all there is, not of a sample",
        statistics.Numbers.summaries,
        "/ (self.counts[several] - 1)",
        "/ self.counts[several]",
    ),
    Break(
        "of equal content the earliest stays",
        selection.preference,
        '-frame.column("id").floats()',
        'frame.column("id").floats()',
    ),
    Break(
        "the run stored last is the latest, whenever it was made",
        derived._latest_last,
        "np.isnan(created)",
        "np.isfinite(created)",
    ),
    Break(
        "equal results of a deterministic program count each time",
        grouping.Copies.among,
        "np.bincount(tracks)[tracks] > 1",
        "np.bincount(tracks)[tracks] > 1_000",
    ),
    Break(
        "disturbed runs are in the figures of load",
        grouping.sound,
        "> 0)",
        "> 1)",
    ),
)


@contextmanager
def broken(one: Break) -> Iterator[None]:
    """Have a line broken for a while, for all that call its function."""
    source = textwrap.dedent(inspect.getsource(one.function))
    if source.count(one.line) != 1:
        raise LookupError(f"{one.function.__name__} has {source.count(one.line)} of {one.line!r}, not one")
    found: dict[str, Any] = {}
    text = "from __future__ import annotations\n" + source.replace(one.line, one.wrong)
    exec(compile(text, one.what, "exec"), dict(one.function.__globals__), found)  # noqa: S102
    right = one.function.__code__
    one.function.__code__ = found[one.function.__name__].__code__
    try:
        yield
    finally:
        one.function.__code__ = right
