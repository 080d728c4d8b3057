# SPDX-License-Identifier: Apache-2.0
"""Plans for the commands: from manifests to the runs that they ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.model.errors import InputError
from slamhive.model.run import MappingRun
from slamhive.model.sweep import RunTemplate, Sweep, SweepSpec, TemplateMeta
from slamhive.plan import plan_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.model.loading import Kind
    from slamhive.plan import Catalog, Plan


CANCELLED = "spec.cancel: true; a cancelled run is not started"


def sweeps_of(objects: Sequence[Kind]) -> list[Sweep]:
    """Return the sweeps among objects; a single run is a sweep of one.

    Raises:
        InputError: a run that shall be started is cancelled.
    """
    for item in objects:
        if isinstance(item, MappingRun) and item.spec.cancel:
            raise InputError(f"MappingRun {item.name}: {CANCELLED}")
    return [
        item if isinstance(item, Sweep) else _as_sweep(item)
        for item in objects
        if isinstance(item, Sweep | MappingRun)
    ]


def _as_sweep(single: MappingRun) -> Sweep:
    spec = single.spec.model_dump(mode="json", by_alias=True, exclude_unset=True)
    template = RunTemplate(
        metadata=TemplateMeta(labels=single.metadata.labels, annotations=single.metadata.annotations),
        spec=spec,
    )
    return Sweep(metadata=single.metadata, spec=SweepSpec(template=template))


def planned(sweep: Sweep, catalog: Catalog, *, strict: bool) -> Plan:
    """Return the runs of a sweep.

    Args:
        sweep: the sweep.
        catalog: what its names mean.
        strict: whether a check reports names that are not in the catalog.

    Raises:
        InputError: with the sweep's name.
    """
    try:
        return plan_of(sweep, catalog, strict=strict)
    except InputError as error:
        raise InputError(f"{sweep.kind} {sweep.name}: {error}") from None
