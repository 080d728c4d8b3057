# SPDX-License-Identifier: Apache-2.0
"""Reuse: finds an equal run that was done before, in the cluster or in the archive.

Equal means equal content: the spec, the Algorithm, the recording, the version of the preparation and the
image. What image a tag stands for is known from the last run that used it.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from slamhive.engine import LoadConditions
from slamhive.kube.api.kinds import Key, Kind, Label, annotations_of, key_of, labels_of
from slamhive.kube.reconciling.sweep_runs import SAME_AS
from slamhive.kube.reconciling.variants import Wanted
from slamhive.kube.records import record_of
from slamhive.kube.status import phase_of
from slamhive.model.results import Phase
from slamhive.model.status import AlgorithmStatus, DatasetStatus, MappingRunStatus
from slamhive.model.sweep import CachePolicy
from slamhive.plan import content_hash, image_digest, pinned_digest

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.archive import Archive
    from slamhive.kube.cluster import Cluster
    from slamhive.kube.reconciling.catalogue import Catalogue
    from slamhive.kube.reconciling.run_status import RunFacts
    from slamhive.model.algorithm import Algorithm
    from slamhive.model.results import RunRecord
    from slamhive.plan import Plan, Point


class ReusableRuns:
    """Finished runs by what their results depend on.

    Args:
        catalogue: Algorithms and Datasets.
        archive: where further ones are found, if anywhere.
    """

    def __init__(self, catalogue: Catalogue, archive: Archive | None = None) -> None:
        self._catalogue = catalogue
        self._archive = archive
        self._known: dict[tuple[str, str], str] = {}
        self._learned: dict[Key, tuple[str, str | None]] = {}
        self._has_looked_around = False
        self.conditions: set[LoadConditions] = set()
        """Conditions that the cluster's runs are measured under, as far as they told of them."""

    def learn(self, run: dict[str, Any]) -> None:
        """Take note of a run, if it has finished."""
        if not phase_of(run["status"]).is_finished:
            return
        # It is looked at again after each write to it; what is needed here doesn't change any more.
        key, uid = key_of(Kind.MAPPING_RUN, run), run["metadata"]["uid"]
        if self._learned.get(key, ("", None))[0] == uid:
            return
        self.forget(key)
        self._learned[key] = uid, None
        # Only what is needed: it is done for all finished runs of a cluster at once.
        told = {name: run["status"][name] for name in ("phase", "provenance") if name in run["status"]}
        status = MappingRunStatus.of({"status": told})
        provenance = status.provenance
        hashed = provenance.content_hash
        # Only runs that computed: who took over another's result would lead there anyway.
        if status.phase is Phase.SUCCEEDED and hashed and not provenance.reused_from:
            self._learned[key] = uid, hashed
            self._known[key.namespace, hashed] = key.name
            self.conditions.add(LoadConditions.of(provenance))

    def forget(self, key: Key) -> None:
        """Forget a run that is gone: what is archived is found there, and a large Sweep's are many."""
        _, hashed = self._learned.pop(key, (None, None))
        if hashed is not None and self._known.get((key.namespace, hashed)) == key.name:
            del self._known[key.namespace, hashed]

    def _look_around(self, cluster: Cluster) -> None:
        """Learn all finished runs, once.

        After its start an operator looks at runs in any order: without this, which result a run takes over,
        and whether usage comes with it, would depend on that order.
        """
        if not self._has_looked_around:
            self._has_looked_around = True
            for namespace in cluster.settings.namespaces:
                for run in cluster.store.of(Kind.MAPPING_RUN, namespace):
                    self.learn(run)

    async def find(self, cluster: Cluster, facts: RunFacts) -> RunRecord | None:
        """Return an equal finished run, when this one may take its result."""
        if not self._may_reuse(cluster, facts):
            return None
        hashed = self.content_hash(facts, self._image(cluster, facts))
        if hashed is None:
            return None
        self._look_around(cluster)
        name = self._known.get((facts.key.namespace, hashed))
        twin = cluster.store.get(Key(Kind.MAPPING_RUN, facts.key.namespace, name)) if name else None
        # The name may belong to another run by now: what it holds decides.
        if twin is not None and MappingRunStatus.of(twin).provenance.content_hash == hashed:
            return record_of(twin)
        if self._archive is None:
            return None
        kept = await asyncio.to_thread(self._archive.find_reusable, hashed)
        if kept is not None and _ran_on(cluster, kept):
            self.conditions.add(LoadConditions.of(kept.provenance))  # its object is gone: maybe never seen
        return kept

    @staticmethod
    def _may_reuse(cluster: Cluster, facts: RunFacts) -> bool:
        """Tell whether a run may take another one's result."""
        sweep = labels_of(facts.body).get(Label.SWEEP)
        owner = cluster.store.get(Key(Kind.SWEEP, facts.key.namespace, sweep)) if sweep else None
        if owner is None:
            return False  # a run by itself has no cachePolicy that could turn it off
        # `Rerun` asks for new results, but points of one Sweep that come out equal still run once.
        done_in_sweep = SAME_AS in annotations_of(facts.body)
        return done_in_sweep or owner["spec"].get("cachePolicy") != CachePolicy.RERUN

    def content_hash(self, facts: RunFacts, image: str | None) -> str | None:
        """Return the hash of all that a run's result depends on; None while a part is not known.

        Args:
            facts: the run.
            image: digest of its image.
        """
        return self._hash(facts.spec_hash, facts.algorithm, facts.variant.description, image)

    def contents(self, cluster: Cluster, namespace: str, plan: Plan) -> Callable[[Point], str | None]:
        """Return a function that tells the content hash that a run of a plan would have now.

        It holds what is known at this moment, so that any thread may call it.
        """
        images = {
            name: self._image_of(cluster, namespace, algorithm) for name, algorithm in plan.algorithms.items()
        }
        datasets = (cluster.store.get(Key(Kind.DATASET, namespace, name)) for name in plan.datasets)
        variants = {
            entry.name: entry.description
            for body in datasets
            for entry in DatasetStatus.of(body or {}).variants
        }

        def content(point: Point) -> str | None:
            spec = point.spec
            algorithm = plan.algorithms.get(spec["algorithmRef"]["name"])
            dataset = plan.datasets.get(spec["datasetRef"]["name"])
            if algorithm is None or dataset is None:
                return None
            description = variants.get(Wanted.by(spec, algorithm, dataset).name)
            return self._hash(point.spec_hash, algorithm, description, images.get(algorithm.name))

        return content

    def _hash(
        self, spec_hash: str, algorithm: Algorithm, description: dict[str, Any] | None, image: str | None
    ) -> str | None:
        if image is None or not description:
            return None
        return content_hash(
            spec_hash,
            self._catalogue.algorithm_hash(algorithm),
            description["datasetSha256"],
            str(description["preparationVersion"]),
            image,
            description.get("preparedBy"),
        )

    def _image(self, cluster: Cluster, facts: RunFacts) -> str | None:
        return self._image_of(cluster, facts.key.namespace, facts.algorithm)

    @staticmethod
    def _image_of(cluster: Cluster, namespace: str, algorithm: Algorithm) -> str | None:
        pinned = pinned_digest(algorithm.spec.image or "")
        if pinned is not None:
            return pinned
        body = cluster.store.get(Key(Kind.ALGORITHM, namespace, algorithm.name)) or {}
        known = AlgorithmStatus.of(body).image_id
        return image_digest(known) if known else None


def _ran_on(cluster: Cluster, run: RunRecord) -> bool:
    """Tell whether an archived run was computed on this cluster.

    A workstation's record has no namespace. Where clusters have no identity, our namespaces are ours.
    """
    ours = run.cluster == cluster.identity and run.namespace in cluster.settings.namespaces
    return ours and run.provenance.reused_from is None
