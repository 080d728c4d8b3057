# SPDX-License-Identifier: Apache-2.0
"""Every number that evo 1.38.1 gave for real runs, to 1e-9 relative or 1e-12 absolute."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive_eval import (
    Association,
    Options,
    RpeOptions,
    Statistics,
    Trajectory,
    align,
    ape_errors,
    associate,
    evaluate,
    find_pairs,
    interpolate,
    read_trajectory,
    rpe_errors,
)

if TYPE_CHECKING:
    from pathlib import Path

Load = Callable[[str], tuple[Association, Trajectory, Trajectory]]

LIMIT = 1e-9
FILES = {
    "fr2_desk": ("fr2_desk_groundtruth.txt", "fr2_desk_ORB.txt"),
    "fr2_desk_kf": ("fr2_desk_groundtruth.txt", "fr2_desk_ORB_kf_mono.txt"),
    "fr1_xyz": ("freiburg1_xyz-groundtruth.txt", "freiburg1_xyz-rgbdslam_drift.txt"),
}
RELATIONS = {
    "translation_part": "trans_part",
    "rotation_part": "rot_part",
    "full_transformation": "full",
    "rotation_angle_deg": "angle_deg",
    "point_distance": "point_distance",
    "point_distance_error_ratio": "point_distance_error_ratio",
}
WITHOUT_PEER = {"ape|translation_part|sim3|xy"}
"""Projected into a plane, which isn't built yet."""


def deviation(found: float | None, expected: float) -> float:
    assert found is not None
    return 0.0 if abs(found - expected) <= 1e-12 else abs(found - expected) / abs(expected)


def worst(found: Statistics | None, expected: dict[str, float]) -> float:
    assert found is not None
    return max(deviation(value, expected[name]) for name, value in found.as_dict().items())


def test_all_runs_of_the_paper(icra2023: Path) -> None:
    read = functools.cache(read_trajectory)
    reference = json.loads((icra2023 / "reference.json").read_text())["runs"]
    assert len(reference) == 81
    for run in reference:
        truth = read(icra2023 / "groundtruth" / f"{run['dataset']}.txt")
        estimate = read_trajectory(icra2023 / "runs" / f"{run['id']:03}" / "traj.txt")
        sim3 = evaluate(truth, estimate, Options(alignment="sim3"))
        se3 = evaluate(truth, estimate, Options(alignment="se3", rpe=()))
        assert sim3.matched == se3.matched == run["matched_poses"], run["id"]
        assert worst(sim3.ate, run["ate_sim3"]) <= LIMIT, run["id"]
        assert worst(se3.ate, run["ate_se3"]) <= LIMIT, run["id"]
        assert worst(sim3.rpe[0].statistics, run["rpe_1m_all_pairs_sim3"]) <= LIMIT, run["id"]
        assert round(sim3.coverage.share, 3) == run["coverage"], run["id"]
        assert sim3.coverage.keyframes == run["keyframes"], run["id"]
        if run["id"] == 124:
            assert sim3.outcome == se3.outcome == "Diverged"


@pytest.fixture(scope="module")
def evo(trajectories: Path) -> Any:
    return json.loads((trajectories / "evo_reference.json").read_text())


@pytest.fixture(scope="module")
def associated(trajectories: Path) -> Load:
    @functools.cache
    def load(name: str) -> tuple[Association, Trajectory, Trajectory]:
        truth, estimate = (read_trajectory(trajectories / file) for file in FILES[name])
        pairs = associate(truth, estimate)
        return pairs, truth.select(pairs.reference), estimate.select(pairs.estimate)

    return load


@pytest.mark.parametrize("name", FILES)
def test_association(evo: Any, associated: Load, name: str) -> None:
    pairs, _, _ = associated(name)
    assert len(pairs) == evo[name]["n_assoc"]
    first = sorted((pairs.reference[:10].tolist(), pairs.estimate[:10].tolist()))
    assert first == sorted(evo[name]["assoc_first10"])


@pytest.mark.parametrize("name", FILES)
def test_ape(evo: Any, associated: Load, name: str) -> None:
    _, truth, estimate = associated(name)
    keys = [key for key in evo[name] if key.startswith("ape|") and key not in WITHOUT_PEER]
    assert len(keys) == 18
    for key in keys:
        _, relation, method, *first = key.split("|")
        found = align(truth, estimate, method, int(first[0][1:]) if first else None)
        errors = ape_errors(truth, found.apply(estimate), RELATIONS[relation])
        assert len(errors) == evo[name][key]["n"]
        assert worst(Statistics.of(errors), evo[name][key]) <= LIMIT, key
        if "T" in evo[name][key] and method != "scale":
            np.testing.assert_allclose(found.transform, evo[name][key]["T"], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", FILES)
def test_rpe(evo: Any, associated: Load, name: str) -> None:
    _, truth, estimate = associated(name)
    keys = [key for key in evo[name] if key.startswith("rpe|")]
    assert len(keys) == 29
    for key in keys:
        _, relation, delta, kind, *pairs_from = key.split("|")
        unit = delta.lstrip("0123456789.")
        source = truth if pairs_from == ["pairs_from_ref"] else estimate
        pairs = find_pairs(source, float(delta.removesuffix(unit)), unit, all_pairs=kind == "all")
        errors = rpe_errors(truth, estimate, pairs, RELATIONS[relation])
        assert len(errors) == evo[name][key]["n"], key
        assert worst(Statistics.of(errors), evo[name][key]) <= LIMIT, key


@pytest.mark.parametrize("name", FILES)
def test_interpolated_ground_truth(evo: Any, associated: Load, trajectories: Path, name: str) -> None:
    _, _, estimate = associated(name)
    truth = read_trajectory(trajectories / FILES[name][0])
    found, positions, quaternions = interpolate(truth, estimate.stamps, max_gap_seconds=10.0)
    assert found.all()
    truth = Trajectory(estimate.stamps, positions, quaternions)
    errors = ape_errors(truth, align(truth, estimate, "se3").apply(estimate))
    assert worst(Statistics.of(errors), evo[name]["ape_interp_se3"]) <= LIMIT


def test_several_relative_errors_in_one_call(evo: Any, trajectories: Path) -> None:
    truth, estimate = (read_trajectory(trajectories / file) for file in FILES["fr2_desk"])
    asked = (RpeOptions(10, "frames", "consecutive"), RpeOptions(10, "deg", "consecutive"))
    found = evaluate(truth, estimate, Options(alignment="none", rpe=asked)).rpe
    for error, key in zip(found, ("10frames", "10.0deg"), strict=True):
        assert worst(error.statistics, evo["fr2_desk"][f"rpe|translation_part|{key}|consec"]) <= LIMIT
        assert worst(error.rotation_deg, evo["fr2_desk"][f"rpe|rotation_angle_deg|{key}|consec"]) <= LIMIT
