# SPDX-License-Identifier: Apache-2.0
"""Does a system know that it is lost? Its own confidence over time, held against its losses.

What it says holds until it says something else, a second at most. ``degraded`` and ``lost`` are warnings.

- *Lead*: how long before a loss the warning began that was still given when it came, breaks of a second
  allowed; less than 0 where it came so long after. A loss that passed without one is missed.
- *False*: the share of the time warned in which the estimate was not lost, nor about to be within
  ``horizon`` seconds.
- *Missed*: the share of the time lost in which it didn't warn.
- *AUC*: the probability that a value given while the estimate was off is smaller than one given while it
  wasn't, ties counted half (Hanley and McNeil 1982; the Mann-Whitney statistic): 0.5 is a guess, 1 perfect.

What can't be judged counts in none of them, and a figure of nothing is absent, never 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.association import nearest
from slamhive_eval.errors import OptionError, TrajectoryError
from slamhive_eval.formats.healthfiles import FLAGS, SAYS_NOTHING
from slamhive_eval.measures.consistency import Part, measure_consistency
from slamhive_eval.measures.losses import LocalErrors, LossRule, local_errors, stretches
from slamhive_eval.preparing import lay, set_clock

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from slamhive_eval.formats.healthfiles import Confidence
    from slamhive_eval.preparing import Preparation, Prepared
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

    Mask = npt.NDArray[np.bool_]

HOLD_SECONDS = 1.0
"""Age at which a row of confidence holds no more."""
MOST_TOLD = 100
"""Losses, and warnings, that are told one by one."""
SAME_STAMP_SECONDS = 1e-3
"""A covariance belongs to the pose whose stamp differs by at most this."""


@dataclass(frozen=True)
class HealthRule:
    """Rule by which confidence is judged.

    Attributes:
        loss: When an estimate is lost.
        horizon: Seconds before a loss in which a warning of it is true.
    """

    loss: LossRule = field(default_factory=LossRule)
    horizon: float = 10.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.horizon) and self.horizon >= 0):
            raise OptionError(f"the horizon must be a number of seconds from 0 on, not {self.horizon}")


@dataclass(frozen=True)
class ToldLoss:
    """A loss, and the warning of it.

    Attributes:
        begin, end: In s.
        lead: Seconds from the warning to its begin; None where there was none.
    """

    begin: float
    end: float
    lead: float | None

    def as_dict(self) -> dict[str, float | None]:
        """Plain JSON data."""
        return {"begin": self.begin, "end": self.end, "lead": self.lead}


@dataclass(frozen=True, eq=False)
class Awareness:
    """Worth of a system's confidence: leads, false and missed warnings, AUC.

    Attributes:
        rows: Number of rows that it said.
        seconds: Time that can be judged.
        lost: Of it the time lost.
        losses: Each of them.
        warnings: Begin and end of each stretch of warnings in s, shape (w, 2).
        warned: Time warned; None where it gave no flag at all.
        cried: Of that the time in which it was wrong to.
        unwarned: Of the time lost that without a warning.
        auc: Of its values; None where it gave none, or was never off, or always.
        values: How many values that is of.
    """

    rows: int
    seconds: float
    lost: float
    losses: tuple[ToldLoss, ...]
    warnings: FloatArray
    warned: float | None = None
    cried: float | None = None
    unwarned: float | None = None
    auc: float | None = None
    values: int = 0

    @property
    def leads(self) -> list[float]:
        """Lead of each loss that it warned of, in s."""
        return [one.lead for one in self.losses if one.lead is not None]

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data; None for figures of nothing."""
        leads = self.leads
        told: dict[str, Any] = {
            "rows": self.rows,
            "seconds": self.seconds,
            "lostSeconds": self.lost,
            "losses": len(self.losses),
        }
        if self.warned is not None:
            told["warning"] = {
                "seconds": self.warned,
                "losses": len(leads),
                "lead": sum(leads) / len(leads) if leads else None,
                "leadMin": min(leads) if leads else None,
            }
            told["false"] = {"share": _share(self.cried, self.warned)}
            told["missed"] = {
                "share": _share(self.unwarned, self.lost),
                "losses": len(self.losses) - len(leads),
            }
        return {**told, "auc": self.auc, "values": self.values}


