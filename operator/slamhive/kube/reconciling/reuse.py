# SPDX-License-Identifier: Apache-2.0
"""Finding an equal run that was done before, in the cluster or in the archive.

Equal means equal content: the spec, the Algorithm, the recording, the version of the preparation and the
image. What image a tag stands for is known from the last run that used it.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from slamhive.kube.kinds import Key, Kind, Label
from slamhive.kube.reconciling.records import image_digest, pinned_digest, record_of
from slamhive.kube.reconciling.sweep_runs import SAME_AS
from slamhive.model.results import Phase
from slamhive.model.sweep import CachePolicy
from slamhive.plan import content_hash

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator
    from slamhive.kube.reconciling.catalogue import Catalogue
    from slamhive.kube.reconciling.run import RunFacts
    from slamhive.model.results import RunRecord


class Twins:
    """Finished runs by what their results depend on.

    Args:
        catalogue: Algorithms and Datasets.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._known: dict[tuple[str, str], str] = {}

    def learn(self, run: dict[str, Any]) -> None:
        """Take note of a finished run."""
        status = run["status"]
        provenance = status.get("provenance") or {}
        hashed = provenance.get("contentHash")
        if status.get("phase") == Phase.SUCCEEDED and hashed and not provenance.get("reusedFrom"):
            self._known[run["metadata"]["namespace"], hashed] = run["metadata"]["name"]

    async def find(self, op: Operator, facts: RunFacts) -> RunRecord | None:
        """Return an equal finished run, when this one may take its result."""
        meta = facts.body["metadata"]
        sweep = (meta.get("labels") or {}).get(Label.SWEEP)
        owner = op.store.get(Key(Kind.SWEEP, facts.key.namespace, sweep)) if sweep else None
        done_in_sweep = SAME_AS in (meta.get("annotations") or {})
        if owner is None or (owner["spec"].get("cachePolicy") == CachePolicy.RERUN and not done_in_sweep):
            return None
        hashed = self.content_hash(facts, self._image(op, facts))
        if hashed is None:
            return None
        name = self._known.get((facts.key.namespace, hashed))
        twin = op.store.get(Key(Kind.MAPPING_RUN, facts.key.namespace, name)) if name else None
        if twin is not None and (twin["status"].get("provenance") or {}).get("contentHash") == hashed:
            return record_of(twin)
        if op.archive is None:
            return None
        return await asyncio.to_thread(op.archive.find_reusable, hashed)

    def content_hash(self, facts: RunFacts, image: str | None) -> str | None:
        """Return the hash of all that a run's result depends on; None while a part is not known.

        Args:
            facts: the run.
            image: digest of its image.
        """
        description = facts.variant.description
        if image is None or not description:
            return None
        return content_hash(
            facts.spec_hash,
            self._catalogue.algorithm_hash(facts.algorithm),
            description["datasetSha256"],
            str(description["preparationVersion"]),
            image,
        )

    @staticmethod
    def _image(op: Operator, facts: RunFacts) -> str | None:
        pinned = pinned_digest(facts.algorithm.spec.image or "")
        if pinned is not None:
            return pinned
        algorithm = op.store.get(Key(Kind.ALGORITHM, facts.key.namespace, facts.algorithm.name)) or {}
        known = (algorithm.get("status") or {}).get("imageID")
        return image_digest(known) if known else None
