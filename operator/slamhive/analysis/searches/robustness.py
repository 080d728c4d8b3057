# SPDX-License-Identifier: Apache-2.0
"""Robustness card: how much of each disturbance each system bears, from the table of runs.

Runs of searches for thresholds and of grids count alike: at each value of an axis it is counted how many
failed, and the threshold is estimated from the counts. Where searches of an axis have several rules by which
runs failed, each rule has rows of its own. Figure, table and page show this one card.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from slamhive.analysis.expressions import parse_where
from slamhive.analysis.grouping import FAILED_OF_ITSELF, SUBJECT, Groups, apart, varies, varying, where_equal
from slamhive.analysis.measures import CONFIGURATION
from slamhive.analysis.searches.thresholds import Threshold, estimate, noticed
from slamhive.analysis.selection import finished, first_rows, once
from slamhive.engine import ValueTally
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.model.results import Outcome, Phase
from slamhive.model.search import Failing, Search, SearchMethod

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.columns import Mask
    from slamhive.analysis.frame import Frame

MOST_AXES = 12
_SWEEP, _ERROR = "sweep.uid", "ate.rmse"


@dataclass(frozen=True)
class RobustnessWish:
    """A card as it was asked for.

    Attributes:
        axes: columns of the axes; empty for those of the searches, or else what was varied.
        failing: condition on runs that failed; None for those of the searches, or else all but tracked.
        quantile: share of the runs that must fail for a value to fail; None for that of the searches, or
            else one half.
        searches: what the Sweeps sought, by their identity: several may have one name.
        option: what names the axes, for complaints.
    """

    axes: tuple[str, ...] = ()
    failing: str | None = None
    quantile: float | None = None
    searches: Mapping[str, Search] = field(default_factory=dict)
    option: str = "x"

    def rule(self, sweep: str | None) -> Failing:
        """Return the rule by which runs of a Sweep, given its identity, failed."""
        search = self.searches.get(sweep or "")
        return search.failing if search is not None else Failing()

    def rule_name(self, sweep: str | None) -> str:
        """Return the name of the rule for a Sweep's runs; empty where all have one."""
        rule = self.rule(sweep)
        if rule.metric is not None:
            name = (
                f"{rule.metric} > {rule.above:g}"
                if rule.above is not None
                else f"{rule.metric} < {rule.below:g}"
            )
        else:
            name = " or ".join(map(str, rule.outcome)) if rule.outcome else f"not {Outcome.TRACKED}"
        share = (
            "" if self.quantile is not None or rule.quantile == 0.5 else f" in {rule.quantile:.0%} of runs"
        )
        return share.strip() if self.failing is not None else f"{name}{share}"


@dataclass(frozen=True)
class RobustnessCard:
    """Thresholds of systems on axes.

    Attributes:
        axes: columns of the axes.
        rows: what each row is of, by column.
        cells: the threshold of each row on each axis; None where nothing was run.
        runs: number of runs behind it.
        notes: what it is of, in sentences; the last one is on how it is drawn.
    """

    axes: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    cells: tuple[tuple[Threshold | None, ...], ...]
    runs: int
    notes: tuple[str, ...] = ()

    def columns(self) -> dict[str, list[Any]]:
        """Return the card as a table, a line for each threshold, by column."""
        keys = list(dict.fromkeys(name for key in self.rows for name in key))
        lines = [
            {name: key.get(name) for name in keys}
            | {"axis": axis, "status": str(cell.status), "direction": cell.direction}
            | {"passes": cell.passing, "fails": cell.failing}
            | {"sureFrom": cell.sure[0], "sureTo": cell.sure[1], "values": len(cell.tallies)}
            | {"runs": cell.runs, "counts": cell.counts}
            for key, cells in zip(self.rows, self.cells, strict=True)
            for axis, cell in zip(self.axes, cells, strict=True)
            if cell is not None
        ]
        return {name: [line[name] for line in lines] for name in (lines[0] if lines else keys)}


