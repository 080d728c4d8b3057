# SPDX-License-Identifier: Apache-2.0
"""Summary of an edit: what it did to errors, failures and load, dataset by dataset.

Each line is one figure on one dataset, by `slamhive.analysis.versions`: settings that ran with the current
version and the one before it, each by the median of its repetitions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import count_distinct
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.versions import before_and_after, permutation_test, verdict

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from slamhive.analysis.columns import Floats
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.versions import Change, Side, Version

NOT_TRACKED = "runs not tracked"


@dataclass(frozen=True)
class EditLine:
    """One figure on one dataset, before and after.

    Attributes:
        keys: dataset and what else its runs share, by column.
        metric: the figure's column, or ``NOT_TRACKED``.
        before, after: geometric means over settings; infinite where a setting's median run failed. Of
            ``NOT_TRACKED``: numbers of runs.
        of: runs before and after, of ``NOT_TRACKED``; None for figures.
        ratio: after over before; NaN where failed runs forbid it.
        wins: settings in which after is better, worse, the same.
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
        disturbed: runs before and after that shared their cores with other work or were throttled.
    """

    changed: str
    name: str
    before: Version
    after: Version
    lines: list[EditLine]
    settings: int
    unpaired: int
    disturbed: tuple[int, int]


def edits(frame: Frame, metrics: Sequence[str], names: Collection[str]) -> tuple[list[Edit], list[str]]:
    """Return the effects of the latest edits of some algorithms or datasets, and notes.

    The current version is compared with the earlier one that has most settings in common with it, the latest
    of several: one that was edited again after its first runs tells little.

    Args:
        frame: one row a run and evaluation, superseded ones too.
        metrics: columns of numbers; failures are counted by the first.
        names: of the algorithms and datasets that were edited.
    """
    found: dict[tuple[str, str], list[tuple[Change, bool]]] = {}
    notes: dict[str, None] = {}
    for dataset in _names(frame, "dataset"):
        part = frame.select(where_equal(frame, "dataset", dataset))
        for place, metric in enumerate(metrics):
            changes, said = before_and_after(part, metric)
            notes |= dict.fromkeys(said if place == 0 else ())
            for change in changes:
                owner = str(change.keys[change.changed])
                if owner in names and change.current:
                    # It is asked for alone: nothing is to be corrected for the versions before.
                    alone = replace(change, keys={"dataset": dataset, **change.keys}, p_holm=change.p)
                    found.setdefault((change.changed, owner), []).append((alone, place == 0))
    return [_edit(frame, *key, _of_one_version(changes)) for key, changes in found.items()], list(notes)


def _of_one_version(changes: Sequence[tuple[Change, bool]]) -> list[tuple[Change, bool]]:
    """Return the changes from the earlier version that has most settings in common with the current one."""
    common: dict[str, tuple[int, float]] = {}
    for change, is_first in changes:
        count, last = common.get(change.before.version, (0, -math.inf))
        moment = change.before.last if change.before.last is not None else -math.inf
        common[change.before.version] = (count + is_first * len(change.settings), max(last, moment))
    chosen = max(common, key=lambda version: common[version])
    return [pair for pair in changes if pair[0].before.version == chosen]


def _names(frame: Frame, column: str) -> list[str]:
    return [str(value) for value in frame.column(column).factorized()[1] if value is not None]


def _edit(frame: Frame, changed: str, name: str, changes: Sequence[tuple[Change, bool]]) -> Edit:
    first = [change for change, is_first in changes if is_first] or [changes[0][0]]
    lines = []
    for change, is_first in changes:
        keys = {key: value for key, value in change.keys.items() if key != changed or changed == "dataset"}
        if change.settings:
            lines.append(_line(keys, change))
        if is_first and change.settings:
            lines.append(_failures(keys, change))
    return Edit(
        changed=changed,
        name=name,
        before=first[0].before,
        after=first[0].after,
        lines=lines,
        settings=sum(len(change.settings) for change in first),
        unpaired=sum(change.unpaired for change in first),
        disturbed=(
            _disturbed(frame, changed, name, first[0].before.version),
            _disturbed(frame, changed, name, first[0].after.version),
        ),
    )


def _disturbed(frame: Frame, changed: str, name: str, version: str) -> int:
    own = where_equal(frame, changed, name) & where_equal(frame, f"{changed}.version", version)
    own &= np.nan_to_num(frame.column("disturbed").floats()) > 0
    return count_distinct(frame.column("id").floats()[own])


def _line(keys: dict[str, Any], change: Change) -> EditLine:
    sides = [np.array([getattr(one, side).median for one in change.settings]) for side in ("before", "after")]
    return EditLine(
        keys=keys,
        metric=change.metric,
        before=_geometric_mean(sides[0]),
        after=_geometric_mean(sides[1]),
        of=None,
        ratio=change.ratio,
        wins=change.wins,
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
    wins = (
        sum(new < old for old, new in shares),
        sum(new > old for old, new in shares),
        sum(new == old for old, new in shares),
    )
    p, told = None, ""
    if wins[2] < len(shares) and not change.deterministic:
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
        deterministic=change.deterministic,
        p=p,
        verdict=told,
    )


@dataclass(frozen=True)
class _Failed:
    """Runs of a setting that failed, and all of them as ones and zeros: equal results once."""

    number: int
    values: list[float]


def _unsound(side: Side) -> _Failed:
    number = sum(side.failures.values())
    if side.same:
        return _Failed(number, [float(side.n == 0)])
    return _Failed(number, [1.0] * number + [0.0] * side.n)
