# SPDX-License-Identifier: Apache-2.0
"""Rows of ``slamhive doctor``: what there is to work with, what that costs, and what helps."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from slamhive.model.base import Choice


class State(Choice):
    """States of a thing that ``slamhive doctor`` checks, such as there or missing."""

    THERE = "there"
    LIMITED = "limited"
    MISSING = "missing"
    UNKNOWN = "unknown"
    UNNEEDED = "not needed"


@dataclass(frozen=True)
class ReadinessRow:
    """Result of one check of ``slamhive doctor``.

    Attributes:
        check: what it is.
        state: whether it is there.
        found: what was seen of it.
        costs: what comes of that; empty where nothing is lost.
        helps: what would change it.
        needed: whether nothing can be run without it.
    """

    check: str
    state: State
    found: str
    costs: str = ""
    helps: str = ""
    needed: bool = False

    @property
    def stops(self) -> bool:
        """Tell whether nothing can be run because of it."""
        return self.needed and self.state in {State.MISSING, State.UNKNOWN}

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self) | {"state": str(self.state)}


def there(check: str, found: str, *, needed: bool = False) -> ReadinessRow:
    """Return the row of what is there."""
    return ReadinessRow(check, State.THERE, found, needed=needed)


def limited(check: str, found: str, costs: str, helps: str = "", *, needed: bool = False) -> ReadinessRow:
    """Return the row of what is there, but less than it could be."""
    return ReadinessRow(check, State.LIMITED, found, costs, helps, needed)


def missing(check: str, found: str, costs: str, helps: str = "", *, needed: bool = False) -> ReadinessRow:
    """Return the row of what isn't there."""
    return ReadinessRow(check, State.MISSING, found, costs, helps, needed)
