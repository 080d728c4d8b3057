# SPDX-License-Identifier: Apache-2.0
"""Findings: what is wrong in a Sweep that is judged to its end, and what can't be judged for that.

A Sweep with mistakes has no plan that could run. The rest of it makes one that can be looked at: so mistakes
of paths, values and names are told together. What would only follow from an earlier mistake is not told.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from slamhive.model.errors import InputError
from slamhive.plan.paths import KNOWN, bounded, parse_path

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.plan.paths import Path

ANY = "*"
"""Stands for any field, where it isn't known which one was meant."""


def _none_hidden(_kind: str, _name: str) -> bool:
    return False


@dataclass
class Findings:
    """Mistakes of one Sweep, and what is not known because of them.

    Attributes:
        problems: a sentence for each mistake, the field first.
        lost: first words of the paths that something wrong may have been meant to set.
        labels: labels of axes that can't be used.
        hidden: tells whether a manifest that can't be used may hold an entry of the catalog, by kind
            (``algorithm``, ``dataset``) and name; without a name, any of that kind.
    """

    problems: list[str] = field(default_factory=list)
    lost: set[str] = field(default_factory=set)
    labels: set[str] = field(default_factory=set)
    hidden: Callable[[str, str], bool] = _none_hidden

    def lose(self, text: str) -> None:
        """Note that a path as it was written sets nothing."""
        self.lost.add(meant(text))

    def lose_axis(self, label: str, path: str | None) -> None:
        """Note that an axis can't be used."""
        self.labels.add(label)
        self.lose(path or "")

    def refuse(self) -> None:
        """Raise what was found.

        Raises:
            InputError: with the first sentences and how many more there are, one a line.
        """
        if self.problems:
            raise InputError("\n".join(bounded(self.problems)))

    def unsure(self, *paths: Path) -> bool:
        """Tell whether something wrong may have been meant to set one of some paths."""
        return bool(self.lost) and (ANY in self.lost or any(path[0] in self.lost for path in paths))


def meant(text: str) -> str:
    """Return the first word of the path that a text most probably was meant to be.

    >>> meant("parameter.voxelSize"), meant("algoritm"), meant("nonsense")
    ('parameters', 'algorithmRef', '*')
    """
    try:
        return parse_path(text, "")[0]
    except InputError:
        pass
    head = text.partition(".")[0]
    words = {path.partition(".")[0] for path in KNOWN}
    for candidates, wanted, cutoff in ((words, head, 0.8), (KNOWN, text, 0.6), (words, head, 0.6)):
        close = difflib.get_close_matches(wanted, candidates, n=1, cutoff=cutoff)
        if close:
            first = close[0].partition(".")[0]
            return {"algorithm": "algorithmRef", "dataset": "datasetRef"}.get(first, first)
    return ANY
