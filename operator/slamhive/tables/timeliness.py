# SPDX-License-Identifier: Apache-2.0
"""Timeliness of runs that were played to: what was known at the time, when poses came, who kept up.

A node publishes a pose for a frame and may publish a better one later. The first ones are the *causal*
trajectory: what a robot had when it needed it. The last ones are the *final* trajectory, the run's own. Where
a player noted all poses and none was published otherwise later, both are the same, and so are their figures.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.derived import LATENCY, PACE, PUBLISHED, late_seconds
from slamhive.analysis.grouping import aggregate, late_words, where_equal
from slamhive.analysis.measures import CAUSAL, KEPT_BESIDE, follows_trajectory
from slamhive.model.algorithm import Pace

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Mask
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Aggregate, Outcomes
    from slamhive.model.results import Result, RunRecord

LATENCIES = tuple(f"{LATENCY}{name}" for name in ("median", "p95", "p99", "max"))
"""Columns of the time from a frame to the first pose for it."""
FACTOR = "metrics.realTimeFactor"
"""Column of the time that a node took over the time it had; clearly above 1 it was behind."""
DROPPED = "frames.dropped"
"""Column of the frames that were dropped for want of time."""

WORDS = (
    "Of nodes that a player played to, medians of the runs that count. Causal: each pose as it was first "
    "published, when a robot needed it; final: the last pose of each stamp, as later frames and loops "
    "corrected it. Latency: from a frame to its first pose. Real-time factor: the time a node took over the "
    "time it had; clearly above 1 it was behind."
)
"""Words above a table of them."""

_BESIDE, _ONLINE, _ = CAUSAL.split(".")


def by_clock(frame: Frame) -> Mask:
    """Tell which rows are of runs whose pace the clock alone set, (n,).

    Their mean cores and wall time are those of a robot. In Stepped the clock stands while a frame is worked
    on, in Lockstep there is none.
    """
    return where_equal(frame, PACE, Pace.REALTIME.value)


def any_dropped(frame: Frame) -> bool:
    """Tell whether frames were dropped for want of time in any of some runs."""
    return bool(np.nansum(frame.column(DROPPED).floats()))


def causal_of(name: str) -> str:
    """Return the column of an error of the causal trajectory, by that of the final one; else its own name."""
    return f"{CAUSAL}{name}" if follows_trajectory(name) else name


def causal_result(record: RunRecord, result: Result) -> Result:
    """Return a result with the figures of the causal trajectory, where a player heard it and it is the final.

    For one run what `with_derived` of `analysis.derived` does for a table.
    """
    published = record.metrics.get(PUBLISHED.removeprefix("metrics."))
    beside = result.values.get(_BESIDE)
    known = beside if isinstance(beside, dict) else {}
    is_heard = isinstance(published, int | float) and published > 0
    if not (is_heard and _pace_of(record).is_played) or _ONLINE in known:
        return result
    figures = {name: value for name, value in result.values.items() if name in KEPT_BESIDE}
    causal = {"outcome": result.outcome.value, "coverage": result.coverage, **figures}
    return result.replace(values=result.values | {_BESIDE: {**known, _ONLINE: causal}})


def late_note(record: RunRecord) -> str | None:
    """Return the remark on a run's memory where its poses came late, None where they came in time."""
    latencies = record.metrics.get("latencySeconds")
    latest = latencies.get("max") if isinstance(latencies, dict) else None
    if not isinstance(latest, int | float) or _pace_of(record) is Pace.STEPPED:
        return None
    prepared, rate = record.provenance.prepared, (record.spec.get("input") or {}).get("rate")
    given = (latest, prepared and prepared.frame_rate, rate)
    late = late_seconds(*(np.array([np.nan if value is None else value], dtype=float) for value in given))
    return None if np.isnan(late[0]) else late_words(float(late[0]))


def _pace_of(record: RunRecord) -> Pace:
    """Return the pace of a run, that of who reads by itself where its spec says none that is known."""
    told = (record.spec.get("input") or {}).get("pace")
    return next((pace for pace in Pace if pace.value == told), Pace.LOCKSTEP)


def timely_metrics(frame: Frame, metric: str) -> list[str]:
    """Return the columns that say how a figure fared in time: final, causal, latencies, real-time factor.

    Nothing where no run has any of the latter.
    """
    others = [name for name in (causal_of(metric), *LATENCIES, FACTOR) if name != metric]
    held = [name for name in others if not frame.column(name).is_empty]
    return [metric, *held] if held else []


def timeliness(frame: Frame, metric: str, by: Sequence[str], outcomes: Outcomes) -> Aggregate | None:
    """Return figures of what was known when, by competitor and dataset; None where nobody noted it.

    Args:
        frame: the rows.
        metric: what competitors are ranked by.
        by: columns that tell competitors apart.
        outcomes: which runs enter the figures.
    """
    metrics = timely_metrics(frame, metric)
    if not metrics:
        return None
    noted = np.logical_or.reduce([frame.column(name).present for name in metrics[1:]])
    chosen = frame.select(noted)
    return aggregate(chosen, metrics, list(dict.fromkeys([*by, "dataset"])), outcomes)
