# SPDX-License-Identifier: Apache-2.0
"""Cells of a gate: a setting on a dataset, with the figures of its repetitions before and now."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.columns import Floats

_LEAST = 1e-9
"""Number below which a ratio is one of rounding: a billionth of a metre, a degree, a core."""


@dataclass(frozen=True)
class GateRuns:
    """Repetitions of one setting on one dataset.

    Attributes:
        tracked: whether each was.
        values: of each column a number a repetition; NaN where there is none, as of runs not tracked.
    """

    tracked: Sequence[bool] = ()
    values: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of repetitions."""
        return len(self.tracked)

    @property
    def failed(self) -> int:
        """Number of those that weren't tracked."""
        return self.count - sum(self.tracked)

    def numbers(self, name: str, *, logarithms: bool) -> Floats:
        """Return the numbers of a column that runs have, or their logarithms, (n,)."""
        found = np.asarray(
            [value for value in self.values.get(name, ()) if math.isfinite(value)], dtype=np.float64
        )
        if not logarithms:
            return found
        return np.log(np.maximum(found, _LEAST))


@dataclass(frozen=True)
class GateCell:
    """A setting on a dataset, before and now.

    Attributes:
        name: words that tell it from the others.
        before: recorded.
        now: those of this gate so far.
    """

    name: str
    before: GateRuns
    now: GateRuns
