# SPDX-License-Identifier: Apache-2.0
"""Side effects of an operator, and its death at one of them."""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from random import Random
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.archive import Archive

WRITES = frozenset({"create", "patch", "delete"})
ARCHIVE = "archive"
THOROUGH = os.environ.get("SLAMHIVE_EXAMPLES") == "thorough"
"""True if all moments are played; otherwise some of each kind."""
_ARCHIVE_WRITES = frozenset({"put_run", "put_used", "put_runs", "put_result", "put_sweep", "put_catalog"})


class Point(NamedTuple):
    """A moment at a side effect: the ``number``-th (from 1) of a verb on a resource."""

    verb: str
    resource: str
    number: int
    moment: str

    def __str__(self) -> str:
        return f"{self.moment} {self.verb} {self.resource} #{self.number}"


def chosen(points: Sequence[Point], seed: int) -> list[Point]:
    """Return a point of each verb, resource and moment, drawn by a seed, or all."""
    if THOROUGH:
        return [*points]
    kinds: dict[tuple[str, str, str], list[Point]] = defaultdict(list)
    for point in points:
        kinds[point.verb, point.resource, point.moment].append(point)
    chance = Random(seed)
    return [chance.choice(kinds[kind]) for kind in sorted(kinds)]


class Killed(BaseException):
    """Exception in the place of `kill -9`: nothing after it happens, and nobody may catch it."""


class Faults:
    """A fault hook that notes the side effects, and from one of them on lets nothing happen any more.

    Args:
        death: where to die, if at all.
        meanwhile: called once, at that point, instead of dying.
    """

    def __init__(self, death: Point | None = None, meanwhile: Callable[[], None] | None = None) -> None:
        self.dead = False
        self.reached = False
        self.points: list[Point] = []
        self._death = death
        self._meanwhile = meanwhile
        self._seen: Counter[tuple[str, str, str]] = Counter()

    def __call__(self, moment: str, verb: str, resource: str) -> None:
        """Take note of a call, or die."""
        if self.dead:
            raise Killed
        if verb not in WRITES and verb != ARCHIVE:
            return
        self._seen[moment, verb, resource] += 1
        point = Point(verb, resource, self._seen[moment, verb, resource], moment)
        self.points.append(point)
        if point == self._death:
            self.reached = True
            if self._meanwhile is not None:
                self._meanwhile()
                return
            self.dead = True
            raise Killed


class FaultyArchive:
    """An archive whose writes are fault points, and which is out of reach once the operator is dead."""

    def __init__(self, archive: Archive, faults: Faults) -> None:
        self._archive = archive
        self._faults = faults

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._archive, name)
        if not callable(found):
            return found
        verb = ARCHIVE if name in _ARCHIVE_WRITES else "read"

        def call(*arguments: Any, **options: Any) -> Any:
            self._faults("before", verb, name)
            answer = found(*arguments, **options)
            self._faults("after", verb, name)
            return answer

        return call
