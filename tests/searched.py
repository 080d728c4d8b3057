# SPDX-License-Identifier: Apache-2.0
"""Archives that hold a search: settings by chance, runs that are made up, and the real decisions."""

from __future__ import annotations

import math
import random
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from slamhive.analysis.searches.seen import runs_seen
from slamhive.archive import Archive, SweepRecord
from slamhive.engine.deciding import decide
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord
from slamhive.model.search import SearchRecord, Trial
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, SearchPlan

if TYPE_CHECKING:
    from collections.abc import Mapping

BEGUN = datetime(2026, 1, 1, tzinfo=UTC)
ERROR, COST = "ate.rmse", "usage.cpu.secondsPerDataSecond"


def sweep_of(name: str, objectives: int = 1, trials: int = 30, **search: Any) -> Sweep:
    """Return a search over three settings of an algorithm on two datasets."""
    matrix: list[dict[str, Any]] = [
        {"path": "dataset", "values": ["hall", "yard"]},
        {"path": "parameters.voxelSize", "range": {"from": 0.1, "to": 2, "scale": "Log"}},
        {"path": "parameters.maxRange", "values": [20, 40]},
        {"path": "parameters.deskew", "values": [True, False]},
    ]
    asked: dict[str, Any] = {"method": "TPE" if objectives == 1 else "NSGA-II", "trials": trials}
    asked["objectives"] = [{"metric": metric} for metric in (ERROR, COST)[:objectives]]
    asked |= {"repetitions": {"first": 1, "promote": 2}, **search}
    template = {"spec": {"algorithmRef": {"name": "icp"}}}
    body: dict[str, Any] = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Sweep", "metadata": {"name": name}}
    return Sweep.model_validate(body | {"spec": {"template": template, "matrix": matrix, "search": asked}})


def run_of(plan: SearchPlan, index: int, *, taken: bool = False) -> RunRecord:
    """Return a run: 0.5 m voxels are best, the smallest run out of memory, the largest lose track."""
    point, chance = plan.point(index), random.Random(index)
    voxel, far = point.coordinates["parameters.voxelSize"], point.coordinates.get("parameters.maxRange", 40)
    error = (1 + abs(math.log(voxel / 0.5))) * (1 if far > 20 else 1.1) * math.exp(chance.gauss(0, 0.02))
    error *= {"hall": 0.1, "yard": 0.5}[point.coordinates["dataset"]]
    cost = 0.1 / voxel * far / 20
    crashed, lost = voxel < 0.12, voxel > 1.7
    result = Result(
        evaluation="se3",
        outcome=Outcome.LOST if lost else Outcome.TRACKED,
        coverage=0.2 if lost else 0.99,
        values={} if lost else {"alignment": "se3", "ate": {"rmse": error}},
    )
    finished = BEGUN + timedelta(seconds=60 * index)
    return RunRecord.model_validate(
        {
            "uid": f"{plan.sweep.name}-{index}",
            "name": point.name,
            "sweep": plan.sweep.name,
            "sweepUid": plan.uid,
            "index": index,
            "spec": point.spec,
            "phase": Phase.FAILED if crashed else Phase.SUCCEEDED,
            "reason": Reason.OUT_OF_MEMORY if crashed else None,
            **dict.fromkeys(("created", "started", "finished"), finished),
            "usage": {"cpu": {"meanCores": 1.0, "seconds": 100 * cost, "secondsPerDataSecond": cost}},
            "results": [] if crashed else [result],
            "evaluations": [{"evaluation": "se3", "alignment": "se3"}],
            "provenance": {"contentHash": f"{index:064x}", **({"reusedFrom": "earlier"} if taken else {})},
        }
    )


def searched(
    sweep: Sweep, most_runs: int | None = None, known: int = 0
) -> tuple[SearchPlan, Mapping[int, Any]]:
    """Go through a search as its drivers do; settings are drawn by chance, whatever its method.

    Args:
        sweep: the search.
        most_runs: runs after which it is left as it is.
        known: how many of the first runs took the result of an equal one.
    """
    plan, chance, records = SearchPlan(sweep, FixedCatalog(), strict=False), random.Random(1), {}
    search = sweep.spec.search
    while True:
        decision = decide(plan, runs_seen(records, search))
        if decision.is_over or len(records) == most_runs:
            return plan, records
        if decision.draws:
            for trial in decision.draws:
                plan.draw(trial)
            continue
        if decision.told is not None:
            values = [10 ** chance.uniform(-1, 0.301), chance.choice([20, 40]), chance.random() < 0.5]
            plan.draw(Trial(values=values, told=decision.told))
            continue
        index = decision.wanted[0]
        records[index] = run_of(plan, index, taken=len(records) < known)


def fill_search(archive: Archive, sweep: Sweep, most_runs: int | None = None, known: int = 0) -> SearchPlan:
    """Put a search that was gone through into an archive; arguments as for ``searched``."""
    plan, records = searched(sweep, most_runs, known)
    spec = sweep.spec.model_dump(mode="json", by_alias=True, exclude_unset=True)
    record = SearchRecord(trials=plan.trials, spared=known)
    archive.put_sweep(SweepRecord(uid=plan.uid, name=sweep.name, spec=spec, created=BEGUN, search=record))
    archive.put_runs(records.values())
    return plan
