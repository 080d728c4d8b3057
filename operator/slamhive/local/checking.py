# SPDX-License-Identifier: Apache-2.0
"""Checks of what an Algorithm declares, by running it on a recording with exact ground truth.

Whether something reads each of its parameters shows without a run.

`slamhive algorithm check` prints them.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.analysis.measuring import Subject, measure, read_estimate
from slamhive.local.parameters import parameter_uses
from slamhive.local.runner import Job, Runner
from slamhive.model.algorithm import Poses
from slamhive.model.base import ObjectMeta
from slamhive.model.evaluation import Association, EvaluationSettings
from slamhive.model.results import Outcome, Phase, RunRecord
from slamhive.model.sensors import SensorMode
from slamhive.model.sweep import RunTemplate, Sweep, SweepSpec
from slamhive.plan import Plan, local_uid
from slamhive_eval import Trajectory
from slamhive_eval.rotation import conjugate, rotate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import numpy.typing as npt

    from slamhive.local.catalog import AlgorithmEntry
    from slamhive.local.workbench import Workbench
    from slamhive.model.algorithm import Mode, Output
    from slamhive.model.results import Result
    from slamhive_eval import Relations

_RECORDINGS = {
    SensorMode.LIDAR: "synthetic-lidar",
    SensorMode.LIDAR_INERTIAL: "synthetic-lidar",
}
_CAMERA_RECORDING = "synthetic-camera"
_MAX_SHARE = 0.02
"""An ATE above this share of the path says that something is wrong with the frame, the stamp or the scale."""
_CLEARLY = 0.85
"""A reading of the poses is clearly better than another when its error is below this share of that one's."""
_SHIFTS_SECONDS = (-0.1, -0.05, 0.05, 0.1)


class Answer(enum.Enum):
    """What was found of something that is declared."""

    HOLDS = "true"
    FAILS = "false"
    UNKNOWN = "can't tell"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at, with the figures; where it fails or can't be told, why."""

    answer: Answer
    text: str


class Fit(NamedTuple):
    """How well poses fit the ground truth under one reading of them.

    Attributes:
        metres: RMSE of the ATE.
        degrees: RMSE of its rotations; infinite where there are none.
    """

    metres: float
    degrees: float

    def __str__(self) -> str:
        """Return the figures as people read them."""
        return f"{self.metres:.4f} m, {self.degrees:.2f}°"

    def clearly_better(self, other: Fit) -> bool:
        """Tell whether one figure is clearly better than another's, and the other not clearly worse."""
        pairs = list(zip(self, other, strict=True))
        better = any(own < _CLEARLY * its for own, its in pairs)
        return better and not any(its < _CLEARLY * own for own, its in pairs)


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
    entry = bench.workshop.algorithm(name)
    algorithm = entry.algorithm
    findings = list(_parameters(entry))
    for mode in algorithm.spec.modes:
        records = _run_twice(bench, name, mode)
        failed = [record for record in records if record.phase is not Phase.SUCCEEDED]
        if failed:
            findings += [Finding(Answer.FAILS, f"{mode.name}: {one.reason}: {one.message}") for one in failed]
            continue
        findings += [_repeatable(algorithm.spec.deterministic, mode, records)]
        findings += _meaning(bench, mode, records[-1])
    return findings


def _parameters(entry: AlgorithmEntry) -> Iterator[Finding]:
    """Tell whether something reads each parameter that is declared."""
    if not entry.algorithm.spec.parameters:
        return
    unused, why = parameter_uses(entry)
    if not unused:
        yield Finding(Answer.HOLDS, "parameters: each is named by a template or a program of its folder")
        return
    text = f"parameters: no template and no program in {entry.folder} names {', '.join(unused)}"
    yield Finding(Answer.UNKNOWN, f"{text}; {why}") if why else Finding(Answer.FAILS, text)


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
    equal = len({record.trajectory.sha256 for record in records if record.trajectory}) == 1
    given = "equal" if equal else "different"
    text = f"{mode.name}: deterministic: {declared}; two runs gave {given} trajectories"
    if declared == "Yes":
        return Finding(Answer.HOLDS if equal else Answer.FAILS, text)
    if declared == "No" and not equal:
        return Finding(Answer.HOLDS, text)
    why = "others may differ" if equal else "nothing is declared; it could say No"
    return Finding(Answer.UNKNOWN, f"{text}: {why}")


def _meaning(bench: Workbench, mode: Mode, record: RunRecord) -> Iterator[Finding]:
    """Tell whether poses fit the ground truth, and as declared better than in any other reading of them."""
    algorithm = bench.workshop.algorithm(record.spec["algorithmRef"]["name"]).algorithm
    variant = bench.prepare(record.spec, algorithm)
    truth = bench.truth(record.spec["datasetRef"]["name"])
    result = record.results[0] if record.results else None
    if truth is None or result is None:
        yield Finding(Answer.UNKNOWN, f"{mode.name}: {record.message or 'it was not measured'}")
        return
    estimate = read_estimate(Path(record.folder or "") / "run" / "output" / "trajectory.txt")
    if estimate is None or not result.values.get("ate"):
        yield Finding(Answer.FAILS, f"{mode.name}: {result.outcome}: {result.values.get('message')}")
        return
    frames: dict[str, npt.NDArray[np.float64]] = {"body": np.eye(4)}
    frames |= {role.value: np.array(view.T_body_sensor) for role, view in variant.sensors.items()}
    declared = Declared(mode.name, algorithm.spec.output_of(mode), frames, variant.duration_seconds)
    yield from readings(declared, truth.poses, estimate, result)


