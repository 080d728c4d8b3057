# SPDX-License-Identifier: Apache-2.0
"""Finished results in SQL: SQLite on a workstation, SQLite or PostgreSQL beside a cluster.

Whoever finishes or evaluates a run writes here (the workstation's runner, the operator, importers);
``slamhive results`` and the dashboard only read. A run is keyed by its UID and a result by run and
evaluation, so writing the same thing twice is harmless.
"""

from slamhive.archive.archive import Archive
from slamhive.archive.records import CatalogEntry, Cost, EarlierRun, FinishedPoint, SweepRecord, Totals

__all__ = ["Archive", "CatalogEntry", "Cost", "EarlierRun", "FinishedPoint", "SweepRecord", "Totals"]
