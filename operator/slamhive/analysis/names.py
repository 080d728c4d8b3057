# SPDX-License-Identifier: Apache-2.0
"""Names and units of columns: the one table behind tables, pages, figures and reports.

A column such as ``ate.rmse`` is what people type; ``name_of`` says what they call it where they read it. An
axis of a chart has room for all of it ("ATE RMSE [m]", ``label_of``), the head of a table for less
("ATE [m]", ``title_of``). Settings are called as their author called them, with the unit that the manifest
of their algorithm gives them: a table of runs knows those (``Frame.units``), ``declared_units`` has them hold
while it is shown.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


CONFIGURATION = ("parameters.", "input.", "dataset.attributes.", "resources.")
"""Beginnings of the names of settings."""


class Name(NamedTuple):
    """Name and unit of a column as people read them in tables, pages, figures and reports.

    Attributes:
        text: its name, where there is room.
        unit: of its numbers as they are stored; empty for a plain number, and for what isn't one.
        short: its name in the head of a table.
    """

    text: str
    unit: str
    short: str

    @property
    def label(self) -> str:
        """The name of an axis: the text with the unit in brackets."""
        return with_unit(self.text, self.unit)


_NAMES: dict[str, tuple[str, ...]] = {
    # column: (text, unit, name in a table's head if that is shorter)
    "algorithm": ("algorithm", ""),
    "sensors": ("sensors", ""),
    "dataset": ("dataset", ""),
    "repetition": ("repetition", ""),
    "evaluation": ("evaluation", ""),
    "alignment": ("alignment", ""),
    "outcome": ("outcome", ""),
    "status": ("outcome or reason", "", "status"),
    "coverage": ("coverage", ""),
    "scale": ("scale", ""),
    "points.count": ("control points", ""),
    "points.met": ("control points met", ""),
    "points.missing": ("control points missed", ""),
    "points.share": ("share of control points met", ""),
    "points.medianSpacingSeconds": ("median time between control points", "s"),
    "points.rmseStandardError": ("standard error of the RMSE at control points", "m"),
    "points.longestSpacingSeconds": ("longest time between control points", "s"),
    "ate.extended": ("extended ATE RMSE", "m", "extended ATE"),
    "settings": ("evaluation settings", "", "settings"),
    "input.pace": ("pace", ""),
    "input.frameRate": ("frame rate", "Hz"),
    "input.resolution": ("resolution", ""),
    "input.start": ("start", "s"),
    "input.duration": ("duration", "s"),
    "usage.cpu.meanCores": ("mean CPU load", "cores", "CPU"),
    "usage.cpu.maxCores": ("maximum CPU load", "cores", "CPU max"),
    "usage.cpu.seconds": ("CPU time", "s"),
    "usage.cpu.totalSeconds": ("CPU time with the reader", "s", "CPU time, total"),
    "usage.cpu.secondsPerDataSecond": ("CPU time per second of data", "s/s", "CPU"),
    "usage.readerCpuSeconds": ("CPU time of the reader", "s", "reader"),
    "usage.readerShare": ("share of the reader", ""),
    "usage.wallSeconds": ("wall time", "s"),
    "usage.includesReader": ("reader included", ""),
    "usage.memory.peakBytes": ("peak memory", "B"),
    "usage.memory.meanBytes": ("mean memory", "B"),
    "usage.memory.anonymousPeakBytes": ("peak anonymous memory", "B"),
    "usage.memory.workingSetPeakBytes": ("peak working set", "B"),
    "usage.memory.kernelPeakBytes": ("peak memory by the kernel", "B"),
    "usage.memory.kind": ("kind of memory", ""),
    "frames.offered": ("frames offered", ""),
    "frames.processed": ("frames processed", ""),
    "frames.dropped": ("frames dropped", ""),
    "trajectory.poses": ("poses", ""),
    "trajectory.durationSeconds": ("duration of the trajectory", "s"),
    "provenance.cpuModel": ("processor", ""),
    "prepared.frameRate": ("prepared frame rate", "Hz"),
    "prepared.recordedFrameRate": ("recorded frame rate", "Hz"),
    "algorithm.version": ("version of the algorithm", "", "algorithm.version"),
    "dataset.version": ("version of the dataset", "", "dataset.version"),
}

_STATISTICS = {
    "rmse": "RMSE",
    "mean": "mean",
    "median": "median",
    "std": "standard deviation",
    "min": "minimum",
    "max": "maximum",
}
_ERRORS = re.compile(
    r"(?:beside\.(?P<beside>\w+)\.)?"
    r"(?P<error>ate|ateRotationDeg|rpe\[(?P<number>\d+)\]|rpe\[(?P<turn>\d+)\]\.rotationDeg"
    r"|relations(?:\.byTime\[(?P<time>\d+)\])?\.(?P<kind>translation|rotationDeg))"
    r"\.(?P<statistic>" + "|".join(_STATISTICS) + ")"
)
_SHORT = {
    "ate.rmse": "ATE",
    "rpe[0].rmse": "RPE",
    "relations.translation.mean": "relations",
    "relations.rotationDeg.mean": "relations",
}
_SETTINGS = re.compile(r"(parameters|input|resources|dataset\.attributes|label)\.(.+)")


_DECLARED: ContextVar[Mapping[str, str]] = ContextVar("units of settings", default=MappingProxyType({}))


@contextmanager
def declared_units(units: Mapping[str, str]) -> Iterator[None]:
    """Have settings named with their units inside.

    Args:
        units: by column.
    """
    before = _DECLARED.set(units)
    try:
        yield
    finally:
        _DECLARED.reset(before)


def name_of(column: str) -> Name:
    """Return the name of a column for people; one without a name of its own is called as it is."""
    name = _name_of(column)
    unit = _DECLARED.get().get(column)
    return name if unit is None else name._replace(unit=unit)


@lru_cache(maxsize=4096)
def _name_of(column: str) -> Name:
    if column in _NAMES:
        text, unit, *short = _NAMES[column]
        return Name(text, unit, short[0] if short else text)
    if match := _ERRORS.fullmatch(column):
        return _error(column, match)
    if column.endswith("Bytes"):
        return Name(column, "B", column)
    if column.endswith(("Seconds", ".seconds")):
        return Name(column, "s", column)
    return Name(column, "", column)


def _error(column: str, match: re.Match[str]) -> Name:
    error, statistic = match["error"], _STATISTICS[match["statistic"]]
    turned = "otation" in error
    if error.startswith("ate"):
        what = "ATE"
    elif error.startswith("rpe"):
        number = int(match["number"] or match["turn"] or 0)
        what = f"RPE {number + 1}" if number else "RPE"
    else:
        what = "error over relations" if match["time"] is None else f"error over relations {match['time']}"
    text = f"{what}{' of rotation' if turned else ''} {statistic}"
    if match["beside"]:
        text += f" of {match['beside']}"
    return Name(text, "°" if turned else "m", _SHORT.get(column, text))


def with_unit(text: str, unit: str) -> str:
    """Return a name with its unit in brackets, if it has one."""
    return f"{text} [{unit}]" if unit else text


def label_of(column: str, unit: str | None = None, among: Iterable[str] = ()) -> str:
    """Return the name of an axis.

    Args:
        column: what is drawn along it.
        unit: of the numbers as they are drawn; None for the unit that they are stored in.
        among: names of the columns beside it, from which it must stay apart.
    """
    name = name_of(column)
    return with_unit(_own(column, name.text, among), name.unit if unit is None else unit)


def title_of(column: str, unit: str | None = None, among: Iterable[str] = ()) -> str:
    """Return the head of a table's column; arguments as for ``label_of``."""
    name = name_of(column)
    return with_unit(_own(column, name.short, among), name.unit if unit is None else unit)


def _own(column: str, text: str, among: Iterable[str]) -> str:
    """Return a setting's own name, without what it is a setting of where that is clear."""
    match = _SETTINGS.fullmatch(column)
    if text != column or match is None or sum(other.endswith(f".{match[2]}") for other in among) > 1:
        return text
    return match[2]


def columns_ending_in(name: str, columns: Iterable[str]) -> list[str]:
    """Return the columns whose last part is a name: of several the only setting, else all of them, sorted.

    >>> columns_ending_in("k", ["parameters.k", "metrics.k"]), columns_ending_in("x", ["b.x", "a.x", "y"])
    (['parameters.k'], ['a.x', 'b.x'])
    """
    ending = sorted(column for column in columns if column.endswith(f".{name}"))
    settings = [column for column in ending if column.startswith(CONFIGURATION)]
    return settings if len(settings) == 1 else ending
