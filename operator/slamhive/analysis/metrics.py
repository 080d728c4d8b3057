# SPDX-License-Identifier: Apache-2.0
"""Columns as people read them: names with units, and numbers with the digits they are shown in.

An axis of a chart has room for all of a column's name ("ATE RMSE [m]", ``label_of``), the head of a table for
less ("ATE [m]", ``title_of``); ``ate.rmse:cm:.3f`` says unit and digits. Settings are called as their author
called them, with the unit that the manifest of their algorithm gives them: a table of runs knows those
(``Frame.units``), ``declared_units`` has them hold while it is shown.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Self

from slamhive.analysis.measures import CAUSAL, CONFIGURATION, measure_of
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Collection, Container, Iterator, Mapping

    from slamhive.analysis.measures import Measure

UNITS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "cm": 1e2, "mm": 1e3},
    "B": {"B": 1.0, "KiB": 2.0**-10, "MiB": 2.0**-20, "GiB": 2.0**-30, "MB": 1e-6, "GB": 1e-9},
    "s": {"s": 1.0, "ms": 1e3, "min": 1 / 60, "h": 1 / 3600},
    "": {"%": 1e2},
}
"""By the unit of the stored number: what it can be shown in, and the factor."""

_SHOWN_IN = {"B": "MiB"}
_FORMAT = re.compile(r"\.\d{1,2}[efg]")
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


def name_of(column: str) -> Measure:
    """Return the measure of a column, with its name for people; a setting's with the unit declared for it."""
    measure = measure_of(column)
    unit = _DECLARED.get().get(column)
    return measure if unit is None else replace(measure, unit=unit)


def with_unit(text: str, unit: str) -> str:
    """Return a name with its unit in brackets, if it has one."""
    return f"{text} [{unit}]" if unit else text


def label_of(column: str, unit: str | None = None, among: Collection[str] = ()) -> str:
    """Return the name of an axis.

    Args:
        column: what is drawn along it.
        unit: of the numbers as they are drawn; None for the unit that they are stored in.
        among: names of the columns beside it, from which it must stay apart.
    """
    name = name_of(column)
    return with_unit(_own(column, name.text, among), name.unit if unit is None else unit)


def title_of(column: str, unit: str | None = None, among: Collection[str] = ()) -> str:
    """Return the head of a table's column; arguments as for ``label_of``."""
    name = name_of(column)
    return with_unit(_own(column, name.short, among), name.unit if unit is None else unit)


def named_final(column: str, text: str, among: Container[str]) -> str:
    """Return a name, that of an error beside that of the causal trajectory as the final one."""
    return f"{text}, final" if f"{CAUSAL}{column}" in among else text


def _own(column: str, text: str, among: Collection[str]) -> str:
    """Return a setting's own name, without what it is a setting of where that is clear."""
    if (final := named_final(column, text, among)) != text:
        return final
    match = _SETTINGS.fullmatch(column)
    if text != column or match is None or sum(other.endswith(f".{match[2]}") for other in among) > 1:
        return text
    return match[2]


@dataclass(frozen=True)
class Metric:
    """A column, and how its numbers are shown.

    Attributes:
        column: name of the column.
        unit: unit shown, empty for a plain number.
        factor: what the stored number is multiplied by.
        format: Python's format of a number, empty for four significant digits.
    """

    column: str
    unit: str
    factor: float
    format: str = ""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``COLUMN[:UNIT][:FORMAT]``.

        Raises:
            InputError: the unit doesn't fit the column, or the format is none.
        """
        column, *rest = text.split(":")
        base = stored_unit(column)
        unit, shape = base, ""
        if base in _SHOWN_IN and not column.startswith(CONFIGURATION):  # settings stand as they were written
            unit, shape = _SHOWN_IN[base], ".0f"
        for part in rest:
            if _FORMAT.fullmatch(part):
                shape = part
            elif part in UNITS[base]:
                unit = part
            else:
                units = ", ".join(UNITS[base])
                raise InputError(f"{text}: {part!r} is neither a unit of {column} ({units}) nor like .3f")
        return cls(column, unit, UNITS[base].get(unit, 1.0), shape)

    @property
    def heading(self) -> str:
        """Return the column's name with the unit."""
        return f"{self.column} [{self.unit}]" if self.unit else self.column

    @property
    def title(self) -> str:
        """Return the column's name for people, with the unit."""
        return self.title_among(())

    def title_among(self, names: Container[str]) -> str:
        """Return the same, as it is told apart from other columns beside it."""
        name = name_of(self.column)
        return with_unit(named_final(self.column, name.short, names), self.unit or name.unit)

    @property
    def label(self) -> str:
        """Return the name of an axis along which the numbers are drawn, with the unit."""
        return self.label_among(())

    def label_among(self, names: Collection[str]) -> str:
        """Return the same, as it is told apart from other axes."""
        return label_of(self.column, self.unit or None, names)

    def show(self, value: float | None) -> str:
        """Return a stored number as it is shown, a dash for none."""
        if value is None:
            return "–"
        return format(value * self.factor, self.format or ".4g")


def stored_unit(column: str) -> str:
    """Return the unit of a column's numbers, of those that can be shown in several: m, B, s, or nothing."""
    unit = name_of(column).unit
    return unit if unit in UNITS else ""
