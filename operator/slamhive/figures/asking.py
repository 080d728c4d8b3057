# SPDX-License-Identifier: Apache-2.0
"""Questions that figures answer: what was written on the command line, against the columns that there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.boards import COMPETITORS
from slamhive.analysis.columns import ColumnKind
from slamhive.analysis.grouping import Groups, Outcomes, apart, varies
from slamhive.analysis.metrics import Metric
from slamhive.model.base import Choice
from slamhive.model.errors import InputError
from slamhive.reporting.papertables import Statistic
from slamhive.reporting.questions import usual_metric, varied
from slamhive.reporting.titles import keys_text
from slamhive.tables.queries import split_names
from slamhive.tables.timeliness import by_clock

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from slamhive.analysis.frame import Frame
    from slamhive.analysis.searches.robustness import RobustnessWish

MOST_PANELS = 12
MOST_SERIES = 12
MOST_CATEGORIES = 60


class FigureKind(Choice):
    """Kinds of figures that can be drawn: scatter plots, box plots, heat maps, trajectories and others."""

    SCATTER = "scatter"
    LINES = "lines"
    BOX = "box"
    HEAT = "heat"
    PARETO = "pareto"
    TRAJECTORIES = "trajectories"
    ERROR_OVER_TIME = "error-over-time"
    USAGE = "usage"
    ECDF = "ecdf"
    REPETITIONS = "repetitions"
    SEARCH = "search"
    ROBUSTNESS = "robustness"

    @property
    def is_of_files(self) -> bool:
        """True if it is made of files in the folders of runs, and not of the table of runs alone."""
        return self in {FigureKind.TRAJECTORIES, FigureKind.ERROR_OVER_TIME, FigureKind.USAGE}


class Log(Choice):
    """Choices of which axes of a figure are logarithmic."""

    AUTO = "auto"
    X = "x"
    Y = "y"
    XY = "xy"
    NONE = "none"

    def of(self, side: str) -> bool | None:
        """Tell whether the axis of a side is; None where its numbers are to say."""
        if self is Log.AUTO:
            return None
        return self is not Log.NONE and side in str(self.value)


@dataclass(frozen=True)
class Wish:
    """A figure as it was asked for; None where nothing was said.

    Attributes:
        kind: what it shows.
        x, y: columns, or what is drawn of a run.
        by: columns that tell series apart; of a heat map the column of the colours.
        facet: columns that tell panels apart.
        outcomes: which runs count.
        statistic: what stands for several runs.
        log: which axes are logarithmic.
        robust: whether a few numbers far out may be left outside.
        each: whether every run is drawn, where one would stand for several.
        robustness: what a robustness card is asked for by; None of other kinds.
    """

    kind: FigureKind
    x: str | None = None
    y: str | None = None
    by: str | None = None
    facet: str | None = None
    outcomes: Outcomes = Outcomes.TRACKED
    statistic: Statistic = Statistic.MEDIAN
    log: Log = Log.AUTO
    robust: bool = True
    each: bool = False
    robustness: RobustnessWish | None = None

    def columns(self, field: str, default: Sequence[str], frame: Frame) -> tuple[str, ...]:
        """Return the columns that an option names; of the default ones those that vary.

        Args:
            field: the option.
            default: columns that are meant where nothing was said.
            frame: the runs.

        Raises:
            InputError: a column is unknown.
        """
        text = getattr(self, field)
        if text is None:
            return tuple(name for name in default if varies(frame, name))
        return tuple(dict.fromkeys(frame.resolve(name, field) for name in split_names(text)))

    def named(self, field: str, default: Sequence[str], frame: Frame) -> tuple[str, ...]:
        """Return the columns whose values stand side by side along an axis, as ``COLUMN,…``.

        Raises:
            InputError: a column is unknown, or none of the runs has it.
        """
        names = self.columns(field, default, frame) or tuple(default)
        for name in names:
            if frame.column(name).is_empty:
                raise InputError(f"{name}: none of the runs has it: there is nothing to draw", field)
        return names

    def series(self, frame: Frame, besides: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the columns that tell series apart, without those that stand elsewhere."""
        return tuple(name for name in self.columns("by", COMPETITORS, frame) if name not in besides)

    def number(self, field: str, default: str, frame: Frame) -> Metric:
        """Return a column of numbers with the unit it is shown in, as ``COLUMN[:UNIT]``.

        Raises:
            InputError: it is unknown, holds no numbers, or the unit doesn't fit.
        """
        metric = self.place(field, default, frame)
        column = frame.column(metric.column)
        if column.is_empty:
            raise InputError(f"{metric.column}: none of the runs has it: there is nothing to draw", field)
        if np.isnan(column.floats()).all():
            raise InputError(f"{metric.column}: a column of numbers is needed, this one holds none", field)
        return metric

    def place(self, field: str, default: str, frame: Frame) -> Metric:
        """Return a column of any kind, as ``COLUMN[:UNIT]``.

        Raises:
            InputError: it is unknown, or the unit doesn't fit.
        """
        text = getattr(self, field) or default
        name, colon, unit = text.partition(":")
        if frame.has(text):  # a name with a colon in it
            return Metric(text, "", 1.0) if colon else Metric.parse(text)
        column = frame.resolve(name.strip(), field)
        return Metric.parse(f"{column}:{unit}" if colon else column)

    def refuse(self, **why: str) -> None:
        """Complain of options that mean nothing here.

        Raises:
            InputError: one was given.
        """
        for field, sentence in why.items():
            if getattr(self, field) not in {None, False}:
                raise InputError(sentence, field)


