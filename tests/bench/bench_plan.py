# SPDX-License-Identifier: Apache-2.0
"""Benchmark of plans: a sweep of 80,000 points counted, indexed and expanded, beside its limits."""

from __future__ import annotations

import resource
import statistics
import sys
import time
from pathlib import Path

import yaml

from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, Plan, plan_problems, spec_hash

EXAMPLE = Path(__file__).parents[2] / "examples" / "icra2023-80000.yaml"
ALGORITHM = """
apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: NAME}
spec:
  image: none
  modes: [{name: mono}, {name: stereo}]
  output: {frame: body}
  parameters: {}
"""


def _catalog(sweep: Sweep) -> FixedCatalog:
    """Give each algorithm of the sweep fifty parameters, as many as real ones have."""
    parameters = {f"Group.parameter{n}": {"type": "Number", "default": n / 7} for n in range(47)}
    parameters |= {
        "nFeatures": {"type": "Integer", "default": 1000},
        "scaleFactor": {"type": "Number", "default": 1.2},
        "loopClosing": {"type": "Boolean", "default": True},
    }
    names = next(axis.values for axis in sweep.spec.matrix if axis.path == "algorithm") or []
    objects = []
    for name in names:
        body = yaml.safe_load(ALGORITHM.replace("NAME", name))
        body["spec"]["parameters"] = parameters
        objects.append(Algorithm.model_validate(body))
    return FixedCatalog.of(objects)


def _report(what: str, figure: float, unit: str, limit: float | None = None, note: str = "") -> None:
    beside = note if limit is None else f"limit {limit:g} {unit}{'' if figure < limit else ', TOO MUCH'}"
    print(f"{what} · {figure:.3f} {unit} · {beside}", flush=True)


def main() -> int:
    """Print each figure beside its limit; the exit code is 1 when names or hashes are wrong."""
    started = time.perf_counter()
    sweep = load_file(EXAMPLE)[0]
    assert isinstance(sweep, Sweep)
    count = len(Plan(sweep, FixedCatalog(), strict=False))
    _report(f"read the file and count {count} points", time.perf_counter() - started, "s", 1)

    plan = Plan(sweep, _catalog(sweep), strict=False)
    single = []
    for index in range(17, count, 801):
        started = time.perf_counter()
        point = plan.point(index)
        _ = point.name, point.spec, point.spec_hash
        single.append((time.perf_counter() - started) * 1e3)
    _report("one point: name, spec and hash (median)", statistics.median(single), "ms", 1)

    started = time.perf_counter()
    expanded = [(point.name, point.spec_hash) for point in plan]
    _report(f"{len(expanded)} names and specHashes", time.perf_counter() - started, "s", 8)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    _report("peak memory of the whole process", peak, "MB", 200)

    sample = range(0, count, 997)
    started = time.perf_counter()
    slow = [spec_hash(plan.point(index).spec) for index in sample]
    pace = (time.perf_counter() - started) / len(slow) * count
    equal = slow == [expanded[index][1] for index in sample]
    verdict = "equal" if equal else "DIFFER"
    _report("the plain way, scaled up, for comparison", pace, "s", note=f"hashes {verdict}")
    started = time.perf_counter()
    plan.start_order()
    _report("order of starting", time.perf_counter() - started, "s")
    started = time.perf_counter()
    plan_problems(plan)
    _report("check against the catalog", time.perf_counter() - started, "s")
    return 0 if equal and len(set(expanded)) == count else 1


if __name__ == "__main__":
    sys.exit(main())
