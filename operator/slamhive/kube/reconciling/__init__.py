# SPDX-License-Identifier: Apache-2.0
"""Reconcilers: each looks at one object, asks the engine what to do, does it, and writes what changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.reconciling.catalogue import Catalogue
from slamhive.kube.reconciling.evaluating import Evaluations
from slamhive.kube.reconciling.reuse import Twins
from slamhive.kube.reconciling.run import RunReconciler
from slamhive.kube.reconciling.sweep import SweepReconciler
from slamhive.kube.reconciling.variants import DatasetReconciler

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator, Reconcile

__all__ = ["RECONCILERS", "reconcilers"]


def reconcilers() -> dict[Kind, Reconcile]:
    """Return a fresh set of reconcilers by kind, which share what they know."""
    catalogue = Catalogue()
    twins = Twins(catalogue)
    evaluations = Evaluations(catalogue)
    runs = RunReconciler(catalogue, evaluations, twins)
    sweeps = SweepReconciler(catalogue)
    datasets = DatasetReconciler()

    async def wake(op: Operator, key: Key) -> float | None:
        """Look again at what waited for the catalog."""
        for waiting in (*runs.waiting(key.namespace), *sweeps.waiting(key.namespace)):
            op.queue.add(waiting)
        return None

    async def dataset(op: Operator, key: Key) -> float | None:
        await wake(op, key)
        return await datasets(op, key)

    return {
        Kind.ALGORITHM: wake,
        Kind.DATASET: dataset,
        Kind.MAPPING_RUN: runs,
        Kind.SWEEP: sweeps,
        Kind.EVALUATION: evaluations,
    }


RECONCILERS = reconcilers()
"""Those of an operator's process."""
