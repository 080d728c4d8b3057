# SPDX-License-Identifier: Apache-2.0
"""Figures of a search: the best so far over the runs it took, or the front between two objectives."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.metrics import Metric
from slamhive.figures.pictures import Dots, Line, Panel, Picture, PictureAxis
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.model.search import Goal
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from slamhive.figures.asking import Wish
    from slamhive.figures.pictures import Mark
    from slamhive.tables.searches import SearchStory, TriedSetting

_BEST, _COMPLETE, _DROPPED = range(3)


def search(story: SearchStory, wish: Wish) -> Picture:
    """Return the picture of a search's results so far.

    Args:
        story: the search.
        wish: what was asked for.

    Raises:
        InputError: nothing would be seen, or an option means nothing here.
    """
    alone = "the figure of a search has its objectives along its axes"
    wish.refuse(x=alone, y=alone, by=alone, facet=alone, each=alone)
    if not story.search.objectives:
        raise InputError("a threshold has no best setting: figure robustness draws it", "kind")
    if not story.history:
        raise InputError(f"no setting has all its runs yet: {story.message}")
    metrics = [Metric.parse(objective.metric) for objective in story.search.objectives]
    marks, axes = (_front if len(metrics) > 1 else _curve)(story, metrics)
    lost = sum(trial.judged > 0 and None in trial.figures for trial in story.trials)
    dropped = sum(trial.dropped is not None for trial in story.trials)
    without = f", {lost} of all settings had no run with a figure" if lost else ""
    circles = f"circles are settings with all of their runs, {story.block} each: {story.averaged}"
    settings, computed = plural(len(story.trials), "setting"), plural(story.computed, "computed run")
    tried = f"{story.search.method} tried {settings} in {computed}"
    better = "of two settings the one of which fewer runs failed is the better"
    notes = [
        f"{circles}, of runs that did not fail; {better}",
        f"{tried}; dropped after fewer runs: {dropped}{without}",
    ]
    if story.ended > story.computed:
        taken = story.ended - story.computed
        notes.append(f"{taken} further run{'s' if taken > 1 else ''} took the result of an equal one")
    if len(story.contexts) > 1:
        notes.append("figures of dropped settings are not of all datasets and so not drawn")
    if not story.is_over:
        notes.append("the search goes on")
    rest = "without a figure" if len(story.contexts) > 1 else "dropped"
    return Picture(
        x=PictureAxis(axes[0], wish.log.of("x") if len(metrics) > 1 else False, robust=False),
        y=PictureAxis(axes[1], wish.log.of("y"), robust=wish.robust),
        panels=(Panel("", tuple(marks)),),
        series=("best so far" if len(metrics) == 1 else "best", "all runs", rest),
        notes=tuple(notes),
        columns=as_columns([_row(story, trial) for trial in story.trials]),
        runs=story.ended,
    )


def _curve(story: SearchStory, metrics: list[Metric]) -> tuple[list[Mark], tuple[str, str]]:
    (metric,) = metrics
    best = [(step.runs, story.trials[step.best[0]].figures[0]) for step in story.history]
    best.append((max(story.computed, best[-1][0]), best[-1][1]))
    marks: list[Mark] = []
    dropped = [trial for trial in story.trials if trial.dropped is not None]
    if len(story.contexts) < 2:
        marks += _dots(_DROPPED, [(one.at, _drawn(one, 0, metric)) for one in dropped], hollow=False)
    else:
        marks += _dots(
            _DROPPED, [(one.at, math.nan) for one in dropped if one.figures[0] is None], hollow=False
        )
    complete = [trial for trial in story.trials if trial.is_complete]
    marks += _dots(_COMPLETE, [(one.at, _drawn(one, 0, metric)) for one in complete], hollow=True)
    x, y = np.array(best, dtype=float).T
    marks.append(Line(_BEST, x, y * metric.factor, steps=True))
    return marks, ("runs computed", metric.label)


def _front(story: SearchStory, metrics: list[Metric]) -> tuple[list[Mark], tuple[str, str]]:
    places = {
        trial.number: tuple(_drawn(trial, at, metric) for at, metric in enumerate(metrics))
        for trial in story.trials
        if trial.is_complete and None not in trial.figures
    }
    rest = [place for number, place in places.items() if number not in story.best]
    best = sorted(places[number] for number in story.best)
    x, y = np.array(best).T
    marks: list[Mark] = [*_dots(_COMPLETE, rest, hollow=True), Line(-1, x, y, steps=_is_small(story))]
    marks += _dots(_BEST, best, hollow=False, small=False)
    return marks, (metrics[0].label, metrics[1].label)


def _is_small(story: SearchStory) -> bool:
    """Tell whether small is good of both: then what is better lies below and left of the steps."""
    return all(objective.goal is Goal.MINIMIZE for objective in story.search.objectives)


def _dots(series: int, places: list[tuple[float, ...]], *, hollow: bool, small: bool = True) -> list[Mark]:
    if not places:
        return []
    x, y = np.array(places, dtype=float).T
    return [Dots(series, x, y, (hollow,) * len(x), small=small)]


def _drawn(trial: TriedSetting, objective: int, metric: Metric) -> float:
    value = trial.figures[objective]
    return math.nan if value is None else value * metric.factor


def _row(story: SearchStory, trial: TriedSetting) -> dict[str, object]:
    figures = zip((one.metric for one in story.search.objectives), trial.figures, strict=True)
    told = trial.as_json()
    values, _ = told.pop("values"), told.pop("figures")
    return {"setting": told.pop("number"), **values, **dict(figures), **told}