@dataclass(frozen=True, eq=False)
class Declared:
    """What an Algorithm says of its poses, and what else they could be.

    Attributes:
        mode: its sensor mode.
        output: what it declares.
        frames: T_body_frame of the frames whose poses they could be, (4, 4) each.
        seconds: length of the recording.
    """

    mode: SensorMode
    output: Output
    frames: Mapping[str, npt.NDArray[np.float64]]
    seconds: float


def readings(
    declared: Declared, truth: Trajectory | Relations, estimate: Trajectory, result: Result
) -> Iterator[Finding]:
    """Compare poses as they are declared with other readings of them: frames, the inverse, moved stamps.

    Args:
        declared: what is declared.
        truth: the ground truth of the body.
        estimate: what the algorithm wrote, converted as declared.
        result: its evaluation, with an ATE.
    """
    mode, output, frames = declared.mode, declared.output, declared.frames

    def fit(frame: str, shift: float = 0.0, poses: Trajectory = estimate) -> Fit:
        settings = EvaluationSettings(association=Association(offset=shift))
        subject = Subject(mode, frames[frame], keyframes=output.poses is Poses.KEYFRAMES)
        values = measure(truth, poses, settings, subject).values
        metres, turn = values.get("ate") or {}, values.get("ateRotationDeg") or {}
        return Fit(metres.get("rmse", np.inf), turn.get("rmse", np.inf))

    length, own = float(result.values["pathLength"]), fit(output.frame)
    share = own.metres / length
    tracked = result.outcome is Outcome.TRACKED and share <= _MAX_SHARE
    why = "" if tracked else f"; {result.values.get('message') or f'more than {_MAX_SHARE:.0%} of the path'}"
    yield Finding(
        Answer.HOLDS if tracked else Answer.FAILS,
        f"{mode}: ATE {own}, {share:.2%} of {length:.1f} m; coverage {result.coverage}{why}",
    )
    others = {
        frame: fit(frame)
        for frame, pose in frames.items()
        if not np.allclose(pose, frames[output.frame], atol=1e-6)
    }
    # Where poses are bad in every reading, which of them is least so says nothing.
    bad = min(found.metres for found in (own, *others.values())) > _MAX_SHARE * length
    yield _compared(f"{mode}: frame {output.frame}", own, others, hidden=bad)
    turned_around = fit(output.frame, poses=inverse(estimate))
    bad = min(own.metres, turned_around.metres) > _MAX_SHARE * length
    was = "inverted as declared" if output.trajectory and output.trajectory.inverted else "not inverted"
    yield _compared(f"{mode}: poses {was}", own, {"the inverse": turned_around}, hidden=bad)
    moved = {shift: fit(output.frame, shift) for shift in _SHIFTS_SECONDS}
    nearest = min(moved, key=moved.__getitem__)
    # Drift as large as what a shift does hides it.
    hidden = own.metres > abs(nearest) * length / declared.seconds
    named = {f"{shift:+.2f} s": other for shift, other in moved.items()}
    yield _compared(f"{mode}: stamp {output.stamp}", own, named, hidden=hidden)


def inverse(estimate: Trajectory) -> Trajectory:
    """Return the inverse of each pose: the world's in the body's frame, or the other way round."""
    back = conjugate(estimate.quaternions)
    return Trajectory(estimate.stamps, -rotate(back, estimate.positions), back)


def _compared(what: str, own: Fit, others: Mapping[str, Fit], *, hidden: bool = False) -> Finding:
    """Say whether what is declared fits better than all others.

    Args:
        what: what is declared.
        own: how well it fits.
        others: how well others fit, by name.
        hidden: whether the drift is too large to tell.
    """
    told = f"{what}: {own}"
    if not others:
        return Finding(Answer.HOLDS, f"{told}; there is no other to compare with")
    best = min(others, key=others.__getitem__)
    if hidden:
        return Finding(Answer.UNKNOWN, f"{told}; as {best}: {others[best]}; the drift is too large to tell")
    better = [name for name, other in others.items() if other.clearly_better(own)]
    if better:
        best = min(better, key=others.__getitem__)
        return Finding(Answer.FAILS, f"{told}; {best} fits better: {others[best]}")
    close = [name for name, other in others.items() if not own.clearly_better(other)]
    if close:
        best = min(close, key=others.__getitem__)
        return Finding(Answer.UNKNOWN, f"{told}; {best} fits about as well: {others[best]}")
    return Finding(Answer.HOLDS, f"{told}; the next best, {best}: {others[best]}")
