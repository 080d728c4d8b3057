# SPDX-License-Identifier: Apache-2.0
"""Reconcilers: each looks at one object, asks the engine what to do, does it, and writes what changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.reconciling.archiving import Keeper
from slamhive.kube.reconciling.catalogue import Catalogue
from slamhive.kube.reconciling.evaluating import Evaluations
from slamhive.kube.reconciling.reuse import ReusableRuns
from slamhive.kube.reconciling.run import RunReconciler
from slamhive.kube.reconciling.sweep import SweepReconciler
from slamhive.kube.reconciling.variants import DatasetReconciler

if TYPE_CHECKING:
    from slamhive.archive import Archive
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.loop import Reconcile
    from slamhive.sampling import Proposer

__all__ = ["reconcilers"]


def reconcilers(archive: Archive | None = None, sampler: Proposer | None = None) -> dict[Kind, Reconcile]:
    """Return a fresh set of reconcilers by kind, which share what they know.

    Args:
        archive: where finished runs are kept, if anywhere.
        sampler: proposes what searches try; default: one that nobody else uses.
    """
    catalogue = Catalogue()
    reusable = ReusableRuns(catalogue, archive)
    evaluations = Evaluations(catalogue)
    keeper = Keeper(catalogue, archive) if archive is not None else None
    runs = RunReconciler(catalogue, evaluations, reusable, keeper)
    sweeps = SweepReconciler(catalogue, archive, sampler, reusable)
    datasets = DatasetReconciler()

    async def wake(cluster: Cluster, key: Key) -> float | None:
        """Look again at what waited for the catalog."""
        for waiting in (*runs.waiting(key.namespace), *sweeps.waiting(key.namespace)):
            cluster.queue.add(waiting)
        return None

    async def dataset(cluster: Cluster, key: Key) -> float | None:
        await wake(cluster, key)
        return await datasets(cluster, key)

    return {
        Kind.ALGORITHM: wake,
        Kind.DATASET: dataset,
        Kind.MAPPING_RUN: runs,
        Kind.SWEEP: sweeps,
        Kind.EVALUATION: evaluations,
    }
