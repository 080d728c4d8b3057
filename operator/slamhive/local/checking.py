# SPDX-License-Identifier: Apache-2.0
"""Whether what an Algorithm declares is true, found out on a recording whose ground truth is exact."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.measuring import Subject, measure
from slamhive.local.runner import Job, Runner
from slamhive.model.algorithm import Poses
from slamhive.model.base import ObjectMeta
from slamhive.model.evaluation import Association, EvaluationSettings
from slamhive.model.results import Outcome, Phase, RunRecord
from slamhive.model.sensors import SensorMode
from slamhive.model.sweep import RunTemplate, Sweep, SweepSpec
from slamhive.plan import Plan, local_uid
from slamhive_eval import read_tum

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy.typing as npt

    from slamhive.local.workbench import Workbench
    from slamhive.model.algorithm import Mode

_RECORDINGS = {
    SensorMode.LIDAR: "synthetic-lidar",
    SensorMode.LIDAR_INERTIAL: "synthetic-lidar",
}
_CAMERA_RECORDING = "synthetic-camera"
_MAX_SHARE = 0.02
"""An ATE above this share of the path says that something is wrong with the frame, the stamp or the scale."""
_CLEARLY = 0.85
"""Another reading of the poses is better when its ATE is below this share of the declared one's."""
_SHIFTS_SECONDS = (-0.1, -0.05, 0.05, 0.1)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    holds: bool
    text: str


class _Silent:
    """A watcher that shows nothing."""

    def phase(self, job: Job, index: int, phase: Phase) -> None:
        """Show nothing."""

    def finished(self, job: Job, record: RunRecord) -> None:
        """Show nothing."""

    def tick(self, jobs: Sequence[Job]) -> None:
        """Show nothing."""


def check_algorithm(bench: Workbench, name: str) -> list[Finding]:
    """Run an algorithm twice in each of its modes and compare what it wrote with what it declares.

    Raises:
        InputError: there is no algorithm of that name.
    """
    algorithm = bench.workshop.algorithm(name).algorithm
    findings: list[Finding] = []
    for mode in algorithm.spec.modes:
        records = _run_twice(bench, name, mode)
        failed = [record for record in records if record.phase is not Phase.SUCCEEDED]
        if failed:
            findings += [Finding(False, f"{mode.name}: {one.reason}: {one.message}") for one in failed]
            continue
        findings += [_repeatable(algorithm.spec.deterministic, mode, records)]
        findings += _meaning(bench, mode, records[-1])
    return findings


def _run_twice(bench: Workbench, name: str, mode: Mode) -> list[RunRecord]:
    template = {
        "algorithmRef": {"name": name},
        "datasetRef": {"name": _RECORDINGS.get(mode.name, _CAMERA_RECORDING)},
        "sensors": mode.name.value,
        "timeout": "30m",
    }
    metadata = ObjectMeta(name=f"check-{name}-{mode.name}")
    sweep = Sweep(metadata=metadata, spec=SweepSpec(template=RunTemplate(spec=template)))
    records = []
    for _ in range(2):
        job = Job(sweep, local_uid(sweep), Plan(sweep, bench.workshop))
        Runner(bench, _Silent(), parallelism=1, rerun=True).run([job])
        record = bench.archive.get(job.run_uid(0))
        if record is not None:
            records.append(record)
    return records


def _repeatable(declared: str, mode: Mode, records: list[RunRecord]) -> Finding:
    sums = {record.trajectory.sha256 for record in records if record.trajectory}
    equal = len(sums) == 1
    given = "equal" if equal else "different"
    text = f"{mode.name}: deterministic: {declared}; two runs gave {given} trajectories"
    return Finding(declared != "Yes" or equal, text)


def _meaning(bench: Workbench, mode: Mode, record: RunRecord) -> Iterator[Finding]:
    """Tell whether poses fit the declared frame and instant better than any other."""
    algorithm = bench.workshop.algorithm(record.spec["algorithmRef"]["name"]).algorithm
    output = algorithm.spec.output_of(mode)
    variant = bench.prepare(record.spec, algorithm)
    truth = bench.evaluator.truth(record.spec["datasetRef"]["name"])
    if truth is None:
        return
    poses = truth.poses
    estimate = read_tum(Path(record.folder or "") / "run" / "output" / "trajectory.txt")
    frames: dict[str, npt.NDArray[np.float64]] = {"body": np.eye(4)}
    frames |= {role.value: np.array(view.T_body_sensor) for role, view in variant.sensors.items()}

    def error(frame: str, shift: float = 0.0) -> float:
        settings = EvaluationSettings(association=Association(offset=shift))
        subject = Subject(mode.name, frames[frame], keyframes=output.poses is Poses.KEYFRAMES)
        values = measure(poses, estimate, settings, subject).values
        return float(values["ate"]["rmse"]) if values.get("ate") else float("inf")

    result = record.results[0] if record.results else None
    length = float(result.values["pathLength"]) if result else float("nan")
    own = error(output.frame)
    share = own / length
    tracked = result is not None and result.outcome is Outcome.TRACKED
    coverage = result.coverage if result else None
    yield Finding(
        tracked and share <= _MAX_SHARE,
        f"{mode.name}: ATE {own:.4f} m, {share:.2%} of {length:.1f} m; coverage {coverage}",
    )
    better = {frame: error(frame) for frame in frames if frame != output.frame}
    best = min(better, key=lambda frame: better[frame], default=output.frame)
    yield Finding(
        better.get(best, own) >= _CLEARLY * own,
        f"{mode.name}: frame {output.frame}: ATE {own:.4f} m; as {best}: {better.get(best, own):.4f} m",
    )
    moved = {shift: error(output.frame, shift) for shift in _SHIFTS_SECONDS}
    nearest = min(moved, key=lambda shift: moved[shift])
    # Drift as large as what a shift does hides it.
    visible = abs(nearest) * length / variant.duration_seconds
    text = f"{mode.name}: stamp {output.stamp}: ATE {own:.4f} m; {nearest:+.2f} s: {moved[nearest]:.4f} m"
    if own > visible:
        yield Finding(True, f"{text}; the drift is too large to tell")
    else:
        yield Finding(moved[nearest] >= _CLEARLY * own, text)