def error_of(frame: Frame) -> str:
    """Return the column of the error that is meant where nothing was said."""
    return usual_metric(frame)


def cost_of(frame: Frame) -> str:
    """Return the column of the cost that is meant where nothing was said: mean cores in real time alone."""
    if by_clock(frame).any():
        return "usage.cpu.meanCores"
    names = ("usage.cpu.secondsPerDataSecond", "usage.cpu.meanCores")
    return next((name for name in names if not frame.column(name).is_empty), "usage.memory.peakBytes")


def setting_of(frame: Frame, number: int = 0, otherwise: str = "dataset") -> str:
    """Return the setting that was varied most, or the next one after it."""
    names = [name for name in varied(frame) if not name.startswith("dataset.")]
    return names[number] if len(names) > number else otherwise


@dataclass(frozen=True)
class Parts:
    """Runs by panel.

    Attributes:
        frame: all of them, with what they must be told apart by.
        names: columns that tell panels apart.
        panels: (keys, frame) of each.
    """

    frame: Frame
    names: tuple[str, ...]
    panels: tuple[tuple[dict[str, Any], Frame], ...]

    def title(self, keys: dict[str, Any]) -> str:
        """Return the title of a panel."""
        return keys_text(keys)


def parted(frame: Frame, facet: Sequence[str], told: Sequence[str], metrics: Sequence[str]) -> Parts:
    """Split runs into panels: as asked, and by what must never be pooled and isn't told apart within them.

    Args:
        frame: the runs.
        facet: columns that were asked for.
        told: columns that tell runs of a panel apart.
        metrics: what is drawn of them.
    """
    given = [name for name in facet if name not in told]
    frame, facets = apart(frame, [*given, *told], metrics)
    names = (*given, *facets)
    groups = Groups(frame, names)
    rows = [frame.select(members) for members in groups.members()]
    return Parts(frame, names, tuple(zip(groups.keys, rows, strict=True)))


def nothing(what: str) -> InputError:
    """Return the complaint that no run that counts has what is to be drawn."""
    return InputError(
        f"no run that counts has {what}: there is nothing to draw; --outcomes all takes all runs that were "
        "evaluated"
    )


def check_panels(count: int, names: Sequence[str], frame: Frame, facet: str | None) -> None:
    """Refuse more panels than a figure has room for.

    Raises:
        InputError: there are more.
    """
    if count <= MOST_PANELS:
        return
    distinct = {name: len(frame.column(name).unique()) for name in names}
    most = ", ".join(f"{name} ({number:,})" for name, number in distinct.items())
    first = next(iter(names), "")
    if facet is not None and distinct.get(first, 0) > MOST_PANELS:
        raise InputError(
            f"{first} has {distinct[first]:,} values, and a figure has at most {MOST_PANELS} panels: choose "
            "some of them by --where",
            "facet",
        )
    raise InputError(
        f"{'' if facet else 'panels: '}{count:,} would be needed for the values of {most}, and a figure has "
        f"at most {MOST_PANELS}: choose runs by --where, or tell them apart by --by",
        "facet" if facet else "",
    )


def check_series(names: Sequence[str], found: Sequence[Any]) -> None:
    """Refuse more series than can be told apart.

    Raises:
        InputError: there are more.
    """
    if len(found) > MOST_SERIES:
        raise InputError(
            f"{', '.join(names)}: {len(found):,} series, and at most {MOST_SERIES} can be told apart in a "
            "figure: choose fewer by --where, or name other columns",
            "by",
        )


def check_categories(field: str, name: str, count: int) -> None:
    """Refuse more texts along an axis than can be read.

    Raises:
        InputError: there are more.
    """
    if count > MOST_CATEGORIES:
        raise InputError(
            f"{name} has {count:,} values, and at most {MOST_CATEGORIES} stand side by side: choose some of "
            "them by --where",
            field,
        )


def is_numeric(frame: Frame, name: str) -> bool:
    """Tell whether a column stands along an axis by its numbers."""
    kind = frame.column(name).kind
    return kind in {ColumnKind.NUMBER, ColumnKind.INTEGER}
