# SPDX-License-Identifier: Apache-2.0
"""Nodes compared by the load that they measured of equal runs: one that is slower than its like is named.

Runs of one setting on nodes of one kind take the same CPU time but for noise, whichever node they are on. Of
each node the ratio is estimated by which its runs take longer than those of all others of its kind: the
median of all quotients of its runs and theirs within a setting (Hodges and Lehmann 1963), settings weighted
as in the test of van Elteren (1960), of which the interval is the inversion: quantiles of the same quotients.
Ranks alone decide, so that a few runs beside other work move little. All intervals hold together
(Bonferroni), so that among nodes that are no more than `LEAST_RATIO` apart one is named in at most 5 of 100
archives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import CONDITIONS, FACETS, PROCESSOR, Groups, varying, where_equal
from slamhive.analysis.measures import measure_of
from slamhive.analysis.selection import first_rows
from slamhive.analysis.statistics import LEVEL, bounds
from slamhive.model.base import Choice, plural
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices
    from slamhive.analysis.frame import Frame

NODE = "provenance.node"
"""Column of the machine that a run was on."""

LOAD = "usage.cpu.seconds"
"""Column that nodes are compared by: CPU seconds, which a slower clock makes more, whatever the pace."""

LEAST_RATIO = 1.05
"""Ratio of a node's CPU time to its like from which on it is named."""

MOST_EACH = 20
"""Runs of a setting on a node that count: the newest."""

MOST_QUOTIENTS = 4_000_000
"""Quotients of runs that are made at most: of more, settings have fewer runs, and then every k-th counts."""

_OF_MEASURING = {"evaluation", "alignment", "settings", "evaluationVersion"}
_KEPT = (*(name for name in FACETS if name not in _OF_MEASURING), "usage.includesReader")


class NodeVerdict(Choice):
    """Verdicts on a node's load beside that of its like, by `LEAST_RATIO`."""

    SLOWER = "slower"
    FASTER = "faster"
    EQUAL = "equal"
    UNSURE = "unsure"


