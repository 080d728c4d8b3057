# SPDX-License-Identifier: Apache-2.0
"""Statistics of errors: whatever a result says of an error, it says by these names."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray


@dataclass(frozen=True)
class Statistics:
    """Statistics of errors e ≥ 0 under evo's names, in the errors' unit.

    Attributes:
        rmse: √(Σe²/n).
        mean: Mean.
        median: Median.
        std: Standard deviation, divided by n.
        min: Smallest.
        max: Largest.
        sse: Σe², in the unit squared.
    """

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    sse: float

    @classmethod
    def of(cls, errors: FloatArray) -> Statistics | None:
        """Statistics of errors, shape (n,); None for n = 0."""
        import numpy as np  # noqa: PLC0415 - whoever asks for the names alone needs none

        if not errors.size:
            return None
        sse = float(np.sum(errors * errors))
        return cls(
            rmse=float(np.sqrt(sse / errors.size)),
            mean=float(np.mean(errors)),
            median=_median(errors),
            std=float(np.std(errors)),
            min=float(np.min(errors)),
            max=float(np.max(errors)),
            sse=sse,
        )

    def as_dict(self) -> dict[str, float | None]:
        """The seven numbers by name; one that isn't finite becomes None, for JSON knows no infinity."""
        return {name: value if math.isfinite(value) else None for name, value in asdict(self).items()}


STATISTICS = Statistics.__match_args__
"""Names of the statistics."""

IN_UNIT = tuple(name for name in STATISTICS if name != "sse")
"""Those in the errors' own unit, which tables compare."""


def _median(errors: FloatArray) -> float:
    """Return np.median, without its import of numpy.ma: a tenth of what a small evaluation takes."""
    import numpy as np  # noqa: PLC0415

    upper = errors.size // 2
    lower = upper - 1 + errors.size % 2
    middle = np.partition(errors, (lower, upper))
    return float(np.mean(middle[lower : upper + 1]))
