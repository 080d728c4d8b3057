# SPDX-License-Identifier: Apache-2.0
"""Summary of an edit: what it did to errors, failures and load, dataset by dataset.

Each line is one figure on one dataset, by `slamhive.analysis.versions`: settings that ran with the current
version and one before it, each by the median of its repetitions. All else is as it is now: runs of an
algorithm that was edited since tell nothing of an edit of their dataset, and the other way round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import where_equal
from slamhive.analysis.measures import is_error
from slamhive.analysis.versions import before_and_after, permutation_test, verdict

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.columns import Floats, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.versions import Change, Side, Version

NOT_TRACKED = "runs not tracked"
_ERROR = "ate.rmse"


@dataclass(frozen=True)
class EditLine:
    """One figure on one dataset, before and after.

    Attributes:
        keys: dataset and what else its runs share, by column.
        metric: the figure's column, or ``NOT_TRACKED``.
        before, after: geometric means over settings, without those that failed on both sides if others are
            left; infinite where a setting's median run failed. Of ``NOT_TRACKED``: numbers of runs.
        of: runs before and after, of ``NOT_TRACKED``; None for figures.
        ratio: after over before; NaN where failed runs forbid it.
        wins: settings in which after is better, worse, the same.
        failed: number of settings whose median run failed before and after: they are none of these.
        deterministic: whether each setting has one result on each side, however often it ran.
        p: that both are equally good, two-sided; None where nothing was tested.
        verdict: what the test says, in words; empty where there is nothing to test.
    """

    keys: dict[str, Any]
    metric: str
    before: float
    after: float
    of: tuple[int, int] | None
    ratio: float
    wins: tuple[int, int, int]
    failed: int
    deterministic: bool
    p: float | None
    verdict: str


@dataclass(frozen=True)
class Edit:
    """An algorithm or a dataset that has a version before the current one.

    Attributes:
        changed: what has versions: ``algorithm`` or ``dataset``.
        name: its name.
        before, after: the versions.
        lines: what they come to.
        settings: number of settings that ran with both, on all datasets.
        unpaired: number of those that ran with one of them alone.
        runs: number of runs before and after, of these and of the others.
        disturbed: number of those that shared their cores with other work or were throttled.
    """

    changed: str
    name: str
    before: Version
    after: Version
    lines: list[EditLine]
    settings: int
    unpaired: int
    runs: tuple[int, int]
    disturbed: tuple[int, int]


def edits(
    frame: Frame, metrics: Sequence[str], before: Mapping[tuple[str, str], str]
) -> tuple[list[Edit], list[str]]:
    """Return the effects of edits of some algorithms or datasets, and notes.

    Args:
        frame: one row a run and evaluation, superseded ones too.
        metrics: columns of numbers; failures are counted by the first error of them.
        before: version that the current one is compared with, by ``algorithm`` or ``dataset`` and its name.
    """
    error = next(filter(is_error, metrics), None)
    if error is None:  # where nothing ever succeeded there is none, and that is to be said
        error, metrics = _ERROR, (_ERROR, *metrics)
    found: list[Edit] = []
    notes: dict[str, None] = {}
    for (changed, name), version in before.items():
        sides = _sides(frame, changed, name, version)
        part = frame.select(sides[0] | sides[1])
        changes: list[tuple[Change, bool]] = []
        for dataset in _names(part, "dataset"):
            rows = part.select(where_equal(part, "dataset", dataset))
            for metric in metrics:
                compared, said = before_and_after(rows, metric)
                notes |= dict.fromkeys(said if metric == error else ())
                changes += [
                    # It is asked for alone: nothing is to be corrected for the versions before.
                    (replace(one, keys={"dataset": dataset, **one.keys}, p_holm=one.p), metric == error)
                    for one in compared
                    if (one.changed, one.before.version, one.current) == (changed, version, True)
                ]
        if changes:
            found.append(_edit(changed, name, changes, [frame.select(side) for side in sides]))
    return found, list(notes)


def _sides(frame: Frame, changed: str, name: str, version: str) -> tuple[Mask, Mask]:
    """Tell which rows are of an earlier version, with all else as it is now, and of the current one."""
    own = where_equal(frame, changed, name)
    current = own & ~frame.column("superseded").present
    before = own & where_equal(frame, f"{changed}.version", version) & ~current
    other = "dataset" if changed == "algorithm" else "algorithm"
    others = list(zip(frame.column(other).tolist(), frame.column(f"{other}.version").tolist(), strict=True))
    known = {others[row] for row in np.flatnonzero(current).tolist()}
    before &= np.array([one in known for one in others], dtype=bool)
    return before, current


def _names(frame: Frame, column: str) -> list[str]:
    return [str(value) for value in frame.column(column).unique() if value is not None]


def _edit(changed: str, name: str, changes: Sequence[tuple[Change, bool]], sides: Sequence[Frame]) -> Edit:
    first = [change for change, is_first in changes if is_first] or [changes[0][0]]
    lines = []
    for change, is_first in changes:
        keys = {key: value for key, value in change.keys.items() if key != changed or changed == "dataset"}
        if change.settings:
            lines.append(_line(keys, change))
        if is_first and change.settings:
            lines.append(_failures(keys, change))
    before, after = sides
    return Edit(
        changed=changed,
        name=name,
        before=first[0].before,
        after=first[0].after,
        lines=lines,
        settings=sum(len(change.settings) for change in first),
        unpaired=sum(change.unpaired for change in first),
        runs=(before.count_runs(), after.count_runs()),
        disturbed=(_disturbed(before), _disturbed(after)),
    )


def _disturbed(frame: Frame) -> int:
    return frame.count_runs(frame.column("disturbed").floats() > 0)


def _line(keys: dict[str, Any], change: Change) -> EditLine:
    compared = [one for one in change.settings if not one.failed] or change.settings
    sides = [np.array([getattr(one, side).median for one in compared]) for side in ("before", "after")]
    return EditLine(
        keys=keys,
        metric=change.metric,
        before=_geometric_mean(sides[0]),
        after=_geometric_mean(sides[1]),
        of=None,
        ratio=change.ratio,
        wins=change.wins,
        failed=change.failed,
        deterministic=change.deterministic,
        p=change.p if change.test else None,
        verdict=change.verdict,
    )


def _geometric_mean(values: Floats) -> float:
    if np.isinf(values).any():
        return float(values[np.isinf(values)][0])
    with np.errstate(divide="ignore"):
        return float(np.exp(np.log(values).mean()))


def _failures(keys: dict[str, Any], change: Change) -> EditLine:
    """Return the share of the paired settings' runs without a figure that counts, tested within settings."""
    before = [_unsound(setting.before) for setting in change.settings]
    after = [_unsound(setting.after) for setting in change.settings]
    shares = [
        (sum(old.values) / max(len(old.values), 1), sum(new.values) / max(len(new.values), 1))
        for old, new in zip(before, after, strict=True)
    ]
    failed = sum(old.is_all and new.is_all for old, new in zip(before, after, strict=True))
    wins = (
        sum(new < old for old, new in shares),
        sum(new > old for old, new in shares),
        sum(new == old for old, new in shares) - failed,
    )
    p, told = None, ""
    if any(wins[:2]) and not change.deterministic:
        pairs = [(np.array(old.values), np.array(new.values)) for old, new in zip(before, after, strict=True)]
        p, least = permutation_test(pairs)
        told = verdict(p, least)
    numbers = sum(one.number for one in before), sum(one.number for one in after)
    return EditLine(
        keys=keys,
        metric=NOT_TRACKED,
        before=numbers[0],
        after=numbers[1],
        of=(sum(one.before.runs for one in change.settings), sum(one.after.runs for one in change.settings)),
        ratio=math.nan,
        wins=wins,
        failed=failed,
        deterministic=change.deterministic,
        p=p,
        verdict=told,
    )


@dataclass(frozen=True)
class _Failed:
    """Runs of a setting that failed, and all of them as ones and zeros: equal results once."""

    number: int
    values: list[float]

    @property
    def is_all(self) -> bool:
        """True if none of the runs has a figure that counts."""
        return bool(self.values) and all(self.values)


def _unsound(side: Side) -> _Failed:
    number = sum(side.failures.values())
    if side.same:
        return _Failed(number, [float(side.n == 0)])
    return _Failed(number, [1.0] * number + [0.0] * side.n)
