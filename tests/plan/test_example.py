# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

from slamhive.model.loading import load_file
from slamhive.model.sweep import Sweep
from slamhive.plan import FixedCatalog, Plan, plan_problems

EXAMPLE = Path(__file__).parents[2] / "examples" / "icra2023-80000.yaml"


def test_the_papers_example_has_80000_runs() -> None:
    (sweep,) = load_file(EXAMPLE)
    assert isinstance(sweep, Sweep)
    points = Plan(sweep, FixedCatalog(), strict=False)
    assert len(points) == 80_000
    assert plan_problems(points) == []
    assert points.grid.shape == (10, 4, 4, 10, 10, 5)
    last = points.point(79_999)
    assert last.coordinates["dataset"] == "tum-rgbd-fr3-long-office"
    assert last.spec["input"] == {"remap": {}, "frameRate": 2, "resolution": 1}
    assert last.spec["sensors"] == "stereo-inertial"
    assert len(plan_problems(Plan(sweep, FixedCatalog()), 100)) == 20
