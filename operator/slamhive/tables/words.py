# SPDX-License-Identifier: Apache-2.0
"""Words beneath a table: what its columns mean there, and which of its errors are out of proportion."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import shows_cpu, where_equal
from slamhive.analysis.measures import CAUSAL, measure_of
from slamhive.analysis.metrics import named_final
from slamhive.model.results import Outcome
from slamhive_eval.evaluation import MAX_ATE_SHARE, MAX_LOCAL_SHARE

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Aggregate
    from slamhive.model.results import Result

MOST_A_METRE = MAX_LOCAL_SHARE
"""RPE a metre up to which nothing is said: a quarter of what an estimate has that stands still, 1 m."""

MOST_OF_PATH = MAX_ATE_SHARE / 2
"""Share of the path that an ATE may have before it is remarked: half of what is called diverged."""

_ALIGNED = {
    "se3": "SE(3) alignment",
    "sim3": "Sim(3) alignment",
    "yaw": "alignment of position and yaw",
    "origin": "alignment of the first pose",
    "none": "none",
}
_READER = {True: ", with the reader", False: ", without the reader"}
_RPE = re.compile(r"rpe\[\d+\]")


def meanings(frame: Frame, columns: Iterable[str]) -> list[str]:
    """Return the line beneath a table that says what its columns mean there; none where there is no need.

    Args:
        frame: the rows that the table is of.
        columns: what it shows.
    """
    told = {}
    shown = list(columns)
    for name in shown:
        measure = measure_of(name)
        if measure.meaning:
            title = measure.text if measure.short in told else measure.short
            parts = _MeaningParts(frame, name.removeprefix(CAUSAL))
            told[named_final(name, title, shown)] = measure.meaning.format_map(parts)
    return ["; ".join(f"{short}: {text}" for short, text in told.items())] if told else []


def spread_notes(found: Aggregate) -> list[str]:
    """Say what is before and behind the sign ± of a table, where one stands."""
    spread = any((one.summaries.n > 1).any() for one in found.cells.columns.figures.values())
    return ["a ± b: mean and standard deviation (n − 1) of several runs"] if spread else []


class _MeaningParts(dict[str, str]):
    """The parts of a meaning that follow from the rows, found as they are asked for."""

    def __init__(self, frame: Frame, column: str) -> None:
        super().__init__()
        self._frame = frame
        self._column = column

    def __missing__(self, part: str) -> str:
        if part == "aligned":
            kinds = [words for value, words in _ALIGNED.items() if value in self._values("alignment")]
            if kinds == ["none"]:
                return " without alignment"
            return f" after {' or '.join(kinds)}" if kinds else ""
        if part == "reader":
            shown = self._frame.select(shows_cpu(self._frame))
            found = shown.column("usage.includesReader").unique()  # None: it isn't known
            return _READER.get(found[0], "") if len(found) == 1 else ""
        stem = match[0] if (match := _RPE.match(self._column)) else ""
        over = [self._values(f"{stem}.{name}") for name in ("delta", "unit", "pairs")]
        if any(len(values) != 1 for values in over[:2]):
            return ""
        (delta,), (unit,), pairs = over
        text = f" over {delta:g} {unit}" + (" of path" if unit == "m" else "")
        return f"{text}, {pairs[0]} pairs" if len(pairs) == 1 else text

    def _values(self, name: str) -> list[Any]:
        return [value for value in self._frame.column(name).unique() if value is not None]


def disproportion(result: Result) -> str | None:
    """Return the warning that a tracked run's error is out of proportion to its way; None for none."""
    if result.outcome is not Outcome.TRACKED:
        return None
    values = result.values
    ate, rpe = values.get("ate"), values.get("rpe")
    first = rpe[0] if isinstance(rpe, list) and rpe else None
    told = _told(
        _number(ate, "rmse"),
        _number(values, "pathLength"),
        _number(first, "rmse") if isinstance(first, dict) and first.get("unit") == "m" else np.nan,
        _number(first, "delta"),
    )
    return f"out of proportion for a tracked run: {told}" if told else None


def disproportion_notes(frame: Frame) -> list[str]:
    """Say how many tracked runs of a table have an error out of proportion, and which is the worst."""
    ate, path = frame.column("ate.rmse").floats(), frame.column("pathLength").floats()
    rpe, delta = frame.column("rpe[0].rmse").floats(), frame.column("rpe[0].delta").floats()
    rpe = np.where(where_equal(frame, "rpe[0].unit", "m"), rpe, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        beyond = np.fmax(rpe / delta / MOST_A_METRE, ate / path / MOST_OF_PATH)
    beyond[~(where_equal(frame, "status", Outcome.TRACKED.value) & (beyond > 1))] = 0.0
    if not beyond.any():
        return []
    worst = int(np.argmax(beyond))
    told = _told(float(ate[worst]), float(path[worst]), float(rpe[worst]), float(delta[worst]))
    (names,) = frame.select(np.array([worst])).records(("algorithm", "dataset"))
    count = frame.count_runs(beyond > 0)
    runs = "1 tracked run has an error" if count == 1 else f"{count:,} tracked runs have errors"
    return [f"{runs} out of proportion; the worst, {names['algorithm']} on {names['dataset']}: {told}"]


def _told(ate: float, path: float, rpe: float, delta: float) -> str:
    """Return the errors that are out of proportion, with the limits of both."""
    parts: list[str] = []
    if rpe > MOST_A_METRE * delta > 0:
        parts.append(f"RPE {rpe / delta:.2g} m a metre (above {MOST_A_METRE:g}; standing still has 1)")
        # Two positions that are off by their ATE each are off by twice as much from each other at most.
        if rpe > 2 * ate:
            parts[0] += (
                ", more than positions of this ATE can make: orientations are off, or of another frame"
            )
    if ate > MOST_OF_PATH * path > 0:
        limits = f"above {100 * MOST_OF_PATH:g} %; above {100 * MAX_ATE_SHARE:g} % is Diverged"
        parts.append(f"ATE {ate:.3g} m on {path:.3g} m of path ({limits})")
    return "; ".join(parts)


def _number(values: Any, name: str) -> float:
    """Return a number of a result, NaN where there is none: an evaluator of one's own may write anything."""
    found = values.get(name) if isinstance(values, dict) else None
    return float(found) if isinstance(found, int | float) and not isinstance(found, bool) else np.nan