def robustness(frame: Frame, wish: RobustnessWish) -> RobustnessCard:
    """Return the card of some runs.

    Raises:
        InputError: no axis was varied, several were and none was named, or a name is wrong.
    """
    frame, waiting = finished(frame.select(first_rows(frame)))
    axes = _axes(frame, wish)
    names = np.array([wish.rule_name(sweep) for sweep in frame.column(_SWEEP).tolist()], dtype=object)
    frame, names = _once_each(frame, names)
    failed, known = _judged(frame, wish)
    rows: dict[str, Mapping[str, Any]] = {}
    found: dict[tuple[str, str], Threshold] = {}
    counted = np.zeros(len(frame), dtype=bool)
    meant = [np.isfinite(frame.column(axis).floats()) & _apart_from(frame, axis, axes, wish) for axis in axes]
    several = any(len(set(names[inside])) > 1 for inside in meant)
    for axis, of_axis in zip(axes, meant, strict=True):
        numbers = frame.column(axis).floats()
        counted |= of_axis
        for name in sorted(set(names[of_axis])):
            inside = of_axis & (names == name)
            part = frame.select(inside)
            sweeps = set(part.column(_SWEEP).tolist())
            searches = [search for uid, search in wish.searches.items() if uid in sweeps]
            for subject, members in _series(part, axis, searches):
                key = subject | ({"failing": name} if several else {})
                own = np.flatnonzero(inside)[members]
                quantile = wish.quantile or wish.rule(_first(part, _SWEEP, members)).quantile
                counts = [
                    ValueTally(float(value), int(failed[at].sum()), int(known[at].sum()))
                    for value in np.unique(numbers[own])
                    for at in [own[numbers[own] == value]]
                ]
                identity = repr(key)
                rows.setdefault(identity, key)
                found[identity, axis] = _with_figure(
                    frame.select(own), axis, wish, estimate(axis, key, counts, quantile)
                )
    order = sorted(rows, key=lambda one: [str(value) for value in rows[one].values()])
    told = {name for key in rows.values() for name in key}
    runs = int(once(frame.select(counted)).sum())
    common = {name for name in told - {"algorithm"} if len({repr(rows[o].get(name)) for o in rows}) == 1}
    return RobustnessCard(
        axes,
        tuple({name: value for name, value in rows[one].items() if name not in common} for one in order),
        tuple(tuple(found.get((one, axis)) for axis in axes) for one in order),
        runs,
        tuple(
            _notes(frame, wish, runs, waiting, {name: rows[order[0]].get(name) for name in sorted(common)})
        ),
    )


def _once_each(frame: Frame, names: Any) -> tuple[Frame, Any]:
    """Return the rows without those of equal content, once for each rule, and the rules of what is left."""
    kept = np.zeros(len(frame), dtype=bool)
    for name in set(names):
        own = np.flatnonzero(names == name)
        kept[own[once(frame.select(own))]] = True
    return frame.select(kept), names[kept]


def _axes(frame: Frame, wish: RobustnessWish) -> tuple[str, ...]:
    if wish.axes:
        names = tuple(dict.fromkeys(frame.resolve(name, wish.option) for name in wish.axes))
        for name in names:
            if not np.isfinite(frame.column(name).floats()).any():
                raise InputError(f"{name}: a column of numbers is needed, this one holds none", wish.option)
        return _few(names, wish)
    names_of = dict(zip(frame.column(_SWEEP).tolist(), frame.column("sweep").tolist(), strict=True))
    found = sorted((str(names_of[uid]), uid) for uid in wish.searches if uid in names_of)
    sought = [wish.searches[uid].axis for _, uid in found]
    names = tuple(dict.fromkeys(name for name in sought if name and frame.has(name)))
    if names:
        return _few(names, wish)
    varied = [name for name in varying(frame) if _is_axis(frame, name)]
    if not varied:
        raise InputError("no number was varied in these runs: there is nothing to fail by", wish.option)
    if len(varied) > 1 and len(names_of.keys() - {None}) < len(varied):
        raise InputError(
            f"{', '.join(varied)} were varied: name the axes whose thresholds are meant", wish.option
        )
    return _few(tuple(varied), wish)


def _few(names: tuple[str, ...], wish: RobustnessWish) -> tuple[str, ...]:
    if len(names) > MOST_AXES:
        raise InputError(
            f"{len(names)} axes are meant, at most {MOST_AXES} are shown: name some", wish.option
        )
    return names


def _is_axis(frame: Frame, name: str) -> bool:
    column = frame.column(name)
    chosen = name.startswith(CONFIGURATION) and "seed" not in name.lower()
    return chosen and column.kind.is_numeric and len(np.unique(column.floats()[column.present])) > 1


def _apart_from(frame: Frame, axis: str, axes: Sequence[str], wish: RobustnessWish) -> Mask:
    """Tell which runs are those of an axis: not those of a search of another one."""
    others = [
        uid
        for uid, search in wish.searches.items()
        if not wish.axes and search.axis in axes and search.axis != axis
    ]
    inside: Mask = np.ones(len(frame), dtype=bool)
    for uid in others:
        inside &= ~where_equal(frame, _SWEEP, uid)
    return inside


def _series(part: Frame, axis: str, searches: Sequence[Search]) -> list[tuple[dict[str, Any], Any]]:
    """Return the subjects that were run, and the places of their runs, for all values of an axis together."""
    names = [name for name in SUBJECT if name == "algorithm" or varies(part, name)]
    # An attribute follows from its dataset, a seed and what was gone across make repetitions.
    repeated = {name for search in searches for name in search.across or ()}
    names += [
        name
        for name in varying(part)
        if name not in {axis, *repeated}
        and "seed" not in name.lower()
        and not name.startswith("dataset.attributes.")
    ]
    part, facets = apart(part, [*SUBJECT, *names, axis], ())
    # A run that broke off was not measured: it belongs to those that were.
    facets = [name for name in facets if len({*part.column(name).tolist()} - {None}) > 1]
    groups = Groups(part, list(dict.fromkeys([*SUBJECT, *names, *facets])))
    return list(zip(groups.keys, groups.members(), strict=True))