def _share(part: float | None, whole: float) -> float | None:
    return min(part / whole, 1.0) if part is not None and whole > 0 else None


def measure_health(errors: LocalErrors, said: Confidence, rule: HealthRule | None = None) -> Awareness:
    """Hold what a system said of itself against its losses.

    Args:
        errors: Its local errors.
        said: What it said, its stamps by the same clock.
        rule: How to judge.
    """
    rule = rule or HealthRule()
    losses = errors.losses()
    begin, end, warns = _spoken(said)
    horizon = losses[:, 0] - rule.horizon
    edges = np.unique(np.concatenate((errors.begin, errors.end, begin, end, losses.ravel(), horizon)))
    length, middle = np.diff(edges), (edges[:-1] + edges[1:]) / 2
    place = np.searchsorted(errors.begin, middle, side="right") - 1
    judged = (place >= 0) & (middle < errors.end[np.maximum(place, 0)]) & errors.known[np.maximum(place, 0)]
    lost = _inside(losses, middle)
    judged |= lost
    about_to_be = _inside(np.column_stack((horizon, losses[:, 0])), middle)
    warned = _inside(np.column_stack((begin, end))[warns], middle) & judged
    flagged = bool((said.flags != SAYS_NOTHING).any())

    def time(chosen: Mask) -> float:
        return float(length[chosen].sum())

    warnings = stretches(begin, end, warns, HOLD_SECONDS)
    auc, values = _auc(errors, said)
    return Awareness(
        rows=len(said),
        seconds=time(judged),
        lost=time(lost),
        losses=_told(losses, warnings, float(errors.begin[0])),
        warnings=warnings,
        warned=time(warned) if flagged else None,
        cried=time(warned & ~lost & ~about_to_be) if flagged else None,
        unwarned=time(lost & ~warned) if flagged else None,
        auc=auc,
        values=values,
    )


def _spoken(said: Confidence) -> tuple[FloatArray, FloatArray, Mask]:
    """Begin and end of the time for which each row holds, and whether it warns."""
    end = said.stamps + HOLD_SECONDS
    np.minimum(end[:-1], said.stamps[1:], out=end[:-1])
    return said.stamps, end, said.flags >= FLAGS.index("degraded")


def _inside(times: FloatArray, moments: FloatArray) -> Mask:
    """Tell which moments are in one of some times, begins ascending, shape (n, 2), which may overlap."""
    if not len(times):
        return np.zeros(len(moments), dtype=bool)
    place = np.searchsorted(times[:, 0], moments, side="right") - 1
    reached = np.maximum.accumulate(times[:, 1])
    inside: Mask = (place >= 0) & (moments < reached[np.maximum(place, 0)])
    return inside


def _told(losses: FloatArray, warnings: FloatArray, first: float) -> tuple[ToldLoss, ...]:
    """Each loss with its lead: by the first warning that was given in it, since the end of the one before."""
    told: list[ToldLoss] = []
    since = first
    for begin, end in losses.tolist():
        given = warnings[(warnings[:, 1] > begin) & (warnings[:, 0] < end)]
        lead = begin - max(float(given[0, 0]), since) if len(given) else None
        told.append(ToldLoss(begin, end, lead))
        since = end
    return tuple(told)


def _auc(errors: LocalErrors, said: Confidence) -> tuple[float | None, int]:
    place = np.searchsorted(errors.end, said.stamps, side="left")
    inside = np.minimum(place, len(errors.end) - 1)
    judged = (place < len(errors.end)) & (said.stamps >= errors.begin[0]) & errors.known[inside]
    judged &= ~np.isnan(said.values)
    off, values = errors.off[inside[judged]], said.values[judged]
    bad, good = int(off.sum()), int((~off).sum())
    if not bad or not good:
        return None, bad + good
    _, of_each, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[of_each]
    smaller = bad * good + bad * (bad + 1) / 2 - float(ranks[off].sum())
    return smaller / (bad * good), bad + good