@dataclass(frozen=True)
class NodeStanding:
    """A node beside all others of its kind.

    Attributes:
        node: its name.
        kind: processor and what else makes load comparable, by column; what isn't known is left out.
        others: number of other nodes of its kind with a run of an equal setting.
        settings: number of settings that it shares with one of them.
        runs: number of its runs that count.
        ratio: its CPU time by theirs.
        low, high: ends of the interval of that, 95 % for all nodes together; 0 and infinite where runs are
            too few to tell.
    """

    node: str
    kind: dict[str, Any]
    others: int
    settings: int
    runs: int
    ratio: float
    low: float
    high: float

    @property
    def verdict(self) -> NodeVerdict:
        """Return the verdict that the interval allows."""
        if self.low > LEAST_RATIO:
            return NodeVerdict.SLOWER
        if self.high < 1 / LEAST_RATIO:
            return NodeVerdict.FASTER
        inside = self.low > 1 / LEAST_RATIO and self.high < LEAST_RATIO
        return NodeVerdict.EQUAL if inside else NodeVerdict.UNSURE

    @property
    def sentence(self) -> str:
        """Return the verdict in words."""
        percent = 100 * abs(self.ratio - 1)
        others = "another of its kind" if self.others == 1 else f"{self.others} others of its kind"
        match self.verdict:
            case NodeVerdict.SLOWER | NodeVerdict.FASTER:
                more = "more" if self.ratio > 1 else "less"
                told = f"{percent:.1f} % {more} CPU time than {others}"
                return f"{self.node} is {self.verdict}: {told} for the same runs"
            case NodeVerdict.EQUAL:
                return f"{self.node} is equal to {others} within {100 * (LEAST_RATIO - 1):.0f} %"
            case _:
                return f"{self.node}: too few equal runs, or too unlike ones, to tell it from {others}"

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values; ends that nobody knows are absent."""
        return {
            "node": self.node,
            "kind": self.kind,
            "others": self.others,
            "settings": self.settings,
            "runs": self.runs,
            "ratio": self.ratio,
            "low": self.low if self.low > 0 else None,
            "high": self.high if math.isfinite(self.high) else None,
            "verdict": self.verdict.value,
            "sentence": self.sentence,
        }

    def flat(self) -> dict[str, Any]:
        """Return it as a row of plain values, what tells its kind each by itself."""
        found = self.as_json()
        return {name: value for name, value in found.items() if name != "kind"} | self.kind


def kind_text(kind: dict[str, Any]) -> str:
    """Return a kind of node in words, such as ``EPYC 7543, governor performance, SMT off``."""
    words = {True: "on", False: "off"}
    return ", ".join(
        str(value) if name == PROCESSOR else f"{measure_of(name).text} {words.get(value, value)}"
        for name, value in kind.items()
    )


@dataclass(frozen=True)
class NodeComparison:
    """Nodes beside their like.

    Attributes:
        nodes: those that can be compared, the slowest first.
        notes: sentences on what is left out.
    """

    nodes: list[NodeStanding]
    notes: list[str]


def compare_nodes(frame: Frame) -> NodeComparison:
    """Return the nodes beside others of their kind, by the CPU time of equal runs.

    Args:
        frame: one row a run and evaluation.
    """
    frame = frame.select(first_rows(frame))
    measured = _measured(frame)
    notes = []
    if not measured.any():
        return NodeComparison([], ["of no run both node and CPU time are known"])
    if unknown := int((frame.column(LOAD).present & ~frame.column(NODE).present).sum()):
        notes.append(f"left out: {plural(unknown, 'run')} of which nobody noted the node")
    frame = frame.select(measured)
    codes, names = frame.column(NODE).factorized()
    if len(names) == 1:
        return NodeComparison([], [*notes, f"all runs were on one node, {names[0]}: nothing to compare"])
    settings = Groups(frame, [*CONDITIONS, *_KEPT, *varying(frame)])
    kinds = Groups(frame, CONDITIONS)
    runs = _shared(_NodeRuns.of(frame, settings.of_row, codes.astype(np.intp)))
    if not len(runs.row):
        return NodeComparison([], [*notes, "no setting ran on several nodes of the same kind"])
    runs, left_out = _bounded(runs)
    notes += left_out
    places = np.unique(np.stack([kinds.of_row[runs.row], runs.node]), axis=1).T.tolist()
    margin = NormalDist().inv_cdf(1 - (1 - LEVEL) / 2 / len(places))
    found = []
    for kind, keys in enumerate(kinds.keys):
        known = {name: value for name, value in keys.items() if value is not None}
        mine = runs.only(kinds.of_row[runs.row] == kind)
        found += _standings(names, known, mine, margin)
    alone = len(set(codes.tolist()) - set(runs.node.tolist()))
    if alone:
        nodes = "1 node has" if alone == 1 else f"{alone} nodes have"
        notes.append(f"{nodes} no run that is equal to one on another of the same kind")
    return NodeComparison(sorted(found, key=lambda one: -one.ratio), notes)


def _measured(frame: Frame) -> npt.NDArray[np.bool_]:
    """Tell which rows have load that was measured here and now, on a node that is known, (n,)."""
    fine = where_equal(frame, "phase", Phase.SUCCEEDED.value) & frame.column(NODE).present
    for name in ("provenance.reusedFrom", "usage.suspect", "origin.kind"):
        fine &= ~frame.column(name).present
    found: npt.NDArray[np.bool_] = fine & (frame.column(LOAD).floats() > 0)
    return found


@dataclass(frozen=True)
class _NodeRuns:
    """Runs that are compared, sorted by setting; all arrays (n,).

    Attributes:
        row: of the table.
        setting: number of its setting and kind of node.
        node: number of its node.
        value: logarithm of its CPU time.
        age: how many runs of its setting and node are newer.
    """

    row: Indices
    setting: Indices
    node: Indices
    value: Floats
    age: Indices

    @classmethod
    def of(cls, frame: Frame, setting: Indices, node: Indices) -> _NodeRuns:
        finished = np.nan_to_num(frame.column("finished").floats(), nan=-np.inf)
        order = np.lexsort((-finished, node, setting))
        cell = setting[order] * (int(node.max()) + 1) + node[order]
        begins = np.flatnonzero(np.diff(cell, prepend=-1))
        age = np.arange(len(cell)) - np.repeat(begins, np.diff(begins, append=len(cell)))
        value = np.log(frame.column(LOAD).floats()[order])
        return cls(order, setting[order], node[order], value, age)

    def only(self, which: npt.NDArray[np.bool_]) -> _NodeRuns:
        """Return some of them."""
        return _NodeRuns(
            self.row[which], self.setting[which], self.node[which], self.value[which], self.age[which]
        )


def _shared(runs: _NodeRuns) -> _NodeRuns:
    """Return the runs of settings that ran on several nodes."""
    if not len(runs.row):
        return runs
    first = np.flatnonzero(np.diff(runs.setting, prepend=-1))
    sizes = np.diff(first, append=len(runs.setting))
    several = np.maximum.reduceat(runs.node, first) > np.minimum.reduceat(runs.node, first)
    return runs.only(np.repeat(several, sizes))


def _bounded(runs: _NodeRuns) -> tuple[_NodeRuns, list[str]]:
    """Return the newest runs of each setting and node, and say which others are left out."""
    for most in (MOST_EACH, 10, 5, 3, 2, 1):
        kept = runs.only(runs.age < most)
        sizes = np.bincount(kept.setting).astype(np.float64)
        if float((sizes**2).sum()) <= MOST_QUOTIENTS:
            break
    else:
        used = np.unique(kept.setting)
        step = math.ceil(float((sizes**2).sum()) / MOST_QUOTIENTS)
        kept = kept.only(np.isin(kept.setting, used[::step]))
        return kept, [f"of 1 setting in {step} the newest run on a node counts"]
    if len(kept.row) == len(runs.row):
        return kept, []
    return kept, [f"of each setting the newest {most} runs on a node count" if most > 1 else _NEWEST]


_NEWEST = "of each setting the newest run on a node counts"


def _standings(
    names: Sequence[Any], kind: dict[str, Any], runs: _NodeRuns, margin: float
) -> list[NodeStanding]:
    """Return the standings of the nodes of a kind; those that are slower are no measure for the others."""
    first = {node: _standing(names[node], kind, runs, node, margin) for node in np.unique(runs.node).tolist()}
    slow = [node for node, one in first.items() if one.verdict is NodeVerdict.SLOWER]
    sound = _shared(runs.only(~np.isin(runs.node, slow))) if slow else runs
    again = np.unique(sound.node).tolist() if slow else []
    return [*(first | {node: _standing(names[node], kind, sound, node, margin) for node in again}).values()]


def _standing(name: Any, kind: dict[str, Any], runs: _NodeRuns, node: int, margin: float) -> NodeStanding:
    """Return a node's standing among the runs of its kind.

    Args:
        name: of the node.
        kind: of the node.
        runs: of all nodes of the kind, those of settings that several of them ran.
        node: its number.
        margin: standard errors to either side.
    """
    mine = runs.node == node
    runs = runs.only(np.isin(runs.setting, runs.setting[mine]))
    mine = runs.node == node
    settings, places = np.unique(runs.setting, return_inverse=True)
    spans = [*pairwise(bounds(places.reshape(-1), len(settings)).tolist())]
    quotients, weights, wide, heaviest = [], [], 0.0, 0.0
    for begin, end in spans:
        here = mine[begin:end]
        values = runs.value[begin:end]
        weight = 1 / (end - begin + 1)
        found = (values[here][:, None] - values[~here][None, :]).ravel()
        quotients.append(found)
        weights.append(np.full(len(found), weight))
        wide, heaviest = wide + weight * len(found), max(heaviest, weight)
    # As far as half a place of the ranks, too, as they are whole numbers.
    half = margin / math.sqrt(12 * wide) + heaviest / 2 / wide
    ratio, low, high = _estimate(np.concatenate(quotients), np.concatenate(weights), half)
    others = len(np.unique(runs.node)) - 1
    return NodeStanding(str(name), kind, others, len(spans), int(mine.sum()), ratio, low, high)


def _estimate(quotients: Floats, weights: Floats, half: float) -> tuple[float, float, float]:
    """Return the weighted median of logarithms as a ratio, and the quantiles as far to either side.

    Args:
        quotients: logarithms, (n,).
        weights: of each, (n,).
        half: share of the weight between the median and either quantile.
    """
    order = np.argsort(quotients, kind="stable")
    ordered, reached = quotients[order], np.cumsum(weights[order])
    total = float(reached[-1])

    def at(share: float) -> float:
        return float(ordered[min(int(np.searchsorted(reached, share * total)), len(ordered) - 1)])

    low = math.exp(at(0.5 - half)) if half < 0.5 else 0.0
    high = math.exp(at(0.5 + half)) if half < 0.5 else math.inf
    return math.exp(at(0.5)), low, high
