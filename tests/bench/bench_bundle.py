# SPDX-License-Identifier: Apache-2.0
"""Verifying a bundle beside evaluating its trajectories alone, in runs a second on all processors.

Unpacking, checksums and the comparison of every figure are part of the one and not of the other, which is
what ``slamhive-eval batch`` does. Both by turns.

Run: python tests/bench/bench_bundle.py
"""

from __future__ import annotations

import json
import os
import tempfile
import time
import zipfile
from pathlib import Path
from statistics import median

import numpy as np

from slamhive import __version__
from slamhive.analysis.measuring import Subject, measure, options, settings_hash
from slamhive.analysis.subjects import SubjectItem
from slamhive.bridges.bundles.contents import (
    MEASURED,
    METADATA,
    STUDY,
    BundledRun,
    BundledStudy,
    StudyAlgorithm,
    StudyDataset,
    truth_sha256,
)
from slamhive.bridges.bundles.opening import opened_bundle
from slamhive.bridges.bundles.verifying import verify
from slamhive.cli.parts.console import open_workbench
from slamhive.data.recordings.entries import file_sha256
from slamhive.local.home.folder import Home
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import Phase, RunRecord, TrajectoryInfo
from slamhive.model.sensors import SensorMode
from slamhive_eval import Trajectory, read_tum, write_tum
from slamhive_eval.batch import Pair, evaluate_pairs

ROOT = Path(__file__).parents[2]
RUNS, POSES, ROUNDS, TARGET = 200, 3000, 5, 0.8
SETTINGS = EvaluationSettings()
SUBJECT = Subject(SensorMode.LIDAR)


def trajectories(folder: Path) -> tuple[Path, list[Path]]:
    """Write ground truth and estimates of it."""
    random = np.random.default_rng(1)
    stamps = 1.6e9 + np.arange(POSES) / 20
    positions = np.cumsum(random.normal(0.05, 0.02, (POSES, 3)), axis=0)
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (POSES, 1))
    truth = folder / "truths" / "hall.txt"
    truth.parent.mkdir()
    write_tum(truth, Trajectory(stamps, positions, quaternions))
    found = []
    for number in range(RUNS):
        path = folder / "bundle" / "runs" / f"run-{number}" / "trajectory.txt"
        path.parent.mkdir(parents=True)
        write_tum(path, Trajectory(stamps, positions + random.normal(0, 0.03, (POSES, 3)), quaternions))
        found.append(path)
    return truth, found


def bundled(folder: Path, truth: Path, paths: list[Path]) -> Path:
    """Write the bundle of runs with these trajectories."""
    root, poses = folder / "bundle", read_tum(truth)
    algorithm, dataset = "manifests/algorithms/icp-0.yaml", "manifests/datasets/hall-0.yaml"
    written = {
        METADATA: "{}",
        algorithm: (ROOT / "images" / "algorithms" / "kiss-icp" / "algorithm.yaml").read_text(),
        dataset: (ROOT / "examples" / "datasets" / "synthetic-lidar.yaml").read_text(),
    }
    for name, text in written.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    for path in paths:
        record = RunRecord(
            uid=path.parent.name,
            name=path.parent.name,
            spec={"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}, "sensors": "lidar"},
            phase=Phase.SUCCEEDED,
            trajectory=TrajectoryInfo(
                poses=POSES, duration_seconds=0, sha256=file_sha256(path), path="trajectory.txt"
            ),
            results=[measure(poses, read_tum(path), SETTINGS, SUBJECT)],
        )
        run = BundledRun(record=record, algorithm=algorithm, dataset=dataset, subject=SubjectItem.of(SUBJECT))
        (path.parent / "run.json").write_text(json.dumps(run.as_json()))
    files = {str(one.relative_to(root)): file_sha256(one) for one in root.rglob("*") if one.is_file()}
    study = BundledStudy(
        name="s",
        title="Bench",
        slamhive=__version__,
        sweep={},
        settings={settings_hash(SETTINGS): SETTINGS},
        algorithms=[StudyAlgorithm(name="icp", manifest=algorithm)],
        datasets=[StudyDataset(name="hall", manifest=dataset, truth=truth_sha256(poses))],
        files=files,
    )
    (root / STUDY).write_text(json.dumps(study.as_json()))
    path = folder / "study.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for one in root.rglob("*"):
            if one.is_file():
                archive.write(one, one.relative_to(root))
    return path


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth, paths = trajectories(folder)
        study = bundled(folder, truth, paths)
        pairs = [Pair(str(truth), str(path)) for path in paths]
        bench = open_workbench(Home.at(folder / "home"))
        ours, alone = [], []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            assert not any("error" in one for one in evaluate_pairs(pairs, [options(SETTINGS, SUBJECT)]))
            alone.append(time.perf_counter() - start)
            start = time.perf_counter()
            with opened_bundle(study, later=MEASURED) as opened:
                found = verify(bench, opened, truth.parent)
            ours.append(time.perf_counter() - start)
            assert found.results == RUNS
            assert not found.mismatches
        bench.archive.close()
    rate, peer = (RUNS / median(seconds) for seconds in (ours, alone))
    cores = len(os.sched_getaffinity(0))
    print(
        f"verify {RUNS} runs of {POSES} poses, {cores} cores · {rate:.1f} runs/s, {rate / peer:.2f} of batch "
        f"· batch alone {peer:.1f} runs/s, at least {TARGET:g} of it"
    )


if __name__ == "__main__":
    main()