def evaluate_health(
    reference: Trajectory,
    estimate: Trajectory,
    how: Preparation,
    *,
    said: Confidence | None = None,
    covariances: tuple[FloatArray, FloatArray] | None = None,
    keyframes: bool | None = None,
    window: tuple[float, float] | None = None,
    maps: IndexArray | None = None,
    rule: HealthRule | None = None,
) -> dict[str, Any]:
    """Measure what a system said of itself beside an estimate.

    Args:
        reference: Ground truth.
        estimate: What the system wrote; its own covariances count where no others are given.
        how: How both are matched and aligned.
        said: Its confidence over time.
        covariances: Stamps of poses, shape (m,), and how wrong it took these to be, as
            `slamhive_eval.Trajectory` has covariances.
        keyframes: Whether the estimate holds keyframes alone; None to tell by its spacing.
        window: First and last time of the run in s; None for all of the ground truth.
        maps: Map of each pose, which share no frame, shape (n,).
        rule: How to judge.

    Returns:
        Plain JSON data: ``health``, the figures, with covariances ``health.nees`` of position and rotation
        each, of the aligned poses; ``healthLosses`` and ``healthWarnings``, the longest of them in the order
        of time.

    Raises:
        AssociationError: The clock's offset can't be found.
        OptionError: An option that isn't allowed.
        TrajectoryError: Too few poses have a ground truth, or they have no orientations.
    """
    if covariances is not None:
        estimate = replace(estimate, covariances=_beside(estimate, *covariances))
    estimate, clock = set_clock(reference, estimate, how)
    pairs, truth, kept = how.pair_up(reference, estimate)
    if not len(pairs):
        raise TrajectoryError("no pose has a ground truth beside which it could be judged")
    laid = lay(truth, kept, how)
    told: dict[str, Any] = {"health": {}}
    if said is not None:
        if clock is not None:
            said = replace(said, stamps=clock.corrected(said.stamps))
        rule = rule or HealthRule()
        errors = local_errors(
            reference, estimate, pairs, laid, keyframes=keyframes, window=window, maps=maps, rule=rule.loss
        )
        measured = measure_health(errors, said.shifted(how.offset_seconds), rule)
        told["health"] = measured.as_dict()
        told["healthLosses"] = _longest([one.as_dict() for one in measured.losses])
        warnings = [{"begin": begin, "end": end} for begin, end in measured.warnings.tolist()]
        told["healthWarnings"] = _longest(warnings)
    if estimate.covariances is not None:
        told["health"]["nees"] = _nees(laid)
    return told


def describe(found: Mapping[str, Any]) -> str:
    """Say in a sentence what the figures of ``health`` are; empty where nothing was said of confidence."""
    if "rows" not in found:
        return ""
    times = {1: "once", 2: "twice"}.get(found["losses"], f"{found['losses']} times")
    lost = f"lost {times}, {found['lostSeconds']:.1f} s" if found["losses"] else "never lost"
    parts = [f"{lost} of {found['seconds']:.1f} s"]
    warning = found.get("warning")
    if warning is None:
        parts.append("it gave no flags")
    elif not warning["seconds"]:
        parts.append("it never warned")
    else:
        lead = warning["lead"]
        if lead is not None:
            when = f"{lead:.1f} s before" if lead >= 0 else f"{-lead:.1f} s too late"
            parts.append(f"it warned {when}{'' if warning['losses'] == 1 else ' on average'}")
        parts.append(f"{found['false']['share']:.0%} of {warning['seconds']:.1f} s warned were false")
    if warning is not None and found["missed"]["losses"]:
        parts.append(f"{found['missed']['losses']} not warned of")
    if found["auc"] is not None:
        parts.append(f"AUC of its values {found['auc']:.2f}")
    return "its own health: " + "; ".join(parts)


def _longest(times: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    longest = sorted(times, key=lambda one: one["begin"] - one["end"])[:MOST_TOLD]
    return sorted(longest, key=lambda one: float(one["begin"]))


def _beside(estimate: Trajectory, stamps: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances of the poses, NaN for those that none was given for."""
    place = nearest(stamps, estimate.stamps, SAME_STAMP_SECONDS)
    made = covariances[place]
    made[place < 0] = np.nan
    return made


def _nees(laid: Prepared) -> dict[str, Any]:
    covariances = laid.estimate.covariances
    if covariances is None:
        raise TrajectoryError("covariances can't follow poses that were moved by a lever arm")
    parts: list[Part] = ["position"]
    if covariances.shape[1] == 6 and laid.reference.oriented and laid.estimate.oriented:
        parts.append("rotation")
    return {
        part: measure_consistency(laid.reference, laid.estimate, covariances, part=part).summary()
        for part in parts
    }
