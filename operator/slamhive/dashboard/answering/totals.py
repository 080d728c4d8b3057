# SPDX-License-Identifier: Apache-2.0
"""Totals of archived sweeps: how many runs each one asks for. Computed once for each sweep and remembered."""

from __future__ import annotations

import json
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from slamhive.dashboard.problems import TooCostly
from slamhive.tables.searches import most_runs

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.archive.records import SweepRecord
    from slamhive.dashboard.answering.workers import AnswerWorkers

KEPT = 10_000


@dataclass(frozen=True)
class StoredSweeps:
    """The sweeps that an archive knows.

    Attributes:
        records: in the order of storing.
        totals: number of runs by UID; None where it can't be told.
    """

    records: Sequence[SweepRecord] = ()
    totals: Mapping[str, int | None] = field(default_factory=dict)


class SweepTotals:
    """Remembers how many runs sweeps were asked for.

    Args:
        workers: lay their plans out.
    """

    def __init__(self, workers: AnswerWorkers) -> None:
        self._workers = workers
        self._known: OrderedDict[tuple[str, str], int | None] = OrderedDict()

    async def of(self, records: Sequence[SweepRecord]) -> dict[str, int | None]:
        """Return the number of runs of some sweeps by their UIDs; None where it can't be worked out.

        A sweep whose plan takes more than an answer may is one of those, and is not tried again.
        """
        keys = {(one.uid, json.dumps(one.spec, sort_keys=True)): one for one in records}
        news = {key: one for key, one in keys.items() if key not in self._known}
        if news:
            try:
                found = await self._workers.compute(lambda: [most_runs(one) for one in news.values()])
                self._known.update(zip(news, found, strict=True))
            except TooCostly:
                await self._one_by_one(news)
            while len(self._known) > max(KEPT, len(keys)):
                self._known.popitem(last=False)
        return {uid: self._known.get((uid, spec)) for uid, spec in keys}

    async def _one_by_one(self, news: Mapping[tuple[str, str], SweepRecord]) -> None:
        for key, record in news.items():
            try:
                self._known[key] = await self._workers.compute(lambda one=record: most_runs(one))  # type: ignore[misc]
            except TooCostly:
                self._known[key] = None
