# SPDX-License-Identifier: Apache-2.0
"""The catalog that a plan is made against: Algorithms and Datasets by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, Self

from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class Catalog(Protocol):
    """Interface of a catalog for plans: Algorithms and Datasets, from folders or from a cluster."""

    @property
    def algorithms(self) -> Mapping[str, Algorithm]:
        """Return the Algorithms by name."""

    @property
    def datasets(self) -> Mapping[str, Dataset]:
        """Return the Datasets by name."""


@dataclass(frozen=True)
class FixedCatalog:
    """A catalog that is a given set of objects."""

    algorithms: Mapping[str, Algorithm] = field(default_factory=dict)
    datasets: Mapping[str, Dataset] = field(default_factory=dict)

    @classmethod
    def of(cls, objects: Iterable[object]) -> Self:
        """Collect the Algorithms and Datasets among objects of any kind."""
        items = list(objects)
        return cls(
            algorithms={item.name: item for item in items if isinstance(item, Algorithm)},
            datasets={item.name: item for item in items if isinstance(item, Dataset)},
        )


def select(catalog: Catalog, kind: str, labels: Mapping[str, str]) -> list[str]:
    """Return the names of the entries that carry all of some labels, sorted.

    Args:
        catalog: where to look.
        kind: ``algorithm`` or ``dataset``.
        labels: labels that must be equal.
    """
    entries: Mapping[str, Algorithm | Dataset]
    entries = catalog.algorithms if kind == "algorithm" else catalog.datasets
    return sorted(name for name, entry in entries.items() if labels.items() <= entry.metadata.labels.items())