def _with_figure(part: Frame, axis: str, wish: RobustnessWish, threshold: Threshold) -> Threshold:
    """Return a threshold that knows whether the figure of its rule, or else the error, changed at all."""
    name = wish.rule(_first(part, _SWEEP, [0])).metric or _ERROR
    figures, numbers = part.column(name).floats(), part.column(axis).floats()
    if not np.isfinite(figures).all():
        return threshold
    datasets, _ = part.column("dataset").factorized()
    blocks = [
        [figures[here & (numbers == value)].tolist() for value in np.unique(numbers[here])]
        for here in (datasets == one for one in np.unique(datasets))
    ]
    return noticed(threshold, name, blocks)


def _judged(frame: Frame, wish: RobustnessWish) -> tuple[Mask, Mask]:
    """Tell which runs failed, and of which that is known."""
    own = np.array([one in FAILED_OF_ITSELF for one in frame.column("reason").tolist()], dtype=bool)
    broken = where_equal(frame, "phase", Phase.FAILED.value) & own
    done = where_equal(frame, "phase", Phase.SUCCEEDED.value)
    measured = done & frame.column("outcome").present
    tracked = where_equal(frame, "outcome", Outcome.TRACKED.value)
    if wish.failing is not None:
        try:
            failed = parse_where(wish.failing, frozenset(frame.names)).mask(frame)
        except InputError as error:
            raise InputError(str(error), "failing") from None
        return broken | (measured & failed), broken | measured
    outcomes = frame.column("outcome").tolist()
    lost = np.array([one is not None and Outcome(one).has_lost_track for one in outcomes], dtype=bool)
    sweeps = frame.column(_SWEEP).tolist()
    failed = np.zeros(len(frame), dtype=bool)
    for sweep in dict.fromkeys(sweeps):
        mine = np.array([one == sweep for one in sweeps], dtype=bool)
        rule = wish.rule(sweep)
        if rule.metric is None:
            bad = [str(one) for one in rule.outcome or [one for one in Outcome if one is not Outcome.TRACKED]]
            failed |= mine & np.array([one in bad for one in outcomes], dtype=bool)
            continue
        figure = frame.column(rule.metric).floats()
        worse = figure > rule.above if rule.above is not None else figure < (rule.below or 0.0)
        failed |= mine & (worse | lost | (np.isnan(figure) & ~tracked))
        measured = measured & (~mine | np.isfinite(figure) | ~tracked)
    return broken | (measured & failed), broken | measured


def _first(frame: Frame, name: str, members: Any) -> str | None:
    value = frame.select(members[:1]).column(name).tolist()[0]
    return None if value is None else str(value)


def _notes(
    frame: Frame, wish: RobustnessWish, runs: int, waiting: Sequence[str], common: Mapping[str, Any]
) -> list[str]:
    where = ", ".join(f"{value}" for value in common.values() if value is not None)
    notes = [f"n = {plural(runs, 'run')}{f' on {where}' if where else ''}"]
    if wish.failing is not None:
        rule = f"which meet {wish.failing}"
    else:
        sweeps = {None if one is None else str(one) for one in frame.column(_SWEEP).tolist()}
        rule = "; or ".join(sorted({_rule_text(wish.rule(sweep)) for sweep in sweeps}))
    notes.append(f"failed are runs {rule}, and those whose program failed")
    notes += waiting
    notes.append(
        "bars end at the last value that passes, whiskers span where the threshold lies in 95 of 100 cases; "
        "counts are runs that failed of those known, at the last value that passes and the first that fails"
    )
    return notes


def _rule_text(rule: Failing) -> str:
    if rule.metric is not None:
        bound = f"above {rule.above:g}" if rule.above is not None else f"below {rule.below:g}"
        return f"with {rule.metric} {bound}, Lost or Diverged"
    if rule.outcome is not None:
        return f"with the outcome {' or '.join(map(str, rule.outcome))}"
    return "that did not track"


def searches_of(specs: Mapping[str, Mapping[str, Any]]) -> dict[str, Search]:
    """Return the searches of Sweeps that sought thresholds, by identity.

    Args:
        specs: specs of Sweeps by identity, as they are archived.
    """
    found: dict[str, Search] = {}
    for uid, spec in specs.items():
        if (spec.get("search") or {}).get("method") != SearchMethod.THRESHOLD.value:
            continue
        try:
            search = Search.model_validate(spec["search"])
        except ValidationError:
            continue  # of another version of slamhive
        labels = {one.get("name") or one.get("path"): one.get("path") for one in spec.get("matrix") or ()}
        across = [labels.get(label) or label for label in search.across or ()]
        axis = labels.get(search.axis) or search.axis
        found[uid] = search.replace(axis=axis, across=across or None)
    return found
