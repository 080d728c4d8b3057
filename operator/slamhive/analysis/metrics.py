# SPDX-License-Identifier: Apache-2.0
"""A column of numbers with the unit and the digits it is shown in: ``ate.rmse:cm:.3f``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Self

from slamhive.analysis.names import CONFIGURATION, label_of, name_of, with_unit
from slamhive.model.errors import InputError

UNITS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "cm": 1e2, "mm": 1e3},
    "B": {"B": 1.0, "KiB": 2.0**-10, "MiB": 2.0**-20, "GiB": 2.0**-30, "MB": 1e-6, "GB": 1e-9},
    "s": {"s": 1.0, "ms": 1e3, "min": 1 / 60, "h": 1 / 3600},
    "": {"%": 1e2},
}
"""By the unit of the stored number: what it can be shown in, and the factor."""

_SHOWN_IN = {"B": "MiB"}
_FORMAT = re.compile(r"\.\d{1,2}[efg]")


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
        name = name_of(self.column)
        return with_unit(name.short, self.unit or name.unit)

    @property
    def label(self) -> str:
        """Return the name of an axis along which the numbers are drawn, with the unit."""
        return label_of(self.column, self.unit or None)

    def show(self, value: float | None) -> str:
        """Return a stored number as it is shown, a dash for none."""
        if value is None:
            return "–"
        return format(value * self.factor, self.format or ".4g")


def stored_unit(column: str) -> str:
    """Return the unit of a column's numbers, of those that can be shown in several: m, B, s, or nothing."""
    unit = name_of(column).unit
    return unit if unit in UNITS else ""
