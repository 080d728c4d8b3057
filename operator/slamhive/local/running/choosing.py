# SPDX-License-Identifier: Apache-2.0
"""Choice of the runs of a sweep that are done this time, by the conditions that tables are asked by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.expressions import ExpressionError, parse_where
from slamhive.analysis.flattening import Results, columns_of_runs
from slamhive.analysis.frame import Frame
from slamhive.local.running.outlook import RunStanding
from slamhive.model.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.analysis.columns import Mask
    from slamhive.local.home.catalog import Workshop
    from slamhive.local.running.outlook import Outlook, Points
    from slamhive.model.sweep import Sweep

_NOTHING_YET = ("usage", "frames", "trajectory", "metrics", "provenance")


@dataclass(frozen=True)
class RunChoice:
    """Choice of how many runs of the sweeps are done this time, and whether finished ones are done again.

    Attributes:
        first: at most so many runs are done, those that tell most; None for all.
        rerun: whether finished runs are done again, and nothing is reused.
        retry_failed: whether failed runs are done again.
    """

    first: int | None = None
    rerun: bool = False
    retry_failed: bool = False


def ask(
    sweeps: Sequence[tuple[Sweep, Points]],
    workshop: Workshop,
    only: str | None = None,
    datasets: Sequence[str] = (),
) -> list[set[int] | None]:
    """Return the runs of each sweep that are asked for, by index; None where none is left out.

    Args:
        sweeps: sweeps with their runs.
        workshop: what their names mean.
        only: a condition on settings.
        datasets: names; none for all.

    Raises:
        InputError: the condition can't be understood, no sweep has a dataset, or no run is left.
    """
    if only is None and not datasets:
        return [None] * len(sweeps)
    known = {name for _, points in sweeps for name in points.dataset_names()}
    for name in datasets:
        if name not in known:
            raise UnknownNameError("dataset", name, sorted(known), "--dataset: the runs here")
    frames = [settings_frame(sweep, points, workshop) for sweep, points in sweeps]
    # Of all sweeps of a command: a condition that means something in one of them is no mistake in the others.
    names = frozenset(name for frame in frames for name in frame.names if _has_meaning(frame, name))
    found: list[set[int] | None] = []
    for frame in frames:
        inside = np.ones(len(frame), dtype=bool)
        if datasets:
            inside &= np.array([name in datasets for name in frame.column("dataset").tolist()], dtype=bool)
        if only is not None:
            inside &= _mask(frame, only, names)
        found.append(set(np.flatnonzero(inside).tolist()))
    if not any(found):
        given = {"--dataset": bool(datasets), "--only": only is not None}
        asked = " and ".join(name for name, is_given in given.items() if is_given)
        raise InputError(f"{asked}: no run meets it, of {sum(map(len, frames)):,}")
    return found


def _has_meaning(frame: Frame, name: str) -> bool:
    """Tell whether runs may be chosen by a column before they ran."""
    return name != "id" and (name.startswith("input.") or not frame.column(name).is_empty)


def settings_frame(sweep: Sweep, points: Points, workshop: Workshop) -> Frame:
    """Return the runs of a sweep as a table of their settings, under the names that results have."""
    found = [points.point(index) for index in range(len(points))]
    specs = [point.spec for point in found]
    labels = dict(sweep.spec.template.metadata.labels)
    attributes = {
        name: place.dataset.spec.known_attributes for name, place in workshop.dataset_places.items()
    }
    datasets = [spec["datasetRef"]["name"] for spec in specs]
    runs: Mapping[str, Sequence[Any]] = {
        "id": range(len(found)),
        "name": [point.name for point in found],
        "sweep": [sweep.name] * len(found),
        "point": [point.index for point in found],
        "algorithm": [spec["algorithmRef"]["name"] for spec in specs],
        "dataset": datasets,
        "sensors": [spec["sensors"] for spec in specs],
        "repetition": [spec["repetition"] for spec in specs],
        "seed": [spec["seed"] for spec in specs],
        "spec": specs,
        "labels": [labels] * len(found),
        "attributes": [attributes.get(name, {}) for name in datasets],
        "evaluations": [()] * len(found),
        **{name: [{}] * len(found) for name in _NOTHING_YET},
    }
    return Frame(*columns_of_runs(runs, Results([], [], [], [], [])))


def _mask(frame: Frame, condition: str, names: frozenset[str]) -> Mask:
    try:
        return parse_where(condition, names).mask(frame)
    except ExpressionError as error:
        raise InputError(f"--only: {error}") from None


def first_of(order: Iterable[int], outlook: Outlook, pending: set[int], first: int) -> set[int]:
    """Return the runs that are done when the first so many are asked for.

    Args:
        order: the order in which they are started.
        outlook: how they stand; what takes over an equal result costs nothing and isn't counted.
        pending: those that are to be done.
        first: how many.
    """
    # Who asks for the first ten wants ten answers, not ten that were there already.
    free = {index for index in pending if outlook.standing[index] == RunStanding.EQUAL}
    counted = (index for index in order if index in pending and index not in free)
    return free | {index for index, _ in zip(counted, range(first), strict=False)}


def twins_among(twins: Mapping[int, int], chosen: set[int] | None, done: set[int]) -> dict[int, int]:
    """Return the runs that wait for an equal one, when some are left out: for none that isn't done at all.

    Args:
        twins: the runs that come out as an earlier one does, with its index.
        chosen: those that are done this time; None for all.
        done: those that are finished.
    """
    if chosen is None:
        return dict(twins)
    found: dict[int, int] = {}
    stand_in: dict[int, int] = {}
    for index in sorted(twins):
        if index not in chosen:
            continue
        original = twins[index]
        if original in chosen or original in done:
            found[index] = original
        elif original in stand_in:
            found[index] = stand_in[original]
        else:
            stand_in[original] = index
    return found
