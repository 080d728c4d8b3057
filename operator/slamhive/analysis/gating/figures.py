# SPDX-License-Identifier: Apache-2.0
"""Figures that a gate looks at, and by how much each may get worse before that counts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from slamhive.analysis.grouping import LOAD
from slamhive.analysis.measures import UNDISTURBED, Better, figures, measure_of
from slamhive.model.errors import InputError
from slamhive_eval.errors import did_you_mean

FAILURES = "failures"
"""Name of the figure of runs that failed or weren't tracked."""

COVERAGE = "coverage"
LATENCY = "metrics.latencySeconds.median"
TIME = UNDISTURBED
MEMORY = "usage.memory.peakBytes"


class MarginScale(StrEnum):
    """Scale on which a figure's margin is meant: a share of what it was, or a difference of shares."""

    RATIO = "ratio"
    DIFFERENCE = "difference"
    COUNT = "count"


@dataclass(frozen=True)
class GateFigure:
    """A figure under test.

    Attributes:
        name: a column, or FAILURES.
        margin: by how much it may be worse, as a share: 0.1 is a tenth of what it was, or 10 points of a
            figure that is a share itself.
    """

    name: str
    margin: float

    @property
    def scale(self) -> MarginScale:
        """Scale of the margin."""
        if self.name == FAILURES:
            return MarginScale.COUNT
        return MarginScale.DIFFERENCE if self.name == COVERAGE else MarginScale.RATIO

    @property
    def is_load(self) -> bool:
        """Tell whether it depends on the processor."""
        return self.name.startswith((LOAD, "metrics."))

    @property
    def follows_hours(self) -> bool:
        """Tell whether it depends on what else a machine does at the time: all load but memory."""
        return self.is_load and not self.name.startswith(f"{LOAD}memory.")

    @property
    def title(self) -> str:
        """Name for people."""
        if self.name == FAILURES:
            return "runs not tracked"
        measure = measure_of(self.name)
        return measure.text or self.name

    @property
    def sign(self) -> float:
        """Factor that makes worse of larger."""
        return 1.0 if self.name == FAILURES else measure_of(self.name).sign

    @property
    def bound(self) -> float:
        """Margin on the scale of tests: the logarithm of a ratio, or a difference."""
        return math.log1p(self.margin) if self.scale is MarginScale.RATIO else self.margin

    def change(self, shift: float) -> float:
        """Return a shift on the scale of tests as the change of the figure itself, a share."""
        shift *= self.sign
        if self.scale is not MarginScale.RATIO:
            return shift
        return math.expm1(shift) if shift < 700 else math.inf


MARGINS = {
    "ate.rmse": 0.10,
    "rpe[0].rmse": 0.10,
    COVERAGE: 0.10,
    FAILURES: 0.30,
    "usage.cpu.secondsPerDataSecond": 0.10,
    MEMORY: 0.30,
    LATENCY: 0.15,
    TIME: 0.50,
}
"""Figures that are looked at unless told, with their margins; docs/gate.md says how they were found."""

USUAL_MARGIN = 0.10
"""Margin of a figure that is asked for by name and isn't among those."""

_WORDS = {
    "ate": "ate.rmse",
    "rpe": "rpe[0].rmse",
    "cpu": "usage.cpu.secondsPerDataSecond",
    "memory": MEMORY,
    "latency": LATENCY,
    "time": TIME,
}
"""Short names of figures on the command line."""


def parse_figure(text: str, option: str) -> tuple[str, float | None]:
    """Return the column that ``NAME`` or ``NAME=MARGIN`` names, and the margin as a share; None without one.

    >>> parse_figure("cpu=15%", "--figure")
    ('usage.cpu.secondsPerDataSecond', 0.15)

    Raises:
        InputError: nothing says which way the figure is good, or the margin is no share within 0 and 10.
    """
    name, has_margin, margin = (part.strip() for part in text.partition("="))
    name = _WORDS.get(name, name)
    if name != FAILURES and measure_of(name).better is Better.NONE:
        short = [*_WORDS, COVERAGE, FAILURES]
        close = did_you_mean(name, [*short, *figures(1)])
        raise InputError(
            f"{option} {text}: nobody has said which way {name!r} is good{close}; short names are "
            f"{', '.join(short)}"
        )
    if not has_margin:
        return name, None
    try:
        share = float(margin.removesuffix("%")) / (100 if margin.endswith("%") else 1)
    except ValueError:
        share = math.nan
    if not 0 < share <= 10 or (share > 1 and name in {COVERAGE, FAILURES}):
        most = "100%" if name in {COVERAGE, FAILURES} else "1000%"
        raise InputError(f"{option} {text}: the margin is a share above 0 and up to {most}, as in 10%")
    return name, share
