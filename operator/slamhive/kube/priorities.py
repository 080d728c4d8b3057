# SPDX-License-Identifier: Apache-2.0
"""Priorities of Sweeps: the values of the PriorityClasses of their pods, as far as these may be read.

The API server refuses a pod whose class is not there. Where classes can be read, none is made before it is;
elsewhere one run finds out, and no further one starts before it has a pod.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.kube.capacity import ClusterReading

if TYPE_CHECKING:
    from slamhive.kube.cluster import Cluster

CLASS_NOT_FOUND = "PriorityClassNotFound"
"""Reason of what waits for a PriorityClass."""
CLASSES_SECONDS = 10.0
"""Shortest time between two readings."""
_SHOWN = 8
UNSEEN = (
    "not known, so weights alone decide: the operator may not read PriorityClasses "
    "(sharing.readPriorityClasses of the chart)"
)


class PriorityClasses:
    """PriorityClasses of the cluster, and those that pods were seen to have."""

    def __init__(self) -> None:
        self._reading = ClusterReading()
        self._values: dict[str, int] | None = None
        self._default: tuple[str, int] | None = None
        self._met: set[str] = set()

    async def look(self, cluster: Cluster) -> None:
        """Read the classes now and then, as far as the account may."""
        if not cluster.settings.sharing.read_priority_classes:
            return
        reading = self._reading
        await reading.renew(cluster.clock(), CLASSES_SECONDS, cluster.api.priority_classes)
        if reading.objects is None:
            self._values = self._default = None
            return
        self._values = {one["metadata"]["name"]: one.get("value") or 0 for one in reading.objects}
        default = [one["metadata"]["name"] for one in reading.objects if one.get("globalDefault")]
        self._default = (default[0], self._values[default[0]]) if default else None

    def meet(self, name: str) -> None:
        """Note that a pod has a class."""
        self._met.add(name)

    def miss(self, name: str) -> None:
        """Note that a pod was refused because a class is not there."""
        self._met.discard(name)

    def is_doubtful(self, name: str | None) -> bool:
        """Tell whether nobody knows yet that there is a class of this name."""
        return name is not None and self._values is None and name not in self._met

    def value(self, name: str | None) -> int:
        """Return the priority of pods with a class, None for none; alike for all where none can be read."""
        if self._values is None:
            return 0
        if name is None:
            return self._default[1] if self._default is not None else 0
        return self._values.get(name, 0)

    def lack(self, name: str | None) -> tuple[str, str] | None:
        """Return reason and sentence where it is known that a class is not there."""
        if name is None or self._values is None or name in self._values:
            return None
        others = sorted(self._values)
        shown = ", ".join(others[:_SHOWN]) + (" …" if len(others) > _SHOWN else "")
        return CLASS_NOT_FOUND, (
            f"no run can start: there is no PriorityClass {name!r}, and the API server refuses pods of it; "
            f"it goes on when there is, or with another priorityClassName (there are: {shown or 'none'})"
        )

    def words(self, name: str | None) -> str | None:
        """Return the words of a Sweep's share on its priority; None where there are none."""
        if self._values is None:
            return f"PriorityClass {name}: {UNSEEN}" if name is not None else None
        if name is None and self._default is not None:
            return f"{self._default[1]:,} (PriorityClass {self._default[0]}, the cluster's default)"
        if name is None:
            return None
        return f"{self.value(name):,} (PriorityClass {name}{'' if name in self._values else ', not there'})"
